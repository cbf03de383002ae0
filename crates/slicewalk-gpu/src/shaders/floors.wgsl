// The highest floor under boxes: integers alone decide.
//
// A question: first and last pixel along x and y, least and greatest top that count. An answer: the top or one of
// the three numbers below, plus 4.

const END: u32 = 16320u;
const NO_FLOOR: i32 = -1;
const FLOOR_NOT_LOADED: i32 = -2;
const FLOOR_UNDECIDED: i32 = -3;

// Whether floor that ends at a page's end in pixel (`x`, `y`) continues in the page above.
fn goes_on(above: vec4<u32>, x: u32, y: u32) -> bool {
    if above.w == NONE {
        return (above.y & 1u) != 0u;
    }
    let record = record_of(above.w, (y >> 3u) * 8u + (x >> 3u));
    if record == NONE {
        return false;
    }
    let end = row_of(record, (y & 7u) + 1u);
    for (var at = row_of(record, y & 7u); at < end; at++) {
        if is_spent() {
            break;
        }
        let span = words[at];
        if lane_of(span) == (x & 7u) {
            // The lowest span of the pixel.
            return bottom_of(span) == 0u && (span & OBSTACLE) == 0u;
        }
    }
    return false;
}

// The highest top of a union of floor spans that begins at or below `limit`, plus 1; 0 without one. The top itself may lie
// above `limit`.
fn highest_union(record: u32, limit: u32) -> u32 {
    let first = words[record + 2u];
    let end = first + (words[record + 3u] & 0xffffu);
    var highest = 0u;
    for (var at = first; at < end; at++) {
        if is_spent() {
            break;
        }
        let span = words[at];
        if bottom_of(span) > limit {
            break;
        }
        if (span & OBSTACLE) == 0u {
            highest = max(highest, top_of(span) + 1u);
        }
    }
    return highest;
}

// The highest top of floor from `least` to `limit`, plus 1; 0 without one. `above` is the number of the slot of the page
// above, or NONE.
fn highest_top(page: u32, x: vec2<u32>, y: vec2<u32>, least: u32, limit: u32, above: u32) -> u32 {
    var highest = 0u;
    for (var by = y.x >> 3u; by <= y.y >> 3u; by++) {
        if is_spent() {
            break;
        }
        for (var bx = x.x >> 3u; bx <= x.y >> 3u; bx++) {
            if is_spent() {
                break;
            }
            let record = record_of(page, by * 8u + bx);
            if record == NONE {
                continue;
            }
            let by_union = highest_union(record, limit);
            if by_union <= max(least, highest) {
                continue;
            }
            let columns = vec2<u32>(max(x.x, bx * 8u), min(x.y, bx * 8u + 7u)) - vec2<u32>(bx * 8u);
            let rows = vec2<u32>(max(y.x, by * 8u), min(y.y, by * 8u + 7u)) - vec2<u32>(by * 8u);
            // A top below the limit and the page's end is that of a span; all of the block's pixels count.
            if columns.x == 0u && columns.y == 7u && rows.x == 0u && rows.y == 7u && by_union <= min(limit, END - 1u) + 1u {
                highest = by_union;
                continue;
            }
            for (var row = rows.x; row <= rows.y && highest < by_union; row++) {
                if is_spent() {
                    break;
                }
                let end = row_of(record, row + 1u);
                for (var at = row_of(record, row); at < end; at++) {
                    if is_spent() {
                        break;
                    }
                    let span = words[at];
                    let lane = lane_of(span);
                    let top = top_of(span);
                    if lane < columns.x || lane > columns.y || (span & OBSTACLE) != 0u || top > limit || top < max(least, highest) {
                        continue;
                    }
                    if i32(top) == PAGE_QUANTA && above != NONE {
                        if goes_on(slots[above], bx * 8u + lane, by * 8u + row) {
                            continue;
                        }
                    }
                    highest = top + 1u;
                }
            }
        }
    }
    return highest;
}

@compute @workgroup_size(64)
fn floors(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= batch.count {
        return;
    }
    let at = id.x * 6u;
    let i = vec2<i32>(integer(at), integer(at + 1u));
    let j = vec2<i32>(integer(at + 2u), integer(at + 3u));
    var least = integer(at + 4u);
    let limit = integer(at + 5u);
    var best = NO_FLOOR;
    // The second pass looks whether a missing page can hold a higher floor than the one found.
    for (var pass_number = 0; pass_number < 2; pass_number++) {
        if is_spent() {
            break;
        }
        var missing = false;
        for (var ty = j.x >> 6u; ty <= j.y >> 6u; ty++) {
            if is_spent() {
                break;
            }
            let y = part(j, ty * 64, 64);
            for (var tx = i.x >> 6u; tx <= i.y >> 6u; tx++) {
                if is_spent() {
                    break;
                }
                let x = part(i, tx * 64, 64);
                let column = column_of(tx, ty);
                for (var left = column.y; left > 0u && least <= limit; left--) {
                    if is_spent() {
                        break;
                    }
                    let number = column.x + left - 1u;
                    let slot = slots[number];
                    let base = i32(slot.x) * PAGE_QUANTA;
                    if !is_near(base, least, limit) {
                        continue;
                    }
                    let lowest = local(least, base);
                    let highest = local(limit, base);
                    if !is_occupied(slot, lowest, highest) {
                        continue;
                    }
                    if slot.w == NONE {
                        missing = true;
                    } else if pass_number == 0 {
                        var above = NONE;
                        if left < column.y {
                            if slots[number + 1u].x == slot.x + 1u {
                                above = number + 1u;
                            }
                        }
                        let top = highest_top(slot.w, x, y, lowest, highest, above);
                        if top > 0u {
                            best = base + i32(top) - 1;
                            least = best + 1;
                        }
                    }
                }
            }
        }
        if !missing {
            break;
        }
        if pass_number == 1 || best == NO_FLOOR {
            best = FLOOR_NOT_LOADED;
            break;
        }
    }
    answers[id.x] = bitcast<u32>(select(best, FLOOR_UNDECIDED, spent > batch.budget) + 4);
}

// Boxes against pages: integers alone decide.
//
// A question: first and last pixel along x and y, lowest and highest height.

fn box_meets(page: u32, x: vec2<u32>, y: vec2<u32>, low: u32, high: u32) -> bool {
    for (var by = y.x >> 3u; by <= y.y >> 3u; by++) {
        if is_spent() {
            break;
        }
        for (var bx = x.x >> 3u; bx <= x.y >> 3u; bx++) {
            if is_spent() {
                break;
            }
            let record = record_of(page, by * 8u + bx);
            if record == NONE || !unions_meet(record, low, high) {
                continue;
            }
            let columns = vec2<u32>(max(x.x, bx * 8u), min(x.y, bx * 8u + 7u)) - vec2<u32>(bx * 8u);
            let rows = vec2<u32>(max(y.x, by * 8u), min(y.y, by * 8u + 7u)) - vec2<u32>(by * 8u);
            if columns.x == 0u && columns.y == 7u && rows.x == 0u && rows.y == 7u {
                return true;
            }
            let end = row_of(record, rows.y + 1u);
            for (var at = row_of(record, rows.x); at < end; at++) {
                if is_spent() {
                    break;
                }
                let span = words[at];
                let lane = lane_of(span);
                if lane >= columns.x && lane <= columns.y && meets(span, low, high) {
                    return true;
                }
            }
        }
    }
    return false;
}

@compute @workgroup_size(64)
fn boxes(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= batch.count {
        return;
    }
    let at = id.x * 6u;
    let i = vec2<i32>(integer(at), integer(at + 1u));
    let j = vec2<i32>(integer(at + 2u), integer(at + 3u));
    let low = integer(at + 4u);
    let high = integer(at + 5u);
    var answer = CLEAR;
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
            for (var number = 0u; number < column.y; number++) {
                if is_spent() {
                    break;
                }
                let slot = slots[column.x + number];
                let base = i32(slot.x) * PAGE_QUANTA;
                if !is_near(base, low, high) {
                    continue;
                }
                let lowest = local(low, base);
                let highest = local(high, base);
                if !is_occupied(slot, lowest, highest) {
                    continue;
                }
                if slot.w == NONE {
                    answer = NOT_LOADED;
                } else if box_meets(slot.w, x, y, lowest, highest) {
                    answers[id.x] = HIT;
                    return;
                }
            }
        }
    }
    answers[id.x] = select(answer, UNDECIDED, spent > batch.budget);
}

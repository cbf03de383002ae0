// The pixel and the spans that a ray hits first. Positions along the ray are computed in single precision. Cells grown by a
// margin hold every pixel that the ray may meet, cells shrunk by it only those that it certainly meets. If both agree on
// the first hit, the processor computes its distance; otherwise it searches itself.
//
// A question: the ray's begin as a pixel, a pixel and a quantum, with the fraction of each; its speed along the axes
// (per unit of length), and the inverses; its length at most and at least; the margins across and along z.
// An answer: 1 (nothing), NONE (undecided), or the slot plus 2; then the pixel in its tile (6 bits for each axis), the
// first span in its column and the number of spans (10 bits each).

const QUESTION: u32 = 16u;
// Most spans of a column that an answer can name.
const MOST_SPANS: u32 = 1023u;

var<private> origin: vec3<i32>;
var<private> fraction: vec3<f32>;
var<private> speed: vec3<f32>;
var<private> inverse: vec3<f32>;
// The ray may end at the first and certainly does not end before the second.
var<private> longest: f32;
var<private> shortest: f32;
var<private> margin: f32;
var<private> margin_z: f32;
// Axis along which the ray crosses more pixels.
var<private> major: u32;
// No first hit lies behind this length.
var<private> until: f32;
var<private> found: bool;
var<private> unsure: bool;
var<private> hit: vec2<u32>;

// Part of the lengths `along` in which the ray lies between two edges, moved outward by `grow`.
fn clip(axis: u32, low: i32, high: i32, grow: f32, along: vec2<f32>) -> vec2<f32> {
    let a = (f32(low - origin[axis]) - fraction[axis] - grow) * inverse[axis];
    let b = (f32(high - origin[axis]) - fraction[axis] + grow) * inverse[axis];
    return vec2<f32>(max(along.x, min(a, b)), min(along.y, max(a, b)));
}

// First and last cell of `1 << shift` pixels that the ray may meet, within `first` to `last`.
fn cells(axis: u32, shift: u32, along: vec2<f32>, first: i32, last: i32) -> vec2<i32> {
    let a = fraction[axis] + speed[axis] * along.x;
    let b = fraction[axis] + speed[axis] * along.y;
    let low = origin[axis] + i32(floor(min(a, b) - margin));
    let high = origin[axis] + i32(floor(max(a, b) + margin));
    return vec2<i32>(max(low >> shift, first), min(high >> shift, last));
}

// Lowest and highest quantum that the ray meets, with its heights grown by `grow`.
fn heights(along: vec2<f32>, grow: f32) -> vec2<i32> {
    let a = fraction.z + speed.z * along.x;
    let b = fraction.z + speed.z * along.y;
    return vec2<i32>(origin.z + i32(ceil(min(a, b) - grow)), origin.z + i32(floor(max(a, b) + grow)));
}

// Cell `number` of `ends` in the order of the ray.
fn in_order(axis: u32, ends: vec2<i32>, number: i32) -> i32 {
    return select(ends.x + number, ends.y - number, speed[axis] < 0.0);
}

// Whether the ray meets a cell between the lengths `along` and no hit lies before it.
fn is_open(along: vec2<f32>) -> bool {
    return along.x <= along.y && along.x <= until;
}

// Upper bound of the length at which the ray meets a span, which it certainly meets between the lengths `along`.
fn length_to(bottom: i32, top: i32, along: vec2<f32>) -> f32 {
    let low = f32(bottom - origin.z) - fraction.z;
    let high = f32(top - origin.z) - fraction.z;
    let begin = speed.z * along.x;
    if begin >= low + margin_z && begin <= high - margin_z {
        return along.x;
    }
    if speed.z > 0.0 && begin < low + margin_z {
        return clamp((low + margin_z) * inverse.z, along.x, along.y);
    }
    if speed.z < 0.0 && begin > high - margin_z {
        return clamp((high - margin_z) * inverse.z, along.x, along.y);
    }
    return along.y;
}

fn visit_pixel(number: u32, base: i32, record: u32, i: i32, j: i32, along: vec2<f32>) {
    let all = heights(along, margin_z) - vec2<i32>(base);
    if all.y < 0 || all.x > PAGE_QUANTA {
        return;
    }
    let lowest = u32(max(all.x, 0));
    let highest = u32(all.y);
    let sure_part = vec2<f32>(along.x, min(along.y, shortest));
    let sure = clip(1u, j, j + 1, -margin, clip(0u, i, i + 1, -margin, sure_part));
    let sure_heights = heights(sure, -margin_z) - vec2<i32>(base);
    let lane = bitcast<u32>(i) & 7u;
    let row = bitcast<u32>(j) & 7u;
    let end = row_of(record, row + 1u);
    var index = 0u;
    var first = 0u;
    var count = 0u;
    var nearest = longest;
    for (var at = row_of(record, row); at < end; at++) {
        if is_spent() {
            break;
        }
        let span = words[at];
        if lane_of(span) < lane {
            continue;
        }
        if lane_of(span) > lane {
            break;
        }
        if meets(span, lowest, highest) {
            let bottom = i32(bottom_of(span));
            let top = i32(top_of(span));
            if !(sure.x <= sure.y) || bottom > sure_heights.y || top < sure_heights.x || index >= MOST_SPANS {
                unsure = true;
                return;
            }
            if count == 0u {
                first = index;
            }
            count = index - first + 1u;
            nearest = min(nearest, length_to(base + bottom, base + top, sure));
        }
        index++;
    }
    if count == 0u {
        return;
    }
    if found {
        unsure = true;
        return;
    }
    found = true;
    until = nearest;
    hit = vec2<u32>(number + 2u, (bitcast<u32>(i) & 63u) | ((bitcast<u32>(j) & 63u) << 6u) | (first << 12u) | (count << 22u));
}

fn visit_block(number: u32, base: i32, record: u32, corner: vec2<i32>, along: vec2<f32>) {
    let minor = 1u - major;
    let rows = cells(major, 0u, along, corner[major], corner[major] + 7);
    for (var n = 0; n <= rows.y - rows.x; n++) {
        if is_spent() {
            break;
        }
        let row = in_order(major, rows, n);
        let in_row = clip(major, row, row + 1, margin, along);
        if !is_open(in_row) {
            continue;
        }
        let line = cells(minor, 0u, in_row, corner[minor], corner[minor] + 7);
        for (var m = 0; m <= line.y - line.x; m++) {
            if is_spent() {
                break;
            }
            let cell = in_order(minor, line, m);
            let in_cell = clip(minor, cell, cell + 1, margin, in_row);
            if !is_open(in_cell) {
                continue;
            }
            let pixel = select(vec2<i32>(cell, row), vec2<i32>(row, cell), major == 0u);
            let bit = (bitcast<u32>(pixel.y) & 7u) * 8u + (bitcast<u32>(pixel.x) & 7u);
            if ((words[record + (bit >> 5u)] >> (bit & 31u)) & 1u) == 0u {
                continue;
            }
            visit_pixel(number, base, record, pixel.x, pixel.y, in_cell);
            if unsure {
                return;
            }
        }
    }
}

fn visit_page(number: u32, base: i32, page: u32, corner: vec2<i32>, along: vec2<f32>) {
    let minor = 1u - major;
    let rows = cells(major, 3u, along, corner[major] >> 3u, (corner[major] >> 3u) + 7);
    for (var n = 0; n <= rows.y - rows.x; n++) {
        if is_spent() {
            break;
        }
        let row = in_order(major, rows, n);
        let in_row = clip(major, row * 8, row * 8 + 8, margin, along);
        if !is_open(in_row) {
            continue;
        }
        let line = cells(minor, 3u, in_row, corner[minor] >> 3u, (corner[minor] >> 3u) + 7);
        for (var m = 0; m <= line.y - line.x; m++) {
            if is_spent() {
                break;
            }
            let cell = in_order(minor, line, m);
            let in_cell = clip(minor, cell * 8, cell * 8 + 8, margin, in_row);
            if !is_open(in_cell) {
                continue;
            }
            let block = select(vec2<i32>(cell, row), vec2<i32>(row, cell), major == 0u);
            let record = record_of(page, (bitcast<u32>(block.y) & 7u) * 8u + (bitcast<u32>(block.x) & 7u));
            if record == NONE {
                continue;
            }
            let all = heights(in_cell, margin_z) - vec2<i32>(base);
            if all.y < 0 || all.x > PAGE_QUANTA || !unions_meet(record, u32(max(all.x, 0)), u32(all.y)) {
                continue;
            }
            visit_block(number, base, record, block * 8, in_cell);
            if unsure {
                return;
            }
        }
    }
}

// Part of the lengths `along` in which the ray may meet the page with its floor at `base`.
fn clip_z(base: i32, along: vec2<f32>) -> vec2<f32> {
    let a = (f32(base - origin.z) - fraction.z - margin_z) * inverse.z;
    let b = (f32(base + PAGE_QUANTA - origin.z) - fraction.z + margin_z) * inverse.z;
    return vec2<f32>(max(along.x, min(a, b)), min(along.y, max(a, b)));
}

fn visit_tile(tx: i32, ty: i32, along: vec2<f32>) {
    let column = column_of(tx, ty);
    if column.y == 0u {
        return;
    }
    let all = heights(along, margin_z);
    for (var n = 0u; n < column.y; n++) {
        if is_spent() {
            break;
        }
        let number = column.x + select(n, column.y - 1u - n, speed.z < 0.0);
        let slot = slots[number];
        let base = i32(slot.x) * PAGE_QUANTA;
        if !is_near(base, all.x, all.y) || !is_occupied(slot, local(all.x, base), local(all.y, base)) {
            continue;
        }
        // A steep ray meets the pages of a tile one after another.
        var part_of = along;
        if speed.z != 0.0 {
            part_of = clip_z(base, along);
        }
        if !is_open(part_of) {
            continue;
        }
        if slot.w == NONE {
            unsure = true;
            return;
        }
        visit_page(number, base, slot.w, vec2<i32>(tx * 64, ty * 64), part_of);
        if unsure {
            return;
        }
    }
}

@compute @workgroup_size(64)
fn rays(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= batch.count {
        return;
    }
    let at = id.x * QUESTION;
    origin = vec3<i32>(integer(at), integer(at + 1u), integer(at + 2u));
    fraction = vec3<f32>(real(at + 3u), real(at + 4u), real(at + 5u));
    speed = vec3<f32>(real(at + 6u), real(at + 7u), real(at + 8u));
    inverse = vec3<f32>(real(at + 9u), real(at + 10u), real(at + 11u));
    longest = real(at + 12u);
    shortest = real(at + 13u);
    margin = real(at + 14u);
    margin_z = real(at + 15u);
    major = select(0u, 1u, abs(speed.y) > abs(speed.x));
    until = longest;
    found = false;
    unsure = false;
    hit = vec2<u32>(1u, 0u);
    let minor = 1u - major;
    let along = vec2<f32>(0.0, longest);
    let rows = cells(major, 6u, along, 0, batch.tiles[major] - 1);
    for (var n = 0; n <= rows.y - rows.x; n++) {
        if is_spent() {
            break;
        }
        let row = in_order(major, rows, n);
        let in_row = clip(major, row * 64, row * 64 + 64, margin, along);
        if !is_open(in_row) {
            continue;
        }
        let line = cells(minor, 6u, in_row, 0, batch.tiles[minor] - 1);
        for (var m = 0; m <= line.y - line.x; m++) {
            if is_spent() {
                break;
            }
            let cell = in_order(minor, line, m);
            let in_cell = clip(minor, cell * 64, cell * 64 + 64, margin, in_row);
            if !is_open(in_cell) || unsure {
                continue;
            }
            let tile = select(vec2<i32>(cell, row), vec2<i32>(row, cell), major == 0u);
            visit_tile(tile.x, tile.y, in_cell);
        }
    }
    answers[2u * id.x] = select(hit.x, NONE, unsure || spent > batch.budget);
    answers[2u * id.x + 1u] = hit.y;
}

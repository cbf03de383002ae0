// Upright cylinders and spheres against pages. Distances are computed in single precision, and each span is certainly
// inside, certainly outside, or undecided; the margins between the two squares of the radius cover every rounding error.
//
// A question: first and last pixel along x and y, lowest and highest height; the middle as a pixel, a pixel and a
// quantum, with the fraction of each; a lower and an upper bound of the square of the radius (pixels).

var<private> middle: vec3<i32>;
var<private> fraction: vec3<f32>;
// Whether the shape is a cylinder.
var<private> upright: bool;
// Bounds of the square of the radius.
var<private> inner: f32;
var<private> outer: f32;

// Distance of the middle from `low` to `high` along an axis.
fn gap(axis: u32, low: i32, high: i32) -> f32 {
    let before = f32(low - middle[axis]) - fraction[axis];
    let behind = fraction[axis] - f32(high - middle[axis]);
    return max(max(before, behind), 0.0);
}

// Distance of the middle to the farther end.
fn reach(axis: u32, low: i32, high: i32) -> f32 {
    return max(fraction[axis] - f32(low - middle[axis]), f32(high - middle[axis]) - fraction[axis]);
}

// Square of the distance along z to a span of the page with its floor at `base`.
fn rise(span: u32, base: i32) -> f32 {
    let across = gap(2u, base + i32(bottom_of(span)), base + i32(top_of(span))) * batch.quantum;
    return across * across;
}

// HIT, UNDECIDED or CLEAR for a page whose first pixel is `corner`.
fn meets_page(page: u32, corner: vec2<i32>, x: vec2<u32>, y: vec2<u32>, base: i32, low: u32, high: u32) -> u32 {
    var answer = CLEAR;
    for (var by = y.x >> 3u; by <= y.y >> 3u; by++) {
        if is_spent() {
            break;
        }
        let row = corner.y + i32(by) * 8;
        let dy = gap(1u, row, row + 8);
        for (var bx = x.x >> 3u; bx <= x.y >> 3u; bx++) {
            if is_spent() {
                break;
            }
            let record = record_of(page, by * 8u + bx);
            if record == NONE {
                continue;
            }
            let lane = corner.x + i32(bx) * 8;
            let dx = gap(0u, lane, lane + 8);
            if dx * dx + dy * dy > outer || !unions_meet(record, low, high) {
                continue;
            }
            if upright {
                let far_x = reach(0u, lane, lane + 8);
                let far_y = reach(1u, row, row + 8);
                if far_x * far_x + far_y * far_y <= inner {
                    return HIT;
                }
            }
            for (var dj = 0u; dj < 8u; dj++) {
                if is_spent() {
                    break;
                }
                let j = row + i32(dj);
                let across = gap(1u, j, j + 1);
                if across * across > outer {
                    continue;
                }
                let end = row_of(record, dj + 1u);
                for (var at = row_of(record, dj); at < end; at++) {
                    if is_spent() {
                        break;
                    }
                    let span = words[at];
                    if !meets(span, low, high) {
                        continue;
                    }
                    let i = lane + i32(lane_of(span));
                    let along = gap(0u, i, i + 1);
                    var square = across * across + along * along;
                    if !upright {
                        square += rise(span, base);
                    }
                    if square <= inner {
                        return HIT;
                    }
                    if square <= outer {
                        answer = UNDECIDED;
                    }
                }
            }
        }
    }
    return answer;
}

fn answer_round(number: u32) {
    let at = number * 14u;
    middle = vec3<i32>(integer(at + 6u), integer(at + 7u), integer(at + 8u));
    fraction = vec3<f32>(real(at + 9u), real(at + 10u), real(at + 11u));
    inner = real(at + 12u);
    outer = real(at + 13u);
    answer_shape(number, at);
}

@compute @workgroup_size(64)
fn cylinders(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < batch.count {
        upright = true;
        answer_round(id.x);
    }
}

@compute @workgroup_size(64)
fn spheres(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < batch.count {
        upright = false;
        answer_round(id.x);
    }
}

// Boxes against pages: integers alone decide.
//
// A question: first and last pixel along x and y, lowest and highest height.

// HIT or CLEAR for a page.
fn meets_page(page: u32, corner: vec2<i32>, x: vec2<u32>, y: vec2<u32>, base: i32, low: u32, high: u32) -> u32 {
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
                return HIT;
            }
            let end = row_of(record, rows.y + 1u);
            for (var at = row_of(record, rows.x); at < end; at++) {
                if is_spent() {
                    break;
                }
                let span = words[at];
                let lane = lane_of(span);
                if lane >= columns.x && lane <= columns.y && meets(span, low, high) {
                    return HIT;
                }
            }
        }
    }
    return CLEAR;
}

@compute @workgroup_size(64)
fn boxes(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x < batch.count {
        answer_shape(id.x, id.x * 6u);
    }
}

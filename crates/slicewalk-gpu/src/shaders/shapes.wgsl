// Shapes against the pages under them. `meets_page` of the shader that follows decides about a page.
//
// A question begins with the first and last pixel along x and y, and the lowest and highest height.

// Answers the question of this number, whose words begin at `at`.
fn answer_shape(number: u32, at: u32) {
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
            for (var slot_number = 0u; slot_number < column.y; slot_number++) {
                if is_spent() {
                    break;
                }
                let slot = slots[column.x + slot_number];
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
                    answer = max(answer, NOT_LOADED);
                    continue;
                }
                let met = meets_page(slot.w, vec2<i32>(tx, ty) * 64, x, y, base, lowest, highest);
                if met == HIT {
                    answers[number] = HIT;
                    return;
                }
                answer = max(answer, met);
            }
        }
    }
    answers[number] = select(answer, UNDECIDED, spent > batch.budget);
}

//! Digits and round lengths for the scales of pictures.

/// Height of [`figures`] (pixels).
pub const HEIGHT: i64 = 3 * 5;
/// Width of a digit and the gap after it (pixels).
pub const WIDTH: i64 = 3 * 4;

/// Draws a text of digits, `.`, `-`, `m` and `z` by calling `set` for pixels relative to its upper left corner. Other
/// characters are gaps.
pub fn figures(text: &str, mut set: impl FnMut(i64, i64)) {
    for (place, character) in (0..).zip(text.chars()) {
        for (row, bits) in (0..).zip(glyph(character)) {
            for column in (0..3).filter(|column| bits >> (2 - column) & 1 == 1) {
                for (dx, dy) in (0..3).flat_map(|dx| (0..3).map(move |dy| (dx, dy))) {
                    set(WIDTH * place + 3 * column + dx, 3 * row + dy);
                }
            }
        }
    }
}

/// Largest of 1, 2 and 5 times a power of ten that is at most `most`.
pub fn round_length(most: f64) -> f64 {
    let power = 10f64.powf(most.log10().floor());
    [5.0, 2.0, 1.0].into_iter().map(|n| n * power).find(|length| *length <= most).unwrap_or(power)
}

/// Rows of three bits.
fn glyph(character: char) -> [u8; 5] {
    match character {
        '0' => [7, 5, 5, 5, 7],
        '1' => [2, 6, 2, 2, 7],
        '2' => [7, 1, 7, 4, 7],
        '3' => [7, 1, 3, 1, 7],
        '4' => [5, 5, 7, 1, 1],
        '5' => [7, 4, 7, 1, 7],
        '6' => [7, 4, 7, 5, 7],
        '7' => [7, 1, 2, 2, 2],
        '8' => [7, 5, 7, 5, 7],
        '9' => [7, 5, 7, 1, 7],
        '.' => [0, 0, 0, 0, 2],
        '-' => [0, 0, 7, 0, 0],
        'm' => [0, 5, 7, 5, 5],
        'z' => [0, 7, 3, 6, 7],
        _ => [0; 5],
    }
}

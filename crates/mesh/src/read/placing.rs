//! Transforms of texture coordinates: materials move, rotate and scale the coordinates of corners.

/// Transform of texture coordinates; the results count from the upper left of the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Placing {
    rows: [[f64; 3]; 2],
}

impl Default for Placing {
    fn default() -> Self {
        Self { rows: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] }
    }
}

impl Placing {
    /// Transform of the MTL options `-s` and `-o`: scale, then move, both from the lower left, as programs that write
    /// them do.
    pub(super) fn of_mtl(scale: [f64; 2], offset: [f64; 2]) -> Self {
        let [[su, sv], [ou, ov]] = [scale, offset];
        Self { rows: [[su, 0.0, ou], [0.0, sv, 1.0 - sv - ov]] }
    }

    /// Transform of `KHR_texture_transform`: scale, rotate (radians), then move.
    pub(super) fn of_gltf(offset: [f64; 2], rotation: f64, scale: [f64; 2]) -> Self {
        // libm instead of the platform's functions, so that colours are the same everywhere.
        let (sin, cos) = libm::sincos(rotation);
        Self { rows: [[cos * scale[0], sin * scale[1], offset[0]], [-sin * scale[0], cos * scale[1], offset[1]]] }
    }

    /// Maps texture coordinates of a corner to the image.
    pub(super) fn of(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        self.rows.map(|[a, b, c]| a * u + b * v + c)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_near(found: [f64; 2], expected: [f64; 2]) {
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{found:?}, expected {expected:?}");
    }

    #[test]
    fn places_stay_without_options_to_the_last_bit() {
        for place in [[0.1, 0.7], [-3.3, 1e9], [1.0, 0.0]] {
            assert_eq!(Placing::default().of(place), place);
            assert_eq!(Placing::of_mtl([1.0; 2], [0.0; 2]).of(place), place);
            assert_eq!(Placing::of_gltf([0.0; 2], 0.0, [1.0; 2]).of(place), place);
        }
    }

    #[test]
    fn options_of_mtl_count_from_the_lower_left() {
        let placing = Placing::of_mtl([2.0, 3.0], [0.25, 0.5]);
        // The lower left corner, then the upper right one.
        assert_near(placing.of([0.0, 1.0]), [0.25, 0.5]);
        assert_near(placing.of([1.0, 0.0]), [2.25, -2.5]);
    }

    #[test]
    fn gltf_scales_then_turns_then_moves() {
        // Expected values follow the matrices in the extension's text; a quarter turn.
        let placing = Placing::of_gltf([0.5, 0.25], std::f64::consts::FRAC_PI_2, [2.0, 3.0]);
        assert_near(placing.of([0.0, 0.0]), [0.5, 0.25]);
        assert_near(placing.of([1.0, 0.0]), [0.5, 0.25 - 2.0]);
        assert_near(placing.of([0.0, 1.0]), [0.5 + 3.0, 0.25]);
    }
}

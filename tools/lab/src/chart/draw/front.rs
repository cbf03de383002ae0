//! The Pareto front: what nothing else beats in both of two costs.

/// Whether `a` is nowhere worse than `b` and somewhere better.
pub fn dominates(a: (f64, f64), b: (f64, f64)) -> bool {
    a.0 <= b.0 && a.1 <= b.1 && a != b
}

/// Indices of the points that no other dominates, by x.
pub fn front(points: &[(f64, f64)]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|a, b| {
        let (a, b) = (points[*a], points[*b]);
        a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1))
    });
    let mut least: Option<(f64, f64)> = None;
    order.retain(|at| {
        let point = points[*at];
        let stays = least.is_none_or(|least| point.1 < least.1 || point == least);
        if stays {
            least = Some(point);
        }
        stays
    });
    order
}

/// Corners of the stairs through the front: what lies above and right of them is beaten.
pub fn stairs(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut corners: Vec<(f64, f64)> = Vec::new();
    for at in front(points) {
        if let Some(before) = corners.last().copied() {
            corners.push((points[at].0, before.1));
        }
        corners.push(points[at]);
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_front_is_that_of_brute_force(cells in prop::collection::vec((0u8..12, 0u8..12), 0..40)) {
            let points: Vec<(f64, f64)> = cells.iter().map(|(x, y)| (f64::from(*x), f64::from(*y))).collect();
            let beaten = |at: &usize| points.iter().any(|other| dominates(*other, points[*at]));
            let expected: Vec<usize> = (0..points.len()).filter(|at| !beaten(at)).collect();
            let found = front(&points);
            prop_assert!(found.windows(2).all(|pair| points[pair[0]].0 <= points[pair[1]].0));
            let mut found = found;
            found.sort_unstable();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn stairs_go_right_and_then_down() {
        assert_eq!(stairs(&[(4.0, 1.0), (1.0, 3.0), (2.0, 5.0)]), [(1.0, 3.0), (4.0, 3.0), (4.0, 1.0)]);
    }
}

//! How steeply the ground of a region rises, and where a ramp has no landing.
//!
//! The grade at a place is the slope of the plane that fits the places around it best (least squares): those within half
//! the length of measurement along y, and as far along x from each of these. So neither noise nor single steps count, and
//! the grade of a plane is exact, beside the end of the region, too.

use super::Region;
use super::distance::{End, clearances};
use super::region::NO_PLACE;

/// Length over which the grade of the ground is measured (m), and most pixels to each side: enough for pixels of 1.5 mm,
/// and so few that no sum overflows.
const GRADE_M: f64 = 1.0;
const MOST_PIXELS: i64 = 512;
/// Length over which the grade of a landing is measured (m), and the steepest one: up to 3 %, ground is no ramp (DIN 18040).
const LANDING_M: f64 = 1.5;
const LANDING_GRADE: f64 = 0.03;
/// A grade is too steep if it exceeds the limit by more than this share: heights are rounded to quanta.
const SLACK: f64 = 0.02;
/// Across ground narrower than this, noise decides: only the rise along it counts (m).
const NARROW_M: f64 = 0.3;

/// Sums over places, of their offsets (pixels) and heights (quanta). All are whole and exact.
#[derive(Debug, Default, Clone, Copy, PartialEq)]
struct Sums {
    count: i64,
    x: i64,
    y: i64,
    z: i64,
    xx: i64,
    xy: i64,
    yy: i64,
    xz: i64,
    yz: i64,
}

impl Sums {
    fn of_place(z: i32) -> Self {
        Self { count: 1, z: i64::from(z), ..Self::default() }
    }

    /// Adds the sums of places that have moved by an offset.
    fn add(&mut self, other: &Self, [x, y]: [i64; 2]) {
        self.count += other.count;
        self.x += other.x + x * other.count;
        self.y += other.y + y * other.count;
        self.z += other.z;
        self.xx += other.xx + x * (2 * other.x + x * other.count);
        self.xy += other.xy + x * other.y + y * (other.x + x * other.count);
        self.yy += other.yy + y * (2 * other.y + y * other.count);
        self.xz += other.xz + x * other.z;
        self.yz += other.yz + y * other.z;
    }

    /// Returns the slope of the plane that fits best (quanta for each pixel). Where the places are narrower than `narrow`
    /// (pixels), only the slope along them.
    fn slope(&self, narrow: f64) -> f64 {
        // Products of sums may exceed 64 bits in scans of extreme height.
        let covariance = |product: i64, a: i64, b: i64| self.count as f64 * product as f64 - a as f64 * b as f64;
        let [xx, xy, yy] = [
            covariance(self.xx, self.x, self.x),
            covariance(self.xy, self.x, self.y),
            covariance(self.yy, self.y, self.y),
        ];
        let [xz, yz] = [covariance(self.xz, self.x, self.z), covariance(self.yz, self.y, self.z)];
        // Variances along the principal axes of the places.
        let (middle, apart) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
        let [along, across] = [middle + apart, middle - apart];
        if along <= 0.0 {
            return 0.0;
        }
        // A strip of even width has a twelfth of the squared width.
        if across >= (self.count as f64 * narrow).powi(2) / 12.0 {
            return (xz * yy - yz * xy).hypot(yz * xx - xz * xy) / (xx * yy - xy * xy);
        }
        let axis = if xx >= yy { [along - yy, xy] } else { [xy, along - xx] };
        (xz * axis[0] + yz * axis[1]).abs() / (along * axis[0].hypot(axis[1]))
    }
}

impl Region {
    /// Returns the grade of the ground at each place, measured over `length` (m).
    fn grades_over(&self, length: f64) -> Vec<f64> {
        let frame = &self.grid.frame;
        let far = ((length / 2.0 / frame.pixel_m()).round() as i64).clamp(1, MOST_PIXELS);
        let rows: Vec<Sums> = (0..self.len() as u32)
            .map(|place| {
                self.sums(place, 0, far, |at| Sums::of_place(self.tops[at as usize] - self.tops[place as usize]))
            })
            .collect();
        let narrow = NARROW_M / frame.pixel_m();
        let grade = |place: u32| {
            let around = self.sums(place, 1, far, |at| {
                let (own, rise) = (rows[at as usize], i64::from(self.tops[at as usize] - self.tops[place as usize]));
                Sums { z: own.z + rise * own.count, xz: own.xz + rise * own.x, ..own }
            });
            around.slope(narrow) * frame.quantum_m() / frame.pixel_m()
        };
        (0..self.len() as u32).map(grade).collect()
    }

    /// Sums over the places up to `far` links to both sides along an axis.
    fn sums(&self, place: u32, axis: usize, far: i64, of: impl Fn(u32) -> Sums) -> Sums {
        let mut sums = of(place);
        for (way, sign) in [(axis, 1), (axis + 2, -1)] {
            let mut at = place;
            for by in 1..=far {
                at = self.links[at as usize][way];
                if at == NO_PLACE {
                    break;
                }
                let mut offset = [0; 2];
                offset[axis] = sign * by;
                sums.add(&of(at), offset);
            }
        }
        sums
    }

    /// Returns the grade of the ground at each standing place (rise over run), in the order of
    /// [`places`](Self::places). It is measured as for [`Pawn::max_grade`](super::Pawn::max_grade), so stairs count as
    /// ramps.
    pub fn grades(&self) -> Vec<f64> {
        let grades = self.grades_over(GRADE_M).into_iter().zip(&self.standing);
        grades.filter(|(_, standing)| **standing).map(|(grade, _)| grade).collect()
    }

    /// Returns for each place whether the ground is too steep for the pawn.
    pub(super) fn too_steep(&self) -> Vec<bool> {
        let most = self.pawn().max_grade * (1.0 + SLACK);
        self.grades_over(GRADE_M).into_iter().map(|grade| grade > most).collect()
    }

    /// Returns for each place whether the nearest landing is farther than half of the pawn's longest ramp.
    pub(super) fn far_from_landings(&self) -> Vec<bool> {
        let most = LANDING_GRADE * (1.0 + SLACK);
        let grades = self.grades_over(LANDING_M);
        let is_level = |place: u32| grades[place as usize] <= most;
        // A place at the tip of the region has hardly any ground around it to measure: those beside it count as well.
        let is_landing = |place: &u32| {
            let beside = self.links[*place as usize].iter().filter(|link| **link != NO_PLACE);
            is_level(*place) && self.standing[*place as usize] && beside.copied().all(is_level)
        };
        let landings = (0..self.len() as u32).filter(is_landing);
        let landings: Vec<End> = landings.map(|place| End { place, offset: [0; 2], is_open: false }).collect();
        let far = self.pawn().max_ramp / 2.0;
        clearances(&self.grid, &self.links, &landings).into_iter().map(|distance| f64::from(distance) > far).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Sums over places at these offsets and heights.
    fn summed(places: &[[i64; 3]]) -> Sums {
        let sum = |of: fn(&[i64; 3]) -> i64| places.iter().map(of).sum();
        Sums {
            count: places.len() as i64,
            x: sum(|[x, ..]| *x),
            y: sum(|[_, y, _]| *y),
            z: sum(|[.., z]| *z),
            xx: sum(|[x, ..]| x * x),
            xy: sum(|[x, y, _]| x * y),
            yy: sum(|[_, y, _]| y * y),
            xz: sum(|[x, _, z]| x * z),
            yz: sum(|[_, y, z]| y * z),
        }
    }

    proptest! {
        #[test]
        fn sums_of_moved_places_are_those_at_their_new_offsets(
            own in prop::collection::vec([-9..9i64, -9..9i64, -99..99i64], 0..9),
            moved in prop::collection::vec([-9..9i64, -9..9i64, -99..99i64], 0..9),
            by in [-9..9i64, -9..9i64],
        ) {
            let mut sums = summed(&own);
            sums.add(&summed(&moved), by);
            let all: Vec<_> = own.into_iter().chain(moved.iter().map(|[x, y, z]| [x + by[0], y + by[1], *z])).collect();
            prop_assert_eq!(sums, summed(&all));
        }

        #[test]
        fn the_slope_is_that_of_the_plane_or_along_a_strip(rise in [-9..9i64, -9..9i64], [a, b] in [-5..=5i64, 1..=5i64]) {
            let z = |[x, y]: [i64; 2]| [x, y, rise[0] * x + rise[1] * y];
            let square = (-3..4).flat_map(|x| (-3..4).map(move |y| [x, y]));
            let plane = summed(&square.map(z).collect::<Vec<_>>()).slope(3.0);
            prop_assert!((plane - (rise[0] as f64).hypot(rise[1] as f64)).abs() < 1e-9, "{plane}");
            let strip = summed(&(-4..5).map(|n| z([a * n, b * n])).collect::<Vec<_>>()).slope(3.0);
            let along = (rise[0] * a + rise[1] * b).abs() as f64 / (a as f64).hypot(b as f64);
            prop_assert!((strip - along).abs() < 1e-9, "{strip} beside {along}");
        }
    }
}

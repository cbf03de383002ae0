//! Sample of places on surfaces that is even over their area, and the same for any order of the input.
//!
//! At each of several levels, space is cut into cells; each cell has one place, the least of all in it. Of more than
//! [`MOST`] cells, those with the smallest hashes stay. The sample is the coarsest level whose cells are still small beside
//! the whole: dense parts of a scan have no more places there than sparse ones.

use super::find::{Bulk, Patch};

/// Cells per metre of the levels.
const LEVELS: [f64; 6] = [256.0, 32.0, 4.0, 0.5, 1.0 / 16.0, 1.0 / 128.0];
/// Most places of a level.
const MOST: usize = 1 << 16;
/// Least number of cells along the extent of the whole.
const CELLS_ALONG: f64 = 128.0;

/// Places of all levels.
#[derive(Default)]
pub struct Sample {
    levels: [Level; LEVELS.len()],
}

#[derive(Default)]
struct Level {
    places: Vec<(u64, Patch)>,
    /// Hash above which cells have no place; 0 as long as all have one.
    most: u64,
}

impl Sample {
    pub fn add(&mut self, patch: Patch) {
        for (level, cells) in self.levels.iter_mut().zip(LEVELS) {
            level.add(hash(patch.at, cells), patch);
        }
    }

    /// Returns the places of the coarsest level with small enough cells, else those of the finest.
    pub fn finish(mut self) -> Vec<Patch> {
        self.levels.iter_mut().for_each(Level::thin);
        let places =
            |level: &mut Level| std::mem::take(&mut level.places).into_iter().map(|(_, patch)| patch).collect();
        let finest: Vec<Patch> = places(&mut self.levels[0]);
        let Some(bulk) = Bulk::of(&finest) else { return finest };
        match LEVELS.iter().rposition(|cells| cells * bulk.extent >= CELLS_ALONG) {
            Some(level) if level > 0 => places(&mut self.levels[level]),
            _ => finest,
        }
    }
}

impl Level {
    fn add(&mut self, hash: u64, patch: Patch) {
        if self.most > 0 && hash > self.most {
            return;
        }
        // Points that follow each other often lie in one cell.
        match self.places.last_mut() {
            Some((last, place)) if *last == hash => {
                if patch.key() < place.key() {
                    *place = patch;
                }
            }
            _ => self.places.push((hash, patch)),
        }
        if self.places.len() == 2 * MOST {
            self.thin();
        }
    }

    fn thin(&mut self) {
        self.places.sort_unstable_by(|a, b| a.0.cmp(&b.0).then_with(|| a.1.key().cmp(&b.1.key())));
        self.places.dedup_by_key(|(hash, _)| *hash);
        if self.places.len() >= MOST {
            self.places.truncate(MOST);
            self.most = self.places[MOST - 1].0;
        }
    }
}

/// Hash of a cell: the SplitMix64 finaliser over a weighted sum; at least 1.
fn hash(at: [f64; 3], cells: f64) -> u64 {
    let weights = [0x9E37_79B9_7F4A_7C15, 0xC2B2_AE3D_27D4_EB4F, 0x1656_67B1_9E37_79F9];
    let cells = at
        .into_iter()
        .zip(weights)
        .map(|(v, weight): (f64, u64)| ((v * cells).floor() as i64 as u64).wrapping_mul(weight));
    let mut h = cells.fold(0, u64::wrapping_add);
    h = (h ^ h >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    h = (h ^ h >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    (h ^ h >> 31).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(count: u64) -> Vec<Patch> {
        let mut state = 1u64;
        let mut draw = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64 * 50.0 - 25.0
        };
        (0..count).map(|_| Patch { at: [draw(), draw(), 0.01 * draw()], normal: None }).collect()
    }

    #[test]
    fn order_and_repetition_do_not_matter() {
        let all = places(300_000);
        let sampled = |patches: &mut dyn Iterator<Item = &Patch>| {
            let mut sample = Sample::default();
            patches.for_each(|patch| sample.add(*patch));
            let mut found = sample.finish();
            found.sort_unstable_by_key(Patch::key);
            found
        };
        let expected = sampled(&mut all.iter());
        assert!((MOST / 4..=MOST).contains(&expected.len()), "{}", expected.len());
        assert!(sampled(&mut all.iter().rev()) == expected);
        assert!(sampled(&mut all.iter().flat_map(|patch| [patch, patch])) == expected);
        assert!(sampled(&mut all.iter().chain(&all)) == expected);
    }

    #[test]
    fn dense_parts_have_no_more_places_than_sparse_ones() {
        let mut sample = Sample::default();
        // One half has a hundred times as many points.
        for patch in places(1_000_000) {
            sample.add(patch);
            let [x, y, z] = patch.at;
            if patch.key()[0] % 100 == 0 {
                sample.add(Patch { at: [x + 100.0, y, z], normal: None });
            }
        }
        let found = sample.finish();
        let sparse = found.iter().filter(|patch| patch.at[0] > 50.0).count();
        let share = sparse as f64 / found.len() as f64;
        // Of the points, one in a hundred.
        assert!((0.05..0.5).contains(&share), "{share}");
    }
}

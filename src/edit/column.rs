//! The pages of one tile column with the edits applied.

use super::{Change, Edits};
use crate::frame::{Frame, PAGE_QUANTA, SLICE_QUANTA, TILE_PIXELS};
use crate::page::{Page, PageBuilder, Span};
use crate::{Error, Result};

/// Most pages that edits may change or add in one archive.
pub(crate) const MOST_EDITED_PAGES: usize = 1 << 16;
/// Most spans of one pixel in a page.
const MOST_SPANS: usize = 64;

/// Solid run of a pixel (quanta above the grid's origin).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Run {
    bottom: i64,
    top: i64,
    is_obstacle: bool,
}

/// Runs of the pixels of a tile column that are being edited.
pub(crate) struct EditedColumn<'a> {
    edits: &'a Edits,
    frame: &'a Frame,
    /// True for an overview level, which must hold all solid that the archive holds.
    is_of_level: bool,
    /// First pixel.
    corner: [i64; 2],
}

impl Edits {
    /// Returns the tile columns that the edits may change, from first to last along x and y, and the layers that an
    /// added solid fills; no layers for solids taken away.
    pub(crate) fn regions<'a>(
        &'a self,
        frame: &'a Frame,
    ) -> impl Iterator<Item = ([[i64; 2]; 2], Option<[i64; 2]>)> + 'a {
        self.all.iter().map(|(prism, change)| {
            let tiles = prism.pixels(frame, *change).map(|at| at.map(|pixel| pixel.div_euclid(TILE_PIXELS)));
            let layers = || {
                let (bottom, top) = (frame.quantum_floor(prism.bottom), frame.quantum_ceil(prism.top));
                [bottom.div_euclid(PAGE_QUANTA), (top - 1).div_euclid(PAGE_QUANTA)]
            };
            (tiles, matches!(change, Change::Added { .. }).then(layers))
        })
    }
}

impl<'a> EditedColumn<'a> {
    pub fn new(edits: &'a Edits, frame: &'a Frame, is_of_level: bool, [tx, ty]: [i32; 2]) -> Self {
        Self { edits, frame, is_of_level, corner: [i64::from(tx) * TILE_PIXELS, i64::from(ty) * TILE_PIXELS] }
    }

    /// Returns the pages with the edits applied: those of `pages`, with their layers from below, and new ones where
    /// solid is added. Pages that lose everything stay, empty. Fails if solid would be added in more than
    /// [`MOST_EDITED_PAGES`] layers or beyond the format's.
    pub fn apply(&self, pages: &[(i32, &Page)]) -> Result<Vec<(i32, Page)>> {
        let mut layers: Vec<i32> = pages.iter().map(|(layer, _)| *layer).collect();
        let mut changed: Vec<Option<Vec<Run>>> = vec![None; (TILE_PIXELS * TILE_PIXELS) as usize];
        // Heights in pages of a level are rounded outwards to a unit, by which readers know how far. Edits keep to it.
        let of_page = |(layer, page): &(i32, &Page)| (i64::from(*layer), i64::from(page.height_unit()));
        let units: Vec<(i64, i64)> = pages.iter().filter(|_| self.is_of_level).map(of_page).collect();
        let unit = |at: i64| {
            let layer = at.div_euclid(PAGE_QUANTA);
            units.iter().find(|unit| unit.0 == layer).map_or(1, |unit| unit.1)
        };
        let down = |at: i64| at - at.rem_euclid(unit(at));
        let up = |at: i64| at + (unit(at) - at.rem_euclid(unit(at))) % unit(at);
        for (prism, change) in &self.edits.all {
            let [low, high] = prism.pixels(self.frame, *change);
            let first = [0, 1].map(|axis| (low[axis] - self.corner[axis]).clamp(0, TILE_PIXELS));
            let last = [0, 1].map(|axis| (high[axis] - self.corner[axis]).clamp(-1, TILE_PIXELS - 1));
            for (y, x) in (first[1]..=last[1]).flat_map(|y| (first[0]..=last[0]).map(move |x| (y, x))) {
                let at = [self.corner[0] + x, self.corner[1] + y];
                let is_in = match change {
                    // Pixels of the archive whose middle lies outside keep their solid.
                    Change::Removed if self.is_of_level => prism.outline.holds_all(self.frame, at),
                    Change::Removed => prism.outline.holds_middle(self.frame, at),
                    Change::Added { .. } => prism.outline.touches(self.frame, at),
                };
                if !is_in {
                    continue;
                }
                let runs = changed[(y << 6 | x) as usize].get_or_insert_with(|| runs_of(pages, x as u32, y as u32));
                let (floor, ceil) = (self.frame.quantum_floor(prism.bottom), self.frame.quantum_ceil(prism.top));
                match *change {
                    Change::Removed => {
                        let [low, high] = [self.frame.quantum_ceil(prism.bottom), self.frame.quantum_floor(prism.top)];
                        remove(runs, up(low), down(high));
                    }
                    Change::Added { is_floor } => {
                        let [bottom, top] = [down(floor), up(ceil.max(floor + 1))];
                        add(runs, Run { bottom, top, is_obstacle: !is_floor });
                    }
                }
            }
        }
        for run in changed.iter().flatten().flatten() {
            let [first, last] = [run.bottom, run.bottom.max(run.top - 1)].map(|at| at.div_euclid(PAGE_QUANTA));
            let range = i32::try_from(first).and_then(|first| Ok(first..=i32::try_from(last)?));
            let range = range.map_err(|_| Error::limit("layer of an edit", first.abs().max(last.abs()), i32::MAX))?;
            let count = last - first + 1;
            if count > MOST_EDITED_PAGES as i64 {
                return Err(Error::limit("pages that edits change", count, MOST_EDITED_PAGES));
            }
            for layer in range {
                if let Err(at) = layers.binary_search(&layer) {
                    layers.insert(at, layer);
                }
            }
        }
        let mut builder = PageBuilder::default();
        Ok(layers
            .into_iter()
            .map(|layer| {
                let page = pages.iter().find(|page| page.0 == layer).map(|page| page.1);
                builder.clear();
                for (pixel, runs) in changed.iter().enumerate() {
                    let (x, y) = (pixel as u32 & 63, pixel as u32 >> 6);
                    let is_set = match (runs, page) {
                        (Some(runs), _) => builder.set_column(x, y, &spans_of(runs, layer)),
                        (None, Some(page)) => builder.set_column(x, y, page.column(x, y)),
                        (None, None) => true,
                    };
                    debug_assert!(is_set, "runs are in order and apart");
                }
                (layer, builder.build())
            })
            .collect())
    }
}

/// Returns the runs of a pixel from below; runs cut between two pages are joined.
fn runs_of(pages: &[(i32, &Page)], x: u32, y: u32) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    for (layer, page) in pages {
        let floor = i64::from(*layer) * PAGE_QUANTA;
        for span in page.column(x, y) {
            let [bottom, top] = [span.bottom(), span.top()].map(|quanta| floor + i64::from(quanta));
            match runs.last_mut() {
                Some(below) if below.top == bottom && bottom == floor && below.is_obstacle == span.is_obstacle() => {
                    below.top = top;
                }
                _ => runs.push(Run { bottom, top, is_obstacle: span.is_obstacle() }),
            }
        }
    }
    runs
}

/// Takes away what lies strictly between two heights.
fn remove(runs: &mut Vec<Run>, low: i64, high: i64) {
    if low >= high {
        return;
    }
    let cut = |run: Run| {
        let is_cut = run.bottom < high && run.top > low;
        let whole = (!is_cut).then_some(run);
        // A level cut is floor.
        let below = (is_cut && run.bottom <= low).then_some(Run { top: low, is_obstacle: false, ..run });
        let above = (is_cut && run.top >= high).then_some(Run { bottom: high, ..run });
        [whole, below, above].into_iter().flatten()
    };
    *runs = runs.iter().copied().flat_map(cut).collect();
    join_touching(runs);
}

/// Adds a run, joined with those that it touches. The top of the result decides its class; below the top slice it is an
/// obstacle.
fn add(runs: &mut Vec<Run>, new: Run) {
    let touches = |run: &Run| run.bottom <= new.top && run.top >= new.bottom;
    let mut all = new;
    for run in runs.iter().filter(|run| touches(run)) {
        if run.top > all.top {
            (all.top, all.is_obstacle) = (run.top, run.is_obstacle);
        } else if run.top == all.top {
            all.is_obstacle &= run.is_obstacle;
        }
        all.bottom = all.bottom.min(run.bottom);
    }
    runs.retain(|run| !touches(run));
    // The lowest run that it joins may stand on one of the other class, which stays.
    let at = runs.partition_point(|run| run.top <= all.bottom);
    let cut = (all.top - 1).div_euclid(SLICE_QUANTA) * SLICE_QUANTA;
    if all.is_obstacle || cut <= all.bottom {
        runs.insert(at, all);
    } else {
        let below = Run { top: cut, is_obstacle: true, ..all };
        runs.splice(at..at, [below, Run { bottom: cut, ..all }]);
    }
    join_touching(runs);
}

/// Joins runs that touch, except at a slice boundary where the class changes, as a page requires it.
fn join_touching(runs: &mut Vec<Run>) {
    runs.dedup_by(|above, below| {
        let is_border = above.bottom == below.top && above.bottom.rem_euclid(SLICE_QUANTA) == 0;
        let joins = above.bottom <= below.top && !(is_border && above.is_obstacle != below.is_obstacle);
        if joins {
            (below.top, below.is_obstacle) = (above.top, above.is_obstacle);
        }
        joins
    });
}

/// Returns the spans of a pixel in one page. Where there are more than a page holds, the nearest ones are joined.
fn spans_of(runs: &[Run], layer: i32) -> Vec<Span> {
    let floor = i64::from(layer) * PAGE_QUANTA;
    let mut own: Vec<Run> = runs
        .iter()
        .map(|run| Run { bottom: (run.bottom - floor).max(0), top: (run.top - floor).min(PAGE_QUANTA), ..*run })
        .filter(|run| run.bottom < PAGE_QUANTA && run.bottom <= run.top)
        .collect();
    // A run that only touches the floor of the page belongs to the page below.
    if own.first().is_some_and(|run| run.top == 0) && runs.iter().any(|run| run.bottom < floor && run.top == floor) {
        own.remove(0);
    }
    while own.len() > MOST_SPANS {
        let nearest = (1..own.len()).min_by_key(|at| own[*at].bottom - own[*at - 1].top).unwrap_or(1);
        own[nearest].bottom = own[nearest - 1].bottom;
        own.remove(nearest - 1);
    }
    own.iter().filter_map(|run| Span::new(run.bottom as u32, run.top as u32, run.is_obstacle)).collect()
}

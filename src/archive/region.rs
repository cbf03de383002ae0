//! Regions of whole pixels and slices, and what pages and columns of an archive hold in them.

use super::head::Bounds;
use crate::frame::{Frame, PAGE_SLICES, PageKey, SLICE_QUANTA, TILE_PIXELS};
use crate::page::{Inferred, Page, PageBuilder, Span};
use crate::seen::{CELL_PIXELS, SeenPage};
use crate::{Error, Parameter, Result};

/// Whole pixels and slices, first and last.
#[derive(Debug, Clone, Copy)]
pub(super) struct Region {
    pub i: (i64, i64),
    pub j: (i64, i64),
    pub slices: (i64, i64),
}

/// Returns the first and last index (0 to 63) of `range` in a page that begins at `start`, or `None` if they do not
/// meet.
fn within(range: (i64, i64), start: i64) -> Option<(u32, u32)> {
    let (first, last) = ((range.0 - start).max(0), (range.1 - start).min(TILE_PIXELS - 1));
    (first <= last).then_some((first as u32, last as u32))
}

impl Region {
    /// Returns the pixels and slices that hold a place of the closed box `bounds` (m). Fails if `bounds` are inverted or
    /// NaN.
    pub fn of(frame: &Frame, (min, max): &Bounds) -> Result<Self> {
        // Negated so that NaN fails.
        if !(0..3).all(|axis| min[axis] <= max[axis]) {
            return Err(Error::parameter(Parameter::Bounds, format!("no region lies between {min:?} and {max:?}")));
        }
        let pixels = |axis: usize| (frame.pixel_of(min[axis]), frame.pixel_of(max[axis]));
        Ok(Self { i: pixels(0), j: pixels(1), slices: (frame.slice_of(min[2]), frame.slice_of(max[2])) })
    }

    /// Returns the region with one more pixel and slice on every side.
    pub fn grown(&self) -> Self {
        let grown = |(first, last)| (first - 1, last + 1);
        Self { i: grown(self.i), j: grown(self.j), slices: grown(self.slices) }
    }

    /// Returns the part of page `key` that lies in the region, if any.
    pub fn part_of(&self, key: PageKey) -> Option<PagePart> {
        let (px, py) = self.pixels_of(key)?;
        Some(PagePart { px, py, slices: within(self.slices, i64::from(key.layer) * PAGE_SLICES)? })
    }

    /// Returns the first and last pixel along x and y of page `key` whose columns the region meets.
    pub fn pixels_of(&self, key: PageKey) -> Option<((u32, u32), (u32, u32))> {
        let [px, py] =
            [(self.i, key.tx), (self.j, key.ty)].map(|(range, at)| within(range, i64::from(at) * TILE_PIXELS));
        Some((px?, py?))
    }

    /// Returns whether some page of a block of seen space lies in the region.
    pub fn meets_block(&self, key: PageKey) -> bool {
        let first = i64::from(key.layer) * 64 * PAGE_SLICES;
        self.pixels_of(key).is_some() && self.slices.0 < first + 64 * PAGE_SLICES && self.slices.1 >= first
    }

    /// Returns the part of `whole` in the region, if any.
    pub fn bounds(&self, frame: &Frame, whole: &Bounds) -> Option<Bounds> {
        let least =
            [frame.edge_of_pixel(self.i.0), frame.edge_of_pixel(self.j.0), frame.bottom_of_slice(self.slices.0)];
        let greatest = [
            frame.edge_of_pixel(self.i.1 + 1),
            frame.edge_of_pixel(self.j.1 + 1),
            frame.bottom_of_slice(self.slices.1 + 1),
        ];
        let min: [f64; 3] = std::array::from_fn(|axis| whole.0[axis].max(least[axis]));
        let max: [f64; 3] = std::array::from_fn(|axis| whole.1[axis].min(greatest[axis]));
        (0..3).all(|axis| min[axis] <= max[axis]).then_some((min, max))
    }
}

/// A box of pixels and slices of one page, first and last.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) struct PagePart {
    pub px: (u32, u32),
    pub py: (u32, u32),
    pub slices: (u32, u32),
}

impl PagePart {
    pub const WHOLE: Self = Self { px: (0, 63), py: (0, 63), slices: (0, 63) };

    /// Returns the content of `page` in this box, built in `builder`, and marks which of its spans are inferred.
    pub fn cut(&self, page: &Page, inferred: &Inferred, builder: &mut PageBuilder) -> (Page, Inferred) {
        let slices = (i64::from(self.slices.0), i64::from(self.slices.1));
        builder.clear();
        let (mut column, mut kept): (Vec<Span>, Inferred) = (Vec::new(), Inferred::new());
        for (x, y, spans) in page.columns().filter(|&(x, y, _)| is_in(self.px, x) && is_in(self.py, y)) {
            column.clear();
            let mask = spans_of(runs_of(spans, inferred.of(x, y), 0).filter_map(|run| run.cut(slices)), &mut column);
            if !column.is_empty() {
                let in_order = kept.push(x, y, mask);
                debug_assert!(in_order, "columns come in row order");
                let canonical = builder.set_column(x, y, &column);
                debug_assert!(canonical, "parts of spans that are apart are apart");
            }
        }
        (builder.build(), kept)
    }

    /// Returns the cells that this box meets, or only those that lie in it entirely.
    pub fn cells(&self, entirely: bool) -> SeenPage {
        let edge = CELL_PIXELS as u32;
        let along = |(first, last): (u32, u32)| match entirely {
            true => (first.div_ceil(edge), (last + 1) / edge),
            false => (first / edge, last / edge + 1),
        };
        let (x, y, mut cells) = (along(self.px), along(self.py), SeenPage::NOTHING);
        if x.0 < x.1 && y.0 < y.1 {
            let range = |(first, end): (u32, u32)| [first as usize, end as usize - 1];
            cells.mark([range(x), range(y), [self.slices.0 as usize, self.slices.1 as usize]]);
        }
        cells
    }
}

/// Returns whether `at` lies in `range`, first and last.
pub(super) fn is_in(range: (u32, u32), at: u32) -> bool {
    (range.0..=range.1).contains(&at)
}

const _: () = assert!(PAGE_SLICES == TILE_PIXELS, "pages are cut alike along all axes");

/// Span of a pixel that may reach beyond its page (quanta above the page's floor).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    pub bottom: i64,
    pub top: i64,
    pub obstacle: bool,
    pub inferred: bool,
}

impl Run {
    /// Returns the first and last slice, like [`Span::slices`]; negative below the page.
    pub fn slices(&self) -> (i64, i64) {
        let first = self.bottom.div_euclid(SLICE_QUANTA);
        (first, first.max((self.top - 1).div_euclid(SLICE_QUANTA)))
    }

    /// Returns the part in slices `first` to `last`, if any.
    pub fn cut(self, (first, last): (i64, i64)) -> Option<Self> {
        let own = self.slices();
        let (bottom, top) = (self.bottom.max(first * SLICE_QUANTA), self.top.min((last + 1) * SLICE_QUANTA));
        (own.0 <= last && own.1 >= first).then_some(Self { bottom, top, ..self })
    }
}

/// Iterates over the `spans` of a pixel of the page that lies `layers` pages above; `mask` marks the inferred ones.
pub(super) fn runs_of(spans: &[Span], mask: u64, layers: i64) -> impl Iterator<Item = Run> + '_ {
    let floor = layers * PAGE_SLICES * SLICE_QUANTA;
    spans.iter().enumerate().map(move |(at, span)| Run {
        bottom: floor + i64::from(span.bottom()),
        top: floor + i64::from(span.top()),
        obstacle: span.is_obstacle(),
        inferred: mask >> (at & 63) & 1 == 1,
    })
}

/// Adds the parts of `runs` in the page to `column`, and returns the mask of those that are inferred.
pub(super) fn spans_of(runs: impl IntoIterator<Item = Run>, column: &mut Vec<Span>) -> u64 {
    let mut mask = 0;
    let parts = runs.into_iter().filter_map(|run| run.cut((0, PAGE_SLICES - 1)));
    let spans =
        parts.filter_map(|run| Some((Span::new(run.bottom as u32, run.top as u32, run.obstacle)?, run.inferred)));
    for (span, inferred) in spans {
        mask |= u64::from(inferred) << (column.len() & 63);
        column.push(span);
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_of_a_page_is_cut_at_slices_and_stays_inferred() {
        let span = |slice: u32| Span::new(slice * 255 + 10, slice * 255 + 300, false).unwrap();
        let (mut builder, mut inferred) = (PageBuilder::default(), Inferred::new());
        assert!(builder.set_column(5, 6, &[span(1), span(10), span(20)]) && inferred.push(5, 6, 0b101));
        let page = builder.build();
        for (px, py, slices, spans, marks) in [
            ((0, 63), (0, 63), (0, 63), vec![span(1), span(10), span(20)], 0b101u64),
            ((5, 5), (6, 6), (3, 63), vec![span(10), span(20)], 0b10),
            (
                (5, 6),
                (0, 6),
                (2, 10),
                vec![Span::new(510, 555, false).unwrap(), Span::new(2560, 2805, false).unwrap()],
                0b1,
            ),
            ((6, 63), (0, 63), (0, 63), vec![], 0),
            ((0, 63), (0, 5), (0, 63), vec![], 0),
        ] {
            let (part, kept) = PagePart { px, py, slices }.cut(&page, &inferred, &mut builder);
            assert_eq!((part.column(5, 6), part.span_count()), (&spans[..], spans.len()));
            assert_eq!((kept.of(5, 6), kept.span_count()), (marks, u64::from(marks.count_ones())));
        }
    }

    #[test]
    fn the_region_of_bounds_holds_every_place_in_them() {
        let frame = Frame::new(0.5, 1.0).unwrap();
        let region = Region::of(&frame, &([0.5, 0.6, 1.0], [1.0, 0.9, 1.9])).unwrap();
        // A greatest corner on the edge of a pixel is a place of the pixel beyond.
        assert_eq!((region.i, region.j, region.slices), ((1, 2), (1, 1), (1, 1)));
        let everything = Region::of(&frame, &([f64::NEG_INFINITY; 3], [f64::INFINITY; 3])).unwrap();
        let key = PageKey { tx: -(1 << 30), ty: (1 << 30) - 1, layer: 1 << 29 };
        assert_eq!(everything.part_of(key), Some(PagePart::WHOLE));
        for wrong in [([1.0; 3], [0.0; 3]), ([f64::NAN; 3], [1.0; 3])] {
            assert!(Region::of(&frame, &wrong).is_err());
        }
    }

    #[test]
    fn bounds_are_cut_at_the_outer_edges_of_the_region() {
        let frame = Frame::new(0.5, 1.0).unwrap();
        let region = Region { i: (2, 3), j: (-3, 1), slices: (4, 6) };
        let cut = |min, max| region.bounds(&frame, &(min, max));
        let all = Some(([1.0, -1.5, 4.0], [2.0, 1.0, 7.0]));
        assert_eq!(cut([-90.0; 3], [90.0; 3]), all);
        let inside = ([1.25, -1.0, 4.5], [1.75, 0.5, 6.5]);
        assert_eq!(cut(inside.0, inside.1), Some(inside));
        assert_eq!(cut([2.0, 1.0, 7.0], [90.0; 3]), Some(([2.0, 1.0, 7.0], [2.0, 1.0, 7.0])));
        assert_eq!(cut([-90.0; 3], [90.0, 90.0, 3.5]), None);
    }

    #[test]
    fn cells_that_a_part_meets_are_more_than_those_inside() {
        let part = PagePart { px: (3, 8), py: (4, 63), slices: (2, 5) };
        assert_eq!((part.cells(false).cells(), part.cells(true).cells()), (3 * 15 * 4, 15 * 4));
        assert_eq!(PagePart { px: (1, 6), ..part }.cells(true).cells(), 0);
        assert_eq!(PagePart::WHOLE.cells(true), SeenPage::ALL);
    }
}

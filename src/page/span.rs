//! A span: a vertical solid run in one pixel of one page.

use crate::frame::{PAGE_QUANTA, SLICE_QUANTA};

/// Widest gap (quanta) over which voxels of one pixel join in any class: a pixel's width at the default slice height.
const JOIN_QUANTA: i64 = SLICE_QUANTA / 3;

/// Returns whether the solid of two voxels of one pixel, one right above the other, is one solid run: the `gap` between
/// their points (quanta) is narrow, or both are `obstacles`. Guarantee G2 allows to fill it, whatever its width. Runs of
/// one class become one span; others meet on the boundary of the slices.
#[doc(hidden)]
#[inline]
pub fn joins(gap: i64, obstacles: [bool; 2]) -> bool {
    obstacles == [true; 2] || gap <= JOIN_QUANTA
}

/// Bottom and top (quanta above the page's floor) and class (floor or obstacle) of a solid run; 4 bytes.
///
/// Both ends are inclusive: a span is the closed interval `[bottom, top]`, `0 ≤ bottom ≤ top ≤ 16320`.
///
/// Three bits are spare. Inside a page they hold the pixel's `x % 8`, so that the spans of several pixels can be
/// filtered without looking up where each pixel begins; they are not part of the span's value.
#[derive(Clone, Copy)]
#[repr(transparent)]
pub struct Span(u32);

const FIELD: u32 = (1 << 14) - 1;
const OBSTACLE: u32 = 1 << 28;
const LANE_SHIFT: u32 = 29;
const VALUE: u32 = (1 << LANE_SHIFT) - 1;

impl PartialEq for Span {
    fn eq(&self, other: &Self) -> bool {
        self.0 & VALUE == other.0 & VALUE
    }
}

impl Eq for Span {}

impl std::hash::Hash for Span {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        (self.0 & VALUE).hash(state);
    }
}

impl Span {
    /// Bit of [`kinds`](Self::kinds) that stands for obstacle.
    pub(crate) const OBSTACLE_KIND: u32 = OBSTACLE;

    /// Padding for groups of spans: meets no interval.
    pub(crate) const NEVER: Self = Self(FIELD);

    /// Creates the span `[bottom, top]` (quanta above the page's floor); `None` unless `bottom <= top <= 16320` and the
    /// bottom lies below the page's end (a span that only touches the end belongs to the page above).
    pub fn new(bottom: u32, top: u32, obstacle: bool) -> Option<Self> {
        (bottom <= top && top <= PAGE_QUANTA as u32 && bottom < PAGE_QUANTA as u32)
            .then_some(Self(bottom | top << 14 | if obstacle { OBSTACLE } else { 0 }))
    }

    /// Returns the lowest quantum (above the page's floor).
    #[inline]
    pub fn bottom(self) -> u32 {
        self.0 & FIELD
    }

    /// Returns the highest quantum (above the page's floor).
    #[inline]
    pub fn top(self) -> u32 {
        self.0 >> 14 & FIELD
    }

    /// Returns whether the span is an obstacle, steeper than the slope limit, rather than floor to stand on.
    #[inline]
    pub fn is_obstacle(self) -> bool {
        self.0 & OBSTACLE != 0
    }

    /// Returns bit 0, and bit 28 ([`OBSTACLE_KIND`](Self::OBSTACLE_KIND)) for an obstacle, to be ORed by loops without
    /// branches.
    #[inline]
    pub(crate) fn kinds(self) -> u32 {
        self.0 & OBSTACLE | 1
    }

    /// Returns the pixel's `x % 8`; valid for spans that a page holds.
    #[inline]
    pub(crate) fn lane(self) -> u32 {
        self.0 >> LANE_SHIFT
    }

    /// Returns the span as a page holds it in a pixel with `x % 8 == lane`.
    pub(crate) fn in_lane(self, lane: u32) -> Self {
        Self(self.0 & VALUE | lane << LANE_SHIFT)
    }

    /// Returns whether the span lies in a lane before `lane`, or in `lane` with its top below `low`. Within a row, all
    /// spans for which this holds precede the others.
    #[inline]
    pub(crate) fn is_before(self, lane: u32, low: u32) -> bool {
        self.0 & !OBSTACLE < lane << LANE_SHIFT | low.min(FIELD) << 14
    }

    /// Returns whether the span and the closed interval `[low, high]` share a height.
    #[inline]
    pub fn meets(self, low: u32, high: u32) -> bool {
        self.bottom() <= high && self.top() >= low
    }

    /// Returns whether the span ends below `above`, or ends on its bottom at a slice boundary and differs from it in
    /// class. Neighbouring spans of a pixel satisfy this.
    #[inline]
    #[doc(hidden)]
    pub fn lies_below(self, above: Self) -> bool {
        let (top, bottom) = (self.top(), above.bottom());
        top < bottom
            || top == bottom && top.is_multiple_of(SLICE_QUANTA as u32) && self.is_obstacle() != above.is_obstacle()
    }

    /// Returns the first and last slice of the page (0..=63) that the span occupies. A top on a slice boundary belongs
    /// to the slice below, unless the span consists of that boundary alone.
    #[inline]
    pub fn slices(self) -> (u32, u32) {
        let unit = SLICE_QUANTA as u32;
        let first = self.bottom() / unit;
        (first, first.max(self.top().saturating_sub(1) / unit))
    }

    /// Returns the slices of the span as a mask: bit `k` is slice `k` of the page.
    #[inline]
    pub fn slice_mask(self) -> u64 {
        let (first, last) = self.slices();
        (u64::MAX >> (63 - (last - first))) << first
    }

    /// Returns the part of the span inside slice `k` of the page, in quanta above that slice's floor (0..=255); `None`
    /// outside.
    pub fn within_slice(self, k: u32) -> Option<(u8, u8)> {
        let (first, last) = self.slices();
        (first..=last).contains(&k).then(|| {
            let floor = k * SLICE_QUANTA as u32;
            let clip = |v: u32| v.saturating_sub(floor).min(SLICE_QUANTA as u32) as u8;
            (clip(self.bottom()), clip(self.top()))
        })
    }
}

impl std::fmt::Debug for Span {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let kind = if self.is_obstacle() { "obstacle" } else { "floor" };
        write!(f, "{kind} {}..={}", self.bottom(), self.top())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_on_slice_boundaries_belong_to_one_slice() {
        let slices = |b, t| Span::new(b, t, false).unwrap().slices();
        assert_eq!(slices(0, 0), (0, 0));
        assert_eq!(slices(255, 255), (1, 1));
        assert_eq!(slices(100, 255), (0, 0));
        assert_eq!(slices(100, 256), (0, 1));
        assert_eq!(slices(254, 511), (0, 2));
        assert_eq!(slices(0, 16320), (0, 63));
        assert_eq!(slices(16319, 16320), (63, 63));
        assert_eq!(Span::new(16320, 16320, false), None);
        assert_eq!(Span::new(3, 2, false), None);
        assert_eq!(Span::new(0, 16320, true).unwrap().slice_mask(), u64::MAX);
    }

    #[test]
    fn spans_of_a_row_are_in_order_of_lane_and_top() {
        let span = |lane, bottom, top| Span::new(bottom, top, lane == 3).unwrap().in_lane(lane);
        let row = [span(0, 16319, 16320), span(3, 5, 7), span(3, 8, 20), span(3, 255, 255), span(7, 0, 0)];
        let first = |lane, low| row.partition_point(|span| span.is_before(lane, low));
        assert_eq!([first(0, 0), first(0, 16320), first(0, 16321), first(1, 0)], [0, 0, 1, 1]);
        assert_eq!([first(3, 0), first(3, 7), first(3, 8), first(3, 20), first(3, 21)], [1, 1, 2, 2, 3]);
        assert_eq!([first(3, i32::MAX as u32), first(7, 0), first(7, 1)], [4, 4, 5]);
    }

    #[test]
    fn parts_within_slices_join_without_gap() {
        let span = Span::new(100, 600, true).unwrap();
        assert_eq!(span.within_slice(0), Some((100, 255)));
        assert_eq!(span.within_slice(1), Some((0, 255)));
        assert_eq!(span.within_slice(2), Some((0, 90)));
        assert_eq!(span.within_slice(3), None);
    }
}

//! Spans per pixel as sorted intervals, and their union over footprints.
//!
//! Gaps without room for the body are closed at once: a union only makes gaps smaller, so nothing is lost, and lists
//! stay as short as the scene has storeys. Unions over windows double their length in each pass, because the union of a
//! set with itself changes nothing (van Herk's windows without the inverse).

use super::pawn::Grid;
use super::{MOST_PAGES, MOST_SPANS, Needs, SPANS_OF_A_PIXEL, Stop};
use crate::frame::{PAGE_QUANTA, PageKey};
use crate::store::{Missing, PageSlot, Snapshot, note};
use std::ops::ControlFlow;

/// Solid from `bottom` to `top` (quanta); `floor` is the highest top of a floor span in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interval {
    pub bottom: i32,
    pub top: i32,
    pub floor: i32,
}

/// Value of `floor` in an interval without floor.
pub const NONE: i32 = i32::MIN;

/// A list for each pixel of a rectangle, row by row.
#[derive(Debug, Clone)]
pub struct Lists {
    width: usize,
    height: usize,
    starts: Vec<u32>,
    items: Vec<Interval>,
}

impl Lists {
    fn with_room(width: usize, height: usize, items: usize) -> Self {
        let mut starts = Vec::with_capacity(width * height + 1);
        starts.push(0);
        Self { width, height, starts, items: Vec::with_capacity(items) }
    }

    /// Returns whether all lists are empty.
    pub fn is_empty(&self) -> bool {
        self.items.is_empty()
    }

    fn is_empty_row(&self, y: usize) -> bool {
        self.starts[y * self.width] == self.starts[(y + 1) * self.width]
    }

    #[inline]
    pub fn at(&self, x: usize, y: usize) -> &[Interval] {
        let cell = y * self.width + x;
        &self.items[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    fn end_cell(&mut self) {
        self.starts.push(self.items.len() as u32);
    }

    /// Reads the spans of the pixels from `corner` on (pixels from the first tile), with gaps too low for the body
    /// closed, and the tops of the floors among them; or returns the pages that are needed.
    pub fn read(set: &Snapshot, grid: &Grid, corner: [i32; 2], [width, height]: [usize; 2]) -> Needs<(Self, Floors)> {
        let last = [corner[0] + width as i32 - 1, corner[1] + height as i32 - 1];
        let columns = Columns::under(set, grid, corner, last)?;
        let (spans, most) = columns.spans();
        if spans > most {
            return ControlFlow::Break(Stop::Spans(spans, most));
        }
        let mut lists = Self::with_room(width, height, 2 * width * height);
        let mut floors = Floors { width, starts: Vec::with_capacity(width * height + 1), tops: Vec::new() };
        floors.starts.push(0);
        for j in corner[1]..=last[1] {
            for i in corner[0]..=last[0] {
                let own = lists.items.len();
                for slot in columns.at(i, j) {
                    let Some(page) = slot.page() else { continue };
                    let base = (i64::from(slot.layer()) - i64::from(grid.origin[2])) * PAGE_QUANTA;
                    for span in page.column((i & 63) as u32, (j & 63) as u32) {
                        let [bottom, top] = [span.bottom(), span.top()].map(|quanta| base as i32 + quanta as i32);
                        let floor = if span.is_obstacle() { NONE } else { top };
                        if floor != NONE {
                            floors.tops.push(top);
                        }
                        push(&mut lists.items, own, Interval { bottom, top, floor }, grid.height);
                    }
                }
                lists.end_cell();
                floors.starts.push(floors.tops.len() as u32);
            }
        }
        ControlFlow::Continue((lists, floors))
    }

    /// Returns the union over `length` neighbouring cells along an axis, from each cell on.
    fn windows(&self, length: usize, axis: usize, least: i32) -> Self {
        let (mut widened, mut have) = (None, 1);
        while have < length {
            let lists: &Self = widened.as_ref().unwrap_or(self);
            let step = have.min(length - have);
            let (dx, dy) = if axis == 0 { (step, 0) } else { (0, step) };
            let (width, height) = (lists.width - dx, lists.height - dy);
            let mut wider = Self::with_room(width, height, lists.items.len());
            for y in 0..height {
                if lists.is_empty_row(y) && lists.is_empty_row(y + dy) {
                    wider.starts.extend(std::iter::repeat_n(wider.items.len() as u32, width));
                    continue;
                }
                for x in 0..width {
                    join(lists.at(x, y), lists.at(x + dx, y + dy), least, &mut wider.items);
                    wider.end_cell();
                }
            }
            widened = Some(wider);
            have += step;
        }
        widened.unwrap_or_else(|| self.clone())
    }

    /// Returns the union over a footprint of `rects` around each pixel, without the outermost `half` pixels of the
    /// lists.
    pub fn under(&self, rects: &[[i32; 2]], half: [i32; 2], least: i32) -> Self {
        let [half_x, half_y] = half.map(|half| half as usize);
        let (width, height) = (self.width - 2 * half_x, self.height - 2 * half_y);
        let mut union: Option<Self> = None;
        for &[x, y] in rects {
            let (kx, ky) = (x as usize, y as usize);
            let rect = self.windows(2 * kx + 1, 0, least).windows(2 * ky + 1, 1, least);
            if rects.len() == 1 && [x, y] == half {
                return rect;
            }
            let mut sum = Self::with_room(width, height, rect.items.len());
            for y in 0..height {
                for x in 0..width {
                    let own = rect.at(x + half_x - kx, y + half_y - ky);
                    match &union {
                        Some(before) => join(before.at(x, y), own, least, &mut sum.items),
                        None => sum.items.extend_from_slice(own),
                    }
                    sum.end_cell();
                }
            }
            union = Some(sum);
        }
        union.unwrap_or_else(|| Self::with_room(0, 0, 0))
    }
}

/// The tops of floor in each pixel of a rectangle, row by row and from below.
#[derive(Debug)]
pub struct Floors {
    width: usize,
    starts: Vec<u32>,
    tops: Vec<i32>,
}

impl Floors {
    /// Returns the highest top from `low` to `high` in the `size` pixels from `at` on.
    pub fn highest(&self, at: [usize; 2], size: [usize; 2], [low, high]: [i32; 2]) -> Option<i32> {
        self.within(at, size).filter(|top| (low..=high).contains(top)).max()
    }

    /// Returns the lowest top from `low` to `high` in the `size` pixels from `at` on.
    pub fn lowest(&self, at: [usize; 2], size: [usize; 2], [low, high]: [i32; 2]) -> Option<i32> {
        self.within(at, size).filter(|top| (low..=high).contains(top)).min()
    }

    fn within(&self, [x, y]: [usize; 2], size: [usize; 2]) -> impl Iterator<Item = i32> {
        (y..y + size[1]).flat_map(move |row| {
            let cell = row * self.width + x;
            let [first, end] = [self.starts[cell], self.starts[cell + size[0]]].map(|start| start as usize);
            self.tops[first..end].iter().copied()
        })
    }
}

/// The tile columns under a rectangle of pixels.
pub struct Columns<'a> {
    first: [i32; 2],
    width: i32,
    slots: Vec<&'a [PageSlot]>,
}

impl<'a> Columns<'a> {
    pub fn under(set: &'a Snapshot, grid: &Grid, first: [i32; 2], last: [i32; 2]) -> Needs<Self> {
        let (first, last) = (first.map(|pixel| pixel >> 6), last.map(|pixel| pixel >> 6));
        let mut missing: Option<Missing> = None;
        let mut slots = Vec::new();
        for (y, x) in (first[1]..=last[1]).flat_map(|y| (first[0]..=last[0]).map(move |x| (y, x))) {
            let column = match (grid.origin[0].checked_add(x), grid.origin[1].checked_add(y)) {
                (Some(tx), Some(ty)) => {
                    let column = set.column(tx, ty);
                    if column.len() > MOST_PAGES {
                        return ControlFlow::Break(Stop::Pages(column.len()));
                    }
                    for slot in column.iter().filter(|slot| slot.page().is_none()) {
                        note(&mut missing, PageKey { tx, ty, layer: slot.layer() });
                    }
                    column
                }
                _ => &[],
            };
            slots.push(column);
        }
        match missing {
            Some(missing) => ControlFlow::Break(Stop::Missing(missing)),
            None => ControlFlow::Continue(Self { first, width: last[0] - first[0] + 1, slots }),
        }
    }

    /// Returns the number of spans in all pages and the most that are allowed; stops counting after the page that exceeds
    /// these.
    pub fn spans(&self) -> (usize, usize) {
        let most = MOST_SPANS.max(SPANS_OF_A_PIXEL * 64 * 64 * self.slots.len());
        let mut sum = 0;
        for page in self.slots.iter().copied().flatten().filter_map(PageSlot::page) {
            sum += page.span_count();
            if sum > most {
                break;
            }
        }
        (sum, most)
    }

    pub fn at(&self, i: i32, j: i32) -> &'a [PageSlot] {
        self.slots[(((j >> 6) - self.first[1]) * self.width + (i >> 6) - self.first[0]) as usize]
    }
}

/// Adds an interval that begins no lower than those from `own` on.
fn push(items: &mut Vec<Interval>, own: usize, next: Interval, least: i32) {
    match items[own..].last_mut() {
        Some(last) if next.bottom - last.top < least => {
            last.top = last.top.max(next.top);
            last.floor = last.floor.max(next.floor);
        }
        _ => items.push(next),
    }
}

/// Appends the union of two lists; gaps below `least` are closed, as they are in both lists.
#[inline]
fn join(a: &[Interval], b: &[Interval], least: i32, to: &mut Vec<Interval>) {
    match (a, b) {
        // Most pixels hold nothing or a single floor.
        ([], _) => return to.extend_from_slice(b),
        (_, []) => return to.extend_from_slice(a),
        ([a], [b]) => {
            let (low, high) = if a.bottom <= b.bottom { (a, b) } else { (b, a) };
            let own = to.len();
            to.push(*low);
            return push(to, own, *high, least);
        }
        _ => {}
    }
    let own = to.len();
    let (mut i, mut j) = (0, 0);
    loop {
        let next = match (a.get(i), b.get(j)) {
            (Some(left), right) if right.is_none_or(|right| left.bottom <= right.bottom) => {
                i += 1;
                left
            }
            (_, Some(right)) => {
                j += 1;
                right
            }
            _ => return,
        };
        push(to, own, *next, least);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const LEAST: i32 = 4;

    /// Lists of a rectangle, with gaps closed as [`Lists::read`] does.
    fn lists(width: usize, cells: &[Vec<Interval>]) -> Lists {
        let mut lists = Lists::with_room(width, cells.len() / width, 0);
        for cell in cells {
            let own = lists.items.len();
            united(cell.clone()).into_iter().for_each(|next| push(&mut lists.items, own, next, LEAST));
            lists.end_cell();
        }
        lists
    }

    /// Returns intervals from below, those together that leave no gap of `LEAST` between them.
    fn united(mut all: Vec<Interval>) -> Vec<Interval> {
        all.sort_by_key(|own| own.bottom);
        let mut united: Vec<Interval> = Vec::new();
        for own in all {
            match united.last_mut() {
                Some(last) if own.bottom < last.top + LEAST => {
                    *last =
                        Interval { top: last.top.max(own.top), floor: last.floor.max(own.floor), bottom: last.bottom };
                }
                _ => united.push(own),
            }
        }
        united
    }

    prop_compose! {
        fn interval()(bottom in 0..60i32, thick in 1..6i32, is_floor in any::<bool>()) -> Interval {
            Interval { bottom, top: bottom + thick, floor: if is_floor { bottom + thick } else { NONE } }
        }
    }

    proptest! {
        #[test]
        fn a_union_under_a_footprint_holds_the_intervals_of_all_its_pixels(
            cells in prop::collection::vec(prop::collection::vec(interval(), 0..4), 9 * 12),
            empty in prop::collection::vec(any::<bool>(), 12),
            rects in prop::collection::vec([0..4i32, 0..4i32], 1..4),
        ) {
            let (width, mut cells) = (9, cells);
            for (y, _) in empty.iter().enumerate().filter(|(_, is_empty)| **is_empty) {
                cells[y * width..][..width].fill(Vec::new());
            }
            let half = [0, 1].map(|axis| rects.iter().map(|rect| rect[axis]).max().unwrap());
            let all = lists(width, &cells);
            prop_assert_eq!(all.is_empty(), cells.iter().all(Vec::is_empty));
            let union = all.under(&rects, half, LEAST);
            prop_assert_eq!((union.width, union.height), (width - 2 * half[0] as usize, 12 - 2 * half[1] as usize));
            for (x, y) in (0..union.width).flat_map(|x| (0..union.height).map(move |y| (x, y))) {
                let under = |[kx, ky]: &[i32; 2]| {
                    let [from_x, from_y] = [x as i32 + half[0] - kx, y as i32 + half[1] - ky];
                    let to = [from_x + 2 * kx, from_y + 2 * ky];
                    (from_y..=to[1]).flat_map(move |j| (from_x..=to[0]).map(move |i| j as usize * width + i as usize))
                };
                let own = rects.iter().flat_map(under).flat_map(|cell| cells[cell].iter().copied()).collect();
                prop_assert_eq!(union.at(x, y), united(own), "at {}, {}", x, y);
            }
        }
    }
}

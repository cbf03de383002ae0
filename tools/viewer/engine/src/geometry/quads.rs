//! Converts cells to quads; equal neighbours are joined, along x first.

use super::cells::{Bar, Cells};
use super::smooth::{Corner, End};
use super::{Face, Faces};

/// Slopes are rounded to this many degrees, so that nearly level faces can be joined.
const SLOPE_STEP_DEG: f64 = 15.0;
/// Neighbouring tops with a steeper connection belong to two surfaces.
const CONNECTED_DEG: f64 = 78.0;

/// Adjacent cells at one height: from `x0` up to, but without, `x1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Strip {
    x0: u16,
    x1: u16,
    z: u16,
    attributes: [u8; 3],
}

/// Adds quads at the tops of bars or at their undersides.
pub(super) fn levels(cells: &Cells, top: bool, faces: &mut Faces) {
    let edge = cells.edge as isize;
    // Rectangles that end in the previous row, with their first row; both lists ascend by `x0`.
    let mut open: Vec<(Strip, u16)> = Vec::new();
    let mut strips: Vec<Strip> = Vec::new();
    // Strips that end in the previous cell, and those that end in this one.
    let (mut ends, mut now): (Vec<usize>, Vec<usize>) = Default::default();
    for y in 0..=edge {
        strips.clear();
        ends.clear();
        for x in 0..edge {
            now.clear();
            for bar in cells.within(x, y) {
                let z = if top { bar.top } else { bar.bottom };
                let slope = if top { slope(cells, faces.step_cells, x, y, z) } else { 0 };
                let face = if top { Face::Top } else { Face::Underside };
                let attributes = [face as u8, u8::from(bar.obstacle), slope];
                if bent(cells, top, [x, y], z, attributes, faces) {
                    continue;
                }
                let joins = |at: &&usize| (strips[**at].z, strips[**at].attributes) == (z, attributes);
                if let Some(&at) = ends.iter().find(joins) {
                    strips[at].x1 += 1;
                    now.push(at);
                } else {
                    now.push(strips.len());
                    strips.push(Strip { x0: x as u16, x1: x as u16 + 1, z, attributes });
                }
            }
            std::mem::swap(&mut ends, &mut now);
        }
        let before = std::mem::take(&mut open);
        let mut continued = vec![false; before.len()];
        let mut first = 0;
        for strip in &strips {
            while before.get(first).is_some_and(|(other, _)| other.x0 < strip.x0) {
                first += 1;
            }
            let beside = before[first..].iter().take_while(|(other, _)| other.x0 == strip.x0);
            let same = beside.zip(first..).find(|((other, _), _)| other == strip).map(|(_, at)| at);
            if let Some(at) = same {
                continued[at] = true;
            }
            open.push((*strip, same.map_or(y as u16, |at| before[at].1)));
        }
        for ((Strip { x0, x1, z, attributes }, y0), _) in
            before.into_iter().zip(continued).filter(|(_, goes_on)| !goes_on)
        {
            let y1 = y as u16;
            let corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]];
            match top {
                true => faces.quad(corners, [0, 0, 127], attributes),
                false => faces.quad([corners[0], corners[3], corners[2], corners[1]], [0, 0, -127], attributes),
            }
        }
    }
}

/// Adds the face of one cell if it is smooth and not level; returns whether it is.
fn bent(cells: &Cells, top: bool, [x, y]: [isize; 2], z: u16, attributes: [u8; 3], faces: &mut Faces) -> bool {
    let Some(smooth) = faces.smooth else { return false };
    let end = if top { End::Top } else { End::Bottom };
    let corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)];
    let found = corners.map(|(x, y)| smooth.corner(cells, x, y, end, z));
    let level =
        Corner { height: (u32::from(z) * smooth.step) as u16, normal: if top { [0, 0, 127] } else { [0, 0, -127] } };
    if found.iter().all(|corner| *corner == level) {
        return false;
    }
    let place = |n: usize| [corners[n].0 as u16, corners[n].1 as u16, found[n].height];
    let order = if top { [0, 1, 2, 3] } else { [0, 3, 2, 1] };
    faces.bent(order.map(place), order.map(|n| found[n].normal), attributes);
    true
}

/// Slope of the surface around a top (degrees, in steps), from the tops up to two cells away.
fn slope(cells: &Cells, step_cells: f64, x: isize, y: isize, height: u16) -> u8 {
    let most = CONNECTED_DEG.to_radians().tan();
    let rise = |dx: isize, dy: isize| {
        let far = [2, 1].into_iter().find_map(|far| {
            let tops = cells.at(x + dx * far, y + dy * far).iter().map(|bar| bar.top);
            let nearest = tops.min_by_key(|top| top.abs_diff(height))?;
            let rise = (f64::from(nearest) - f64::from(height)) * step_cells;
            (rise.abs() <= most * far as f64).then_some((rise, far as f64))
        });
        far.unwrap_or((0.0, 0.0))
    };
    let along = |dx: isize, dy: isize| {
        let ((ahead, far), (behind, near)) = (rise(dx, dy), rise(-dx, -dy));
        if far + near > 0.0 { (ahead - behind) / (far + near) } else { 0.0 }
    };
    let degrees = along(1, 0).hypot(along(0, 1)).atan().to_degrees();
    ((degrees / SLOPE_STEP_DEG).round() * SLOPE_STEP_DEG) as u8
}

/// Uncovered part of a side of a bar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Side {
    bottom: u16,
    top: u16,
    obstacle: bool,
    /// True if it faces greater coordinates.
    up: bool,
}

/// Adds quads between cells of which one is solid and the other is not.
pub(super) fn sides(cells: &Cells, faces: &mut Faces) {
    let edge = cells.edge as isize;
    // Sides that end in the previous cell, each with its first cell.
    let (mut open, mut now) = (Vec::<(Side, u16)>::new(), Vec::new());
    for along_y in [true, false] {
        for plane in 0..=edge {
            for at in 0..=edge {
                let cell = |side: isize| if along_y { cells.within(side, at) } else { cells.within(at, side) };
                let (below, above) = (cell(plane - 1), cell(plane));
                for (here, there, up) in [(below, above, true), (above, below, false)] {
                    uncovered(here, there, |bar, bottom, top| {
                        let side = Side { bottom, top, obstacle: bar.obstacle, up };
                        if bent_side(cells, faces, along_y, side, [plane, at], bar) {
                            return;
                        }
                        // A side that continues is no longer open.
                        let goes_on = open.iter().position(|(other, _)| *other == side);
                        now.push((side, goes_on.map_or(at as u16, |n| open.swap_remove(n).1)));
                    });
                }
                for (side, from) in open.drain(..) {
                    side_quad(faces, along_y, side, plane as u16, [from, at as u16]);
                }
                std::mem::swap(&mut open, &mut now);
            }
        }
    }
}

/// Adds a side of one cell whose ends are smooth and not level, unless they meet; returns whether they are.
fn bent_side(cells: &Cells, faces: &mut Faces, along_y: bool, side: Side, [plane, at]: [isize; 2], bar: &Bar) -> bool {
    let Some(smooth) = faces.smooth else { return false };
    // A side ends where its bar does, or at a bar of the other cell.
    let low = (if side.bottom == bar.bottom { End::Bottom } else { End::Top }, side.bottom);
    let high = (if side.top == bar.top { End::Top } else { End::Bottom }, side.top);
    let corner = |along: isize| if along_y { [plane, along] } else { [along, plane] };
    let ends = [at, at + 1].map(|along| smooth.side(cells, corner(along), [low, high]));
    let level = [side.bottom, side.top].map(|z| (u32::from(z) * smooth.step) as u16);
    if ends == [level; 2] {
        return false;
    }
    if ends.iter().any(|[bottom, top]| bottom < top) {
        let point = |along: isize, z: u16| {
            let [x, y] = corner(along);
            [x as u16, y as u16, z]
        };
        let [[a0, a1], [b0, b1]] = ends;
        let corners = [point(at, a0), point(at + 1, b0), point(at + 1, b1), point(at, a1)];
        let (corners, normal) = facing(corners, along_y, side.up);
        faces.bent(corners, [normal; 4], [Face::Side as u8, u8::from(side.obstacle), 90]);
    }
    true
}

/// Corners of a side in their order, and its normal.
fn facing(corners: [[u16; 3]; 4], along_y: bool, up: bool) -> ([[u16; 3]; 4], [i8; 3]) {
    let way = if up { 127 } else { -127 };
    let normal = if along_y { [way, 0, 0] } else { [0, way, 0] };
    // Seen against +x, y runs to the right; seen against +y, x runs to the left.
    match up == along_y {
        true => (corners, normal),
        false => ([corners[0], corners[3], corners[2], corners[1]], normal),
    }
}

fn side_quad(faces: &mut Faces, along_y: bool, side: Side, plane: u16, [a, b]: [u16; 2]) {
    let Side { bottom: z0, top: z1, obstacle, up } = side;
    let corner = |along: u16, z: u16| if along_y { [plane, along, z] } else { [along, plane, z] };
    let corners = [corner(a, z0), corner(b, z0), corner(b, z1), corner(a, z1)];
    let (corners, normal) = facing(corners, along_y, up);
    faces.quad(corners, normal, [Face::Side as u8, u8::from(obstacle), 90]);
}

/// Calls `f` for the parts of `here` that `there` does not cover.
fn uncovered<'a>(here: &'a [Bar], there: &[Bar], mut f: impl FnMut(&'a Bar, u16, u16)) {
    for bar in here {
        let mut from = bar.bottom;
        for other in there.iter().filter(|other| other.top > bar.bottom && other.bottom < bar.top) {
            if other.bottom > from {
                f(bar, from, other.bottom);
            }
            from = from.max(other.top);
        }
        if from < bar.top {
            f(bar, from, bar.top);
        }
    }
}

//! Cells to quads; equal neighbours are joined, along x first.

use super::cells::{Bar, Cells};
use super::{Face, Faces};
use std::collections::HashMap;

/// Slopes are told in steps of this many degrees, so that what is nearly level can be joined.
const SLOPE_STEP_DEG: f64 = 15.0;
/// Neighbouring tops steeper than this are two surfaces.
const CONNECTED_DEG: f64 = 78.0;

/// Quads at the tops of bars, or at their undersides.
pub(super) fn levels(cells: &Cells, top: bool, faces: &mut Faces) {
    let edge = cells.edge as isize;
    // Rectangles that end in the row before: from (x0, x1, height, attributes) to its first row.
    let mut open: HashMap<(u16, u16, u16, [u8; 3]), u16> = HashMap::new();
    let mut runs: Vec<(u16, u16, u16, [u8; 3])> = Vec::new();
    for y in 0..=edge {
        runs.clear();
        // Runs that end in the cell before, by place in `runs`.
        let mut ends: Vec<usize> = Vec::new();
        for x in 0..edge {
            let mut now = Vec::with_capacity(ends.len());
            for bar in cells.at(x, y) {
                let height = if top { bar.top } else { bar.bottom };
                let slope = if top { slope(cells, faces.step_cells, x, y, height) } else { 0 };
                let face = if top { Face::Top } else { Face::Underside };
                let attributes = [face as u8, u8::from(bar.obstacle), slope];
                let joins = ends.iter().copied().find(|&run| (runs[run].2, runs[run].3) == (height, attributes));
                match joins {
                    Some(run) => {
                        runs[run].1 = x as u16 + 1;
                        now.push(run);
                    }
                    None => {
                        now.push(runs.len());
                        runs.push((x as u16, x as u16 + 1, height, attributes));
                    }
                }
            }
            ends = now;
        }
        let before = std::mem::take(&mut open);
        open.extend(runs.iter().map(|run| (*run, before.get(run).copied().unwrap_or(y as u16))));
        let mut closed: Vec<_> = before.into_iter().filter(|(run, _)| !open.contains_key(run)).collect();
        // A hash table has no order of its own.
        closed.sort_unstable();
        for ((x0, x1, z, attributes), y0) in closed {
            let y1 = y as u16;
            let corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]];
            match top {
                true => faces.quad(corners, [0, 0, 127], attributes),
                false => faces.quad([corners[0], corners[3], corners[2], corners[1]], [0, 0, -127], attributes),
            }
        }
    }
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

/// Quads between cells of which one has matter and the other has not.
pub(super) fn sides(cells: &Cells, faces: &mut Faces) {
    let edge = cells.edge as isize;
    for along_y in [true, false] {
        for plane in 0..=edge {
            // Stretches that end in the cell before: from (bottom, top, obstacle, towards greater coordinates) to their first.
            let mut open: HashMap<(u16, u16, bool, bool), u16> = HashMap::new();
            for at in 0..=edge {
                let cell = |side: isize| if along_y { cells.at(side, at) } else { cells.at(at, side) };
                let mut now = HashMap::new();
                if at < edge {
                    let mut side = |here: &[Bar], there: &[Bar], up: bool| {
                        uncovered(here, there, |bottom, top, obstacle| {
                            let key = (bottom, top, obstacle, up);
                            now.insert(key, open.get(&key).copied().unwrap_or(at as u16));
                        });
                    };
                    side(cell(plane - 1), cell(plane), true);
                    side(cell(plane), cell(plane - 1), false);
                }
                let mut closed: Vec<_> = open.into_iter().filter(|(key, _)| !now.contains_key(key)).collect();
                closed.sort_unstable();
                for ((bottom, top, obstacle, up), from) in closed {
                    side_quad(faces, along_y, up, plane as u16, [from, at as u16], [bottom, top], obstacle);
                }
                open = now;
            }
        }
    }
}

fn side_quad(
    faces: &mut Faces,
    along_y: bool,
    up: bool,
    plane: u16,
    [a, b]: [u16; 2],
    [z0, z1]: [u16; 2],
    obstacle: bool,
) {
    let corner = |along: u16, z: u16| if along_y { [plane, along, z] } else { [along, plane, z] };
    let corners = [corner(a, z0), corner(b, z0), corner(b, z1), corner(a, z1)];
    let way = if up { 127 } else { -127 };
    let normal = if along_y { [way, 0, 0] } else { [0, way, 0] };
    // Seen against +x, y runs to the right; seen against +y, x runs to the left.
    let corners = match up == along_y {
        true => corners,
        false => [corners[0], corners[3], corners[2], corners[1]],
    };
    faces.quad(corners, normal, [Face::Side as u8, u8::from(obstacle), 90]);
}

/// Calls `f` with the stretches of `here` that `there` leaves open.
fn uncovered(here: &[Bar], there: &[Bar], mut f: impl FnMut(u16, u16, bool)) {
    for bar in here {
        let mut from = bar.bottom;
        for other in there.iter().filter(|other| other.top > bar.bottom && other.bottom < bar.top) {
            if other.bottom > from {
                f(from, other.bottom, bar.obstacle);
            }
            from = from.max(other.top);
        }
        if from < bar.top {
            f(from, bar.top, bar.obstacle);
        }
    }
}

//! `slicetool stats --coverage`: how much space scanners saw, where it ends in the open, and where the next station should
//! stand.
//!
//! The *border* is made of the faces between seen cells and cells that were neither seen nor lie within two cells of
//! anything solid: a gap in the scan, or its end in the open. A station is the better the more of the border it looks
//! at, from a seen place at eye height above a floor. The first one sees most of the border, each further one most of
//! what is left.

use crate::ground::{Loader, seen_space, tidy};
use crate::{Failure, Outcome};
use nalgebra::{Point3, Vector3};
use serde_json::json;
use slicewalk::Parameter;
use slicewalk::frame::{PAGE_SLICES, PageKey, TILE_PIXELS};
use slicewalk::query::{Aabb, Answer, Overlap, Ray, cast, floor_under, overlaps};
use slicewalk::seen::{CELL_PIXELS, SeenPage, SeenSpace};
use slicewalk_base::text::{counted, grouped};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;

/// Height of a scanner on its tripod, and how far seen places may lie from it (m).
const EYE_M: f64 = 1.6;
const EYE_WITHIN_M: f64 = 0.3;
/// Distance between places at which stations are tried, at least (m), and the most of them.
const APART_M: f64 = 1.0;
const MOST_PLACES: usize = 1000;
/// Greatest distance of places: squares larger than any scan (m).
const FARTHEST_M: f64 = 1e7;
/// Most parts of the border that are looked at, and most that are checked for solid near by.
const MOST_LOOKED_AT: usize = 2000;
const MOST_CHECKED: usize = 200_000;
/// Most places that are held before those without a floor are left out.
const MOST_HELD: usize = 1 << 17;
/// Distance beyond which a station does not count as looking at the border (m).
const FAR_M: f64 = 30.0;
/// Stations named, and the least share of the border that one must see.
const STATIONS: usize = 5;
const LEAST_SHARE: f64 = 0.02;
/// Cells around an unseen one in which nothing solid lies.
const CLEAR_CELLS: f64 = 2.0;
/// Most memory for seen space (bytes), and for pages.
const MOST_SEEN_BYTES: u64 = 4 << 30;
const PAGES_BYTES: u64 = 256 << 20;
/// Colours of the picture: never seen, seen, its border, stations.
const COLOURS: [[u8; 3]; 4] = [[0; 3], [0, 0, 96], [255, 64, 0], [255; 3]];
/// Greatest edge of a picture (pixels).
const MAX_EDGE: i64 = 65_500;
/// Most pixels of a picture, a byte each in memory.
const MOST_PIXELS: i64 = 1 << 28;

type Cell = [i64; 3];

/// A station that should be next.
struct Station {
    at: Point3<f64>,
    /// Area of the border that no earlier one sees (m²).
    border_m2: f64,
}

struct Survey<'a> {
    loader: Loader,
    seen: &'a SeenSpace,
    /// Edges of a cell (m).
    size: [f64; 3],
}

/// Reports the coverage of the archive at `path`; draws a plan of it to `output`.
pub fn run(path: &Path, output: Option<&Path>, json: bool) -> Outcome {
    crate::standard::refuse_two("-o", output, json)?;
    let archive = crate::open(path)?;
    let seen = seen_space(&archive, path, MOST_SEEN_BYTES, Parameter::Bounds)?;
    let to = output.map(|output| crate::output(output, &archive, &[])).transpose()?;
    let frame = *archive.frame();
    let across = CELL_PIXELS as f64 * frame.pixel_m();
    let survey = Survey {
        loader: Loader::new(archive, path, PAGES_BYTES)?,
        seen: &seen,
        size: [across, across, frame.slice_m()],
    };
    let (faces, border_m2) = survey.border()?;
    let stations = survey.stations(&faces, border_m2)?;
    let volume_m3 = seen.cells() as f64 * survey.size.iter().product::<f64>();
    if let (Some(mut to), Some(output)) = (to, output) {
        let image = survey.picture(&faces, &stations, output)?;
        to.write_at(0, &image)?;
        to.publish()?;
    }
    if json {
        let next = stations.iter().map(|station| {
            let [x, y, z] = [station.at.x, station.at.y, station.at.z].map(tidy);
            json!({ "x": x, "y": y, "z": z, "border_m2": tidy(station.border_m2), "share": tidy(station.border_m2 / border_m2) })
        });
        let facts = json!({
            "seen": { "cells": seen.cells(), "m3": tidy(volume_m3) },
            "border_m2": tidy(border_m2),
            "next": next.collect::<Vec<_>>(),
        });
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    let (cells, volume) = (counted(seen.cells(), "cell"), grouped(volume_m3.round() as u64));
    writeln!(text, "seen: {cells}, {volume} m³; it ends in the open over {border_m2:.1} m²")?;
    for (number, Station { at, border_m2: own }) in (1..).zip(&stations) {
        let share = 100.0 * own / border_m2;
        writeln!(text, "station {number}: {:.2},{:.2},{:.2} sees {own:.1} m² of that, {share:.0} %", at.x, at.y, at.z)?;
    }
    if stations.is_empty() {
        writeln!(text, "no station at eye height would see much of that")?;
    }
    output.map_or(Ok(text.clone()), |output| crate::standard::written(output, &text))
}

/// Calls `give` with each seen cell, until a signal asks to stop.
fn each_cell(seen: &SeenSpace, mut give: impl FnMut(Cell)) -> Result<(), Failure> {
    for (key, page) in seen.pages() {
        crate::go_on()?;
        each_cell_of(key, &page, &mut give);
    }
    Ok(())
}

/// Calls `give` with each seen cell of a page.
fn each_cell_of(key: PageKey, page: &SeenPage, mut give: impl FnMut(Cell)) {
    let per_page = TILE_PIXELS / CELL_PIXELS;
    let first = [i64::from(key.tx) * per_page, i64::from(key.ty) * per_page, i64::from(key.layer) * PAGE_SLICES];
    for at in 0..SeenPage::CELLS as usize {
        let by = [at % 16, at / 16 % 16, at / 256];
        if page.is_seen(by.map(|at| [at; 2])) {
            give([0, 1, 2].map(|axis| first[axis] + by[axis] as i64));
        }
    }
}

impl Survey<'_> {
    fn middle(&self, cell: Cell) -> Point3<f64> {
        Point3::from([0, 1, 2].map(|axis| (cell[axis] as f64 + 0.5) * self.size[axis]))
    }

    /// Returns seen cells at the border with the area that each stands for (m²), and the area of the border.
    fn border(&self) -> Result<(Vec<(Cell, f64)>, f64), Failure> {
        // Evenly spread over space, since cells come along the curve of the archive. All of them may take far more memory
        // than the space itself.
        let (mut ends, mut every, mut number) = (Vec::new(), 1usize, 0usize);
        each_cell(self.seen, |cell| {
            for (axis, by) in (0..3).flat_map(|axis| [(axis, -1), (axis, 1)]) {
                let mut beyond = cell;
                beyond[axis] += by;
                if self.seen.is_seen(self.middle(beyond)) {
                    continue;
                }
                if number.is_multiple_of(every) {
                    ends.push((cell, beyond, axis));
                }
                number += 1;
                if ends.len() > MOST_CHECKED {
                    let mut place = 0;
                    ends.retain(|_| {
                        place += 1;
                        place % 2 == 1
                    });
                    every *= 2;
                }
            }
        })?;
        let mut faces: Vec<(Cell, f64)> = Vec::new();
        for (cell, beyond, axis) in ends {
            let around = Vector3::from(self.size) * (0.5 + CLEAR_CELLS);
            let middle = self.middle(beyond);
            let shape = Aabb::new(middle - around, middle + around)?;
            let is_open = self.loader.known(|view| {
                Ok(match overlaps(view, &shape) {
                    Overlap::Clear => Answer::Known(true),
                    Overlap::Hit => Answer::Known(false),
                    Overlap::NotLoaded(missing) => Answer::NotLoaded(missing),
                })
            })?;
            if is_open {
                let area = self.size[(axis + 1) % 3] * self.size[(axis + 2) % 3];
                faces.push((cell, area * every as f64));
            }
        }
        let border_m2 = faces.iter().map(|face| face.1).sum();
        Ok((faces, border_m2))
    }

    /// Returns places at eye height above floors, some distance apart.
    fn places(&self) -> Result<Vec<Point3<f64>>, Failure> {
        let mut apart = APART_M;
        loop {
            let mut best: BTreeMap<Cell, (i64, Cell)> = BTreeMap::new();
            let mut places = Vec::new();
            for (key, page) in self.seen.pages() {
                crate::go_on()?;
                each_cell_of(key, &page, |cell| {
                    let at = self.middle(cell);
                    let square =
                        [(at.x / apart).floor(), (at.y / apart).floor(), (at.z / 0.5).floor()].map(|v| v as i64);
                    let off = |v: f64| ((v / apart).fract() - 0.5).abs();
                    let away = ((off(at.x) + off(at.y)) * 1000.0) as i64;
                    let own = best.entry(square).or_insert((away, cell));
                    *own = (*own).min((away, cell));
                });
                if best.len() > MOST_HELD {
                    self.add_places(std::mem::take(&mut best), &mut places)?;
                }
                if places.len() > MOST_PLACES {
                    break;
                }
            }
            self.add_places(best, &mut places)?;
            // Floors above one another stay, however far apart places are.
            if places.len() <= MOST_PLACES || apart > FARTHEST_M {
                places.truncate(MOST_PLACES);
                return Ok(places);
            }
            apart *= 1.5;
        }
    }

    /// Adds those of these cells that lie at eye height above a floor.
    fn add_places(&self, cells: BTreeMap<Cell, (i64, Cell)>, places: &mut Vec<Point3<f64>>) -> Result<(), Failure> {
        for (_, cell) in cells.into_values() {
            let at = self.middle(cell);
            let foot = Aabb::new(at, at)?;
            let floor = self.loader.known(|view| Ok(floor_under(view, &foot, at.z, EYE_M + EYE_WITHIN_M)))?;
            if floor.is_some_and(|floor| (at.z - floor - EYE_M).abs() <= EYE_WITHIN_M) {
                places.push(at);
            }
        }
        Ok(())
    }

    fn stations(&self, faces: &[(Cell, f64)], border_m2: f64) -> Result<Vec<Station>, Failure> {
        let every = faces.len().div_ceil(MOST_LOOKED_AT).max(1);
        let mut left: Vec<(Point3<f64>, f64)> =
            faces.iter().step_by(every).map(|(cell, area)| (self.middle(*cell), area * every as f64)).collect();
        let places = self.places()?;
        let mut visible: Vec<Vec<bool>> = Vec::new();
        for place in &places {
            visible.push(left.iter().map(|(face, _)| self.looks_at(*place, *face)).collect::<Result<_, _>>()?);
        }
        let mut stations = Vec::new();
        while stations.len() < STATIONS {
            let sees = |visible: &Vec<bool>| -> f64 {
                left.iter().zip(visible).filter(|(_, visible)| **visible).map(|(face, _)| face.1).sum()
            };
            let areas = visible.iter().map(sees).enumerate();
            // Of equal ones the first.
            let Some((best, own)) = areas.reduce(|best, other| if other.1 > best.1 { other } else { best }) else {
                break;
            };
            if own < LEAST_SHARE * border_m2 || own <= 0.0 {
                break;
            }
            stations.push(Station { at: places[best], border_m2: own });
            left.iter_mut().zip(&visible[best]).filter(|(_, visible)| **visible).for_each(|(face, _)| face.1 = 0.0);
        }
        Ok(stations)
    }

    fn looks_at(&self, place: Point3<f64>, face: Point3<f64>) -> Result<bool, Failure> {
        let along = face - place;
        let far = along.norm();
        if far > FAR_M || far < self.size[0] {
            return Ok(far <= FAR_M);
        }
        let ray = Ray::new(place, along, far)?;
        Ok(self.loader.known(|view| Ok(cast(view, &ray)))?.is_none())
    }

    /// Draws a plan, a pixel a cell: what was seen, its border, and stations.
    fn picture(&self, faces: &[(Cell, f64)], stations: &[Station], path: &Path) -> Result<Vec<u8>, Failure> {
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        each_cell(self.seen, |cell| {
            for axis in 0..2 {
                (low[axis], high[axis]) = (low[axis].min(cell[axis] - 4), high[axis].max(cell[axis] + 4));
            }
        })?;
        let size = [0, 1].map(|axis| high[axis].saturating_sub(low[axis]) + 1);
        if seen_nothing(&size) || size.iter().any(|edge| *edge > MAX_EDGE) {
            let reason = format!("a plan of {} × {} cells; expected 1 to {MAX_EDGE} each", size[0], size[1]);
            return Err(Failure::Text(format!("{}: {reason}", path.display())));
        }
        let [width, height] = size;
        if width * height > MOST_PIXELS {
            let reason = format!("a plan of {width} × {height} cells; expected at most {MOST_PIXELS} in all");
            return Err(Failure::Text(format!("{}: {reason}; extract a region first", path.display())));
        }
        // Numbers of colours.
        let mut pixels = vec![0u8; (width * height) as usize];
        let mut set = |[x, y]: [i64; 2], colour: u8| {
            let [column, row] = [x - low[0], high[1] - y];
            if (0..width).contains(&column) && (0..height).contains(&row) {
                pixels[(row * width + column) as usize] = colour;
            }
        };
        each_cell(self.seen, |[x, y, _]| set([x, y], 1))?;
        faces.iter().for_each(|([x, y, _], _)| set([*x, *y], 2));
        for Station { at, .. } in stations {
            let middle = [(at.x / self.size[0]).floor() as i64, (at.y / self.size[1]).floor() as i64];
            (-3..=3).for_each(|by| {
                set([middle[0] + by, middle[1]], 3);
                set([middle[0], middle[1] + by], 3);
            });
        }
        let mut image = Vec::new();
        let mut encoder = png::Encoder::new(&mut image, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        let mut stream = writer.stream_writer()?;
        for row in pixels.chunks_exact(width as usize) {
            let row: Vec<[u8; 3]> = row.iter().map(|colour| COLOURS[usize::from(*colour)]).collect();
            stream.write_all(row.as_flattened())?;
        }
        stream.finish()?;
        writer.finish()?;
        Ok(image)
    }
}

fn seen_nothing(size: &[i64; 2]) -> bool {
    size.iter().any(|edge| *edge <= 0)
}

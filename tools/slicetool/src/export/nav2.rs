//! Occupancy grids of storeys for the map server of Nav2 (ROS): `NAME.yaml` with `NAME.pgm`, and links between storeys.
//!
//! A grid has one sample per pixel, with the greatest y first: *free* where the middle of the pawn can stand on the
//! storey, *occupied* where its body above the climb height collides, *unknown* elsewhere. Where the pawn cannot stand,
//! its feet count as level with the nearest standing place of the storey. Where an archive stores seen space, places
//! where no scanner saw the middle of the pawn above its climb height are unknown, not free. Format: the page on the map server in the
//! documentation of Nav2, trinary mode; its thresholds are those at which the three grey values differ.

use crate::ground::{Loader, Pawns, tidy};
use crate::{Failure, Quiet};
use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use slicewalk::archive::Archive;
use slicewalk::frame::{Frame, TILE_PIXELS};
use slicewalk::query::{Aabb, Answer, Cylinder, Overlap, overlaps};
use slicewalk::reach::{Flood, Pawn, Region, StandingPlaces, Storey, Storeys};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;
use slicewalk_base::output::Output;
use slicewalk_base::text::{grouped, number, one_line};
use std::collections::{HashMap, VecDeque};
use std::io::{BufWriter, IntoInnerError, Write};
use std::path::{Path, PathBuf};

/// Most pixels of a grid: each takes five bytes of memory, or sixteen in a heightfield, besides the queue of a search.
const MOST_PIXELS: i64 = 1 << 26;
/// Grey values of map files.
const FREE: u8 = 254;
const UNKNOWN: u8 = 205;
const OCCUPIED: u8 = 0;
/// Least height of a body above the climb height (m).
const LEAST_BODY_M: f64 = 0.05;
/// A body that only touches something solid does not collide (m).
const TOUCH_M: f64 = 1e-6;
/// Farthest from a link that its steps are looked at (m), and the highest step of a ramp (m).
const LINK_M: f64 = 1.0;
const RAMP_STEP_M: f64 = 0.06;

/// Storeys to write.
#[derive(Clone, Copy)]
pub enum Which {
    /// All of them, each in files of its own, with the links between them.
    All,
    /// The one with this number, counted from the lowest.
    Number(usize),
    /// The one whose floor is nearest to this height (m).
    Near(f64),
}

/// Everything that the pawn can stand on.
pub struct Ground<'a> {
    loader: &'a Loader,
    pawn: Pawn,
    region: Region,
    storeys: Storeys,
    /// First pixel, and size of the grids.
    first: [i64; 2],
    size: [i64; 2],
}

/// Writes the grids of an archive at `path`; returns a line about each file. Memory: the region, the pages in the
/// cache, and one grid.
pub fn write(output: &Path, path: &Path, pawns: &Pawns, which: Which) -> Result<String, Failure> {
    let loader = Loader::new(pawns.open(path)?, path, pawns.cache())?.knowing_seen()?;
    let (archive, edits) = (loader.archive(), pawns.edits().path());
    let named = |storey: usize| beside(output, &format!("_storey{storey}.yaml"));
    // Before the work, which would be lost if one of these must not be replaced.
    let is_all = matches!(which, Which::All);
    let first = GridFiles::begin(&if is_all { named(0) } else { output.to_path_buf() }, archive, edits)?;
    let links = is_all.then(|| crate::output(&beside(output, "_links.geojson"), archive, edits.as_slice()));
    let links = links.transpose()?;
    let ground = Ground::of(&loader, pawns.pawn())?;
    let chosen = ground.chosen(which)?;
    let mut about = ground.grid(chosen.unwrap_or(0), first)?;
    if let Some(links) = links {
        for storey in 1..ground.storeys.all.len() {
            about += &ground.grid(storey, GridFiles::begin(&named(storey), archive, edits)?)?;
        }
        about += &ground.write_links(links, &named)?;
    }
    Ok(about)
}

/// The files of a grid.
struct GridFiles {
    image: Output,
    yaml: Output,
}

impl GridFiles {
    /// Begins `yaml`, and the image beside it. Neither may replace what the command reads.
    fn begin(yaml: &Path, archive: &Archive, edits: Option<&Path>) -> Result<Self, Failure> {
        let image = yaml.with_extension("pgm");
        let also: Vec<&Path> = edits.into_iter().chain([image.as_path()]).collect();
        Ok(Self {
            image: crate::output(&image, archive, edits.as_slice())?,
            yaml: crate::output(yaml, archive, &also)?,
        })
    }
}

/// Returns the name of `output` with another end in place of its extension.
fn beside(output: &Path, end: &str) -> PathBuf {
    let stem = output.file_stem().unwrap_or_default().to_string_lossy();
    output.with_file_name(format!("{stem}{end}"))
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

impl<'a> Ground<'a> {
    /// Finds where the pawn can stand.
    pub fn of(loader: &'a Loader, pawn: Pawn) -> Result<Self, Failure> {
        let view = loader.snapshot();
        let (mut low, mut high) = ([i64::MAX; 2], [i64::MIN; 2]);
        // Those of edits included.
        for number in 0..view.column_count() {
            let (tx, ty, _) = view.column_at(number);
            for (axis, tile) in [tx, ty].map(i64::from).into_iter().enumerate() {
                low[axis] = low[axis].min(tile * TILE_PIXELS);
                high[axis] = high[axis].max((tile + 1) * TILE_PIXELS);
            }
        }
        let size = [0, 1].map(|axis| high[axis].saturating_sub(low[axis]).max(0));
        if size[0].saturating_mul(size[1]) > MOST_PIXELS {
            let reason = format!("a map of {} × {} pixels, more than {MOST_PIXELS}", size[0], size[1]);
            return Err(Failure::Text(format!("{}: {reason}; extract a region first", loader.path().display())));
        }
        let mut standing = StandingPlaces::new(&view, pawn)?;
        // It would keep evicted pages in memory.
        drop(view);
        let mut flood = loader.known(|view| Flood::everywhere(&mut standing, view))?;
        loader.known(|view| flood.grow(&mut standing, view, &Quiet))?;
        let region = flood.region(&standing);
        Ok(Self { loader, pawn, storeys: region.storeys(), region, first: low, size })
    }

    /// Returns the storey to write, `None` for all.
    pub fn chosen(&self, which: Which) -> Result<Option<usize>, Failure> {
        let (all, path) = (&self.storeys.all, self.loader.path());
        if all.is_empty() {
            let reason = "the pawn can stand nowhere; give a smaller --pawn";
            return Err(Failure::Text(format!("{}: {reason}", path.display())));
        }
        Ok(match which {
            Which::All => None,
            Which::Number(storey) if storey < all.len() => Some(storey),
            Which::Number(storey) => {
                let reason = format!("--storey {storey}: expected 0 to {}, the storeys of the archive", all.len() - 1);
                return Err(Failure::Text(format!("{}: {reason}", path.display())));
            }
            Which::Near(z) => {
                let far = |storey: &usize| (all[*storey].z - z).abs();
                (0..all.len()).min_by(|a, b| far(a).total_cmp(&far(b)))
            }
        })
    }

    /// All storeys, from the lowest up.
    pub fn storeys(&self) -> &[Storey] {
        &self.storeys.all
    }

    /// First pixel of the grids.
    pub fn first(&self) -> [i64; 2] {
        self.first
    }

    /// Pixels of the grids along x and y.
    pub fn size(&self) -> [i64; 2] {
        self.size
    }

    fn frame(&self) -> &Frame {
        self.loader.archive().frame()
    }

    /// Returns the places of the region with their pixels and storeys.
    fn places(&self) -> impl Iterator<Item = ([i64; 2], f64, u16)> + '_ {
        let frame = self.frame();
        self.region.places().zip(&self.storeys.of).map(|(place, storey)| {
            ([frame.pixel_of(place.feet.x), frame.pixel_of(place.feet.y)], place.feet.z, *storey)
        })
    }

    /// Writes the grid of a storey. Returns a line about it.
    fn grid(&self, storey: usize, files: GridFiles) -> Result<String, Failure> {
        let (image, name) = (file_name(files.image.name()), files.yaml.name().to_string_lossy().into_owned());
        let samples = self.samples(storey)?;
        let (frame, [width, height]) = (self.frame(), self.size);
        let origin = self.first.map(|pixel| number(frame.edge_of_pixel(pixel)));
        let Storey { z, .. } = self.storeys.all[storey];
        let mut file = BufWriter::new(files.image);
        write!(file, "P5\n{width} {height}\n255\n")?;
        for row in samples.chunks_exact(width as usize).rev() {
            file.write_all(row)?;
        }
        file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
        let mut file = BufWriter::new(files.yaml);
        let image = serde_json::to_string(&image)?;
        writeln!(file, "# floor at z = {} m", number(tidy(z)))?;
        writeln!(file, "image: {image}\nmode: trinary\nresolution: {}", number(frame.pixel_m()))?;
        writeln!(file, "origin: [{}, {}, 0.0]", origin[0], origin[1])?;
        writeln!(file, "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.1")?;
        file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
        let pixel = number(frame.pixel_m());
        let [width, height] = [width, height].map(|edge| grouped(edge as u64));
        Ok(format!("{}: {width} × {height} pixels of {pixel} m, floor at z = {z:.2} m\n", one_line(&name)))
    }

    /// Returns the samples of a storey, least y first.
    fn samples(&self, storey: usize) -> Result<Vec<u8>, Failure> {
        let [width, height] = self.size;
        let mut samples = vec![UNKNOWN; (width * height) as usize];
        let mut levels = vec![f32::NAN; samples.len()];
        let mut next = VecDeque::new();
        // Heights relative to the storey, which 32 bits hold to a quantum.
        let base = self.storeys.all[storey].z;
        for (pixel, z, own) in self.places() {
            let [x, y] = [0, 1].map(|axis| pixel[axis] - self.first[axis]);
            let is_inside = (0..width).contains(&x) && (0..height).contains(&y);
            if usize::from(own) != storey || !is_inside {
                continue;
            }
            let at = (y * width + x) as usize;
            if levels[at].is_nan() {
                next.push_back(at);
            }
            if self.is_seen(pixel, z) {
                samples[at] = FREE;
            }
            levels[at] = levels[at].max((z - base) as f32);
        }
        // Breadth first: each pixel takes the height of a nearest place.
        while let Some(at) = next.pop_front() {
            let (x, y) = (at as i64 % width, at as i64 / width);
            for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1)] {
                let (x, y) = (x + dx, y + dy);
                if (0..width).contains(&x) && (0..height).contains(&y) {
                    let beside = (y * width + x) as usize;
                    if levels[beside].is_nan() {
                        levels[beside] = levels[at];
                        next.push_back(beside);
                    }
                }
            }
        }
        for at in 0..samples.len() {
            if samples[at] == FREE || levels[at].is_nan() {
                continue;
            }
            let middle = |axis: usize, offset: i64| {
                let pixel = self.first[axis] + offset;
                self.frame().edge_of_pixel(pixel).midpoint(self.frame().edge_of_pixel(pixel + 1))
            };
            let feet =
                Point3::new(middle(0, at as i64 % width), middle(1, at as i64 / width), base + f64::from(levels[at]));
            if self.loader.known(|view| self.collides(view, feet))? {
                samples[at] = OCCUPIED;
            }
        }
        Ok(samples)
    }

    /// Returns whether the middle of the pawn was seen; true if the archive does not say.
    fn is_seen(&self, pixel: [i64; 2], z: f64) -> bool {
        let Some(seen) = self.loader.known_seen() else { return true };
        let [x, y] = pixel.map(|at| self.frame().edge_of_pixel(at).midpoint(self.frame().edge_of_pixel(at + 1)));
        seen.is_pawn_seen(Point3::new(x, y, z), self.pawn.climb, self.pawn.body.height())
    }

    /// Returns whether the body above the climb height meets anything solid.
    fn collides(&self, view: &Snapshot, feet: Point3<f64>) -> slicewalk::Result<Answer<bool>> {
        let lifted = feet + Vector3::new(0.0, 0.0, self.pawn.climb);
        let height = (self.pawn.body.height() - self.pawn.climb).max(LEAST_BODY_M);
        let overlap = match self.pawn.body {
            Body::Box { x, y, .. } => {
                let size = Vector3::new((x - TOUCH_M).max(x / 2.0), (y - TOUCH_M).max(y / 2.0), height);
                overlaps(view, &Aabb::standing(lifted, size)?)
            }
            Body::Cylinder { radius, .. } => {
                overlaps(view, &Cylinder::new(lifted, (radius - TOUCH_M).max(radius / 2.0), height)?)
            }
        };
        Ok(match overlap {
            Overlap::Clear => Answer::Known(false),
            Overlap::Hit => Answer::Known(true),
            Overlap::NotLoaded(missing) => Answer::NotLoaded(missing),
        })
    }

    /// Writes the links between storeys to `to`; returns a line about the file.
    fn write_links(&self, to: Output, map: &dyn Fn(usize) -> PathBuf) -> Result<String, Failure> {
        let name = to.name().to_string_lossy().into_owned();
        let links = self.links();
        let features: Vec<Value> = links
            .iter()
            .map(|link| {
                let [x, y, z] = [link.at.x, link.at.y, link.at.z].map(tidy);
                let maps = link.storeys.map(|storey| file_name(&map(storey.into())));
                json!({
                    "type": "Feature",
                    "geometry": { "type": "Point", "coordinates": [x, y, z] },
                    "properties": {
                        "what": "link", "kind": if link.is_ramp { "ramp" } else { "stairs" }, "from": link.storeys[0],
                        "to": link.storeys[1], "from_map": maps[0], "to_map": maps[1], "width": tidy(link.width_m),
                    },
                })
            })
            .collect();
        let mut file = BufWriter::new(to);
        writeln!(file, "{}", json!({ "type": "FeatureCollection", "features": features }))?;
        file.into_inner().map_err(IntoInnerError::into_error)?.publish()?;
        let count = slicewalk_base::text::counted(links.len() as u64, "link");
        Ok(format!("{}: {count} between storeys\n", one_line(&name)))
    }

    /// Returns where steps lead from one storey to another: neighbouring pairs of places, joined if they are within two
    /// pixels of each other.
    fn links(&self) -> Vec<Link> {
        let pixel_m = self.frame().pixel_m();
        let mut columns: HashMap<[i64; 2], Vec<(f64, u16)>> = HashMap::new();
        for (pixel, z, storey) in self.places() {
            columns.entry(pixel).or_default().push((z, storey));
        }
        let beside = |pixel: [i64; 2], z: f64| {
            let ways = [[1, 0], [0, 1], [-1, 0], [0, -1]];
            let all = ways.into_iter().map(move |way| [pixel[0] + way[0], pixel[1] + way[1]]);
            let places = all.filter_map(|at| columns.get(&at)).flatten();
            places.filter(move |place| (place.0 - z).abs() <= self.pawn.climb)
        };
        // Places at the lower storey's side of a border, in the order of places.
        let mut open: Vec<([i64; 2], f64, [u16; 2])> = Vec::new();
        for (pixel, z, storey) in self.places() {
            let mut uppers: Vec<u16> = beside(pixel, z).map(|place| place.1).filter(|other| *other > storey).collect();
            uppers.sort_unstable();
            uppers.dedup();
            open.extend(uppers.into_iter().map(|upper| (pixel, z, [storey, upper])));
        }
        let mut links = Vec::new();
        while let Some(first) = open.first().copied() {
            let (mut own, mut rest) = (vec![first], open[1..].to_vec());
            let mut done = 0;
            while done < own.len() {
                let (at, z, storeys) = own[done];
                let is_near = |other: &([i64; 2], f64, [u16; 2])| {
                    let far = (0..2).map(|axis| (other.0[axis] - at[axis]).abs()).max().unwrap_or(0);
                    other.2 == storeys && far <= 2 && (other.1 - z).abs() <= self.pawn.climb
                };
                own.extend(rest.iter().filter(|other| is_near(other)).copied());
                rest.retain(|other| !is_near(other));
                done += 1;
            }
            open = rest;
            let extent = |axis: usize| {
                let along = || own.iter().map(move |place| place.0[axis]);
                along().max().unwrap_or(0) - along().min().unwrap_or(0) + 1
            };
            let (pixel, z, storeys) = own[own.len() / 2];
            let [x, y] = pixel.map(|pixel| self.frame().edge_of_pixel(pixel) + pixel_m / 2.0);
            let reach = (LINK_M / pixel_m).ceil() as i64;
            let around = (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| [pixel[0] + dx, pixel[1] + dy]));
            let steps = around.flat_map(|at| {
                let own = columns.get(&at).into_iter().flatten().filter(|place| (place.0 - z).abs() <= LINK_M);
                own.flat_map(move |place| beside(at, place.0).map(|other| (other.0 - place.0).abs()))
            });
            let is_ramp = steps.fold(0.0, f64::max) <= RAMP_STEP_M.max(1.01 * pixel_m);
            let width_m = extent(0).max(extent(1)) as f64 * pixel_m;
            links.push(Link { at: Point3::new(x, y, z), storeys, width_m, is_ramp });
        }
        links
    }
}

/// Stairs or a ramp, where the lower storey ends.
struct Link {
    at: Point3<f64>,
    storeys: [u16; 2],
    width_m: f64,
    is_ramp: bool,
}

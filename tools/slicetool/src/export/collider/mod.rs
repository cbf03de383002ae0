//! A collider for physics engines: a simplified surface that contains all solid and lies within a stated distance of it.
//!
//! Each tile, some page columns, gets a closed surface of its own. It begins as the boundary of the tile's solid, grown
//! by about half of the error (`cover.rs`), and edges collapse (`mesh.rs`) as long as every triangle stays outside of the
//! solid and within the error of it (`shell.rs`) and every vertical line crosses each gap an unchanged number of times: then what
//! was inside stays inside. Small case: a floor with noise below the error becomes a plate with two large faces.
//!
//! At the end `tile.rs` checks the corners as the file has them: no triangle meets solid, none lies beyond the error,
//! and the surface winds once around all solid.

mod cover;
mod grid;
mod mesh;
mod shell;
mod tile;
mod write;

pub use write::{glb, obj};

use crate::Failure;
use crate::ground::tidy;
use slicewalk::Monitor;
use slicewalk::archive::{Archive, PageEntry};
use slicewalk::frame::{PAGE_SLICES, TILE_PIXELS};
use slicewalk_base::text::{counted, grouped, number};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use tile::{Piece, Tile};

/// Least edge of a tile (m), and in errors.
const TILE_M: f64 = 12.0;
const TILE_ERRORS: f64 = 8.0;
/// Most pixels, or parts of them, along the edge of a tile of several page columns.
const MOST_CELLS: f64 = 1024.0;
/// Least empty space between parts of a tile that get surfaces of their own (m), and in errors.
const GAP_M: f64 = 16.0;
const GAP_ERRORS: f64 = 4.0;
/// Error with which a search for a number of triangles begins (pixels), and its last factor: 2 to the power 1/16.
const FIRST_ERROR: f64 = 3.0;
const HALVINGS: u32 = 4;
/// Most doublings of the error.
const MOST_DOUBLINGS: u32 = 24;

/// Limit of a collider.
#[derive(Clone, Copy)]
pub enum Bound {
    /// Farthest that the surface may lie from solid (m).
    Error(f64),
    /// Most triangles.
    Triangles(u64),
}

/// Surfaces of all tiles.
pub struct Collider {
    pieces: Vec<Piece>,
    /// Farthest from solid (m).
    error_m: f64,
}

impl Collider {
    /// Makes the collider of an archive at `path`. Memory: its triangles, and a tile for each thread.
    pub fn new(archive: &Archive, path: &Path, bound: Bound) -> Result<Self, Failure> {
        let entries: Vec<PageEntry> = crate::entries(archive, path).collect::<Result<_, _>>()?;
        let scene = Scene { archive, path, entries };
        match bound {
            Bound::Error(error_m) => {
                if grid::Grid::new(archive.frame(), error_m, 1).is_none() {
                    let frame = archive.frame();
                    let [pixel, slice] = [frame.pixel_m(), frame.slice_m()].map(number);
                    // To a millionth, as the option takes it.
                    let least = number((grid::least_error_m(frame) * 1e6 - 1e-6).ceil() / 1e6);
                    let reason = format!(
                        "--error {error_m}: too small for pixels of {pixel} m and slices of {slice} m; give at least {least}"
                    );
                    return Err(Failure::Text(format!("{}: {reason}", path.display())));
                }
                let pieces = scene.pieces(error_m, u64::MAX)?.unwrap_or_default();
                Ok(Self { pieces, error_m })
            }
            Bound::Triangles(most) => scene.search(most),
        }
    }

    /// Number of triangles.
    pub fn triangles(&self) -> u64 {
        self.pieces.iter().map(|piece| piece.triangles.len() as u64).sum()
    }

    /// Says what was made.
    pub fn about(&self) -> String {
        let triangles = counted(self.triangles(), "triangle");
        let tiles = counted(self.pieces.len() as u64, "tile");
        format!("{triangles} in {tiles}, at most {} m beyond the solid", number(self.error_m))
    }
}

struct Scene<'a> {
    archive: &'a Archive,
    path: &'a Path,
    entries: Vec<PageEntry>,
}

impl Scene<'_> {
    /// Returns the tiles for an error.
    fn tiles(&self, error_m: f64) -> Vec<Tile> {
        let frame = self.archive.frame();
        let cells = grid::Grid::new(frame, error_m, 1).map_or(1.0, |grid| frame.pixel_m() / grid.cell_m);
        let mut edge = 1i64;
        while edge < 1 << 30
            && (edge * TILE_PIXELS) as f64 * frame.pixel_m() < TILE_M.max(TILE_ERRORS * error_m)
            && (2 * edge * TILE_PIXELS) as f64 * cells <= MOST_CELLS
        {
            edge *= 2;
        }
        let mut columns: BTreeMap<[i64; 2], BTreeMap<i32, Vec<PageEntry>>> = BTreeMap::new();
        for entry in &self.entries {
            let at = [entry.key.ty, entry.key.tx].map(|tile| i64::from(tile).div_euclid(edge));
            columns.entry(at).or_default().entry(entry.key.layer).or_default().push(*entry);
        }
        let gap = (GAP_M.max(GAP_ERRORS * error_m) / frame.slice_m() / PAGE_SLICES as f64).ceil() as i64 + 1;
        let mut tiles: Vec<Tile> = Vec::new();
        for ([y, x], layers) in columns {
            let mut before: Option<i32> = None;
            for (layer, entries) in layers {
                match (before, tiles.last_mut()) {
                    (Some(before), Some(tile)) if i64::from(layer) - i64::from(before) <= gap => {
                        tile.entries.extend(entries)
                    }
                    (None, _) => tiles.push(Tile { name: format!("tile_{x}_{y}"), entries }),
                    _ => tiles.push(Tile { name: format!("tile_{x}_{y}_{layer}"), entries }),
                }
                before = Some(layer);
            }
        }
        tiles
    }

    /// Makes the surfaces for an error; `None` if they have more than `most` triangles.
    fn pieces(&self, error_m: f64, most: u64) -> Result<Option<Vec<Piece>>, Failure> {
        let (tiles, monitor) = (self.tiles(error_m), crate::terminal());
        monitor.stage(&format!("collider within {} m", number(error_m)), self.entries.len() as u64, "pages");
        let (next, triangles, failed) = (AtomicUsize::new(0), AtomicU64::new(0), AtomicBool::new(false));
        let made: Mutex<Vec<(usize, Result<Piece, Failure>)>> = Mutex::default();
        let work = || {
            while triangles.load(Ordering::Relaxed) <= most && !failed.load(Ordering::Relaxed) {
                let number = next.fetch_add(1, Ordering::Relaxed);
                let Some(tile) = tiles.get(number) else { break };
                let piece = tile::piece(self.archive, self.path, tile, error_m);
                match &piece {
                    Ok(piece) => {
                        monitor.advance(tile.entries.len() as u64);
                        triangles.fetch_add(piece.triangles.len() as u64, Ordering::Relaxed);
                    }
                    Err(_) => failed.store(true, Ordering::Relaxed),
                }
                if let Ok(mut made) = made.lock() {
                    made.push((number, piece));
                }
            }
        };
        let threads = std::thread::available_parallelism().map_or(1, |count| count.get()).min(tiles.len().max(1));
        std::thread::scope(|scope| (0..threads).for_each(|_| drop(scope.spawn(work))));
        let mut made = made.into_inner().unwrap_or_default();
        made.sort_by_key(|(number, _)| *number);
        let pieces = made.into_iter().map(|(_, piece)| piece).collect::<Result<Vec<_>, _>>()?;
        Ok((triangles.into_inner() <= most).then_some(pieces))
    }

    /// Searches the least error with at most `most` triangles, to a factor of 2 to the power 1/16.
    fn search(&self, most: u64) -> Result<Collider, Failure> {
        let frame = self.archive.frame();
        let made = |error_m: f64| -> Result<Option<Collider>, Failure> {
            match grid::Grid::new(frame, error_m, 1) {
                Some(_) => Ok(self.pieces(error_m, most)?.map(|pieces| Collider { pieces, error_m })),
                None => Ok(None),
            }
        };
        let mut error_m = FIRST_ERROR * frame.pixel_m();
        let mut found = made(error_m)?;
        let is_first = found.is_some();
        for _ in 0..MOST_DOUBLINGS {
            if is_first {
                let Some(better) = made(error_m / 2.0)? else { break };
                (error_m, found) = (error_m / 2.0, Some(better));
            } else {
                error_m *= 2.0;
                found = made(error_m)?;
                if found.is_some() {
                    break;
                }
            }
        }
        let Some(mut found) = found else {
            let reason =
                format!("more than {} triangles even at {} m beyond the solid", grouped(most), number(tidy(error_m)));
            return Err(Failure::Text(format!("{}: {reason}; give more --triangles", self.path.display())));
        };
        let mut step = 0.5f64;
        for _ in 0..HALVINGS {
            step = step.sqrt();
            if let Some(better) = made(found.error_m * step)? {
                found = better;
            }
        }
        Ok(found)
    }
}

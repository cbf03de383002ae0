//! The triangles of a set of files, file by file.

use super::watch::{Digest, Watch};
use super::{FARTHEST_M, MeshBatch, MeshCounts, MeshSet, Triangles, Wants, is_far, usable};
use crate::Triangle;
use crate::input::scenes::Scene;
use crate::input::singles::Singles;
use crate::input::{incomplete, warn_incomplete};
use crate::text::counted;
use crate::{Error, Monitor, Result};
use std::sync::Arc;
use std::time::Duration;

/// Least and greatest corner (m).
pub(super) type Bounds = ([f64; 3], [f64; 3]);

/// Empty bounds.
pub(super) const NO_BOUNDS: Bounds = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);

/// Grows `bounds` to include `corner`.
pub(super) fn grown((min, max): Bounds, corner: [f64; 3]) -> Bounds {
    ([0, 1, 2].map(|axis| min[axis].min(corner[axis])), [0, 1, 2].map(|axis| max[axis].max(corner[axis])))
}

/// Iterates over the triangles of a set, file by file.
pub struct MeshFeed<'a> {
    set: &'a MeshSet,
    /// Number of the current file.
    next: usize,
    open: Option<Box<dyn Triangles>>,
    of_file: OfFile,
    total: MeshCounts,
    /// Per file: bounds of the usable triangles and hash of the bytes read until now.
    found: Vec<(Bounds, u128)>,
    /// Coordinates that are floats of 32 bits.
    singles: Singles,
    complete: bool,
    colours: bool,
    /// Shared by each texture of the current file and of the previous one.
    textures: Arc<()>,
}

/// Counts and faults of the current file.
#[derive(Default)]
struct OfFile {
    counts: MeshCounts,
    /// Triangles left out because of corners that are not finite or too far away.
    far: u64,
    broken: u64,
    reason: Option<Error>,
    digest: Digest,
}

impl<'a> MeshFeed<'a> {
    pub(super) fn new(set: &'a MeshSet, colours: bool) -> Self {
        let (of_file, total) = (OfFile::default(), MeshCounts::default());
        let (textures, singles) = (Arc::new(()), Singles::default());
        Self { set, next: 0, open: None, of_file, total, found: Vec::new(), singles, complete: true, colours, textures }
    }

    /// Replaces `batch` by the next usable triangles (m, z up), possibly none; returns false after the last.
    ///
    /// At the end of each file, a warning reports how many triangles without area were left out. A file without a
    /// usable triangle is an error, because an empty archive would silently replace a good one. Broken faces and a file
    /// that changed while it was read are errors too; with `allow_incomplete`, they are warnings to `monitor` instead,
    /// and so is, beside other inputs, a file without a usable triangle.
    pub fn next(&mut self, batch: &mut Vec<Triangle>, monitor: &dyn Monitor) -> Result<bool> {
        let mut whole = MeshBatch { triangles: std::mem::take(batch), ..MeshBatch::default() };
        let more = self.next_painted(&mut whole, monitor);
        *batch = whole.triangles;
        more
    }

    /// Like [`next`](Self::next), but with colours if they are requested. Callers that share a feed must drop a batch
    /// before requesting the next: the textures of a file live until the next file begins, so that textures of two
    /// files are never in memory together.
    pub fn next_painted(&mut self, batch: &mut MeshBatch, monitor: &dyn Monitor) -> Result<bool> {
        batch.clear();
        batch.is_painted = self.colours;
        let more = self.read(batch, monitor);
        if more.is_err() {
            // The position after an error is undefined; other workers see the end of the feed.
            self.next = self.set.files.len();
        }
        more
    }

    fn read(&mut self, batch: &mut MeshBatch, monitor: &dyn Monitor) -> Result<bool> {
        let Some(file) = self.set.files.get(self.next) else { return Ok(false) };
        let allow_incomplete = self.set.options.allow_incomplete;
        let mut watch = Watch::new(monitor, allow_incomplete);
        let more = self.read_some(batch, &mut watch);
        self.of_file.broken = self.of_file.broken.saturating_add(watch.broken);
        self.of_file.reason = self.of_file.reason.take().or(watch.reason);
        let more = match more {
            // The rest of the file cannot be read.
            Err(error) if allow_incomplete && is_about(&error, &file.path) => {
                self.of_file.reason.get_or_insert(error);
                false
            }
            more => more?,
        };
        let read = batch.len();
        self.note_singles(batch);
        batch.triangles.iter_mut().for_each(|triangle| self.set.place(self.next, triangle));
        self.of_file.far += batch.triangles.iter().filter(|triangle| is_far(triangle)).count() as u64;
        batch.retain(usable);
        self.of_file.counts += MeshCounts { read: read as u64, left_out: (read - batch.len()) as u64 };
        self.found.resize(self.next + 1, (NO_BOUNDS, 0));
        let bounds = &mut self.found[self.next].0;
        *bounds = batch.triangles.as_flattened().iter().fold(*bounds, |all, &corner| grown(all, corner));
        if !more {
            self.finish_file(monitor)?;
        }
        Ok(true)
    }

    /// Notes the coordinates of a batch that are floats of 32 bits in the file.
    fn note_singles(&mut self, batch: &MeshBatch) {
        let are_singles = self.open.as_ref().map_or([false; 3], |reader| reader.are_singles());
        if are_singles != [false; 3] {
            let corners = batch.triangles.as_flattened().iter();
            let farthest = corners.fold([0.0; 3], |farthest, corner| {
                [0, 1, 2].map(|axis| match corner[axis].abs() {
                    far if are_singles[axis] && far > farthest[axis] && far <= FARTHEST_M => far,
                    _ => farthest[axis],
                })
            });
            self.singles.note(self.next, farthest);
        }
    }

    fn read_some(&mut self, batch: &mut MeshBatch, watch: &mut Watch) -> Result<bool> {
        watch.check_cancelled()?;
        // Waits while other workers still use the textures of the previous file.
        while self.open.is_none() && Arc::strong_count(&self.textures) > 1 {
            watch.check_cancelled()?;
            std::thread::sleep(Duration::from_millis(1));
        }
        let reader = match &mut self.open {
            Some(reader) => reader,
            closed => {
                self.of_file.digest = Digest::new(self.set.options.hash);
                let wants = Wants { digest: &self.of_file.digest, colours: self.colours.then_some(&self.textures) };
                closed.insert(self.set.reader(self.next, wants, watch)?)
            }
        };
        reader.read(batch, watch)
    }

    fn finish_file(&mut self, monitor: &dyn Monitor) -> Result<()> {
        let file = &self.set.files[self.next];
        let OfFile { counts, far, broken, reason, digest } = std::mem::take(&mut self.of_file);
        let MeshCounts { read, left_out } = counts;
        let mut lost = Vec::new();
        if read == left_out {
            let error = reason.unwrap_or_else(|| {
                let reason = if read == 0 {
                    "it holds no triangles; of these formats only PLY is read as a cloud of points".into()
                } else {
                    format!("none of its {read} triangles has an area and finite corners within 1e12 m; write it again")
                };
                Error::input(&file.path, "triangles", reason)
            });
            let options = &self.set.options;
            if !options.allow_incomplete || !options.has_others && self.set.files.len() == 1 {
                return Err(error);
            }
            monitor.warn(&format!("incomplete: left out: {error}").into());
            self.complete = false;
            self.close(counts, &digest);
            return Ok(());
        }
        if let Some(error) = reason {
            let text = match error {
                Error::Input { at, reason, .. } => format!("{at}: {reason}"),
                other => other.to_string(),
            };
            let more = if broken > 1 { format!(" (and {} more)", counted(broken - 1, "face")) } else { String::new() };
            lost.push(format!("{text}{more}"));
        }
        if far > 0 {
            lost.push(format!("{far} of {read} triangles have a corner that is not finite or beyond 1e12 m"));
        }
        if !file.stamp.is_of(&file.path) {
            lost.push("it was written to, cut or replaced while it was read".into());
        }
        if let Some(first) = lost.first().filter(|_| !self.set.options.allow_incomplete) {
            return Err(incomplete(&file.path, "triangles", first));
        }
        lost.iter().for_each(|lost| warn_incomplete(&file.path, lost, monitor));
        self.complete &= lost.is_empty();
        if left_out > far {
            let flat = left_out - far;
            let text = format!("{}: {flat} of {read} triangles left out: they have no area", file.path.display());
            monitor.warn(&text.into());
        }
        self.close(counts, &digest);
        Ok(())
    }

    fn close(&mut self, counts: MeshCounts, digest: &Digest) {
        self.total += counts;
        self.found[self.next].1 = digest.value();
        self.open = None;
        self.next += 1;
    }

    /// Returns the files that have usable triangles until now, with the bounds of these.
    pub fn scenes(&self) -> impl Iterator<Item = Scene<'a>> {
        let files = self.set.files.iter().zip(&self.found);
        files.filter(|(_, ((min, max), _))| min[0] <= max[0]).map(|(file, &((min, max), _))| Scene {
            path: &file.path,
            min,
            max,
        })
    }

    /// Warns once of files that store coordinates as floats of 32 bits, if some triangle read until now is at a
    /// coordinate where floats are coarse for pixels of `pixel_m`.
    pub fn warn_of_coarse_floats(&self, pixel_m: f64, monitor: &dyn Monitor) {
        let unit = self.set.unit_m() * self.set.options.placement.map_or(1.0, |placement| placement.factor());
        let about = |file: usize| (&*self.set.files[file].path, [unit; 3]);
        self.singles.warning(pixel_m, about).iter().for_each(|text| monitor.warn(&text.as_str().into()));
    }

    /// Returns the bounds of all usable triangles until now.
    pub(super) fn bounds(&self) -> Option<Bounds> {
        let all = self.found.iter().fold(NO_BOUNDS, |all, (file, _)| grown(grown(all, file.0), file.1));
        (all.0[0] <= all.1[0]).then_some(all)
    }

    /// Returns the hashes of the bytes read from each finished file, by number; 0 unless
    /// [`MeshOptions::hash`](super::MeshOptions::hash) is set.
    pub fn hashes(&self) -> impl Iterator<Item = u128> {
        self.found.iter().map(|found| found.1)
    }

    /// Returns the counts over all finished files.
    pub fn counts(&self) -> MeshCounts {
        self.total
    }

    /// Returns whether no input is known to be missing yet; always true unless incomplete input is allowed.
    pub fn is_complete(&self) -> bool {
        self.complete
    }
}

/// Returns whether an error is about the file at `path` (and not about temporary data).
fn is_about(error: &Error, path: &std::path::Path) -> bool {
    match error {
        Error::Input { .. } | Error::Unsupported { .. } => true,
        Error::Io { path: of, .. } => of == path,
        _ => false,
    }
}

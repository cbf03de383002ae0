//! Result of a conversion, as a value and as JSON.

use super::{Resumed, SeenCounts, Similarity, SplatCounts, UpFound};
use crate::archive::{Header, Shard};
use crate::info::{INPUT_QUANTUM_M, header_info, noise_info, placing_info, set_seen, shard_info, splat_info};
use crate::input::TextLayout;
use crate::input::spacing::Spacing;
use crate::mesh::MeshCounts;
use crate::plan::Noise;
use crate::unit::LengthUnit;
use serde_json::Value;
use std::path::PathBuf;

/// Result of a conversion.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Report {
    /// Header of the archive.
    pub header: Header,
    /// Part that the archive holds; `None` for the whole.
    pub shard: Option<Shard>,
    /// Measured point spacing, if the pixel size was chosen automatically.
    pub spacing: Option<Spacing>,
    /// Direction that points up, if the input showed it.
    pub up: Option<UpFound>,
    /// Placement of all inputs, the rotation upwards included; `None` if they stayed in place.
    pub placement: Option<Similarity>,
    /// Noise of the scan, if the tolerance was chosen from it.
    pub noise: Option<Noise>,
    /// Text of the coordinate reference system; empty if the input names none.
    pub crs: String,
    /// Distinct units of the inputs.
    pub units: Vec<LengthUnit>,
    /// Scans in text, and how their columns were interpreted.
    pub texts: Vec<(PathBuf, TextLayout)>,
    /// Length of all input files (bytes).
    pub input_bytes: u64,
    /// Temporary data written to disk (bytes).
    pub temp_bytes: u64,
    /// Data reused from an earlier run.
    pub resumed: Option<Resumed>,
    /// Points left out because a coordinate was not finite.
    pub points_not_finite: u64,
    /// Points that the input states and that could not be read; 0 unless incomplete input is allowed.
    pub points_missing: u64,
    /// Points removed because other stations of the scan saw through their positions.
    pub points_moving: u64,
    /// Seen space; `None` if it is not stored.
    pub seen: Option<SeenCounts>,
    /// True if all of the input was read; always true unless incomplete input is allowed.
    pub complete: bool,
    /// Triangles of meshes; they also count as points in the header.
    pub triangles: MeshCounts,
    /// Gaussian splats; they also count as points in the header.
    pub splats: SplatCounts,
    /// Solid cubes of octrees; they also count as points in the header.
    pub cubes: u64,
    /// Points sampled from the triangles, if they were sampled.
    pub points_made: u64,
    /// Voxels dropped because they had too few points or were isolated. Their points are dropped with them: boxes that
    /// hold only such points report no hit (G1 holds for all other points).
    pub voxels_dropped: u64,
}

impl Report {
    /// Returns the facts under the keys of the command-line contract (`sliceconv --json`), except the seconds.
    pub fn info(&self) -> Value {
        let mut facts = header_info(&self.header, &self.crs, &self.units);
        facts["input_quantum"] = INPUT_QUANTUM_M.into();
        facts["points_not_finite"] = self.points_not_finite.into();
        facts["points_missing"] = self.points_missing.into();
        facts["points_moving"] = self.points_moving.into();
        if let Some(seen) = &self.seen {
            set_seen(&mut facts, seen.cells, seen.bytes);
        }
        facts["complete"] = self.complete.into();
        facts["triangles_read"] = self.triangles.read.into();
        facts["triangles_left_out"] = self.triangles.left_out.into();
        splat_info(&mut facts, &self.splats);
        placing_info(&mut facts, self.up.as_ref(), self.placement.as_ref());
        facts["cubes_read"] = self.cubes.into();
        facts["points_made"] = self.points_made.into();
        facts["voxels_dropped"] = self.voxels_dropped.into();
        let of_text = |(path, layout): &(PathBuf, TextLayout)| {
            let mut facts = layout.info();
            facts["path"] = path.to_string_lossy().into();
            facts
        };
        facts["texts"] = self.texts.iter().map(of_text).collect();
        facts["input_bytes"] = self.input_bytes.into();
        facts["temp_bytes"] = self.temp_bytes.into();
        facts["points_resumed"] = self.resumed.map_or(0, |resumed| resumed.points).into();
        facts["temp_bytes_resumed"] = self.resumed.map_or(0, |resumed| resumed.bytes).into();
        facts["point_spacing"] = self.spacing.as_ref().map(|spacing| spacing.spacing_m).into();
        if let Some(noise) = &self.noise {
            facts["tolerance_auto"] = noise_info(noise);
        }
        if let Some(shard) = &self.shard {
            facts["shard"] = shard_info(shard);
        }
        facts
    }
}

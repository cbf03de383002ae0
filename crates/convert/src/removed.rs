//! Points that a conversion removed, as a LAS file for inspection.
//!
//! LAS 1.4, point format 6, in metres. Positions have the precision of the voxel pass (1/128 pixel, 1/8160 slice).

use crate::Result;
use crate::output::{Output, OutputKind, Protected};
use std::path::Path;

const HEADER_BYTES: usize = 375;
const RECORD_BYTES: usize = 30;
/// Bytes written at once.
const CHUNK_BYTES: usize = 1 << 18;

/// LAS file under construction.
pub(super) struct RemovedPoints {
    output: Output,
    scale: f64,
    offset: [f64; 3],
    count: u64,
    min: [i32; 3],
    max: [i32; 3],
    chunk: Vec<u8>,
    at: u64,
}

impl RemovedPoints {
    /// Creates the file, replacing any file except archives, plans and `protected` ones.
    pub fn create(path: &Path, protected: Protected) -> Result<Self> {
        Ok(Self {
            output: Output::create(path, OutputKind::Result, protected)?,
            scale: 1e-4,
            offset: [0.0; 3],
            count: 0,
            min: [i32::MAX; 3],
            max: [i32::MIN; 3],
            chunk: Vec::new(),
            at: HEADER_BYTES as u64,
        })
    }

    /// Sets the corners between which the points will lie (m).
    pub fn set_bounds(&mut self, min: [f64; 3], max: [f64; 3]) {
        // Below 0 without points.
        let extent = (0..3).map(|axis| max[axis] - min[axis]).fold(f64::NEG_INFINITY, f64::max);
        while extent > self.scale * f64::from(i32::MAX) {
            self.scale *= 10.0;
        }
        self.offset =
            std::array::from_fn(|axis| if extent >= 0.0 { ((min[axis] + max[axis]) / 2.0).floor() } else { 0.0 });
    }

    /// Adds a point (m).
    pub fn push(&mut self, point: [f64; 3]) -> Result<()> {
        let mut record = [0; RECORD_BYTES];
        for axis in 0..3 {
            let value = ((point[axis] - self.offset[axis]) / self.scale).round() as i32;
            self.min[axis] = self.min[axis].min(value);
            self.max[axis] = self.max[axis].max(value);
            record[4 * axis..4 * axis + 4].copy_from_slice(&value.to_le_bytes());
        }
        // Single return of its pulse, unclassified.
        (record[14], record[16]) = (0x11, 1);
        self.chunk.extend(record);
        self.count += 1;
        if self.chunk.len() >= CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        self.output.write_at(self.at, &self.chunk)?;
        self.at += self.chunk.len() as u64;
        self.chunk.clear();
        Ok(())
    }

    /// Writes the header and publishes the file.
    pub fn finish(mut self) -> Result<()> {
        self.flush()?;
        let mut header = [0u8; HEADER_BYTES];
        let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
        put(0, b"LASF");
        // Reference systems, if any, are WKT, as this point format requires.
        put(6, &16u16.to_le_bytes());
        put(24, &[1, 4]);
        put(58, b"slicewalk");
        put(94, &(HEADER_BYTES as u16).to_le_bytes());
        put(96, &(HEADER_BYTES as u32).to_le_bytes());
        put(104, &[6]);
        put(105, &(RECORD_BYTES as u16).to_le_bytes());
        for axis in 0..3 {
            put(131 + 8 * axis, &self.scale.to_le_bytes());
            put(155 + 8 * axis, &self.offset[axis].to_le_bytes());
            if self.count > 0 {
                let bound = |value: i32| (f64::from(value) * self.scale + self.offset[axis]).to_le_bytes();
                put(179 + 16 * axis, &bound(self.max[axis]));
                put(187 + 16 * axis, &bound(self.min[axis]));
            }
        }
        put(247, &self.count.to_le_bytes());
        put(255, &self.count.to_le_bytes());
        self.output.write_at(0, &header)?;
        self.output.publish().map(drop)
    }
}

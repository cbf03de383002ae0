//! `.splat`: rows of 32 bytes and nothing else. Centre and sizes are floats, then red, green, blue and opacity as bytes,
//! then the quaternion w, x, y, z as bytes, where 128 is 0.

use super::columns::{Column, read_error};
use super::gate::{Gate, Raw};
use super::{Body, Work};
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::grouped;
use slicewalk_base::{Error, Parameter, Result};
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

const ROW_BYTES: u64 = 32;

pub struct Splats {
    source: Arc<dyn ByteSource>,
}

impl Splats {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path, allow_incomplete: bool) -> Result<Self> {
        let len = source.len();
        if !len.is_multiple_of(ROW_BYTES) && (!allow_incomplete || len < ROW_BYTES) {
            let reason =
                format!("expected rows of 32 bytes, found {} bytes: the file is cut; fetch it again", grouped(len));
            return Err(Error::input(path, "length", reason).with_suggestion(Parameter::Incomplete));
        }
        Ok(Self { source })
    }
}

impl Body for Splats {
    fn count(&self) -> u64 {
        self.source.len().div_ceil(ROW_BYTES)
    }

    fn are_singles(&self) -> [bool; 3] {
        [true; 3]
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        let whole = self.source.len() / ROW_BYTES;
        let mut column = Column::rest(&self.source, 0);
        let mut row = [0; ROW_BYTES as usize];
        for number in 0..whole {
            column.read_exact(&mut row).map_err(|e| read_error(work.path, format!("splat {number}"), e))?;
            gate.push(raw(&row))?;
        }
        gate.miss(self.count() - whole)
    }
}

fn raw(row: &[u8; ROW_BYTES as usize]) -> Raw {
    let float = |at: usize| f64::from(f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]]));
    let part = |at: usize| f64::from(row[at]);
    Raw {
        mean: [float(0), float(4), float(8)],
        scale: [float(12), float(16), float(20)],
        rotation: [28, 29, 30, 31].map(|at| (part(at) - 128.0) / 128.0),
        opacity: part(27) / 255.0,
        colour: [24, 25, 26].map(|at| part(at) / 255.0),
    }
}

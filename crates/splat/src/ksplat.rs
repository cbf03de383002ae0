//! `.ksplat`: sections of splats as rows; with compression, centres are steps of 16 bits from the centre of a bucket,
//! sizes and quaternions are in half precision.
//!
//! The file header has 4096 bytes, the header of each section 1024. A section begins with the lengths of its buckets that
//! are not full and the centres of all buckets; its rows lie in the order of the buckets, full ones first.

use super::columns::{Column, read_error};
use super::gate::{Gate, Raw};
use super::{Body, Work, is_all, refuse};
use slicewalk_base::Result;
use slicewalk_base::bytes::ByteSource;
use slicewalk_base::text::grouped;
use slicewalk_input::number::Number;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;

const HEADER_BYTES: u64 = 4096;
const SECTION_BYTES: u64 = 1024;
/// Centre of a bucket: three floats.
const CENTRE_BYTES: u64 = 12;
const HARMONICS: [u64; 4] = [0, 9, 24, 45];

#[derive(Debug, Clone, Copy)]
struct Section {
    splats: u64,
    bucket_splats: u64,
    buckets: u64,
    bucket_bytes: u64,
    full: u64,
    partial: u64,
    /// Length of a step (file units), and steps from the edge of a bucket to its centre.
    step: f64,
    range: f64,
    row: u64,
    start: u64,
    rows_at: u64,
}

pub struct Ksplat {
    source: Arc<dyn ByteSource>,
    level: u16,
    count: u64,
    sections: u64,
}

fn word(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]))
}

fn short(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

impl Ksplat {
    pub fn open(source: Arc<dyn ByteSource>, path: &Path) -> Result<Self> {
        let mut header = vec![0; HEADER_BYTES as usize];
        Column::rest(&source, 0).read_exact(&mut header).map_err(|e| read_error(path, "header", e))?;
        let wrong = |reason: String| Err(refuse(path, "header", reason));
        if header[0] != 0 || header[1] == 0 {
            let (major, minor) = (header[0], header[1]);
            return wrong(format!("expected version 0.1 or later, found {major}.{minor}; write it again"));
        }
        let (sections, count, level) = (word(&header, 4), word(&header, 16), short(&header, 20));
        if level > 2 {
            return wrong(format!("expected compression level 0, 1 or 2, found {level}; fetch or write it again"));
        }
        let fit = (source.len() - HEADER_BYTES) / SECTION_BYTES;
        if sections > fit {
            return wrong(format!("it states {sections} sections, and the file has room for {fit}: it is cut"));
        }
        let found = Self { source, level, count, sections };
        let mut splats = 0;
        found.each(path, &mut |section| {
            splats += section.splats;
            Ok(())
        })?;
        if splats != count {
            let [expected, found] = [count, splats].map(grouped);
            return wrong(format!(
                "expected {expected} splats in all sections, found {found}; fetch or write it again"
            ));
        }
        Ok(found)
    }

    /// Checks the sections in turn, and passes those with splats to `act`; returns where the last one ends.
    fn each(&self, path: &Path, act: &mut dyn FnMut(Section) -> Result<()>) -> Result<u64> {
        let mut headers = Column::new(&self.source, HEADER_BYTES, self.sections * SECTION_BYTES);
        let mut bytes = vec![0; SECTION_BYTES as usize];
        let mut at = HEADER_BYTES + self.sections * SECTION_BYTES;
        for number in 0..self.sections {
            let place = || format!("section {number}");
            headers.read_exact(&mut bytes).map_err(|e| read_error(path, place(), e))?;
            let (splats, most, bucket_splats, buckets) =
                (word(&bytes, 0), word(&bytes, 4), word(&bytes, 8), word(&bytes, 12));
            let block = Number::F32.read(&bytes[16..], false);
            let (bucket_bytes, stated_range) = (u64::from(short(&bytes, 20)), word(&bytes, 24));
            let (full, partial, degree) = (word(&bytes, 32), word(&bytes, 36), short(&bytes, 40));
            let wrong = |reason: &str| Err(refuse(path, place(), format!("{reason}; fetch or write it again")));
            let Some(harmonics) = HARMONICS.get(usize::from(degree)) else {
                return wrong("expected harmonics of degree 0 to 3, found others");
            };
            let row = match self.level {
                0 => 44 + harmonics * 4,
                1 => 24 + harmonics * 2,
                _ => 24 + harmonics,
            };
            if splats > most {
                return wrong("it states more splats than it has room for");
            }
            let range = match (stated_range, self.level) {
                (0, 0) => 1.0,
                (0, _) => 32767.0,
                (stated, _) => stated as f64,
            };
            if self.level > 0 && splats > 0 {
                if bucket_bytes < CENTRE_BYTES || !(block.is_finite() && block >= 0.0) {
                    return wrong("its buckets have no centre or no size");
                }
                if full + partial > buckets {
                    return wrong("it states more full and partial buckets than buckets");
                }
                if (full.saturating_add(partial)).saturating_mul(bucket_splats) < splats {
                    return wrong("its buckets hold fewer splats than it states");
                }
            }
            let rows_at = at + partial * 4 + buckets * bucket_bytes;
            let section = Section {
                splats,
                bucket_splats,
                buckets,
                bucket_bytes,
                full,
                partial,
                step: block / 2.0 / range,
                range,
                row,
                start: at,
                rows_at,
            };
            if splats > 0 {
                act(section)?;
            }
            at = rows_at + row * most;
        }
        Ok(at)
    }

    fn read_section(&self, section: &Section, path: &Path, gate: &mut Gate<'_>) -> Result<()> {
        let there = (self.source.len().saturating_sub(section.rows_at) / section.row).min(section.splats);
        gate.begin(section.splats);
        gate.miss(section.splats - there)?;
        let mut rows = Column::new(&self.source, section.rows_at, section.row * there);
        let mut lengths = Column::new(&self.source, section.start, section.partial * 4);
        let centres_at = section.start + section.partial * 4;
        let mut centres = Column::new(&self.source, centres_at, section.buckets * section.bucket_bytes);
        let mut row = vec![0; section.row as usize];
        let mut bucket = vec![0; section.bucket_bytes as usize];
        let (mut centre, mut left, mut passed) = ([0.0; 3], 0, 0);
        for number in 0..there {
            let failed = |e| read_error(path, format!("splat {number} of a section"), e);
            while self.level > 0 && left == 0 {
                left = section.bucket_splats;
                if passed >= section.full {
                    if passed - section.full == section.partial {
                        let reason = "the buckets end before the splats; fetch or write it again";
                        return gate.break_off(refuse(path, "buckets", reason));
                    }
                    let mut length = [0; 4];
                    lengths.read_exact(&mut length).map_err(failed)?;
                    left = u64::from(u32::from_le_bytes(length));
                }
                centres.read_exact(&mut bucket).map_err(failed)?;
                centre = [0, 4, 8].map(|at| Number::F32.read(&bucket[at..], false));
                passed += 1;
            }
            rows.read_exact(&mut row).map_err(failed)?;
            left = left.saturating_sub(1);
            gate.push(self.splat(&row, section, centre))?;
        }
        if self.level > 0 && there == section.splats && (left > 0 || passed < section.full + section.partial) {
            let reason = "the buckets hold more splats than the section states; fetch or write it again";
            gate.refuse(refuse(path, "buckets", reason))?;
        }
        Ok(())
    }

    fn splat(&self, row: &[u8], section: &Section, centre: [f64; 3]) -> Raw {
        let number = if self.level == 0 { Number::F32 } else { Number::F16 };
        let bytes = number.bytes();
        let get = |place: usize| number.read(&row[place * bytes..], false);
        let mean = match self.level {
            0 => [get(0), get(1), get(2)],
            _ => [0, 1, 2].map(|axis| (f64::from(short(row, axis * 2)) - section.range) * section.step + centre[axis]),
        };
        let colour = &row[10 * bytes..];
        Raw {
            mean,
            scale: [get(3), get(4), get(5)],
            rotation: [get(6), get(7), get(8), get(9)],
            opacity: f64::from(colour[3]) / 255.0,
            colour: [0, 1, 2].map(|at| f64::from(colour[at]) / 255.0),
        }
    }
}

impl Body for Ksplat {
    fn count(&self) -> u64 {
        self.count
    }

    fn are_singles(&self) -> [bool; 3] {
        [self.level == 0; 3]
    }

    fn read(&mut self, work: &Work<'_>, gate: &mut Gate<'_>) -> Result<()> {
        let end = self.each(work.path, &mut |section| self.read_section(&section, work.path, gate))?;
        if is_all(Column::rest(&self.source, end), |byte| *byte == 0, work)? {
            return Ok(());
        }
        let [expected, found] = [end, self.source.len()].map(grouped);
        let reason = format!("expected {expected} bytes for all sections, found {found}; fetch or write it again");
        gate.refuse(refuse(work.path, "length", reason))
    }
}

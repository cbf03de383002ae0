//! The voxel pass: points to voxels on the device.

use crate::device::{Device, GROUP, READ, WRITE, bind, layout_of, program};
use crate::error::{Error, Result};
use crate::pending::Piece;
use slicewalk_convert::{Accumulate, PointVoxel};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Accumulates points to voxels on a device, for conversions: set it as the accumulator of
/// `slicewalk_convert::Resources`. The archive has the same bytes as without.
///
/// Tile columns that a device handles badly are left to the processor: those with records of other things than points,
/// with 2¹⁹ slices or more, and jobs with more records than a buffer holds. So is everything after the device has failed.
#[derive(Debug)]
pub struct VoxelPass {
    device: Device,
    layout: wgpu::BindGroupLayout,
    programs: [wgpu::ComputePipeline; 2],
    failure: Mutex<Option<Error>>,
    counts: [AtomicU64; 2],
}

/// Words of a voxel, as `voxels.wgsl` states them.
const VOXEL: usize = 24;
const SLICE_STEPS: u32 = 8160;
const SLICE_BITS: u32 = 19;
/// Most slices of a band, so that heights in it fit 32 bits.
const MOST_SLICES_OF_BAND: u32 = 1 << 18;

impl VoxelPass {
    /// Prepares the pass. Fails if the device is lost.
    pub fn new(device: &Device) -> Result<Self> {
        let shared = &device.shared;
        let layout = layout_of(&shared.device, "voxels", &[wgpu::BufferBindingType::Uniform, READ, READ, WRITE, WRITE]);
        let text = include_str!("shaders/voxels.wgsl");
        let programs = ["number_voxels", "add_points"].map(|name| program(&shared.device, &layout, name, text));
        shared.check()?;
        let (failure, counts) = (Mutex::new(None), [AtomicU64::new(0), AtomicU64::new(0)]);
        Ok(Self { device: device.clone(), layout, programs, failure, counts })
    }

    /// Returns the failure of the device, after which the processor did the work.
    pub fn failure(&self) -> Option<Error> {
        self.failure.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the number of records that the device accumulated, and of those that it left to the processor. Points
    /// near the edge of a tile have more than one record.
    pub fn records(&self) -> [u64; 2] {
        [0, 1].map(|which| self.counts[which].load(Ordering::Relaxed))
    }

    fn run(&self, records: &[u64], ends: &[usize], band: u32) -> Result<Option<Vec<Vec<PointVoxel>>>> {
        let shared = &self.device.shared;
        let limit = shared.buffer_limit().min(u64::from(u32::MAX));
        let Some(plan) = Plan::new(records, ends) else { return Ok(None) };
        let table_bytes = 8 * u64::from(plan.entries);
        let voxel_bytes = 4 * (1 + VOXEL * records.len()) as u64;
        let fits = table_bytes.max(voxel_bytes) <= limit && records.len() as u64 <= shared.dispatch_limit();
        if records.is_empty() || !fits || band > MOST_SLICES_OF_BAND {
            return Ok(None);
        }
        let job = [records.len() as u32, ends.len() as u32, band, 0];
        let storage = wgpu::BufferUsages::STORAGE;
        let buffers = [
            shared.upload("job", &job, wgpu::BufferUsages::UNIFORM),
            shared.upload("records", records, storage),
            shared.upload("columns", &plan.columns, storage),
            shared.buffer("table", table_bytes, storage),
            shared.buffer("voxels", voxel_bytes, storage | wgpu::BufferUsages::COPY_SRC),
        ];
        let copy =
            shared.buffer("copy of voxels", voxel_bytes, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let group = bind(&shared.device, &self.layout, &buffers.each_ref());
        let mut encoder = shared.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        for program in &self.programs {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(program);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups((records.len() as u32).div_ceil(GROUP), 1, 1);
        }
        encoder.copy_buffer_to_buffer(&buffers[4], 0, &copy, 0, voxel_bytes);
        let submission = shared.queue.submit([encoder.finish()]);
        shared.check()?;
        let copied = Piece::new(copy, submission, Vec::new());
        copied.wait(shared)?;
        let mut found = vec![Vec::new(); ends.len()];
        copied.with_words(shared, |words| plan.collect(words, &mut found))??;
        Ok(Some(found))
    }
}

impl Accumulate for VoxelPass {
    fn accumulate(&self, records: &[u64], ends: &[usize], band: u32) -> Option<Vec<Vec<PointVoxel>>> {
        let done = match self.failure() {
            Some(_) => None,
            None => self.run(records, ends, band).unwrap_or_else(|error| {
                self.failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
                None
            }),
        };
        self.counts[usize::from(done.is_none())].fetch_add(records.len() as u64, Ordering::Relaxed);
        done
    }
}

/// Tables of a job's columns.
struct Plan {
    /// As `voxels.wgsl` has them.
    columns: Vec<[u32; 4]>,
    /// Entries of all tables.
    entries: u32,
    records: u32,
}

impl Plan {
    /// Returns `None` if a column does not suit the device.
    fn new(records: &[u64], ends: &[usize]) -> Option<Self> {
        let (mut columns, mut entries, mut begin) = (Vec::with_capacity(ends.len()), 0u32, 0);
        for &end in ends {
            let (mut lowest, mut highest) = (u32::MAX, 0);
            for record in records.get(begin..end)? {
                let slice = (record >> 27) as u32 & 0xff_ffff;
                (lowest, highest) = (lowest.min(slice), highest.max(slice));
                if (record >> 14) as u32 & 0x1fff >= SLICE_STEPS {
                    return None;
                }
            }
            if highest.saturating_sub(lowest) >= 1 << SLICE_BITS {
                return None;
            }
            let size = u32::try_from(2 * (end - begin)).ok()?.checked_next_power_of_two()?;
            columns.push([u32::try_from(end).ok()?, entries, size - 1, lowest]);
            entries = entries.checked_add(size)?;
            begin = end;
        }
        Some(Self { columns, entries, records: u32::try_from(records.len()).ok()? })
    }

    /// Sorts the voxels into their columns.
    fn collect(&self, words: &[u32], found: &mut [Vec<PointVoxel>]) -> Result<()> {
        let wrong = || Error::Failed { reason: "the voxels do not hold the points".into() };
        let (&count, voxels) = words.split_first().ok_or_else(wrong)?;
        let voxels = voxels.chunks_exact(VOXEL).take(count as usize);
        let mut points = 0;
        for voxel in voxels {
            let (column, key) = (voxel[0] as usize, voxel[1]);
            let lowest = self.columns.get(column).ok_or_else(wrong)?[3];
            let (pixel, slice) = (u64::from(key >> SLICE_BITS), u64::from(lowest + (key & ((1 << SLICE_BITS) - 1))));
            let mut sums = [0; 10];
            sums[0] = i64::from(voxel[5]);
            for (sum, words) in sums[1..].iter_mut().zip(voxel[6..].as_chunks::<2>().0) {
                *sum = i64::from(words[0]) | i64::from(words[1]) << 32;
            }
            points += u64::from(voxel[5]);
            found[column].push(PointVoxel {
                key: pixel << 24 | slice,
                heights: [SLICE_STEPS.wrapping_sub(voxel[2]), voxel[3]],
                bins: voxel[4] as u16,
                sums,
            });
        }
        if points != u64::from(self.records) {
            return Err(wrong());
        }
        found.iter_mut().for_each(|voxels| voxels.sort_unstable_by_key(|voxel| voxel.key));
        Ok(())
    }
}

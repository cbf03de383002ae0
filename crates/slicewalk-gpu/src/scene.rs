//! Pages that a device holds, or for want of one the processor, and the questions about them.

use crate::device::{Device, GROUP, bind};
use crate::error::Result;
use crate::kinds::Question;
use crate::layout::{Image, Place};
use crate::pending::{Pending, Piece};
use slicewalk::frame::PageKey;
use slicewalk::store::Snapshot;

/// Questions of one piece of a batch: enough to keep a device busy, few enough that the processor prepares the next piece
/// meanwhile.
const PIECE: usize = 1 << 17;

/// The pages of a snapshot on a device, uploaded once and asked many times; or on the processor, if there is no device.
///
/// A scene of a [`Stream`](slicewalk::store::Stream) holds the pages that its snapshot had in memory, and keeps them there.
/// Make another one, and drop this one, when the window has moved.
#[derive(Debug)]
pub struct Scene {
    pages: Snapshot,
    resident: Option<Resident>,
}

/// Buffers of a scene.
#[derive(Debug)]
pub(crate) struct Resident {
    pub device: Device,
    pub place: Place,
    /// Keys of the pages in the order of their slots.
    pub keys: Vec<PageKey>,
    buckets: wgpu::Buffer,
    slots: wgpu::Buffer,
    words: wgpu::Buffer,
}

impl Scene {
    /// Uploads the pages in memory. Fails if they exceed what the device allows or has, and if the device is lost.
    pub fn new(device: &Device, pages: &Snapshot) -> Result<Self> {
        let shared = &device.shared;
        shared.check()?;
        let image = Image::new(pages, shared.buffer_limit())?;
        let resident = Resident {
            device: device.clone(),
            place: image.place,
            buckets: shared.upload("tile columns", &image.buckets, wgpu::BufferUsages::STORAGE),
            slots: shared.upload("slots", &image.slots, wgpu::BufferUsages::STORAGE),
            words: shared.upload("pages", &image.words, wgpu::BufferUsages::STORAGE),
            keys: image.keys,
        };
        shared.check()?;
        Ok(Self { pages: pages.clone(), resident: Some(resident) })
    }

    /// Creates a scene that the processor answers.
    pub fn on_processor(pages: &Snapshot) -> Self {
        Self { pages: pages.clone(), resident: None }
    }

    /// Opens a device and uploads the pages; if that fails, the processor answers, and the error says why.
    #[cfg(not(target_family = "wasm"))]
    pub fn open(pages: &Snapshot, options: &crate::Options) -> (Self, Option<crate::Error>) {
        match Device::open(options).and_then(|device| Self::new(&device, pages)) {
            Ok(scene) => (scene, None),
            Err(error) => (Self::on_processor(pages), Some(error)),
        }
    }

    /// Returns the pages.
    pub fn pages(&self) -> &Snapshot {
        &self.pages
    }

    /// Returns the device; `None` if the processor answers.
    pub fn device(&self) -> Option<&Device> {
        self.resident.as_ref().map(|resident| &resident.device)
    }

    /// Returns the memory of the pages on the device (bytes).
    pub fn device_bytes(&self) -> u64 {
        let buffers = self.resident.as_ref().map(|resident| [&resident.buckets, &resident.slots, &resident.words]);
        buffers.into_iter().flatten().map(wgpu::Buffer::size).sum()
    }

    /// Sends questions to the device and returns at once with a handle to collect the answers: those of the queries of
    /// [`slicewalk::query`], bit for bit. Fails if the device is lost or out of memory.
    ///
    /// On the processor nothing happens before the answers are collected.
    pub fn ask<'a, Q: Question>(&'a self, questions: &'a [Q]) -> Result<Pending<'a, Q>> {
        let Some(resident) = &self.resident else { return Ok(Pending::on_processor(&self.pages, questions)) };
        let pieces =
            questions.chunks(resident.piece::<Q>()).map(|piece| resident.send(piece)).collect::<Result<_>>()?;
        Ok(Pending::on_device(&self.pages, resident, questions, pieces))
    }
}

impl Resident {
    /// Returns the questions of a piece.
    pub(crate) fn piece<Q: Question>(&self) -> usize {
        let shared = &self.device.shared;
        let by_memory = shared.buffer_limit() / (4 * Q::WORDS.max(Q::ANSWER_WORDS) as u64);
        (PIECE as u64).min(by_memory).min(shared.dispatch_limit()).max(1) as usize
    }

    /// Sends at least one question, and no more than [`piece`](Self::piece) allows.
    fn send<Q: Question>(&self, questions: &[Q]) -> Result<Piece> {
        let shared = &self.device.shared;
        let mut words = Vec::with_capacity(Q::WORDS * questions.len());
        let mut left_out = Vec::new();
        for (number, question) in (0..).zip(questions) {
            if !question.encode(&self.place, &mut words) {
                left_out.push(number);
                // Any words will do, because the answer is not used.
                words.resize(Q::WORDS * (number as usize + 1), 0);
            }
        }
        let bytes = (4 * Q::ANSWER_WORDS * questions.len()) as u64;
        let answers = shared.buffer("answers", bytes, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
        let copy = shared.buffer("copy of answers", bytes, wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let tiles = [self.place.tiles(0), self.place.tiles(1)].map(|count| count as u32);
        let quantum = (self.place.frame.quantum_m() / self.place.frame.pixel_m()) as f32;
        let last = (self.buckets.size() / 16 - 1) as u32;
        let batch = [questions.len() as u32, last, tiles[0], tiles[1], quantum.to_bits(), shared.budget()];
        let batch = shared.upload("batch", &batch, wgpu::BufferUsages::UNIFORM);
        let words = shared.upload("questions", &words, wgpu::BufferUsages::STORAGE);
        let buffers = [&self.buckets, &self.slots, &self.words, &batch, &words, &answers];
        let group = bind(&shared.device, &shared.layout, &buffers);
        let mut encoder = shared.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_pipeline(&shared.programs[Q::PROGRAM as usize]);
            pass.set_bind_group(0, &group, &[]);
            pass.dispatch_workgroups((questions.len() as u32).div_ceil(GROUP), 1, 1);
        }
        encoder.copy_buffer_to_buffer(&answers, 0, &copy, 0, bytes);
        let submission = shared.queue.submit([encoder.finish()]);
        // Mapping an invalid buffer would add another error to the one that matters.
        shared.check()?;
        Ok(Piece::new(copy, submission, left_out))
    }
}

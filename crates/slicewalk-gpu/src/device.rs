//! Adapters and devices: opening, limits, failures.

use crate::error::{Error, Result};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Which device to open, and how much of it to use.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Options {
    /// Accept an adapter that runs on the processor, such as llvmpipe or WARP. It answers as exactly as a graphics card,
    /// but later than the processor itself does. For tests.
    pub software: bool,
    /// Greatest size of one buffer (bytes); `None` for the device's own limit. It limits the pages of a scene and the
    /// length of the pieces in which batches are sent.
    pub buffer_bytes: Option<u64>,
}

/// An open device. Clones share it. If several threads do, a failure may be reported to another one of them than the one
/// that caused it, but no thread gets a wrong answer.
#[derive(Debug, Clone)]
pub struct Device {
    pub(crate) shared: Arc<Shared>,
}

/// The device and everything made for it once.
#[derive(Debug)]
pub(crate) struct Shared {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub layout: wgpu::BindGroupLayout,
    pub programs: [wgpu::ComputePipeline; PROGRAMS.len()],
    info: wgpu::AdapterInfo,
    failures: Arc<Mutex<Failures>>,
}

/// Failures that the driver reported outside the calls that caused them.
#[derive(Debug, Default)]
struct Failures {
    lost: Option<String>,
    /// The first error since the last look.
    error: Option<Error>,
}

/// Program of a kind of questions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Program {
    Boxes,
    Cylinders,
    Spheres,
    Floors,
    Rays,
}

/// Entry points in the order of [`Program`], with their text after that of the pages.
const PROGRAMS: [(&str, &str); 5] = [
    ("boxes", concat!(include_str!("shaders/shapes.wgsl"), include_str!("shaders/boxes.wgsl"))),
    ("cylinders", concat!(include_str!("shaders/shapes.wgsl"), include_str!("shaders/rounds.wgsl"))),
    ("spheres", concat!(include_str!("shaders/shapes.wgsl"), include_str!("shaders/rounds.wgsl"))),
    ("floors", include_str!("shaders/floors.wgsl")),
    ("rays", include_str!("shaders/rays.wgsl")),
];
const PAGES: &str = include_str!("shaders/pages.wgsl");
/// Buffers that `pages.wgsl` declares.
const BATCH: [wgpu::BufferBindingType; 6] = [READ, READ, READ, wgpu::BufferBindingType::Uniform, READ, WRITE];

/// Buffers that a shader reads, and that it may write.
pub(crate) const READ: wgpu::BufferBindingType = wgpu::BufferBindingType::Storage { read_only: true };
pub(crate) const WRITE: wgpu::BufferBindingType = wgpu::BufferBindingType::Storage { read_only: false };

/// Questions that one group of the device's threads answers, as the shaders state it.
pub(crate) const GROUP: u32 = 64;

impl Device {
    /// Opens the fastest device that `options` allow. Waits for the driver; in a browser use
    /// [`request`](Self::request).
    #[cfg(not(target_family = "wasm"))]
    pub fn open(options: &Options) -> Result<Self> {
        crate::pending::wait_for(Self::request(options))
    }

    /// Opens the fastest device that `options` allow.
    pub async fn request(options: &Options) -> Result<Self> {
        let mut wanted = wgpu::InstanceDescriptor::new_without_display_handle();
        wanted.backends = wgpu::Backends::PRIMARY;
        let instance = wgpu::Instance::new(wanted);
        let search = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            force_fallback_adapter: options.software,
            ..wgpu::RequestAdapterOptions::default()
        };
        let none = |reason: String| Error::NoAdapter { reason };
        let adapter = instance.request_adapter(&search).await.map_err(|error| none(error.to_string()))?;
        let info = adapter.get_info();
        if !options.software && info.device_type == wgpu::DeviceType::Cpu {
            return Err(none(format!("only {}, which runs on the processor", info.name)));
        }
        let mut limits = adapter.limits();
        if let Some(bytes) = options.buffer_bytes {
            limits.max_buffer_size = limits.max_buffer_size.min(bytes);
            limits.max_storage_buffer_binding_size = limits.max_storage_buffer_binding_size.min(bytes);
        }
        let wanted = wgpu::DeviceDescriptor {
            label: Some("slicewalk"),
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let failed =
            |error: wgpu::RequestDeviceError| Error::NoDevice { adapter: info.name.clone(), reason: error.to_string() };
        let (device, queue) = adapter.request_device(&wanted).await.map_err(failed)?;
        let failures = Arc::new(Mutex::new(Failures::default()));
        let seen = failures.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&seen, of_wgpu(error))));
        let seen = failures.clone();
        device.set_device_lost_callback(move |reason, words| {
            let mut failures = seen.lock().unwrap_or_else(PoisonError::into_inner);
            let said = if words.is_empty() { format!("{reason:?}") } else { words };
            failures.lost.get_or_insert(said);
        });
        let layout = layout_of(&device, "batch", &BATCH);
        let programs = PROGRAMS.map(|(name, text)| program(&device, &layout, name, &format!("{PAGES}\n{text}")));
        let shared = Shared { device, queue, layout, programs, info, failures };
        shared.check()?;
        Ok(Self { shared: Arc::new(shared) })
    }

    /// Returns the name of the adapter.
    pub fn name(&self) -> &str {
        &self.shared.info.name
    }

    /// Returns the adapter's properties: kind, driver, backend.
    pub fn info(&self) -> &wgpu::AdapterInfo {
        &self.shared.info
    }

    /// Returns the device for programs that draw or compute with it as well.
    pub fn wgpu(&self) -> (&wgpu::Device, &wgpu::Queue) {
        (&self.shared.device, &self.shared.queue)
    }
}

impl Shared {
    /// Fails if the driver has reported a failure since the last call.
    pub fn check(&self) -> Result<()> {
        let error = self.failures().error.take();
        if error.is_some() {
            // The loss of a device shows in errors first and is reported by the next poll.
            let _ = self.device.poll(wgpu::PollType::Poll);
        }
        let lost = self.failures().lost.clone();
        match lost.map(|reason| Error::Lost { reason }).or(error) {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    fn failures(&self) -> MutexGuard<'_, Failures> {
        self.failures.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the failure that the driver has reported, or one for `reason`.
    pub fn failure(&self, reason: impl ToString) -> Error {
        self.check().err().unwrap_or_else(|| Error::Failed { reason: reason.to_string() })
    }

    /// Creates a buffer with this content. Shaders cannot read an empty one. A failure shows in [`check`](Self::check).
    pub fn upload<T: bytemuck::Pod>(&self, label: &str, content: &[T], usage: wgpu::BufferUsages) -> wgpu::Buffer {
        let content: &[u8] = bytemuck::cast_slice(content);
        let content = if content.is_empty() { &[0; 16] } else { content };
        let descriptor =
            wgpu::BufferDescriptor { label: Some(label), size: content.len() as u64, usage, mapped_at_creation: true };
        let buffer = self.device.create_buffer(&descriptor);
        match buffer.get_mapped_range_mut(..) {
            Ok(mut view) => view.copy_from_slice(content),
            Err(error) => note(&self.failures, Error::Failed { reason: one_line(&error.to_string()) }),
        }
        buffer.unmap();
        buffer
    }

    /// Creates a buffer of zeros.
    pub fn buffer(&self, label: &str, size: u64, usage: wgpu::BufferUsages) -> wgpu::Buffer {
        self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(label),
            size,
            usage,
            mapped_at_creation: false,
        })
    }

    /// Returns the greatest size of a buffer that shaders read (bytes).
    pub fn buffer_limit(&self) -> u64 {
        let limits = self.device.limits();
        limits.max_buffer_size.min(limits.max_storage_buffer_binding_size)
    }

    /// Returns the most steps of loops that the device may take for a question.
    pub fn budget(&self) -> u32 {
        match self.info.device_type {
            // llvmpipe ends loops after 65,535 steps of all questions that share a vector, at most 16.
            wgpu::DeviceType::Cpu => 4000,
            // Far below the seconds after which systems reset a device.
            _ => 1 << 18,
        }
    }

    /// Returns the most questions of one dispatch.
    pub fn dispatch_limit(&self) -> u64 {
        u64::from(self.device.limits().max_compute_workgroups_per_dimension) * u64::from(GROUP)
    }
}

/// Keeps the first error since the last look.
fn note(failures: &Mutex<Failures>, error: Error) {
    failures.lock().unwrap_or_else(PoisonError::into_inner).error.get_or_insert(error);
}

fn of_wgpu(error: wgpu::Error) -> Error {
    let reason = one_line(&error.to_string());
    match error {
        wgpu::Error::OutOfMemory { .. } => Error::OutOfMemory { reason },
        _ => Error::Failed { reason },
    }
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Creates a layout of these buffers.
pub(crate) fn layout_of(
    device: &wgpu::Device,
    label: &str,
    kinds: &[wgpu::BufferBindingType],
) -> wgpu::BindGroupLayout {
    let entry = |(binding, &ty): (u32, &wgpu::BufferBindingType)| wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    };
    let entries: Vec<_> = (0..).zip(kinds).map(entry).collect();
    device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
}

/// Compiles the entry point `name` of a shader.
pub(crate) fn program(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    name: &str,
    text: &str,
) -> wgpu::ComputePipeline {
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(name),
        source: wgpu::ShaderSource::Wgsl(text.into()),
    });
    let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(name),
        bind_group_layouts: &[Some(layout)],
        ..wgpu::PipelineLayoutDescriptor::default()
    });
    device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: Some(name),
        layout: Some(&layout),
        module: &module,
        entry_point: Some(name),
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    })
}

/// Binds buffers in the order of their layout.
pub(crate) fn bind(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    buffers: &[&wgpu::Buffer],
) -> wgpu::BindGroup {
    let entries: Vec<_> = (0..)
        .zip(buffers)
        .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
        .collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Scene;
    use slicewalk::frame::Frame;
    use slicewalk::query::Aabb;
    use slicewalk::store::Snapshot;

    #[test]
    fn a_failed_allocation_fails_its_batch_alone() {
        let lack = wgpu::Error::OutOfMemory { source: "not enough\nmemory left".into() };
        let lack = of_wgpu(lack);
        assert!(matches!(&lack, Error::OutOfMemory { reason } if !reason.contains('\n')), "{lack}");
        let device = match Device::open(&Options { software: true, buffer_bytes: None }) {
            Ok(device) => device,
            Err(error) => return eprintln!("skipped: {error}"),
        };
        let scene = Scene::new(&device, &Snapshot::from_pages(Frame::new(0.1, 0.3).unwrap(), [])).unwrap();
        let boxes = [Aabb::new([0.0; 3].into(), [1.0; 3].into()).unwrap()];
        // As the driver would report it, first before and then after the batch was sent.
        note(&device.shared.failures, lack.clone());
        assert_eq!(scene.ask(&boxes).unwrap_err(), lack);
        let pending = scene.ask(&boxes).unwrap();
        note(&device.shared.failures, lack.clone());
        assert_eq!(pending.wait().unwrap_err(), lack);
        assert!(scene.ask(&boxes).unwrap().wait().is_ok());
    }

    #[test]
    fn an_error_of_the_driver_reaches_the_caller_once() {
        let device = match Device::open(&Options { software: true, buffer_bytes: None }) {
            Ok(device) => device,
            Err(error) => return eprintln!("skipped: {error}"),
        };
        // Beyond every limit.
        let size = device.wgpu().0.limits().max_buffer_size + 4;
        let descriptor =
            wgpu::BufferDescriptor { label: None, size, usage: wgpu::BufferUsages::STORAGE, mapped_at_creation: false };
        let _ = device.wgpu().0.create_buffer(&descriptor);
        assert!(matches!(device.shared.check(), Err(Error::Failed { .. } | Error::OutOfMemory { .. })));
        assert_eq!(device.shared.check(), Ok(()));
    }
}

//! The thesis' broad phase on the graphics card (section 5.1): draws the spans of a pawn's slices into a stencil and tests the
//! pawn's footprint with an occlusion query; beside the batch of boxes.
//!
//! ```text
//! cargo run --release --example stencil -- SCAN.slices [--software]
//! ```

use slicewalk::NoMonitor;
use slicewalk::archive::Archive;
use slicewalk::frame::{PAGE_QUANTA, PageKey, SLICE_QUANTA};
use slicewalk::nalgebra::{Point3, Vector3};
use slicewalk::query::{Aabb, GridExtent, grid_extent};
use slicewalk::store::Snapshot;
use slicewalk_gpu::{Device, Options, Reply, Scene, wgpu};
use std::collections::BTreeMap;
use std::error::Error;
use std::ops::Range;
use std::time::Instant;
use wgpu::util::DeviceExt;

/// Edge of the target (pixels), and of a pawn's cell in it.
const TARGET: u32 = 2048;
const CELL: u32 = 32;
/// Most pawns at a time: the queries of a set.
const PAWNS: usize = 4096;
/// Distance of the draws' parameters (bytes).
const STRIDE: usize = 256;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let path = arguments.iter().find(|argument| !argument.starts_with("--")).ok_or("SCAN.slices is missing")?;
    let pages = Snapshot::resident(&Archive::open(path)?, &NoMonitor)?;
    let software = arguments.iter().any(|argument| argument == "--software");
    let device = Device::open(&Options { software, buffer_bytes: None })?;
    println!("{} ({:?})", device.name(), device.info().device_type);
    let scene = Scene::new(&device, &pages)?;
    let stencil = Stencil::new(&device, &pages);
    let pawns = pawns(&pages)?;

    let begin = Instant::now();
    let exact = stencil.test(&pages, &pawns, |heights| heights)?;
    let drawn = begin.elapsed();
    // As the thesis has it: all of the slices that the pawn spans.
    let slices = |[low, high]: [i64; 2]| {
        [low.div_euclid(SLICE_QUANTA) * SLICE_QUANTA, (high.div_euclid(SLICE_QUANTA) + 1) * SLICE_QUANTA]
    };
    let broad = stencil.test(&pages, &pawns, slices)?;
    scene.ask(&pawns)?.wait()?;
    let begin = Instant::now();
    let answers = scene.ask(&pawns)?.wait()?.answers;
    let asked = begin.elapsed();
    let begin = Instant::now();
    let expected = Scene::on_processor(&pages).ask(&pawns)?.wait()?.answers;
    let processor = begin.elapsed();

    let hits: Vec<bool> = expected.iter().map(|reply| *reply == Reply::Known(true)).collect();
    let differing = |found: &[bool]| found.iter().zip(&hits).filter(|(found, hit)| found != hit).count();
    let missed = broad.iter().zip(&hits).filter(|(broad, hit)| **hit && !**broad).count();
    println!("{} pawns, {} hits", pawns.len(), hits.iter().filter(|hit| **hit).count());
    println!("stencil, heights of the spans: {} answers differ from the exact ones", differing(&exact));
    println!("stencil, whole slices: {} answers differ, {missed} of them misses", differing(&broad));
    println!("batch of boxes: {} answers differ", answers.iter().zip(&expected).filter(|(a, b)| a != b).count());
    let each = |time: std::time::Duration| time.as_secs_f64() * 1e6 / pawns.len() as f64;
    println!("stencil {:.2} µs, batch {:.3} µs, processor {:.3} µs each", each(drawn), each(asked), each(processor));
    Ok(())
}

/// Pawns of 0.5 × 0.5 × 1.6 m above floors, a climb height of 0.3 m up.
fn pawns(pages: &Snapshot) -> Result<Vec<Aabb>, Box<dyn Error>> {
    let (frame, mut floors) = (pages.frame(), Vec::new());
    for (tx, ty, slots) in (0..pages.column_count()).map(|number| pages.column_at(number)) {
        for (slot, page) in slots.iter().filter_map(|slot| Some((slot, slot.page()?))) {
            for (x, y, spans) in page.columns() {
                let at = |tile: i32, pixel: u32| (f64::from(tile) * 64.0 + f64::from(pixel)) * frame.pixel_m();
                for span in spans.iter().filter(|span| !span.is_obstacle()) {
                    let quantum = i64::from(slot.layer()) * PAGE_QUANTA + i64::from(span.top());
                    floors.push(Point3::new(at(tx, x), at(ty, y), quantum as f64 * frame.quantum_m() + 0.3));
                }
            }
        }
    }
    let step = (floors.len() / PAWNS).max(1);
    let pawns = floors.into_iter().step_by(step).take(PAWNS);
    Ok(pawns.map(|feet| Aabb::standing(feet, Vector3::new(0.5, 0.5, 1.6))).collect::<Result<_, _>>()?)
}

/// Spans of a scene, and the programs that draw and test.
struct Stencil<'a> {
    device: &'a wgpu::Device,
    queue: &'a wgpu::Queue,
    spans: wgpu::Buffer,
    /// Where the spans of each block of each page lie in the buffer.
    blocks: BTreeMap<PageKey, Vec<Range<u32>>>,
    layout: wgpu::BindGroupLayout,
    draw: wgpu::RenderPipeline,
    test: wgpu::RenderPipeline,
    target: wgpu::TextureView,
}

impl<'a> Stencil<'a> {
    fn new(device: &'a Device, pages: &Snapshot) -> Self {
        let (device, queue) = device.wgpu();
        let (mut words, mut blocks): (Vec<[u32; 2]>, BTreeMap<_, Vec<_>>) = (Vec::new(), BTreeMap::new());
        for (tx, ty, slots) in (0..pages.column_count()).map(|number| pages.column_at(number)) {
            for (slot, page) in slots.iter().filter_map(|slot| Some((slot, slot.page()?))) {
                let ranges = (0..64u32).map(|number| {
                    let first = words.len() as u32;
                    for bit in 0..64 {
                        let (x, y) = ((number & 7) * 8 + (bit & 7), (number >> 3) * 8 + (bit >> 3));
                        let spans = page.block(number & 7, number >> 3).column(bit);
                        words.extend(spans.iter().map(|span| [x | y << 6, span.bottom() | span.top() << 14]));
                    }
                    first..words.len() as u32
                });
                blocks.insert(PageKey { tx, ty, layer: slot.layer() }, ranges.collect());
            }
        }
        let spans = device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("spans"),
            contents: bytemuck::cast_slice(&words),
            usage: wgpu::BufferUsages::STORAGE,
        });
        let entry = |binding, ty, has_dynamic_offset| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::VERTEX,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset, min_binding_size: None },
            count: None,
        };
        let layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: None,
            entries: &[
                entry(0, wgpu::BufferBindingType::Storage { read_only: true }, false),
                entry(1, wgpu::BufferBindingType::Uniform, true),
            ],
        });
        let module = device.create_shader_module(wgpu::include_wgsl!("stencil.wgsl"));
        let pipelines = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: None,
            bind_group_layouts: &[Some(&layout)],
            ..wgpu::PipelineLayoutDescriptor::default()
        });
        let pipeline = |entry_point, compare, pass_op| {
            let face = wgpu::StencilFaceState { compare, pass_op, ..wgpu::StencilFaceState::IGNORE };
            device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(entry_point),
                layout: Some(&pipelines),
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(entry_point),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState {
                    topology: wgpu::PrimitiveTopology::TriangleStrip,
                    ..wgpu::PrimitiveState::default()
                },
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: wgpu::TextureFormat::Stencil8,
                    depth_write_enabled: None,
                    depth_compare: None,
                    stencil: wgpu::StencilState { front: face, back: face, read_mask: 0xff, write_mask: 0xff },
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: None,
                multiview_mask: None,
                cache: None,
            })
        };
        let target = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("stencil"),
            size: wgpu::Extent3d { width: TARGET, height: TARGET, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Stencil8,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            view_formats: &[],
        });
        Self {
            device,
            queue,
            spans,
            blocks,
            draw: pipeline("span_corner", wgpu::CompareFunction::Always, wgpu::StencilOperation::Replace),
            test: pipeline("target_corner", wgpu::CompareFunction::Equal, wgpu::StencilOperation::Keep),
            target: target.create_view(&wgpu::TextureViewDescriptor::default()),
            layout,
        }
    }

    /// Returns whether any pixel under each pawn is drawn. `heights` changes those between which spans are drawn.
    fn test(
        &self,
        pages: &Snapshot,
        pawns: &[Aabb],
        heights: impl Fn([i64; 2]) -> [i64; 2],
    ) -> Result<Vec<bool>, Box<dyn Error>> {
        let extents: Vec<GridExtent> = pawns.iter().map(|pawn| grid_extent(pages.frame(), pawn)).collect();
        // One draw for each block under each pawn: its parameters, its spans, and the pawn.
        let (mut parameters, mut draws) = (Vec::new(), Vec::new());
        let cell = |number: usize| [number as u32 % (TARGET / CELL) * CELL, number as u32 / (TARGET / CELL) * CELL];
        for (number, extent) in extents.iter().enumerate() {
            let size = [extent.i, extent.j].map(|[first, last]| last - first + 1);
            if size.iter().any(|&size| size > i64::from(CELL)) {
                return Err(format!("a pawn covers more than {CELL} pixels").into());
            }
            let [low, high] = heights(extent.heights);
            for (tx, ty) in (extent.j[0] >> 6..=extent.j[1] >> 6)
                .flat_map(|ty| (extent.i[0] >> 6..=extent.i[1] >> 6).map(move |tx| (tx, ty)))
            {
                for slot in pages.column(tx as i32, ty as i32) {
                    let base = i64::from(slot.layer()) * PAGE_QUANTA;
                    if base + PAGE_QUANTA < low || base > high {
                        continue;
                    }
                    let key = PageKey { tx: tx as i32, ty: ty as i32, layer: slot.layer() };
                    let offset = [(tx, extent.i[0], 0), (ty, extent.j[0], 1)]
                        .map(|(tile, first, axis)| (tile * 64 - first) as i32 + cell(number)[axis] as i32);
                    let local = [low, high].map(|height| (height - base).clamp(0, PAGE_QUANTA) as u32);
                    let at = (parameters.len() / STRIDE) as u32;
                    let edge = TARGET as f32;
                    let words =
                        [offset[0] as u32, offset[1] as u32, local[0], local[1], edge.to_bits(), edge.to_bits()];
                    parameters.extend_from_slice(bytemuck::cast_slice(&words));
                    parameters.resize((at as usize + 1) * STRIDE, 0u8);
                    let within = |[first, last]: [i64; 2], tile: i64| {
                        (first - tile * 64).clamp(0, 63) / 8..=(last - tile * 64).clamp(0, 63) / 8
                    };
                    for by in within(extent.j, ty) {
                        for bx in within(extent.i, tx) {
                            let spans = self.blocks[&key][(by * 8 + bx) as usize].clone();
                            if !spans.is_empty() {
                                draws.push((number, at, spans));
                            }
                        }
                    }
                }
            }
        }
        parameters.resize(parameters.len().max(STRIDE), 0);
        let parameters = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("draws"),
            contents: &parameters,
            usage: wgpu::BufferUsages::UNIFORM,
        });
        let draw = wgpu::BufferBinding { buffer: &parameters, offset: 0, size: std::num::NonZero::new(24) };
        let group = self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.spans.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::Buffer(draw) },
            ],
        });
        let queries = self.device.create_query_set(&wgpu::QuerySetDescriptor {
            label: None,
            ty: wgpu::QueryType::Occlusion,
            count: pawns.len() as u32,
        });
        let bytes = 8 * pawns.len() as u64;
        let buffer = |usage| {
            let descriptor = wgpu::BufferDescriptor { label: None, size: bytes, usage, mapped_at_creation: false };
            self.device.create_buffer(&descriptor)
        };
        let results = buffer(wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC);
        let copy = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.target,
                    depth_ops: None,
                    stencil_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(0), store: wgpu::StoreOp::Discard }),
                }),
                occlusion_query_set: Some(&queries),
                ..wgpu::RenderPassDescriptor::default()
            });
            let scissor = |pass: &mut wgpu::RenderPass<'_>, number: usize| {
                let ([x, y], extent) = (cell(number), &extents[number]);
                let size = [extent.i, extent.j].map(|[first, last]| (last - first + 1) as u32);
                pass.set_scissor_rect(x, y, size[0], size[1]);
            };
            pass.set_stencil_reference(1);
            pass.set_pipeline(&self.draw);
            for (number, at, spans) in draws {
                scissor(&mut pass, number);
                pass.set_bind_group(0, &group, &[at * STRIDE as u32]);
                pass.draw(0..4, spans);
            }
            pass.set_pipeline(&self.test);
            pass.set_bind_group(0, &group, &[0]);
            for number in 0..pawns.len() {
                scissor(&mut pass, number);
                pass.begin_occlusion_query(number as u32);
                pass.draw(0..4, 0..1);
                pass.end_occlusion_query();
            }
        }
        encoder.resolve_query_set(&queries, 0..pawns.len() as u32, &results, 0);
        encoder.copy_buffer_to_buffer(&results, 0, &copy, 0, bytes);
        self.queue.submit([encoder.finish()]);
        copy.slice(..).map_async(wgpu::MapMode::Read, |result| result.expect("the device is there"));
        self.device.poll(wgpu::PollType::wait_indefinitely())?;
        let view = copy.slice(..).get_mapped_range()?;
        Ok(view.chunks_exact(8).map(|count| count.iter().any(|&byte| byte != 0)).collect())
    }
}

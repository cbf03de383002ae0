//! Points distributed evenly by area.

use super::{Amount, Kind, Order, Sample, SampleSpec, Stream};
use crate::Scene;
use crate::geometry::{Vec3, add, scale};
use crate::shape::Shape;

/// Draws points by area in the given order.
pub(super) fn draw<'a>(
    scene: &'a Scene,
    seed: u64,
    order: Order,
    spec: &SampleSpec,
) -> Box<dyn Iterator<Item = Sample> + 'a> {
    let mut areas = Vec::with_capacity(scene.surfaces().len());
    let mut total = 0.0;
    for surface in scene.surfaces() {
        total += surface.shape.area();
        areas.push(total);
    }
    let count = match spec.amount {
        Amount::Count(count) => count,
        Amount::Density(density) => (density * total).round() as u64,
    };
    let count = if areas.is_empty() { 0 } else { count };
    let pen = Pen { scene, place: Stream::new(seed, 0), noise: Stream::new(seed, 1), noise_m: spec.noise_m };
    match order {
        Order::Random => Box::new(RandomOrder { pen, areas, total, left: count }),
        Order::Surfaces => Box::new(BySurface { pen, areas, total, count, at: 0, done: 0 }),
        Order::Grid => {
            let step = (total / count.max(1) as f64).sqrt();
            Box::new(Grid { pen, step, surface: 0, cell: 0, stop: count == 0 })
        }
    }
}

/// Draws single points.
struct Pen<'a> {
    scene: &'a Scene,
    place: Stream,
    noise: Stream,
    noise_m: f64,
}

impl Pen<'_> {
    /// A random point of a surface.
    #[inline]
    fn on(&mut self, surface: usize) -> Sample {
        let shape = &self.scene.surfaces()[surface].shape;
        let [w, h] = shape.chart_size();
        loop {
            let (u, v) = (self.place.unit() * w, self.place.unit() * h);
            if let Some(p) = shape.chart(u, v).filter(|p| self.keeps(shape, *p)) {
                return self.finish(surface, p);
            }
        }
    }

    #[inline]
    fn keeps(&mut self, shape: &Shape, p: Vec3) -> bool {
        !matches!(shape, Shape::Terrain(_)) || self.place.unit() < shape.keep_share(p)
    }

    #[inline]
    fn finish(&mut self, surface: usize, mut p: Vec3) -> Sample {
        if self.noise_m > 0.0 {
            let normal = self.scene.surfaces()[surface].shape.normal_at(p);
            p = add(p, scale(normal, self.noise_m * self.noise.normal()));
        }
        Sample { position: p, kind: Kind::Surface, surface: surface as u32, station: 0 }
    }
}

struct RandomOrder<'a> {
    pen: Pen<'a>,
    areas: Vec<f64>,
    total: f64,
    left: u64,
}

impl Iterator for RandomOrder<'_> {
    type Item = Sample;

    #[inline]
    fn next(&mut self) -> Option<Sample> {
        self.left = self.left.checked_sub(1)?;
        let at = self.pen.place.unit() * self.total;
        let surface = self.areas.partition_point(|a| *a <= at).min(self.areas.len() - 1);
        Some(self.pen.on(surface))
    }
}

struct BySurface<'a> {
    pen: Pen<'a>,
    areas: Vec<f64>,
    total: f64,
    count: u64,
    at: usize,
    done: u64,
}

impl Iterator for BySurface<'_> {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        if self.done >= self.count {
            return None;
        }
        // Cumulative rounding makes the counts of the surfaces add up to the total.
        while self.at + 1 < self.areas.len()
            && self.done >= (self.areas[self.at] / self.total * self.count as f64).round() as u64
        {
            self.at += 1;
        }
        self.done += 1;
        Some(self.pen.on(self.at))
    }
}

struct Grid<'a> {
    pen: Pen<'a>,
    step: f64,
    surface: usize,
    cell: u64,
    stop: bool,
}

impl Iterator for Grid<'_> {
    type Item = Sample;

    fn next(&mut self) -> Option<Sample> {
        while !self.stop && self.surface < self.pen.scene.surfaces().len() {
            let shape = &self.pen.scene.surfaces()[self.surface].shape;
            let size = shape.chart_size();
            let cells = size.map(|s| (s / self.step).round().max(1.0));
            if self.cell >= (cells[0] * cells[1]) as u64 {
                (self.surface, self.cell) = (self.surface + 1, 0);
                continue;
            }
            let at = [self.cell % cells[0] as u64, self.cell / cells[0] as u64];
            self.cell += 1;
            let [u, v] = [0, 1].map(|a| (at[a] as f64 + self.pen.place.unit()) / cells[a] * size[a]);
            if let Some(p) = shape.chart(u, v) {
                return Some(self.pen.finish(self.surface, p));
            }
        }
        None
    }
}

//! The thesis as written: slices as pictures of three bytes a pixel (algorithm 3.3), asked pixel by pixel (algorithm 3.4).

use super::method::{Built, Method, Vec3};
use super::subject::Subject;
use crate::size::pictures::png;
use crate::stability::Result;
use crate::stability::lab::Setting;
use crate::stability::written::Written;
use nalgebra::Point3;
use slicewalk::query::Aabb;
use std::collections::{HashMap, HashSet};

/// The method.
pub struct Thesis;

/// Pictures beyond this many bytes are not written as PNG: it takes longer than all else.
const PNG_BYTES: usize = 600_000_000;

impl Method for Thesis {
    fn name(&self) -> &'static str {
        "thesis"
    }

    fn settings(&self) -> String {
        "slices of 3t from the lowest point, epsilon 1/3, RGB pictures over the whole bounds, all in memory".into()
    }

    fn estimate_bytes(&self, subject: &Subject, pixel_m: f64, _: usize) -> f64 {
        let size = subject.bounds[1] - subject.bounds[0];
        let slice = |p: &Point3<f64>| ((p.z - subject.bounds[0].z) / (3.0 * pixel_m)) as i64;
        let slices = subject.points.iter().map(slice).collect::<HashSet<_>>().len();
        3.0 * (size.x / pixel_m + 2.0) * (size.y / pixel_m + 2.0) * slices as f64
    }

    fn growth(&self) -> i32 {
        2
    }

    fn build(&self, subject: &Subject, pixel_m: f64) -> Result<Box<dyn Built>> {
        let setting = Setting::new(pixel_m);
        let written = Written::new(setting, subject.points.iter().map(|&p| p.into()));
        let index = |v: f64| (v / pixel_m).floor() as i64;
        let [low, high] = subject.bounds;
        let first = [index(low.x), index(low.y)];
        let size = [index(high.x) - first[0] + 1, index(high.y) - first[1] + 1];
        let mut images = Images { setting, z0: written.origin(), first, size, slices: HashMap::new() };
        written.pixels(|[i, j, slice], red, obstacle| {
            let at = images.at(i, j);
            let blank = || vec![0; (3 * size[0] * size[1]) as usize];
            let image = images.slices.entry(slice).or_insert_with(blank);
            if let Some(at) = at {
                image[at..at + 3].copy_from_slice(&[red, 255, if obstacle { 255 } else { 26 }]);
            }
        });
        Ok(Box::new(images))
    }
}

struct Images {
    setting: Setting,
    z0: f64,
    first: [i64; 2],
    /// Width and height of every picture.
    size: [i64; 2],
    slices: HashMap<i64, Vec<u8>>,
}

impl Images {
    fn at(&self, i: i64, j: i64) -> Option<usize> {
        let (i, j) = (i - self.first[0], j - self.first[1]);
        let inside = (0..self.size[0]).contains(&i) && (0..self.size[1]).contains(&j);
        inside.then_some(3 * (j * self.size[0] + i) as usize)
    }

    fn index(&self, v: f64) -> i64 {
        (v / self.setting.pixel_m).floor() as i64
    }

    fn slice(&self, z: f64) -> i64 {
        ((z - self.z0) / self.setting.slice_m()).floor() as i64
    }

    /// Red values of the pixels under a box in one picture that are not black.
    fn reds<'a>(&self, image: &'a [u8], min: Point3<f64>, max: Point3<f64>) -> impl Iterator<Item = u8> + use<'a> {
        // Clipped to the picture, so that a box outside asks nothing.
        let [[left, right], [low, high]] = [0, 1].map(|axis| {
            let first = (self.index(min[axis]) - self.first[axis]).clamp(0, self.size[axis]);
            let end = (self.index(max[axis]) + 1 - self.first[axis]).clamp(first, self.size[axis]);
            [first as usize, end as usize]
        });
        let width = self.size[0] as usize;
        let rows = (low..high).map(move |row| &image[3 * (row * width + left)..3 * (row * width + right)]);
        rows.flat_map(|row| row.chunks_exact(3)).filter(|pixel| pixel[1] != 0).map(|pixel| pixel[0])
    }

    fn height(&self, slice: i64, red: u8) -> f64 {
        self.z0 + (slice as f64 + f64::from(red) / 255.0) * self.setting.slice_m()
    }
}

impl Built for Images {
    fn hits(&self, shape: &Aabb) -> bool {
        let (min, max) = (shape.min(), shape.max());
        let mut slices = (self.slice(min.z)..=self.slice(max.z)).filter_map(|slice| self.slices.get(&slice));
        slices.any(|image| self.reds(image, min, max).next().is_some())
    }

    fn file_bytes(&self) -> Result<Option<u64>> {
        if self.slices.values().map(Vec::len).sum::<usize>() > PNG_BYTES {
            return Ok(None);
        }
        let [width, height] = self.size.map(|size| size as usize);
        let mut bytes = 0;
        for image in self.slices.values() {
            bytes += png(width, height, image)?.len() as u64;
        }
        Ok(Some(bytes))
    }

    fn claimed(&self, give: &mut dyn FnMut(Vec3, Vec3)) -> Result<()> {
        let (t, sigma) = (self.setting.pixel_m, self.setting.slice_m());
        for (&slice, image) in &self.slices {
            let z = self.z0 + slice as f64 * sigma;
            for (n, _) in image.chunks_exact(3).enumerate().filter(|(_, pixel)| pixel[1] != 0) {
                let (i, j) = (n as i64 % self.size[0] + self.first[0], n as i64 / self.size[0] + self.first[1]);
                let (x, y) = (i as f64 * t, j as f64 * t);
                give([x, y, z], [x + t, y + t, z + sigma]);
            }
        }
        Ok(())
    }

    fn floor(&self, shape: &Aabb, depth_m: f64) -> Option<Option<f64>> {
        let (min, max) = (shape.min(), shape.max());
        let lowest = min.z - depth_m;
        let mut slices = (self.slice(lowest)..=self.slice(min.z)).rev();
        Some(slices.find_map(|slice| {
            let image = self.slices.get(&slice)?;
            let heights = self.reds(image, min, max).map(|red| self.height(slice, red));
            heights.filter(|z| (lowest..=min.z).contains(z)).max_by(f64::total_cmp)
        }))
    }

    fn obstacle(&self, at: Point3<f64>) -> Option<bool> {
        let image = self.slices.get(&self.slice(at.z))?;
        let place = self.at(self.index(at.x), self.index(at.y)).filter(|&place| image[place + 1] != 0)?;
        Some(image[place + 2] == 255)
    }
}

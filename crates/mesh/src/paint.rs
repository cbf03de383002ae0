//! Colours of triangles and of their pieces in voxels.
//!
//! In: a triangle and its paint: one colour, a colour per corner, or a texture. Out: colour (8-bit sRGB) and weight of
//! each piece of the triangle that lies in one voxel. Memory: none beyond the textures, which are shared.
//!
//! *Definition.* A piece is the part of the triangle in one pixel and one slice, a convex polygon. Its colour is the
//! triangle's colour at the mean of the piece's corners; for a texture, the mean of about as many texels as the piece
//! covers, from a mipmap (L. Williams, "Pyramidal parametrics", 1983). Its weight is its area in sixteenths of a
//! pixel's area, rounded, at least 1 and at most [`MOST_WEIGHT`]. Corners are sorted first, so the result depends
//! neither on the winding nor on the first corner. The arithmetic uses only additions, multiplications, divisions and
//! square roots, which round alike on every platform.

use super::Triangle;
use crate::colour::multiplied;
use crate::frame::{Frame, SLICE_QUANTA};
use std::sync::Arc;

/// Greatest weight of a piece.
pub const MOST_WEIGHT: u32 = 63;
/// Weight of a piece with the area of one pixel.
const WEIGHT_OF_A_PIXEL: f64 = 16.0;
/// Most corners of a triangle cut by six planes.
const MOST_CORNERS: usize = 9;
/// White.
pub const WHITE: [u8; 3] = [255; 3];

/// Source of a triangle's colour (8-bit sRGB).
#[derive(Debug, Clone, Default)]
pub enum Paint {
    /// No colour.
    #[default]
    None,
    /// One colour.
    Flat([u8; 3]),
    /// A colour at each corner; in between, the values are interpolated.
    Corners([[u8; 3]; 3]),
    /// A texture.
    Texture {
        /// The texture.
        texture: Arc<Texture>,
        /// Texture coordinates of each corner; 0 to 1 spans the image, from its upper left.
        places: [[f64; 2]; 3],
        /// Colour at each corner; its linear light multiplies that of the texture.
        tints: [[u8; 3]; 3],
    },
}

impl Paint {
    /// Returns whether the paint has a colour other than black.
    pub fn is_seen(&self) -> bool {
        match self {
            Self::None => false,
            Self::Flat(colour) => *colour != [0; 3],
            Self::Corners(colours) => *colours != [[0; 3]; 3],
            Self::Texture { .. } => true,
        }
    }
}

/// Wrap mode: what a texture shows outside its image.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub enum Wrap {
    /// Repeats the image.
    #[default]
    Repeat,
    /// Repeats the image, every second time mirrored.
    Mirror,
    /// Extends the edge of the image.
    Clamp,
}

impl Wrap {
    /// Maps any coordinate into the image, 0 to 1.
    fn place(self, at: f64) -> f64 {
        if !at.is_finite() {
            return 0.0;
        }
        match self {
            // The image includes its upper edge.
            Self::Repeat if at == 1.0 => at,
            Self::Repeat => at - at.floor(),
            Self::Clamp => at.clamp(0.0, 1.0),
            Self::Mirror => {
                let within = at - 2.0 * (at / 2.0).floor();
                if within > 1.0 { 2.0 - within } else { within }
            }
        }
    }
}

/// An image with its mipmap levels.
#[derive(Debug)]
pub struct Image {
    levels: Vec<Level>,
}

#[derive(Debug)]
struct Level {
    width: u32,
    height: u32,
    rgb: Vec<u8>,
}

impl Image {
    /// Builds an image of `width × height` pixels, top row first, with its mipmap levels. Both sizes are raised to at
    /// least 1; `rgb` holds three bytes per pixel, and missing bytes are black.
    pub fn new(width: u32, height: u32, mut rgb: Vec<u8>) -> Self {
        let (width, height) = (width.max(1), height.max(1));
        rgb.resize(width as usize * height as usize * 3, 0);
        let mut levels = vec![Level { width, height, rgb }];
        while let Some(last) = levels.last().filter(|last| last.width > 1 || last.height > 1) {
            levels.push(last.halved());
        }
        Self { levels }
    }

    /// Upper bound of the bytes of an image of `pixels` pixels with its mipmap levels.
    pub fn bytes(pixels: u64) -> u64 {
        // The mipmap levels add a third, and odd sizes round up.
        pixels.saturating_mul(4) + 4096
    }

    /// Returns the mean of about `texels` texels around a position (0 to 1).
    fn at(&self, [u, v]: [f64; 2], texels: f64) -> [u8; 3] {
        let (mut level, mut covered) = (0, 4.0);
        while covered <= texels && level + 1 < self.levels.len() {
            (level, covered) = (level + 1, covered * 4.0);
        }
        let Level { width, height, rgb } = &self.levels[level];
        let index = |place: f64, size: u32| ((place * f64::from(size)) as u32).min(size - 1) as usize;
        let at = 3 * (index(v, *height) * *width as usize + index(u, *width));
        [rgb[at], rgb[at + 1], rgb[at + 2]]
    }
}

impl Level {
    fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let mut rgb = Vec::with_capacity(width as usize * height as usize * 3);
        for y in 0..height {
            let rows = [2 * y, (2 * y + 1).min(self.height - 1)].map(|y| y as usize * self.width as usize);
            for x in 0..width {
                let columns = [2 * x, (2 * x + 1).min(self.width - 1)].map(|x| x as usize);
                for channel in 0..3 {
                    let value = |row: usize, column: usize| u32::from(self.rgb[3 * (row + column) + channel]);
                    let sum = value(rows[0], columns[0]) + value(rows[0], columns[1]);
                    let sum = sum + value(rows[1], columns[0]) + value(rows[1], columns[1]);
                    rgb.push(((sum + 2) / 4) as u8);
                }
            }
        }
        Self { width, height, rgb }
    }
}

/// An image and its wrap modes.
#[derive(Debug)]
pub struct Texture {
    /// The image.
    pub image: Arc<Image>,
    /// Wrap modes along the width and the height.
    pub wrap: [Wrap; 2],
    /// Shared by all textures of one file; its reference count shows when none is left.
    _alive: Arc<()>,
}

impl Texture {
    /// A texture with this wrapping along u and v; `alive` is dropped with it.
    pub fn new(image: Arc<Image>, wrap: [Wrap; 2], alive: &Arc<()>) -> Self {
        Self { image, wrap, _alive: Arc::clone(alive) }
    }

    /// Returns the mean of about `texels` texels around a position.
    fn at(&self, [u, v]: [f64; 2], texels: f64) -> [u8; 3] {
        self.image.at([self.wrap[0].place(u), self.wrap[1].place(v)], texels)
    }

    /// Area in texels of a triangle with these texture coordinates.
    fn texels(&self, [a, b, c]: [[f64; 2]; 3]) -> f64 {
        let twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        let Level { width, height, .. } = &self.image.levels[0];
        let texels = twice.abs() / 2.0 * f64::from(*width) * f64::from(*height);
        if texels.is_finite() { texels } else { 0.0 }
    }
}

/// A convex polygon; coordinates in pixels, pixels and quanta.
#[derive(Debug, Clone, Copy)]
struct Polygon {
    corners: [[f64; 3]; MOST_CORNERS],
    count: usize,
}

impl Polygon {
    const NONE: Self = Self { corners: [[0.0; 3]; MOST_CORNERS], count: 0 };

    fn push(&mut self, corner: [f64; 3]) {
        // A convex polygon gains at most one corner per cut, so this never drops one.
        if let Some(place) = self.corners.get_mut(self.count) {
            *place = corner;
            self.count += 1;
        }
    }

    /// Clips to `low..=high` along `axis` (Sutherland and Hodgman, 1974).
    fn between(&self, axis: usize, low: f64, high: f64) -> Self {
        self.cut(axis, low, 1.0).cut(axis, high, -1.0)
    }

    /// Clips to one side of a plane: above it for `side` 1, below for -1.
    fn cut(&self, axis: usize, border: f64, side: f64) -> Self {
        let mut left = Self::NONE;
        for at in 0..self.count {
            let (a, b) = (self.corners[at], self.corners[if at + 1 == self.count { 0 } else { at + 1 }]);
            let (inside, next) = ((a[axis] - border) * side >= 0.0, (b[axis] - border) * side >= 0.0);
            if inside {
                left.push(a);
            }
            if inside != next {
                let share = (border - a[axis]) / (b[axis] - a[axis]);
                let mut corner = [0, 1, 2].map(|axis| a[axis] + (b[axis] - a[axis]) * share);
                corner[axis] = border;
                left.push(corner);
            }
        }
        left
    }

    fn middle(&self) -> [f64; 3] {
        let sum = |axis: usize| self.corners[..self.count].iter().map(|corner| corner[axis]).sum::<f64>();
        [0, 1, 2].map(|axis| sum(axis) / self.count as f64)
    }
}

/// Colour and weight of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PaintedPiece {
    /// Colour (8-bit sRGB).
    pub colour: [u8; 3],
    /// Weight, 1 to [`MOST_WEIGHT`].
    pub weight: u32,
}

/// A painted triangle on the grid.
#[derive(Debug)]
pub struct PlacedPaint {
    whole: Polygon,
    /// Corners, in pixels along all axes.
    corners: [[f64; 3]; 3],
    /// Pixels per quantum.
    rise: f64,
    paint: Paint,
    /// The two axes used for barycentric coordinates: those in which the triangle's projection is largest.
    axes: (usize, usize),
    /// Texels per area of a pixel.
    texels: f64,
}

/// Part of a triangle in one row of pixels.
#[derive(Debug)]
pub struct PaintedRow(Polygon);

fn normal_of([a, b, c]: &[[f64; 3]; 3]) -> [f64; 3] {
    let (p, q) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
    [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

impl PlacedPaint {
    /// Puts the triangle (m) on the grid; `None` if it has no paint.
    pub fn new(frame: &Frame, triangle: &Triangle, paint: &Paint) -> Option<Self> {
        // Sorts by position, then by paint: corners at equal positions span no area.
        let key = |at: usize| match paint {
            Paint::None | Paint::Flat(_) => (triangle[at], [0.0; 2], [0; 3]),
            Paint::Corners(colours) => (triangle[at], [0.0; 2], colours[at]),
            Paint::Texture { places, tints, .. } => (triangle[at], places[at], tints[at]),
        };
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal));
        let paint = match paint {
            Paint::None => return None,
            Paint::Flat(colour) => Paint::Flat(*colour),
            Paint::Corners(colours) => Paint::Corners(order.map(|at| colours[at])),
            Paint::Texture { texture, places, tints } => Paint::Texture {
                texture: Arc::clone(texture),
                places: order.map(|at| places[at]),
                tints: order.map(|at| tints[at]),
            },
        };
        let rise = frame.slice_m() / (frame.pixel_m() * SLICE_QUANTA as f64);
        let mut whole = Polygon::NONE;
        for corner in order.map(|at| triangle[at]) {
            whole.push([frame.pixels(corner[0]), frame.pixels(corner[1]), frame.quanta(corner[2])]);
        }
        let corners = [0, 1, 2].map(|at| {
            let [x, y, z] = whole.corners[at];
            [x, y, z * rise]
        });
        let normal = normal_of(&corners);
        let widest = (0..3).fold(0, |best, axis| if normal[axis].abs() > normal[best].abs() { axis } else { best });
        let area = length(normal) / 2.0;
        let texels = match &paint {
            Paint::Texture { texture, places, .. } if area > 0.0 => texture.texels(*places) / area,
            _ => 0.0,
        };
        Some(Self { whole, corners, rise, paint, axes: ((widest + 1) % 3, (widest + 2) % 3), texels })
    }

    /// Clips to row `j` of pixels.
    pub fn row(&self, j: i64) -> PaintedRow {
        PaintedRow(self.whole.between(1, j as f64, (j + 1) as f64))
    }

    /// Returns the piece in pixel `i` of a row and in `slice`. If rounding leaves nothing of it, uses the nearest part
    /// of the triangle with the least weight, so that each voxel that a triangle fills gets a colour.
    pub fn piece(&self, row: &PaintedRow, i: i64, slice: i64) -> PaintedPiece {
        let in_pixel = row.0.between(0, i as f64, (i + 1) as f64);
        let (low, high) = ((slice * SLICE_QUANTA) as f64, ((slice + 1) * SLICE_QUANTA) as f64);
        let piece = in_pixel.between(2, low, high);
        let area = self.area(&piece);
        let found = [&piece, &in_pixel, &row.0, &self.whole].into_iter().find(|polygon| polygon.count > 0);
        let [x, y, z] = found.unwrap_or(&self.whole).middle();
        let weight = ((area * WEIGHT_OF_A_PIXEL + 0.5) as u32).clamp(1, MOST_WEIGHT);
        PaintedPiece { colour: self.colour([x, y, z * self.rise], area), weight }
    }

    /// Returns the mean colour over an area (m²) around a position (m).
    pub fn at(&self, frame: &Frame, [x, y, z]: [f64; 3], area_m2: f64) -> [u8; 3] {
        let place = [frame.pixels(x), frame.pixels(y), frame.quanta(z) * self.rise];
        self.colour(place, area_m2 / (frame.pixel_m() * frame.pixel_m()))
    }

    /// Area of a polygon, in areas of a pixel.
    fn area(&self, polygon: &Polygon) -> f64 {
        let place = |at: usize| {
            let [x, y, z] = polygon.corners[at];
            [x, y, z * self.rise]
        };
        let fan = 2..polygon.count;
        fan.map(|at| length(normal_of(&[place(0), place(at - 1), place(at)])) / 2.0).sum()
    }

    /// Returns the mean colour over an area around a position (both in pixels).
    fn colour(&self, place: [f64; 3], area: f64) -> [u8; 3] {
        let mixed = |shares: [f64; 3], colours: &[[u8; 3]; 3]| {
            [0, 1, 2].map(|channel| {
                let sum: f64 = (0..3).map(|at| shares[at] * f64::from(colours[at][channel])).sum();
                (sum + 0.5) as u8
            })
        };
        match &self.paint {
            Paint::None => [0; 3],
            Paint::Flat(colour) => *colour,
            Paint::Corners(colours) => mixed(self.shares(place), colours),
            Paint::Texture { texture, places, tints } => {
                let shares = self.shares(place);
                let at = [0, 1].map(|axis| (0..3).map(|corner| shares[corner] * places[corner][axis]).sum());
                let colour = texture.at(at, area * self.texels);
                if *tints == [WHITE; 3] { colour } else { multiplied(colour, mixed(shares, tints)) }
            }
        }
    }

    /// Barycentric coordinates of a position, each 0 to 1.
    fn shares(&self, place: [f64; 3]) -> [f64; 3] {
        let (u, v) = self.axes;
        let [a, b, c] = &self.corners;
        let twice =
            |p: &[f64; 3], q: &[f64; 3], r: &[f64; 3]| (q[u] - p[u]) * (r[v] - p[v]) - (q[v] - p[v]) * (r[u] - p[u]);
        let whole = twice(a, b, c);
        let [s, t] = [twice(a, &place, c), twice(a, b, &place)].map(|part| {
            let share = part / whole;
            if share.is_finite() { share.clamp(0.0, 1.0) } else { 0.0 }
        });
        let t = t.min(1.0 - s);
        [(1.0 - s - t).max(0.0), s, t]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::Raster;
    use proptest::prelude::*;

    /// The pieces of a triangle in all voxels that it fills.
    fn pieces(frame: &Frame, triangle: &Triangle, paint: &Paint) -> Vec<([i64; 3], PaintedPiece)> {
        let (Some(placed), Some(paint)) =
            (Raster::new(*frame, 45.0).place(triangle), PlacedPaint::new(frame, triangle, paint))
        else {
            return Vec::new();
        };
        let (mut found, (first, last)) = (Vec::new(), placed.rows());
        for j in first..=last {
            let row = paint.row(j);
            placed.for_each_pixel(j, |i, bottom, top| {
                let lowest = bottom.div_euclid(SLICE_QUANTA);
                for slice in lowest..=lowest.max((top - 1).div_euclid(SLICE_QUANTA)) {
                    found.push(([i, j, slice], paint.piece(&row, i, slice)));
                }
            });
        }
        found
    }

    proptest! {
        #[test]
        fn pieces_have_the_areas_and_colours_of_their_places_whatever_the_order_of_corners(
            corners in prop::array::uniform3(prop::array::uniform3(-1.0f64..1.0)), turn in 0usize..3, turned: bool
        ) {
            let frame = Frame::new(0.1, 0.3).unwrap();
            // A linear function of the position.
            let value = |place: f64| 127.5 + 100.0 * place;
            let mut paint = corners.map(|corner| corner.map(|place| value(place).round() as u8));
            let found = pieces(&frame, &corners, &Paint::Corners(paint));
            let mut weight = 0;
            for (voxel, piece) in &found {
                weight += piece.weight;
                for axis in 0..3 {
                    let cell = if axis == 2 { 0.3 } else { 0.1 };
                    let ends = [0, 1].map(|end| value((voxel[axis] + end) as f64 * cell));
                    let colour = f64::from(piece.colour[axis]);
                    prop_assert!(ends[0] - 1.6 <= colour && colour <= ends[1] + 1.6, "{:?} {:?} {:?}", voxel, piece, ends);
                }
            }
            let p = [0, 1, 2].map(|k| corners[1][k] - corners[0][k]);
            let q = [0, 1, 2].map(|k| corners[2][k] - corners[0][k]);
            let area = length([p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]) / 2.0;
            // Slivers count as 1, and halves are rounded.
            let exact = area * 1600.0;
            prop_assert!((f64::from(weight) - exact).abs() <= found.len() as f64, "{} of {}", weight, exact);
            let mut other = corners;
            other.rotate_left(turn);
            paint.rotate_left(turn);
            if turned {
                other.swap(0, 1);
                paint.swap(0, 1);
            }
            prop_assert_eq!(pieces(&frame, &other, &Paint::Corners(paint)), found);
        }
    }

    #[test]
    fn images_are_halved_to_means_and_places_beyond_them_follow_the_rule() {
        let rgb: Vec<u8> = (0..5 * 3).flat_map(|n| [n * 10, 0, 255]).collect();
        let image = Image::new(5, 3, rgb);
        let sizes: Vec<(u32, u32)> = image.levels.iter().map(|level| (level.width, level.height)).collect();
        assert_eq!(sizes, [(5, 3), (2, 1), (1, 1)]);
        assert_eq!(image.levels[1].rgb, [30, 0, 255, 50, 0, 255]);
        assert_eq!(image.at([0.5, 0.5], 0.0), [70, 0, 255]);
        assert_eq!(image.at([1.0, 1.0], 3.9), [140, 0, 255]);
        assert_eq!(image.at([0.9, 0.9], 4.0), [50, 0, 255]);
        assert_eq!(image.at([0.9, 0.9], f64::INFINITY), [40, 0, 255]);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        near(Wrap::Repeat.place(-0.25), 0.75);
        near(Wrap::Mirror.place(1.25), 0.75);
        near(Wrap::Mirror.place(-0.25), 0.25);
        near(Wrap::Clamp.place(7.0), 1.0);
        for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
            for place in [f64::NAN, f64::INFINITY, -f64::INFINITY, 1e300, -1e300, -1e-300] {
                assert!((0.0..=1.0).contains(&wrap.place(place)), "{wrap:?} {place}");
            }
        }
        let one = Image::new(0, 0, Vec::new());
        assert_eq!(one.at([0.3, 0.9], 1e9), [0; 3]);
    }

    /// An image of 2 × 2 texels with these colours, and the triangle's paint of it.
    fn textured(places: [[f64; 2]; 3], tint: [u8; 3], texels: [[u8; 3]; 4]) -> Paint {
        let image = Arc::new(Image::new(2, 2, texels.concat()));
        Paint::Texture {
            texture: Arc::new(Texture::new(image, [Wrap::Repeat; 2], &Arc::new(()))),
            places,
            tints: [tint; 3],
        }
    }

    #[test]
    fn pieces_have_colours_of_the_paint_wherever_a_file_puts_it() {
        let frame = Frame::new(1.0, 1.0).unwrap();
        let triangle = [[0.0, 0.0, 0.5], [3.0, 0.0, 0.5], [0.0, 3.0, 0.5]];
        assert!(PlacedPaint::new(&frame, &triangle, &Paint::None).is_none());
        // Texture coordinates that are not finite: one of the texels, never a mean of all.
        let texels = [[10, 0, 0], [0, 20, 0], [0, 0, 30], [40, 40, 40]];
        let none = [[f64::NAN; 2], [f64::INFINITY; 2], [1e300; 2], [f64::MAX; 2]];
        for places in [[none[0]; 3], [none[0], none[1], [0.0; 2]], [[0.0; 2], [1e300, 0.0], [0.0, 1e300]], [none[3]; 3]]
        {
            let found = pieces(&frame, &triangle, &textured(places, WHITE, texels));
            assert!(found.len() >= 6, "{found:?}");
            assert!(found.iter().all(|(_, piece)| texels.contains(&piece.colour)), "{places:?}: {found:?}");
        }
        // The linear light of the tint multiplies that of the texture.
        let places = [[0.0; 2], [1.0, 0.0], [0.0, 1.0]];
        for (texel, tint, expected) in [
            ([255; 3], [7, 100, 200], [7, 100, 200]),
            ([7, 100, 200], [255, 255, 0], [7, 100, 0]),
            ([255, 128, 0], [188; 3], [188, 93, 0]),
        ] {
            let found = pieces(&frame, &triangle, &textured(places, tint, [texel; 4]));
            assert!(found.iter().all(|(_, piece)| piece.colour == expected), "{texel:?} {tint:?}: {found:?}");
        }
        // A triangle without area, which has no positions between its corners.
        let corner = triangle[1];
        let paint = PlacedPaint::new(&frame, &[corner; 3], &Paint::Corners([[10, 20, 30]; 3])).unwrap();
        assert_eq!(paint.piece(&paint.row(0), 3, 0), PaintedPiece { colour: [10, 20, 30], weight: 1 });
    }
}

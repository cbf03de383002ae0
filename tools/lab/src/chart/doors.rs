//! The least door that lets a pawn through: doors of many widths in thin walls, at some places of the grid.

use super::method::Method;
use super::record::Figure;
use super::subject::Subject;
use crate::Random;
use crate::peers::character::{FRAME_S, Pawn, Physics, STEPS};
use crate::stability::Result;
use crate::stability::lab::Vec3;
use nalgebra::{Point3, Vector2};
use rapier3d::prelude::SharedShape;
use slicewalk::query::Aabb;

/// Width and height of the pawn (m).
const WIDTH_M: f64 = 0.5;
const HEIGHT_M: f64 = 0.6;
/// How far walls reach below and above it (m).
const BEYOND_M: f64 = 0.1;
/// Widths to a pixel, and the greatest excess (pixels).
const PER_PIXEL: usize = 8;
const MOST: usize = 4;
/// Places of the grid.
const PLACES: usize = 4;
/// Points to a side of a pixel, and width of a jamb (pixels).
const DENSITY: f64 = 3.0;
const JAMB: f64 = 4.0;
/// Way through a door, to both sides (m), and boxes along it.
const WAY_M: f64 = 0.5;
const STOPS: u32 = 64;
/// Frames that a pawn is given for it at 1 m/s.
const FRAMES: usize = 120;

/// Doors, ordered by width at each place.
pub struct Doors {
    /// The points, as a scene of its own.
    pub subject: Subject,
    /// Per place and width the middle of the door.
    sites: Vec<Vec<[f64; 2]>>,
    pixel_m: f64,
}

impl Doors {
    /// Doors for pixels of this size.
    pub fn new(pixel_m: f64) -> Result<Self> {
        let mut random = Random(71);
        let mut points: Vec<Vec3> = Vec::new();
        let [along_x, along_y] = [2.0 * WIDTH_M + (MOST as f64 + 3.0 * JAMB) * pixel_m, 4.0 * WAY_M + JAMB * pixel_m];
        let mut sites = Vec::new();
        for place in 0..PLACES {
            let shift = [0, 1].map(|_| random.between(0.0, pixel_m));
            let site = |n: usize| [n as f64 * along_x + shift[0], place as f64 * along_y + shift[1]];
            let own: Vec<_> = (0..=MOST * PER_PIXEL).map(site).collect();
            for (n, site) in own.iter().enumerate() {
                jambs(*site, width(n, pixel_m), pixel_m, &mut random, &mut points);
            }
            sites.push(own);
        }
        Ok(Self { subject: Subject::written("doors", points)?, sites, pixel_m })
    }

    /// The least passable door of a method.
    pub fn of_boxes(&self, method: &dyn Method) -> Result<Option<Figure>> {
        let built = method.build(&self.subject, self.pixel_m)?;
        let size = [WIDTH_M, WIDTH_M, HEIGHT_M];
        Ok(self.least(|[x, y]| {
            (0..=STOPS).all(|stop| {
                let y = y + (f64::from(stop) / f64::from(STOPS) * 2.0 - 1.0) * WAY_M;
                Aabb::standing(Point3::new(x, y, 0.0), size.into()).is_ok_and(|shape| !built.hits(&shape))
            })
        }))
    }

    /// The least passable door of a capsule of `rapier3d`, which floats: there is no floor.
    pub fn of_capsules(&self, world: SharedShape) -> Option<Figure> {
        let physics = Physics::new(world);
        let origin = self.subject.origin;
        self.least(|[x, y]| {
            let start = Point3::new(x, y - WAY_M, 0.0) - origin;
            let mut pawn = Pawn::new(&physics, start, [WIDTH_M / 2.0, HEIGHT_M], STEPS[0]);
            for _ in 0..FRAMES {
                pawn.float(Vector2::new(0.0, FRAME_S));
            }
            pawn.feet().y - start.y > 2.0 * WAY_M
        })
    }

    /// Per place the least width that passes with all wider ones (cm); `None` if at some place none passes.
    fn least(&self, passes: impl Fn([f64; 2]) -> bool) -> Option<Figure> {
        let of_place = |sites: &Vec<[f64; 2]>| {
            let passing = sites.iter().rev().take_while(|site| passes(**site)).count();
            (passing > 0).then(|| width(sites.len() - passing, self.pixel_m) * 100.0)
        };
        let widths: Option<Vec<f64>> = self.sites.iter().map(of_place).collect();
        Figure::median("door_cm", widths?, PLACES)
    }
}

/// Width of door number `n` (m).
fn width(n: usize, pixel_m: f64) -> f64 {
    WIDTH_M + n as f64 / PER_PIXEL as f64 * pixel_m
}

/// A thin wall to both sides of a door, whose edges are points too.
fn jambs([x, y]: [f64; 2], width: f64, pixel_m: f64, random: &mut Random, points: &mut Vec<Vec3>) {
    let tall = HEIGHT_M + 2.0 * BEYOND_M;
    let count = (JAMB * tall / pixel_m * DENSITY * DENSITY) as usize;
    let edges = (tall / pixel_m * DENSITY) as usize;
    for side in [-1.0, 1.0] {
        for _ in 0..count {
            let along = width / 2.0 + random.between(0.0, JAMB * pixel_m);
            points.push([x + side * along, y, random.between(0.0, tall) - BEYOND_M]);
        }
        for n in 0..=edges {
            points.push([x + side * width / 2.0, y, tall * n as f64 / edges as f64 - BEYOND_M]);
        }
    }
}

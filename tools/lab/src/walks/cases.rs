//! Scenes in which the way of a pawn is known exactly: what it would walk on the true surfaces, as a line in space.
//!
//! Every case is laid out with the pawn's way along x, then turned and moved as a whole. A box keeps to the axes of
//! the world when its scene is turned; how far it reaches towards a surface is its support in that direction.

use nalgebra::{Point3, Vector2};
use scangen::Scene;
use scangen::geometry::Placement;
use scangen::scene::build::{Builder, Flight, Wall};
use slicewalk::walk::{Body, Config};

/// A pawn, a scene, and the exact way.
pub struct Case {
    /// Name of the obstacle.
    pub name: &'static str,
    /// The scene.
    pub scene: Scene,
    /// Where the feet are first (m).
    pub start: Point3<f64>,
    /// Where the pawn wants to go, for as long as the exact way takes.
    pub toward: Vector2<f64>,
    /// The exact way of the feet (m), a polyline.
    pub truth: Vec<Point3<f64>>,
    /// Whether the exact path continues beyond its last point, in the same direction.
    pub goes_on: bool,
    /// How long the exact pawn takes for it (s).
    pub seconds: f64,
    /// The pawn.
    pub body: Body,
}

/// The one case whose way ends where it ends.
const CORNER: &str = "inner corner";
/// Height of walls and columns (m).
const TALL: f64 = 3.0;

/// A case in its own coordinates: the way begins along x.
struct Layout {
    name: &'static str,
    build: Builder,
    truth: Vec<[f64; 3]>,
    /// Way that the pawn wants to go in the time of the case (m).
    way: f64,
    heading_deg: f64,
}

/// Where a layout stands in the world, and the body that walks in it.
struct Place<'a> {
    at: &'a Placement,
    body: Body,
}

impl Place<'_> {
    /// How far the body reaches in the direction (`x`, `y`) of the layout (m).
    fn reach(&self, x: f64, y: f64) -> f64 {
        let (s, c) = scangen::geometry::sin_cos_deg(self.at.rotate_deg);
        let (x, y) = (x * c - y * s, x * s + y * c);
        match self.body {
            Body::Box { x: width, y: depth, .. } => (x.abs() * width + y.abs() * depth) / 2.0,
            Body::Cylinder { radius, .. } => radius * x.hypot(y),
        }
    }

    fn case(&self, layout: Layout) -> Case {
        let place = |p: [f64; 3]| Point3::from(self.at.apply(p));
        let (s, c) = (self.at.rotate_deg + layout.heading_deg).to_radians().sin_cos();
        let truth: Vec<_> = layout.truth.into_iter().map(place).collect();
        Case {
            name: layout.name,
            scene: layout.build.finish(layout.name).placed(self.at),
            start: truth[0],
            toward: Vector2::new(c, s),
            goes_on: layout.name != CORNER,
            truth,
            seconds: layout.way / Config::new(self.body).speed,
            body: self.body,
        }
    }
}

/// Returns all cases for one body, in a scene turned by `turn_deg` degrees and moved by `shift` (m).
pub fn all(body: Body, turn_deg: f64, shift: [f64; 3]) -> Vec<Case> {
    let at = Placement { rotate_deg: turn_deg, translate: shift };
    let place = Place { at: &at, body };
    let mut layouts = vec![floor(), door(), corner(&place), kerb(&place), ledge(&place)];
    layouts.extend([10.0, 30.0, 50.0].map(|angle| wall(&place, angle)));
    layouts.extend([0.1, 0.17, 0.25, 0.3].into_iter().flat_map(|riser| stairs(&place, riser)));
    layouts.extend([15.0, 35.0].into_iter().flat_map(|slope| ramp(&place, slope)));
    match body {
        Body::Cylinder { radius, .. } => {
            layouts.extend([0.15, 0.35].map(|aside| column([0.0, 0.0], radius + COLUMN, aside)));
            layouts.push(jamb(radius));
        }
        // Against the corner of a box along the axes, the way is an arc too; turned, or against its flat front, it is not.
        Body::Box { x, y, .. } if turn_deg == 0.0 => layouts.push(column([-x / 2.0, y / 2.0], COLUMN, y / 2.0 + 0.1)),
        Body::Box { .. } => {}
    }
    layouts.into_iter().map(|layout| place.case(layout)).collect()
}

fn on_floor(half: f64) -> Builder {
    let mut build = Builder::new();
    build.level("floor", [-half, -half, half, half], 0.0, &[]);
    build
}

fn floor() -> Layout {
    let truth = vec![[-2.9, 0.03, 0.0], [2.9, 0.03, 0.0]];
    Layout { name: "level floor", build: on_floor(4.0), truth, way: 5.8, heading_deg: 0.0 }
}

fn door() -> Layout {
    let mut build = on_floor(3.0);
    let wall = Wall { from: [0.0, -3.0], to: [0.0, 3.0], thickness: 0.1, z: [0.0, TALL] };
    build.wall(wall, &[[2.5, 0.0, 3.5, 2.1]]);
    let truth = vec![[-1.5, 0.0, 0.0], [1.5, 0.0, 0.0]];
    Layout { name: "door of 1 m", build, truth, way: 3.0, heading_deg: 0.0 }
}

/// A wall that the pawn meets at this angle and slides along.
fn wall(place: &Place, angle_deg: f64) -> Layout {
    let (s, c) = angle_deg.to_radians().sin_cos();
    let mut build = on_floor(5.0);
    build.quad("wall", [1.0 - 5.0 * c, -5.0 * s, 0.0], [9.0 * c, 9.0 * s, 0.0], [0.0, 0.0, TALL]);
    let start = [-1.5, 0.8 - 2.0 * s];
    // The distance from the wall falls from the start's to the body's reach.
    let from_wall = -(start[0] - 1.0) * s + start[1] * c;
    let free = (from_wall - place.reach(-s, c)) / s;
    let way = free + 2.0 / c;
    let contact = [start[0] + free, start[1], 0.0];
    let end = [contact[0] + 2.0 * c, contact[1] + 2.0 * s, 0.0];
    let truth = vec![[start[0], start[1], 0.0], contact, end];
    let name = ["wall met at 10°", "wall met at 30°", "wall met at 50°"][(angle_deg / 20.0) as usize];
    Layout { name, build, truth, way, heading_deg: 0.0 }
}

/// Into an inner corner, along one of its walls at the end.
fn corner(place: &Place) -> Layout {
    let mut build = on_floor(3.0);
    build.quad("wall", [2.0, -2.0, 0.0], [0.0, 3.0, 0.0], [0.0, 0.0, TALL]);
    build.quad("wall", [-2.0, 1.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, TALL]);
    let heading_deg = 30.0f64;
    let (s, c) = heading_deg.to_radians().sin_cos();
    let end = [2.0 - place.reach(1.0, 0.0), 1.0 - place.reach(0.0, 1.0)];
    let free = end[1] / s;
    let truth = vec![[0.0; 3], [free * c, end[1], 0.0], [end[0], end[1], 0.0]];
    Layout { name: CORNER, build, truth, way: free + (end[0] - free * c) / c, heading_deg }
}

/// Radius of columns (m).
const COLUMN: f64 = 0.32;

/// Past a column, `aside` off its axis: the middle of the pawn goes along a circle until it is clear.
fn column(center: [f64; 2], radius: f64, aside: f64) -> Layout {
    let mut build = on_floor(3.0);
    build.column("column", [0.0, 0.0], COLUMN, [0.0, TALL]);
    arc("round column", build, center, radius, aside)
}

/// The edge of a door frame in the way of a cylinder: an arc around it, then straight on.
fn jamb(radius: f64) -> Layout {
    let mut build = on_floor(3.0);
    let wall = Wall { from: [0.0, -3.0], to: [0.0, 3.0], thickness: 0.3, z: [0.0, TALL] };
    // The wall lies to the left of its line, that is, before it.
    build.wall(wall, &[[2.5, 0.0, 3.5, 2.1]]);
    arc("door jamb", build, [-0.3, -0.5], radius, 0.1 - 0.5)
}

/// Along x at `y` to a circle, and along it to its top.
fn arc(name: &'static str, build: Builder, center: [f64; 2], radius: f64, y: f64) -> Layout {
    let from = ((y - center[1]) / radius).acos();
    let on_circle = |angle: f64| [center[0] - radius * angle.sin(), center[1] + radius * angle.cos(), 0.0];
    let start = [-2.0, y, 0.0];
    let contact = on_circle(from);
    let arc = (0..=100).map(|n| on_circle(from * (1.0 - f64::from(n) / 100.0)));
    let end = [center[0] + 1.2, center[1] + radius, 0.0];
    let truth = std::iter::once(start).chain(arc).chain([end]).collect();
    // Along the circle it advances at the cosine of its slope: the integral of 1 / cos.
    let slowest = std::f64::consts::FRAC_PI_2 - 1e-6;
    let on_arc = radius * (from.min(slowest) / 2.0 + std::f64::consts::FRAC_PI_4).tan().ln();
    Layout { name, build, truth, way: (contact[0] + 2.0) + on_arc + 1.2, heading_deg: 0.0 }
}

/// Four risers between two landings, up and down.
fn stairs(place: &Place, riser: f64) -> [Layout; 2] {
    const TREAD: f64 = 0.3;
    let reach = place.reach(1.0, 0.0);
    let top = 4.0 * riser;
    let layout = |name, up: bool| {
        let mut build = Builder::new();
        build.level("floor", [-2.5, -1.5, 0.0, 1.5], 0.0, &[]);
        build.flight(Flight { foot: [0.0; 3], heading_deg: 0.0, risers: 4, riser, tread: TREAD, width: 3.0 });
        build.level("floor", [3.0 * TREAD, -1.5, 3.5, 1.5], top, &[]);
        let mut truth = vec![[-1.8, 0.0, 0.0]];
        for n in 0..4 {
            let x = f64::from(n) * TREAD - reach;
            truth.extend([[x, 0.0, f64::from(n) * riser], [x, 0.0, f64::from(n + 1) * riser]]);
        }
        truth.push([2.5, 0.0, top]);
        finish(name, build, truth, up)
    };
    let names = match (riser * 100.0) as u32 {
        10 => ["stairs of 10 cm, up", "stairs of 10 cm, down"],
        17 => ["stairs of 17 cm, up", "stairs of 17 cm, down"],
        25 => ["stairs of 25 cm, up", "stairs of 25 cm, down"],
        _ => ["stairs of 30 cm, up", "stairs of 30 cm, down"],
    };
    [layout(names[0], true), layout(names[1], false)]
}

/// A ramp of 1 m rise between two floors, up and down: the pawn stands on the highest point under it.
fn ramp(place: &Place, slope_deg: f64) -> [Layout; 2] {
    let (rise, reach) = (1.0, place.reach(1.0, 0.0));
    let run = rise / slope_deg.to_radians().tan();
    let layout = |name, up: bool| {
        let mut build = Builder::new();
        build.level("floor", [-2.5, -1.5, 0.0, 1.5], 0.0, &[]);
        build.quad("ramp", [0.0, -1.5, 0.0], [run, 0.0, rise], [0.0, 3.0, 0.0]);
        build.level("floor", [run, -1.5, run + 2.5, 1.5], rise, &[]);
        let truth = vec![[-1.8, 0.0, 0.0], [-reach, 0.0, 0.0], [run - reach, 0.0, rise], [run + 1.6, 0.0, rise]];
        finish(name, build, truth, up)
    };
    let names = match slope_deg as u32 {
        15 => ["ramp of 15°, up", "ramp of 15°, down"],
        _ => ["ramp of 35°, up", "ramp of 35°, down"],
    };
    [layout(names[0], true), layout(names[1], false)]
}

/// Along x, or the same back.
fn finish(name: &'static str, build: Builder, mut truth: Vec<[f64; 3]>, up: bool) -> Layout {
    let way = truth[truth.len() - 1][0] - truth[0][0];
    if !up {
        truth.reverse();
    }
    Layout { name, build, truth, way, heading_deg: if up { 0.0 } else { 180.0 } }
}

/// Over a kerb of 15 cm, 40 cm deep.
fn kerb(place: &Place) -> Layout {
    let (reach, height, depth) = (place.reach(1.0, 0.0), 0.15, 0.4);
    let mut build = Builder::new();
    build.level("floor", [-2.5, -1.5, 2.5, 1.5], 0.0, &[[0.0, -1.5, depth, 1.5]]);
    build.open_cuboid("kerb", [0.0, -1.5, 0.0], [depth, 1.5, height]);
    let [from, to] = [-reach, depth + reach];
    let truth = vec![
        [-1.8, 0.0, 0.0],
        [from, 0.0, 0.0],
        [from, 0.0, height],
        [to, 0.0, height],
        [to, 0.0, 0.0],
        [2.0, 0.0, 0.0],
    ];
    Layout { name: "kerb of 15 cm", build, truth, way: 3.8, heading_deg: 0.0 }
}

/// Off a ledge of 2 m: a parabola.
fn ledge(place: &Place) -> Layout {
    let (height, reach) = (2.0, place.reach(1.0, 0.0));
    let config = Config::new(place.body);
    let mut build = Builder::new();
    build.open_cuboid("block", [-2.5, -1.5, 0.0], [0.0, 1.5, height]);
    build.level("floor", [0.0, -1.5, 3.0, 1.5], 0.0, &[]);
    let lasts = (2.0 * height / config.gravity).sqrt();
    let falling = (0..=100).map(|n| {
        let t = lasts * f64::from(n) / 100.0;
        [reach + config.speed * t, 0.0, height - config.gravity * t * t / 2.0]
    });
    let truth: Vec<_> = std::iter::once([-1.5, 0.0, height]).chain(falling).chain([[2.2, 0.0, 0.0]]).collect();
    Layout { name: "ledge of 2 m", build, truth, way: 3.7, heading_deg: 0.0 }
}

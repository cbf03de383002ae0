//! Pawns of Bevy that walk in a slice archive while its pages are streamed.
//!
//! Add [`ScanPlugin`], spawn entities with a [`Pawn`] and a `Transform`, and set [`Pawn::wish`] from the player's input.
//! Pawns move in `FixedUpdate`; one whose pages are still being read waits in place. Scans have z up and may lie millions
//! of metres from the origin, Bevy has y up and `f32`: a scan's (x, y, z) is (x, z, −y) in Bevy, less the scan's
//! [origin](Scan::new).

use bevy_app::{App, FixedUpdate, Plugin};
use bevy_ecs::prelude::{Component, Query, Res, Resource};
use bevy_math::Vec3;
use bevy_time::{Fixed, Time};
use bevy_transform::components::Transform;
use slicewalk::archive::Archive;
use slicewalk::nalgebra::Point3;
use slicewalk::store::{PawnHandle, Stream, StreamOptions};
use slicewalk::walk::{Config, MoveInput, Walker};

/// The streamed scan that all pawns walk in.
#[derive(Resource)]
pub struct Scan {
    stream: Stream,
    origin: Point3<f64>,
}

impl Scan {
    /// Streams `archive` through a cache of this many bytes; `origin` (m) is the place of the scan at Bevy's origin.
    pub fn new(archive: Archive, cache_bytes: usize, origin: Point3<f64>) -> slicewalk::Result<Self> {
        Ok(Self { stream: Stream::open(archive, StreamOptions::new(cache_bytes))?, origin })
    }

    /// Returns a place of the scan in Bevy's coordinates.
    pub fn to_bevy(&self, place: Point3<f64>) -> Vec3 {
        let from = place - self.origin;
        Vec3::new(from.x as f32, from.z as f32, -from.y as f32)
    }
}

/// A body that walks, stands, falls and climbs steps; its entity's `Transform` follows its feet.
#[derive(Component)]
pub struct Pawn {
    /// Where it is to go.
    pub wish: MoveInput,
    walker: Walker,
    waits: bool,
    /// Keeps the pages around it loaded.
    handle: PawnHandle,
}

impl Pawn {
    /// Creates a pawn with its feet at a place of the scan (m), and reads the pages around it; blocks meanwhile.
    pub fn new(scan: &Scan, config: Config, feet: Point3<f64>) -> slicewalk::Result<Self> {
        let walker = Walker::new(config, feet)?;
        let handle = scan.stream.pawn();
        scan.stream.load_around(&walker.motion_hint(scan.stream.archive().frame()))?;
        Ok(Self { wish: MoveInput::Stay, walker, waits: false, handle })
    }

    /// Returns the body as it moves.
    pub fn walker(&self) -> &Walker {
        &self.walker
    }

    /// Returns whether the last step was held up by pages that are still being read.
    pub fn waits(&self) -> bool {
        self.waits
    }

    fn step(&mut self, scan: &Scan, seconds: f64) {
        self.handle.hint(&self.walker.motion_hint(scan.stream.archive().frame()));
        let report = self.walker.step(&scan.stream.snapshot(), seconds, self.wish);
        self.waits = report.missing.is_some();
        if let Some(missing) = &report.missing {
            self.handle.need(missing);
        }
    }
}

/// Moves pawns in `FixedUpdate`. Needs a [`Scan`] and Bevy's time.
pub struct ScanPlugin;

impl Plugin for ScanPlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(FixedUpdate, walk);
    }
}

fn walk(scan: Res<Scan>, time: Res<Time<Fixed>>, mut pawns: Query<(&mut Pawn, &mut Transform)>) {
    for (mut pawn, mut transform) in &mut pawns {
        pawn.step(&scan, time.delta_secs_f64());
        transform.translation = scan.to_bevy(pawn.walker.feet());
    }
}

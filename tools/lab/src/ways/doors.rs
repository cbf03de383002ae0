//! Doors and stairs connect just as their sizes say.

use super::standing::RADII;
use super::truth::{CLIMB, HEIGHT};
use super::{Effort, reached, spot};
use crate::Random;
use crate::stability::Result;
use crate::stability::lab::{Scan, Setting};
use crate::stability::table::{Share, Table};
use scangen::geometry::Placement;
use scangen::sample::{Mode, Order};
use scangen::{Params, SampleSpec, Scene};
use slicewalk::plan::Classifier;
use slicewalk::reach::{Pawn, StandingPlaces};
use slicewalk::store::Snapshot;
use slicewalk::walk::Body;

const NOISE_M: f64 = 0.002;
const PIXEL_M: f64 = 0.05;

/// A scene at a place of the grid.
fn store(name: &str, params: &[(&str, f64)], shift: [f64; 3]) -> Result<Snapshot> {
    let params = params.iter().fold(Params::new(), |params, (name, value)| params.with(name, *value));
    let scene = Scene::named(name, &params)?.placed(&Placement { rotate_deg: 0.0, translate: shift });
    let even = SampleSpec::direct_density((3.0 / PIXEL_M).powi(2)).with_noise(NOISE_M);
    let scan = Scan::new(scene.points(3, &SampleSpec { mode: Mode::Direct(Order::Grid), ..even })?.collect())?;
    Ok(scan.convert(Setting::new(PIXEL_M), Classifier::Plane)?.store)
}

/// Whether a pawn gets from one place to another and back.
fn connects(store: &Snapshot, radius: f64, ends: [[f64; 3]; 2], shift: [f64; 3]) -> Result<[bool; 2]> {
    let mut standing = StandingPlaces::new(store, Pawn::new(Body::Cylinder { radius, height: HEIGHT }))?;
    let mut at = |end: [f64; 3]| {
        let [x, y, z] = [0, 1, 2].map(|axis| end[axis] + shift[axis]);
        spot(store, &mut standing, [x, y, z + 0.1])
    };
    let (Some(a), Some(b)) = (at(ends[0])?, at(ends[1])?) else { return Ok([false; 2]) };
    let there = reached(store, &mut standing, a)?.holds(&b);
    let back = reached(store, &mut standing, b)?.holds(&a);
    Ok([there, back])
}

/// Doors about as wide as each pawn, and stairs about as high as it climbs.
pub fn section(effort: &Effort) -> Result<String> {
    let mut table = Table::new(["what", "radius (m)", "expected", "of tries", "as expected"]);
    let mut random = Random(9);
    let shifts: Vec<[f64; 3]> =
        (0..effort.of(12, 2)).map(|_| [0; 3].map(|_| random.between(0.0, 3.0 * PIXEL_M))).collect();
    let mut row = |what: String, radius: f64, expected: bool, share: Share| {
        let expected = if expected { "connected" } else { "not connected" };
        table.row([what, radius.to_string(), expected.into(), share.all.to_string(), share.yes.to_string()]);
    };
    for radius in RADII {
        for (what, more, expected) in [
            ("door 1 cm wider than the pawn and two pixels", 2.0 * PIXEL_M + 0.01, true),
            ("door as wide as the pawn and two pixels", 2.0 * PIXEL_M, true),
            ("door 1 cm narrower than the pawn", -0.01, false),
        ] {
            let mut share = Share::default();
            for shift in &shifts {
                let params = [("door", 2.0 * radius + more), ("width", 3.0), ("beam", 2.2)];
                let store = store("corridor", &params, *shift)?;
                let found = connects(&store, radius, [[1.5, 0.0, 0.0], [6.5, 0.0, 0.0]], *shift)?;
                share.add(found == [expected; 2]);
            }
            row(what.into(), radius, expected, share);
        }
    }
    for (riser, expected) in [(0.15, true), (0.25, true), (CLIMB - 0.02, true), (CLIMB + 0.02, false)] {
        let stores: Vec<Snapshot> = shifts
            .iter()
            .map(|shift| store("stairs", &[("riser", riser), ("risers", 6.0), ("landing", 3.0)], *shift))
            .collect::<Result<_>>()?;
        for radius in RADII {
            let mut share = Share::default();
            for (store, shift) in stores.iter().zip(&shifts) {
                let ends = [[-1.5, 0.0, 0.0], [2.9, 0.0, 6.0 * riser]];
                share.add(connects(store, radius, ends, *shift)? == [expected; 2]);
            }
            row(format!("stairs with risers of {riser:.2} m"), radius, expected, share);
        }
    }
    Ok(format!(
        "\n## Doors and stairs\n\nScanned evenly with noise of 2 mm at random places of a grid of 5 cm; there and back.\n\n{}\n",
        table.markdown()
    ))
}

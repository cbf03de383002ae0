//! Areas of storeys and ramps as polygons, ways as lines, passages, steps, leaks and places where a way stops as points,
//! in the scan's coordinates.

use super::Reach;
use super::features::{Ground, Ramp};
use super::files::Out;
use crate::Failure;
use crate::blocked::needs;
use crate::ground::{Loader, tidy};
use crate::links::Way;
use crate::outline::{Area, Corner};
use nalgebra::Point3;
use serde_json::{Value, json};
use slicewalk::reach::Obstruction;
use std::io::Write;

pub(super) fn write(reach: &Reach, loader: &Loader, out: &mut Out) -> Result<(), Failure> {
    let frame = loader.archive().frame();
    let mut areas: Vec<Area> = reach.storeys.all.iter().map(|_| Area::default()).collect();
    for (place, storey) in reach.region.places().zip(&reach.storeys.of) {
        areas[usize::from(*storey)].insert((frame.pixel_of(place.feet.x), frame.pixel_of(place.feet.y)));
    }
    let mut features = Vec::new();
    let edge = |v: i64| frame.edge_of_pixel(v);
    let polygons = |area: Area, z: f64| {
        let ring = |ring: &Vec<Corner>| ring.iter().map(|(i, j)| json!([edge(*i), edge(*j), z])).collect::<Vec<_>>();
        let polygons: Vec<Value> =
            area.polygons().iter().map(|rings| json!(rings.iter().map(ring).collect::<Vec<_>>())).collect();
        json!({ "type": "MultiPolygon", "coordinates": polygons })
    };
    for (storey, area) in reach.storeys.all.iter().zip(areas) {
        let properties = json!({ "what": "storey", "z": storey.z, "area_m2": storey.area_m2 });
        features.push(feature(polygons(area, storey.z), properties));
    }
    let ground = Ground::new(reach, frame);
    for Ramp { area, area_m2, z, grade, rise } in ground.ramps() {
        let properties = json!({ "what": "ramp", "z": tidy(z), "area_m2": tidy(area_m2), "grade_percent": tidy(100.0 * grade), "rise": tidy(rise) });
        features.push(feature(polygons(area, z), properties));
    }
    for step in ground.steps() {
        features.push(feature(
            point(step.at),
            json!({ "what": "step", "height": tidy(step.height), "width": tidy(step.width) }),
        ));
    }
    for passage in &reach.passages {
        let connects = passage.rooms.map(|room| [room.x, room.y, room.z].map(tidy));
        features.push(feature(
            point(passage.at),
            json!({ "what": "passage", "width": tidy(passage.width), "connects": connects }),
        ));
    }
    features.extend(reach.way.as_ref().map(way_feature));
    for leak in &reach.leaks {
        let properties = json!({ "what": "leak", "kind": leak.kind.name(), "width": leak.width, "drop": leak.drop });
        features.push(feature(point(leak.at), properties));
    }
    let crs = loader.archive().crs().map_err(|error| crate::broken(loader.path(), &error))?;
    Ok(writeln!(out, "{}", collection(&crs, features))?)
}

/// A collection of features in the coordinates of a scan with this reference system, empty if unknown.
pub fn collection(crs: &str, features: Vec<Value>) -> Value {
    let mut collection = json!({ "type": "FeatureCollection" });
    if !crs.is_empty() {
        collection["crs"] = json!({ "type": "name", "properties": { "name": crs } });
    }
    collection["features"] = features.into();
    collection
}

/// Iterates over `count` items, the last one more than once if there are fewer.
fn doubled<T>(items: &[T], count: usize) -> impl Iterator<Item = &T> {
    items.iter().chain(items.last().into_iter().cycle()).take(count)
}

/// A way as a line.
pub fn way_feature(way: &Way) -> Value {
    // A line has two ends, even one of no length.
    let count = way.points.len().max(2);
    let line: Vec<Value> = doubled(&way.points, count).map(|at| json!([at.x, at.y, at.z])).collect();
    let mut properties = json!({ "what": "way", "length_m": way.length_m, "way_s": way.seconds, "links": way.links });
    if !way.headings.is_empty() {
        properties["headings"] = doubled(&way.headings, count).map(|heading| tidy(*heading)).collect::<Vec<_>>().into();
    }
    feature(json!({ "type": "LineString", "coordinates": line }), properties)
}

fn point(at: Point3<f64>) -> Value {
    json!({ "type": "Point", "coordinates": [at.x, at.y, at.z] })
}

/// A place where a way stops.
pub fn blocked_feature(blocked: &Obstruction) -> Value {
    let properties = json!({ "what": "blocked", "reason": blocked.reason.name(), "needs": needs(blocked) });
    feature(point(blocked.at), properties)
}

fn feature(geometry: Value, properties: Value) -> Value {
    json!({ "type": "Feature", "geometry": geometry, "properties": properties })
}

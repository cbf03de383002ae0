//! Areas of storeys as polygons, passages and leaks as points, in the scan's coordinates.

use super::Reach;
use super::files::Out;
use crate::Failure;
use crate::ground::Loader;
use crate::outline::{Area, Corner};
use serde_json::{Value, json};
use std::io::Write;

pub fn write(reach: &Reach, loader: &Loader, out: &mut Out) -> Result<(), Failure> {
    let frame = loader.archive().frame();
    let mut areas: Vec<Area> = reach.storeys.all.iter().map(|_| Area::default()).collect();
    for (place, storey) in reach.region.places().zip(&reach.storeys.of) {
        areas[usize::from(*storey)].insert((frame.pixel_of(place.feet.x), frame.pixel_of(place.feet.y)));
    }
    let mut features = Vec::new();
    for (storey, area) in reach.storeys.all.iter().zip(areas) {
        let edge = |v: i64| frame.edge_of_pixel(v);
        let ring =
            |ring: &Vec<Corner>| ring.iter().map(|(i, j)| json!([edge(*i), edge(*j), storey.z])).collect::<Vec<_>>();
        let polygons: Vec<Value> =
            area.polygons().iter().map(|rings| json!(rings.iter().map(ring).collect::<Vec<_>>())).collect();
        let properties = json!({ "what": "storey", "z": storey.z, "area_m2": storey.area_m2 });
        features.push(feature(json!({ "type": "MultiPolygon", "coordinates": polygons }), properties));
    }
    let point = |at: nalgebra::Point3<f64>| json!({ "type": "Point", "coordinates": [at.x, at.y, at.z] });
    for passage in &reach.passages {
        features.push(feature(point(passage.at), json!({ "what": "passage", "width": passage.width })));
    }
    if let Some(way) = &reach.way {
        let line = way.points.iter().map(|at| json!([at.x, at.y, at.z])).collect::<Vec<_>>();
        let properties = json!({ "what": "way", "length_m": way.length_m });
        features.push(feature(json!({ "type": "LineString", "coordinates": line }), properties));
    }
    for leak in &reach.leaks {
        let properties = json!({ "what": "leak", "kind": leak.kind.name(), "width": leak.width, "drop": leak.drop });
        features.push(feature(point(leak.at), properties));
    }
    let mut collection = json!({ "type": "FeatureCollection" });
    let crs = loader.archive().crs().map_err(|error| crate::broken(loader.path(), &error))?;
    if !crs.is_empty() {
        collection["crs"] = json!({ "type": "name", "properties": { "name": crs } });
    }
    collection["features"] = features.into();
    Ok(writeln!(out, "{collection}")?)
}

fn feature(geometry: Value, properties: Value) -> Value {
    json!({ "type": "Feature", "geometry": geometry, "properties": properties })
}

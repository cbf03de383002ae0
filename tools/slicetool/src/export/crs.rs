//! Reference system of an archive in the terms of other formats.

use crate::Failure;
use slicewalk::archive::Archive;
use slicewalk::unit::LengthUnit;
use slicewalk_base::text::one_line;
use slicewalk_input::{is_in_metres, projected_epsg};
use std::path::Path;

/// Keys of the GeoTIFF 1.0 specification, section 6.
const MODEL_TYPE: u16 = 1024;
const RASTER_TYPE: u16 = 1025;
const PROJECTED_SYSTEM: u16 = 3072;
const PROJECTED_CITATION: u16 = 3073;
const LINEAR_UNITS: u16 = 3076;
const VERTICAL_UNITS: u16 = 4099;
/// Values of keys: projected system, pixels as areas, user-defined system, metre.
const PROJECTED: u16 = 1;
const PIXEL_IS_AREA: u16 = 1;
const USER_DEFINED: u16 = 32767;
const METRE: u16 = 9001;
/// TIFF tag that holds the texts of keys.
const GEO_TEXT: u16 = 34737;

/// A reference system in metres, the unit of all exports.
pub struct Crs {
    text: String,
    epsg: Option<u16>,
}

/// GeoTIFF keys: the directory and the texts that it refers to.
pub struct GeoKeys {
    pub directory: Vec<u16>,
    pub text: String,
}

impl Crs {
    /// Returns the reference system of an archive. If the unit of the scan or of its system is not the metre, the system
    /// does not apply to metres: the function then warns and returns `None`.
    pub fn of(archive: &Archive, path: &Path) -> Result<Option<Self>, Failure> {
        let broken = |error| crate::broken(path, &error);
        let text = archive.crs().map_err(broken)?;
        if text.is_empty() {
            return Ok(None);
        }
        let units = archive.units().map_err(broken)?;
        // The unit of a scan may be another one than that of its system, by its own statement or by `--units`.
        if units.iter().any(|unit| *unit != LengthUnit::METRE) || !is_in_metres(&text) {
            let short: String = text.chars().take(60).collect();
            let name = one_line(&short);
            crate::say(&format!(
                "{}: the export is in metres and states no reference system: that of the scan ({name}) has another unit",
                path.display()
            ));
            return Ok(None);
        }
        Ok(Some(Self { epsg: projected_epsg(&text), text }))
    }

    /// A code, well-known text, or a name.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns the well-known text if the scan states its system in that form.
    pub fn wkt(&self) -> Option<&str> {
        Some(self.text.as_str()).filter(|text| text.contains('['))
    }

    /// Encodes the system as GeoTIFF keys, by code if it has one, otherwise by name.
    pub fn geo_keys(&self) -> GeoKeys {
        // A bar ends each text, so a text contains none, and only ASCII.
        let clean = |c: char| if c.is_ascii_graphic() && c != '|' || c == ' ' { c } else { '?' };
        let text: String = self.text.chars().take(2000).map(clean).chain(['|']).collect();
        let keys = [
            [MODEL_TYPE, 0, 1, PROJECTED],
            [RASTER_TYPE, 0, 1, PIXEL_IS_AREA],
            [PROJECTED_SYSTEM, 0, 1, self.epsg.unwrap_or(USER_DEFINED)],
            [PROJECTED_CITATION, GEO_TEXT, text.len() as u16, 0],
            [LINEAR_UNITS, 0, 1, METRE],
            [VERTICAL_UNITS, 0, 1, METRE],
        ];
        let head = [1, 1, 0, keys.len() as u16];
        GeoKeys { directory: head.into_iter().chain(keys.into_iter().flatten()).collect(), text }
    }
}

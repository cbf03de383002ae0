//! Reference system by GeoTIFF keys: GeoTIFF specification 1.0, section 2.7.

use super::{GEOCENTRIC, GROUND_AXES, Georeference, HEIGHTS, USER_DEFINED, clean_text};
use crate::epsg::{self, FOOT, Ground, US_SURVEY_FOOT};
use crate::header::{f64_at, u16_at};
use crate::records::{GEO_DOUBLES, GEO_TEXT, Records};

/// GeoTIFF model type of geocentric systems.
pub(super) const GEOCENTRIC_MODEL: u16 = 3;
impl Georeference {
    /// Reads the directory of keys `keys`, whose texts and numbers lie in other records.
    pub(super) fn from_keys(keys: &[u8], records: &Records) -> Self {
        let mut found = Self::default();
        let text = records.projection(GEO_TEXT).unwrap_or_default();
        let doubles = records.projection(GEO_DOUBLES).unwrap_or_default();
        let mut rows = keys.chunks_exact(8).map(|e| [u16_at(e, 0), u16_at(e, 2), u16_at(e, 4), u16_at(e, 6)]);
        let stated = rows.next().map_or(0, |head| usize::from(head[3]));
        let mut entries: Vec<[u16; 4]> = rows.collect();
        let held = entries.len();
        if stated > held || entries[stated..].iter().any(|entry| *entry != [0; 4]) {
            found.notes.push(format!("its GeoTIFF directory states {stated} keys and has room for {held}"));
        }
        entries.truncate(stated);
        let entry = |id: u16| entries.iter().find(|e| e[0] == id);
        let code = |id| entry(id).filter(|e| e[1] == 0).map(|e| e[3]);
        let double = |id| {
            let at = 8 * usize::from(entry(id).filter(|e| e[1] == GEO_DOUBLES)?[3]);
            (at + 8 <= doubles.len()).then(|| epsg::exact(f64_at(doubles, at)))
        };
        let citation = |id| {
            let e = entry(id).filter(|e| e[1] == GEO_TEXT)?;
            let from = usize::from(e[3]);
            clean_text(text.get(from..(from + usize::from(e[2])).min(text.len()))?)
        };
        let is_code = |code: &u16| *code != 0 && *code < USER_DEFINED;
        let ground = |code: u16| epsg::system(code.into()).map(|system| system.ground);
        let projected = code(3072).filter(is_code);
        let geographic = code(2048).filter(is_code);
        let model = code(1024).filter(is_code);
        // Some programs store the code of a geographic system in the key of a projected one.
        let misplaced = projected.filter(|&code| ground(code) == Some(Ground::Angles));
        found.degrees = model == Some(2)
            || misplaced.is_some()
            || model.is_none() && code(3072).is_none() && code(3076).is_none() && geographic.is_some();
        // A projection of the file's own has a geographic system as its base, which does not name it.
        let named = match found.degrees {
            true => misplaced.or(geographic).or(projected),
            false => projected.or(geographic.filter(|_| model == Some(GEOCENTRIC_MODEL))),
        };
        let named = named.map(u32::from);
        found.codes.extend(named);
        let cited = citation(3073).or_else(|| citation(1026));
        found.text = named.map(|n| format!("EPSG:{n}")).or_else(|| cited.clone());
        let mut stated = |id, size: Option<u16>, axes: &str| match code(id) {
            Some(USER_DEFINED) => {
                let length = size.and_then(double);
                if length.is_none() {
                    found
                        .notes
                        .push(format!("its GeoTIFF keys state a unit of their own for {axes}, but not its length"));
                }
                length
            }
            Some(0) | None => None,
            Some(unit) => {
                let length = epsg::unit(unit);
                if length.is_none() {
                    found.notes.push(format!("its GeoTIFF keys name {unit} as unit of length, which it is not"));
                }
                length
            }
        };
        let (horizontal, vertical) = (stated(3076, Some(3077), GROUND_AXES), stated(4099, None, HEIGHTS));
        if !found.degrees {
            found.horizontal = horizontal;
            if model == Some(GEOCENTRIC_MODEL) {
                found.note(GEOCENTRIC);
            }
        }
        found.vertical = vertical;
        // A vertical system is named by a code of its own, or by that of a geographic system with three axes.
        if let Some(code) = code(4096).filter(is_code)
            && let Some(epsg::System { ground: Ground::None | Ground::Angles, up: Some(up), .. }) =
                epsg::system(code.into())
        {
            found.codes.push(code.into());
            found.take_up(Some(up));
        }
        named.into_iter().for_each(|code| found.take_code(code));
        if let Some(code) = code(4096).filter(is_code)
            && (ground(code), found.vertical) == (None, None)
            && found.horizontal.is_some_and(|unit| unit != 1.0)
        {
            found.note(&format!("the unit of its vertical system {code} is unknown; that of x and y is taken"));
        }
        // Last resort: names such as "NAD83 / Texas Central (ftUS) + NAVD88 height (ftUS)".
        let (on_ground, above) =
            cited.as_deref().map(|text| text.split_once('+').unwrap_or((text, ""))).unwrap_or_default();
        if !found.degrees {
            found.horizontal = found.horizontal.or_else(|| unit_in_words(on_ground));
        }
        let of_heights = citation(4097);
        found.vertical = found.vertical.or_else(|| unit_in_words(of_heights.as_deref().unwrap_or(above)));
        found
    }
}

/// Finds a unit in a citation such as "NAD83 / Texas Central (ftUS)": the last resort. The "Feet" of a state plane of
/// ESRI (`..._FIPS_4203_Feet`) are those of the US survey, unless they are "Intl".
pub(super) fn unit_in_words(text: &str) -> Option<f64> {
    let text = text.to_ascii_lowercase();
    let words = text.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let words = format!(" {} ", words.collect::<Vec<_>>().join(" "));
    let any = |runs: &[&str]| runs.iter().any(|run| words.contains(run));
    let is_foot = text.contains("(ft)") || any(&[" foot ", " feet ", " ft intl ", " international ft "]);
    let of_survey = &[" ftus ", " usft ", " us ft ", " ft us ", " footus ", " foot us ", " us foot ", " us feet "];
    if any(of_survey) || any(&[" survey f"]) || is_foot && any(&[" fips "]) && !any(&[" intl ", " international "]) {
        Some(US_SURVEY_FOOT)
    } else {
        is_foot.then_some(FOOT)
    }
}

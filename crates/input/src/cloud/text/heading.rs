//! Interpretation of the column names in a header.
//!
//! A name is split into words; brackets hold a unit. It names an axis if one of its words does and the others are
//! neutral ([`NEUTRAL`]): `Z_ellipsoidal` and `Easting [m]` do, `z_std` and `elev angle deg` do not. x and y come from
//! one pair of names ([`PLANS`]), and z from the first of its names ([`HEIGHTS`]) that is present; a name of one word
//! takes precedence over one with more. Two columns of the same rank are refused, as is an elevation beside an azimuth,
//! because it may be an angle.

use super::super::shown;
use super::layout::{Places, RgbPlaces};
use crate::unit::{FOOT_M, US_SURVEY_FOOT_M};

/// Names of x and y by rank, best first.
const PLANS: [[&[&str]; 2]; 4] = [
    [&["x", "xcoord", "coordx", "xpos", "posx"], &["y", "ycoord", "coordy", "ypos", "posy"]],
    [&["easting", "east"], &["northing", "north"]],
    [&["rechtswert", "rechts", "ost", "este", "est"], &["hochwert", "hoch", "nord", "norte"]],
    [&["e"], &["n"]],
];
/// Names of z by rank, best first.
const HEIGHTS: [&[&str]; 6] = [
    &["z", "zcoord", "coordz", "zpos", "posz"],
    &["height"],
    &["elevation", "elev"],
    &["altitude", "alt"],
    &["höhe", "hoehe", "hohe", "hauteur", "altura", "cota", "quota", "kote"],
    &["h"],
];
/// Rank of an elevation in `HEIGHTS`.
const ELEVATION: usize = 2;
/// Names of angles that accompany an elevation angle.
const ANGLES: [&str; 5] = ["azimuth", "azi", "bearing", "zenith", "inclination"];
/// Words that do not change the meaning of an axis name; units are such words, too.
const NEUTRAL: [&str; 32] = [
    "coord",
    "coords",
    "coordinate",
    "coordinates",
    "co",
    "ord",
    "pos",
    "position",
    "point",
    "pt",
    "value",
    "val",
    "axis",
    "us",
    "local",
    "global",
    "world",
    "map",
    "grid",
    "utm",
    "ellipsoidal",
    "ellipsoid",
    "ell",
    "orthometric",
    "ortho",
    "geoid",
    "msl",
    "amsl",
    "asl",
    "nhn",
    "abs",
    "absolute",
];

/// Names of systems that may be followed by a number.
const SYSTEMS: [&str; 9] = ["utm", "etrs", "wgs", "lv", "epsg", "navd", "dhhn", "nad", "osgb"];

/// A unit stated by a name.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum NameUnit {
    Metres(f64),
    Angle,
    /// A unit in brackets that is not known here.
    Unknown,
}

/// Reason why names give no axes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum NoAxes {
    /// An axis has no name.
    Missing,
    /// An axis could be more than one column.
    Unclear(String),
}

/// A name split into lower-case words, and the lower-case text in its brackets.
struct Name {
    words: Vec<String>,
    bracket: Option<Bracket>,
}

struct Bracket {
    text: String,
    /// True for `[]` and `{}`, which rarely hold anything but units.
    is_square: bool,
}

/// Returns the metres of a unit of length by its name, without blanks and marks.
fn length(word: &str) -> Option<f64> {
    Some(match word {
        "m" | "meter" | "meters" | "metre" | "metres" => 1.0,
        "km" | "kilometer" | "kilometers" | "kilometre" | "kilometres" => 1000.0,
        "dm" | "decimeter" | "decimeters" | "decimetre" | "decimetres" => 0.1,
        "cm" | "centimeter" | "centimeters" | "centimetre" | "centimetres" => 0.01,
        "mm" | "millimeter" | "millimeters" | "millimetre" | "millimetres" => 0.001,
        "um" | "µm" | "μm" | "micrometer" | "micrometers" | "micrometre" | "micrometres" | "micron" | "microns" => {
            1e-6
        }
        "in" | "inch" | "inches" => FOOT_M / 12.0,
        "ft" | "feet" | "foot" | "intft" | "ftint" | "ifeet" | "ift" | "internationalft" | "internationalfeet"
        | "internationalfoot" | "intfeet" | "intfoot" => FOOT_M,
        "yd" | "yard" | "yards" => 3.0 * FOOT_M,
        "usft" | "ftus" | "usfeet" | "usfoot" | "ussurveyft" | "ussurveyfeet" | "ussurveyfoot" | "sft" | "surveyft"
        | "surveyfeet" | "surveyfoot" => US_SURVEY_FOOT_M,
        _ => return None,
    })
}

impl Bracket {
    fn unit(&self) -> Option<NameUnit> {
        let whole: String = self.text.chars().filter(|c| c.is_alphanumeric() || *c == '°').collect();
        let mut words = self.text.split(|c: char| !c.is_alphabetic()).filter(|word| !word.is_empty());
        match &whole[..] {
            "" => None,
            "deg" | "degree" | "degrees" | "°" | "rad" | "radian" | "radians" | "gon" | "grad" => {
                Some(NameUnit::Angle)
            }
            _ if let Some(metres) = length(&whole) => Some(NameUnit::Metres(metres)),
            _ if is_neutral_word(&whole) => None,
            // A number of metres, or a kind of feet.
            _ if self.is_square || words.any(|word| length(word).is_some()) => Some(NameUnit::Unknown),
            _ => None,
        }
    }
}

impl Name {
    fn of(text: &str) -> Self {
        let (mut words, mut word, mut depth) = (Vec::new(), String::new(), 0);
        let (mut bracket, mut is_square) = (String::new(), false);
        let mut before = ' ';
        let text: Vec<char> = text.chars().collect();
        for (at, &c) in text.iter().enumerate() {
            let next_is_lower = text.get(at + 1).is_some_and(|next| next.is_lowercase());
            match c {
                '(' | '[' | '{' => {
                    depth += 1;
                    is_square |= c != '(';
                }
                ')' | ']' | '}' => depth -= 1,
                c if depth > 0 => bracket.extend(c.to_lowercase()),
                c if c.is_alphanumeric() => {
                    // Splits PointX and XCoord, but keeps POINT whole.
                    let begins = c.is_uppercase() && (before.is_lowercase() || before.is_uppercase() && next_is_lower);
                    if begins && !word.is_empty() {
                        words.push(std::mem::take(&mut word));
                    }
                    word.extend(c.to_lowercase());
                }
                _ => {}
            }
            if !c.is_alphanumeric() && !word.is_empty() {
                words.push(std::mem::take(&mut word));
            }
            before = c;
        }
        words.extend(Some(word).filter(|word| !word.is_empty()));
        let bracket = Some(Bracket { text: bracket, is_square }).filter(|bracket| !bracket.text.is_empty());
        Self { words, bracket }
    }

    /// Returns whether the name has further words, or `None` if it is not in `wanted`.
    fn is_one_of(&self, wanted: &[&str]) -> Option<bool> {
        let is_wanted = |word: &&String| wanted.contains(&word.as_str());
        let others = |word: &&String| !is_neutral_word(word);
        let named = self.words.iter().filter(is_wanted).count() == 1;
        let plain = self.words.iter().filter(|word| !is_wanted(word)).filter(others).count() == 0;
        (named && plain && self.unit() != Some(NameUnit::Angle)).then_some(self.words.len() > 1)
    }

    fn unit(&self) -> Option<NameUnit> {
        match &self.bracket {
            Some(bracket) => bracket.unit(),
            None => {
                let [_, others @ ..] = &self.words[..] else { return None };
                // `ftUS` and `us_ft` are two words.
                let two = others.len().checked_sub(2).and_then(|at| length(&others[at..].concat()));
                two.or_else(|| length(others.last()?)).map(NameUnit::Metres)
            }
        }
    }
}

/// Returns the unit stated by a name.
pub(super) fn unit_of(name: &str) -> Option<NameUnit> {
    Name::of(name).unit()
}

/// Returns whether a word only qualifies another one, as `coordinate` and `[m]` do.
pub(super) fn is_neutral(word: &str) -> bool {
    let name = Name::of(word);
    name.words.iter().all(|word| is_neutral_word(word))
}

/// Returns whether a word says nothing about the content of a column; systems may have numbers, as in `utm32`.
fn is_neutral_word(word: &str) -> bool {
    let system = word.trim_end_matches(|c: char| c.is_ascii_digit());
    NEUTRAL.contains(&word) || length(word).is_some() || system.len() < word.len() && SYSTEMS.contains(&system)
}

/// Returns the column with one of the names `wanted`, or `None`; fails if two columns qualify equally.
fn column(names: &[(String, Name)], wanted: &[&str], axis: &str) -> Result<Option<usize>, NoAxes> {
    for with_others in [false, true] {
        let found = |(_, (_, name)): &(usize, &(String, Name))| name.is_one_of(wanted) == Some(with_others);
        let mut found = names.iter().enumerate().filter(found);
        match (found.next(), found.next()) {
            (Some((a, first)), Some((b, second))) => {
                let text = |name: &str, column: usize| format!("{} (column {})", shown(name.as_bytes()), column + 1);
                let both = format!("{} and {}", text(&first.0, a), text(&second.0, b));
                return Err(NoAxes::Unclear(format!("two columns may be {axis}: {both}")));
            }
            (Some((place, _)), None) => return Ok(Some(place)),
            _ => {}
        }
    }
    Ok(None)
}

/// Returns the columns of x, y and z by their names.
pub(super) fn axes(names: &[String]) -> Result<[usize; 3], NoAxes> {
    let names: Vec<(String, Name)> = names.iter().map(|name| (name.clone(), Name::of(name))).collect();
    let has = |wanted: &[&str]| names.iter().any(|(_, name)| name.is_one_of(wanted).is_some());
    let [x, y] = PLANS.into_iter().find(|plan| plan.iter().all(|wanted| has(wanted))).ok_or(NoAxes::Missing)?;
    let rank = HEIGHTS.iter().position(|wanted| has(wanted)).ok_or(NoAxes::Missing)?;
    let column = |wanted, axis| column(&names, wanted, axis)?.ok_or(NoAxes::Missing);
    let found = [column(x, "x")?, column(y, "y")?, column(HEIGHTS[rank], "z")?];
    let is_angle = |name: &Name| name.words.iter().any(|word| ANGLES.contains(&word.as_str()));
    if rank == ELEVATION
        && let Some((angle, _)) = names.iter().find(|(_, name)| is_angle(name))
    {
        let (elevation, angle) = (shown(names[found[2]].0.as_bytes()), shown(angle.as_bytes()));
        return Err(NoAxes::Unclear(format!("{elevation} stands beside {angle} and may be an angle")));
    }
    Ok(found)
}

/// Returns the places of all known columns by their names, given those of the axes.
pub(super) fn places(names: &[String], axes: [usize; 3]) -> Places {
    let find = |wanted: &[&str]| {
        let is_wanted = |name: &String| {
            let plain = name.split(['(', '[']).next().unwrap_or_default().trim().to_lowercase();
            wanted.contains(&plain.as_str())
        };
        names.iter().position(is_wanted).filter(|place| !axes.contains(place))
    };
    let rgb = [&["r", "red", "rf"][..], &["g", "green", "gf"], &["b", "blue", "bf"]].map(find);
    let rgb = match rgb {
        [Some(r), Some(g), Some(b)] => Some(RgbPlaces::Each([r, g, b])),
        _ => None,
    };
    let intensity = find(&["intensity", "i", "scalar_intensity", "reflectance", "scalar_reflectance"]);
    Places { axes, class: find(&["classification", "class", "scalar_classification"]), rgb, intensity }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(names: &str) -> Result<[usize; 3], NoAxes> {
        axes(&names.split(',').map(str::to_owned).collect::<Vec<_>>())
    }

    #[test]
    fn axes_are_found_by_the_rank_of_names() {
        for (names, found) in [
            ("x,y,z", [0, 1, 2]),
            ("R,G,B,Z,X,Y", [4, 5, 3]),
            ("ring,azimuth,elevation,distance,x,y,z", [4, 5, 6]),
            ("elevation_angle,height,z,y,x", [4, 3, 2]),
            ("x,y,elev angle deg,height", [0, 1, 3]),
            ("x,y,elevation [deg],height", [0, 1, 3]),
            ("elevation,height,north,east", [3, 2, 1]),
            ("x,y,easting,northing,elevation", [0, 1, 4]),
            ("x,easting,northing,z", [1, 2, 3]),
            ("X [m],Y [m],Z [m]", [0, 1, 2]),
            ("Easting(m),Northing(m),Height(m)", [0, 1, 2]),
            ("X,Y,Z_ellipsoidal", [0, 1, 2]),
            ("X,Y,Z_ellipsoidal,Z", [0, 1, 3]),
            ("POINT_X,POINT_Y,POINT_Z", [0, 1, 2]),
            ("PointX,PointY,PointZ,NormalX,NormalY,NormalZ", [0, 1, 2]),
            ("nx,ny,nz,xCoord,yCoord,zCoord", [3, 4, 5]),
            ("X coordinate,Y coordinate,Z coordinate", [0, 1, 2]),
            ("Rechtswert,Hochwert,Höhe", [0, 1, 2]),
            ("P,N,E,Z,D", [2, 1, 3]),
            ("X,Y,Altitude (m)", [0, 1, 2]),
            ("X_UTM32,Y_UTM32,Z_DHHN2016", [0, 1, 2]),
            ("X,Y,Elevation,ScanAngleRank", [0, 1, 2]),
            ("x,y,z,z_std,dz,x_error", [0, 1, 2]),
            ("X_ftUS,Y_ftUS,Z_ftUS", [0, 1, 2]),
        ] {
            assert_eq!(of(names), Ok(found), "{names}");
        }
        for names in [
            "X,Y,X",
            "azimuth,elevation,range",
            "x,y,elevation_angle",
            "x,y,elev angle deg",
            "x,y,z_std",
            "x,northing,z",
            "lon,lat,height above ground",
            "Sensor X,Sensor Y,Sensor Z",
            "x,y,height above ground",
            "a,b,c",
            "",
        ] {
            assert_eq!(of(names), Err(NoAxes::Missing), "{names}");
        }
        for (names, words) in [
            ("X,Y,Z,X", "two columns may be x: \"X\" (column 1) and \"X\" (column 4)"),
            ("x,y,Z_ellipsoidal,Z_orthometric", "may be z"),
            ("x,y,azimuth,elevation", "may be an angle"),
            ("Local X,Local Y,Global X,Global Y,Z", "may be x"),
        ] {
            let Err(NoAxes::Unclear(reason)) = of(names) else { panic!("{names} is clear") };
            assert!(reason.contains(words), "{reason}");
        }
    }

    #[test]
    fn names_state_units() {
        for (name, unit) in [
            ("X (mm)", Some(NameUnit::Metres(0.001))),
            ("x_mm", Some(NameUnit::Metres(0.001))),
            ("Easting[m]", Some(NameUnit::Metres(1.0))),
            ("Y (US ft)", Some(NameUnit::Metres(US_SURVEY_FOOT_M))),
            ("Z [°]", Some(NameUnit::Angle)),
            ("Z (NAVD88)", None),
            ("Z [NAVD88]", None),
            ("Z [millimeters]", Some(NameUnit::Metres(0.001))),
            ("z_dm", Some(NameUnit::Metres(0.1))),
            ("X (km)", Some(NameUnit::Metres(1000.0))),
            ("x_cm", Some(NameUnit::Metres(0.01))),
            ("x [µm]", Some(NameUnit::Metres(1e-6))),
            ("z (inches)", Some(NameUnit::Metres(FOOT_M / 12.0))),
            ("y [yards]", Some(NameUnit::Metres(3.0 * FOOT_M))),
            ("z [-]", None),
            ("Elevation (international feet)", Some(NameUnit::Metres(FOOT_M))),
            ("Northing (survey ft)", Some(NameUnit::Metres(US_SURVEY_FOOT_M))),
            ("y (North)", None),
            ("z [10^-3 m]", Some(NameUnit::Unknown)),
            ("z (tenths of feet)", Some(NameUnit::Unknown)),
            ("z [fathoms]", Some(NameUnit::Unknown)),
            ("m", None),
            ("x_ft", Some(NameUnit::Metres(FOOT_M))),
            ("X_ftUS", Some(NameUnit::Metres(US_SURVEY_FOOT_M))),
            ("Easting_ftUS", Some(NameUnit::Metres(US_SURVEY_FOOT_M))),
            ("x_us_ft", Some(NameUnit::Metres(US_SURVEY_FOOT_M))),
            ("point_x_m", Some(NameUnit::Metres(1.0))),
        ] {
            assert_eq!(unit_of(name), unit, "{name}");
        }
        assert!(is_neutral("coordinate") && is_neutral("[m]") && !is_neutral("Intensity"));
    }
}

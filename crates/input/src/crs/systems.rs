//! Reference systems of a set of files: one that the archive names, and a warning if there are others.

use crate::{Monitor, ScanFile, Those};

/// Reference systems of a set of files, collected file by file. Texts may be long and many, so only two are held.
#[derive(Default)]
pub(crate) struct Systems {
    /// The system whose text sorts first.
    least: Option<Stated>,
    /// Short name of one of the others, and the files that state any of them.
    other: Option<(String, Those)>,
}

/// A system, and the files that state it: in the same words or by the same codes.
struct Stated {
    text: String,
    codes: Vec<u32>,
    files: Those,
}

impl Systems {
    /// Adds the text and the codes that file `file` states; files come in ascending order.
    pub(crate) fn add(&mut self, file: usize, text: Option<String>, codes: Vec<u32>) {
        let Some(text) = text else { return };
        let mut files = Those::default();
        files.add(file, true);
        let here = Stated { text, codes, files };
        match &mut self.least {
            None => self.least = Some(here),
            Some(least) if least.text == here.text || !here.codes.is_empty() && least.codes == here.codes => {
                least.files.add(file, true);
                least.text = std::mem::take(&mut least.text).min(here.text);
            }
            Some(least) => {
                let more = if here.text < least.text { std::mem::replace(least, here) } else { here };
                match &mut self.other {
                    Some((_, others)) => others.count += more.files.count,
                    none => *none = Some((short_name(&more.text), more.files)),
                }
            }
        }
    }

    /// Returns the text that sorts first; warns `monitor` if there are others.
    pub(crate) fn common(self, files: &[ScanFile], monitor: &dyn Monitor) -> Option<String> {
        let Stated { text, files: those, .. } = self.least?;
        if let Some((name, others)) = &self.other {
            let named = |those: &Those, name: &str| format!("{} ({name})", those.names(files).unwrap_or_default());
            let text = format!(
                "{} and {} state different reference systems: coordinates are taken as they are, and the archive names the \
                 former system; bring the scans into one system first",
                named(&those, &short_name(&text)),
                named(others, name)
            );
            monitor.warn(&text.into());
        }
        Some(text)
    }
}

/// Returns a short name for messages: the name in the text, or the code.
pub(super) fn short_name(text: &str) -> String {
    let name = text.split('"').nth(1).unwrap_or(text);
    name.chars().take(60).map(|c| if c.is_control() { ' ' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::crs::Georeference;

    #[test]
    fn one_system_in_two_forms_is_one() {
        let forms = ["EPSG:26910", r#"PROJCS["P",UNIT["metre",1],AUTHORITY["EPSG","26910"]]"#];
        let of = |texts: &[&str]| {
            let mut systems = Systems::default();
            for (file, text) in texts.iter().enumerate() {
                systems.add(file, Some((*text).into()), Georeference::of_text((*text).into()).codes);
            }
            let other = systems.other.map(|(name, files)| (name, files.count));
            (systems.least.map(|least| (least.text, least.files.count)), other)
        };
        let other = |name: &str, count| Some((name.to_owned(), count));
        for [a, b] in [[0, 1], [1, 0]] {
            assert_eq!(of(&[forms[a], forms[b]]), (Some((forms[0].into(), 2)), None));
        }
        assert_eq!(of(&[forms[1], "EPSG:26911"]), (Some(("EPSG:26911".into(), 1)), other("P", 1)));
        assert_eq!(of(&["a site", "another"]), (Some(("a site".into(), 1)), other("another", 1)));
        // Files of all other systems count, and a name is one line.
        let least = Some(("a site".into(), 2));
        assert_eq!(of(&["second\nsite", "a site", "third", "a site", "third"]), (least, other("second site", 3)));
    }
}

//! Named numbers that shape a scene: `--param key=value`.

use crate::{Error, Result};
use std::collections::BTreeMap;

/// Values given by the user; missing ones take the scene's default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Params(BTreeMap<String, f64>);

/// One parameter of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParamInfo {
    /// Name, as in `--param name=value`.
    pub name: &'static str,
    /// Default value.
    pub default: f64,
    /// Minimum.
    pub min: f64,
    /// Maximum.
    pub max: f64,
    /// Description, with unit.
    pub about: &'static str,
}

impl Params {
    /// No values, so that every parameter takes its default.
    pub fn new() -> Self {
        Self::default()
    }

    /// These values and `name` = `value`.
    pub fn with(mut self, name: &str, value: f64) -> Self {
        self.0.insert(name.to_owned(), value);
        self
    }

    /// Adds a `key=value` text.
    pub fn parse(&mut self, text: &str) -> Result<()> {
        let wrong = || Error::parameter("--param", format!("{text:?} is not key=number"));
        let (key, value) = text.split_once('=').ok_or_else(wrong)?;
        let value: f64 = value.trim().parse().map_err(|_| wrong())?;
        self.0.insert(key.trim().to_owned(), value);
        Ok(())
    }

    /// Returns the values of `known`, in that order; an unknown name or a value out of range is an error.
    pub(crate) fn resolve(&self, scene: &str, known: &[ParamInfo]) -> Result<Vec<f64>> {
        for name in self.0.keys() {
            if !known.iter().any(|p| p.name == name) {
                let names: Vec<_> = known.iter().map(|p| p.name).collect();
                let known = if names.is_empty() { "it has none".to_owned() } else { names.join(", ") };
                return Err(Error::parameter("--param", format!("scene {scene} has no parameter {name:?} ({known})")));
            }
        }
        known
            .iter()
            .map(|p| {
                let value = self.0.get(p.name).copied().unwrap_or(p.default);
                let fits = (p.min..=p.max).contains(&value);
                fits.then_some(value).ok_or_else(|| {
                    Error::parameter(p.name, format!("{value} lies outside {} to {}: {}", p.min, p.max, p.about))
                })
            })
            .collect()
    }
}

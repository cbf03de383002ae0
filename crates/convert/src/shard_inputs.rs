//! Choice of the inputs that a part of a plan opens: those that meet its columns. Names and lengths identify the
//! others, so a part of a plan of 100,000 tiles opens only some tens of them.
//!
//! The plan states what the headers of all inputs say together: reference system and units. Every opened input is
//! checked by its fingerprint; if another input was exchanged, the parts that read it notice. An input whose name and
//! length match no file of the plan, or several, is opened.

use super::facts::name_of;
use super::options::ConvertOptions;
use super::plan_file::Stated;
use super::shard_filter::{meets, reach};
use super::splats::Divided;
use crate::archive::Shard;
use crate::bytes::{address, len_at};
use crate::input::InputSet;
use crate::{Error, Monitor, Result};
use std::path::PathBuf;

/// The inputs of a part.
#[derive(Debug)]
pub(crate) struct Chosen {
    pub shard: Shard,
    /// Inputs to open, in order of their paths.
    pub opened: Vec<PathBuf>,
    /// Files of splats among the inputs; every part reads them.
    pub splats: Vec<PathBuf>,
    /// All other inputs.
    pub closed: Vec<PathBuf>,
    /// True for each file of the plan, by its number, that is not opened.
    pub is_closed: Vec<bool>,
    pub stated: Stated,
}

impl Chosen {
    /// Chooses the inputs of a part. Returns `None` if all inputs are to be opened: without a plan, with colours (the meaning of values may depend on all files), where
    /// stations see through all files, and where incomplete input is allowed.
    ///
    /// Cost: the names and lengths of all inputs. Memory: the list of paths and 10 bytes per file of the plan.
    pub fn of(options: &ConvertOptions, monitor: &dyn Monitor) -> Result<Option<Self>> {
        let (Some(wanted), Some(file)) = (options.shard, &options.plan_file) else { return Ok(None) };
        if file.colour.is_some()
            || file.plan.options.remove_moving
            || options.sections.free_space
            || options.allow_incomplete
        {
            return Ok(None);
        }
        let shard = file.shard(wanted.index, wanted.count)?;
        let mut order: Vec<u32> = (0..file.inputs.len() as u32).collect();
        let key = |&number: &u32| {
            let input = &file.inputs[number as usize];
            (&input.name[..], input.bytes)
        };
        order.sort_unstable_by(|a, b| key(a).cmp(&key(b)));
        let find = |path: &PathBuf| {
            let name = name_of(path);
            // Asking a store for the length takes a request and shows no more than opening the file does later.
            let bytes = match address(path) {
                Some(_) => (0, u64::MAX),
                None => len_at(path).ok().map(|len| (len, len))?,
            };
            let first = order.partition_point(|number| key(number) < (&name, bytes.0));
            let end = order.partition_point(|number| key(number) <= (&name, bytes.1));
            (end - first == 1).then(|| order[first])
        };
        let Divided { splats, others: paths } = Divided::of(&options.inputs, monitor)?;
        let numbers: Vec<Option<u32>> = paths.iter().map(find).collect();
        let mut claims = vec![0u8; file.inputs.len()];
        for &number in numbers.iter().flatten() {
            claims[number as usize] = claims[number as usize].saturating_add(1);
        }
        let reach = reach(&file.plan, !splats.is_empty());
        let is_closed: Vec<bool> = file
            .inputs
            .iter()
            .zip(claims)
            .map(|(input, claims)| claims == 1 && !meets(&file.plan.frame, reach, input, shard.first, shard.last))
            .collect();
        let (mut opened, mut closed) = (Vec::new(), Vec::new());
        for (path, number) in paths.into_iter().zip(numbers) {
            match number {
                Some(number) if is_closed[number as usize] => closed.push(path),
                _ => opened.push(path),
            }
        }
        Ok(Some(Self { shard, opened, splats, closed, is_closed, stated: file.stated.clone() }))
    }

    /// Refuses the plan if the opened inputs contradict what it states of all inputs, as after an edit by hand.
    pub fn check_stated(&self, set: &InputSet) -> Result<()> {
        let Stated { crs, units } = &self.stated;
        let refused = |what: &str| {
            let reason = format!("the inputs have another {what} than it states; write it again");
            Err(Error::parameter("plan", reason))
        };
        if set.crs().is_some_and(|here| crs.as_deref().is_none_or(|all| all > here)) {
            return refused("reference system");
        }
        if set.length_units().any(|unit| !units.contains(&unit)) {
            return refused("unit of length");
        }
        Ok(())
    }
}

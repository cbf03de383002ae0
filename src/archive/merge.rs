//! Merge of the parts of a conversion (appendix C) into the bytes that a single run would have written.
//!
//! Parts are archives with a `SHRD` record. Their columns are adjacent, so their pages are copied in order; sharing,
//! directory and head are rebuilt because they span parts. Every copied page is decoded and checked. Memory: one writer
//! and one page.

use super::colour_section::{ColourReader, EncodedColours};
use super::copy::{Copier, beyond_this_version, has_seen};
use super::head::{Header, Voxels};
use super::metadata::{Metadata, Tag, Unknown, tag_name};
use super::page_coding::{PageDecoder, PageEncoder};
use super::reader::Archive;
use super::seen::SeenReader;
use super::shard::{InputRead, Shard};
use super::solid_bounds::{Matter, joined};
use super::writer::{ArchiveWriter, Totals};
use crate::bytes::open_named;
use crate::output::Existing;
use crate::plan::{Noise, Plan};
use crate::text::ranges;
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Parameter, Result};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// Most ranges of missing parts in a message.
const MOST_RANGES: usize = 8;

/// Result of a merge.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Merged {
    /// Header of the merged archive.
    pub header: Header,
    /// Coordinate reference system, empty if unknown.
    pub crs: String,
    /// Units of the inputs.
    pub units: Vec<LengthUnit>,
    /// True if the archive was written; false if the target already had its bytes.
    pub written: bool,
    /// Parts that were left out because they are copies of others.
    pub copies: Vec<PathBuf>,
    /// Records of the parts that the merged archive does not keep, as text.
    pub dropped: Vec<String>,
}

/// One part. Its file is closed while others are processed, since parts may exceed the limit on open files.
struct OpenShard<'a> {
    path: &'a Path,
    header: Header,
    shard: Shard,
    crs: String,
    units: Vec<LengthUnit>,
    read: Vec<InputRead>,
    noise: Option<Noise>,
    unknown: Unknown,
}

impl<'a> OpenShard<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let open = || {
            let archive = Archive::open(path)?;
            let metadata = archive.metadata()?;
            Ok((archive, metadata))
        };
        let (archive, metadata) = open().map_err(|error| named(path, error))?;
        let Some(shard) = metadata.shard else {
            let reason = "it is a whole archive and no part of one: it has no SHRD record; convert it as one shard";
            return Err(Error::input(path, "metadata", reason));
        };
        let Metadata { crs, units, read, noise, unknown, .. } = metadata;
        Ok(Self { path, header: archive.header().clone(), shard, crs, units, read, noise, unknown })
    }

    /// Opens the archive again; fails if its header changed in between.
    fn reopen(&self) -> Result<Archive> {
        let archive = Archive::open(self.path).map_err(|error| named(self.path, error))?;
        match *archive.header() == self.header {
            true => Ok(archive),
            false => self.refuse("it was replaced while it was read; merge again".into()),
        }
    }

    /// Returns what all parts must have in common: plan, plan file, number of parts.
    fn family(&self) -> (u128, u128, u32) {
        (self.header.plan_hash, self.shard.plan_file, self.shard.count)
    }

    /// Says what of the heads keeps this part from being merged with `other`, and what to do.
    fn difference(&self, other: &Self) -> Option<String> {
        let name = other.path.display();
        let colours = |part: &Self| part.header.colours.map(|colours| colours.plan);
        Some(if self.header.levels.is_some() != other.header.levels.is_some() {
            format!("only one of it and {name} has overview levels; convert both with the same --levels")
        } else if has_seen(&self.header) != has_seen(&other.header) {
            format!("only one of it and {name} has seen space; convert both with --free-space, or none")
        } else if colours(self) != colours(other) {
            format!("its colours were not made as those of {name}; convert both by one plan, with the same --colour")
        } else if self.crs != other.crs {
            format!("its reference system is not that of {name}")
        } else if self.units != other.units {
            format!("the units of its inputs are not those of {name}")
        } else {
            return None;
        })
    }

    fn refuse<T>(&self, reason: String) -> Result<T> {
        Err(Error::input(self.path, format!("{}", self.shard), reason))
    }
}

/// Adds the path to an error about the content of a part.
fn named(path: &Path, error: Error) -> Error {
    super::copy::named(path, error, "convert this part again")
}

/// Merges the archives `shards`, in any order, into `output`: byte for byte what one run over the whole input writes.
///
/// Needs all parts of one plan file. Errors name parts that are missing, foreign or damaged. Leaves `output` alone if
/// it already has the right bytes; replaces another archive only with `overwrite`, and never one of the parts.
///
/// Cost: reads and decodes every page once. `output` appears only when it is complete.
pub fn merge(shards: &[PathBuf], output: &Path, overwrite: bool, monitor: &dyn Monitor) -> Result<Merged> {
    join(shards, None, output, overwrite, monitor)
}

/// Merges neighbouring parts into part `part.0` of `part.1` of a coarser division, to be merged with its other parts.
///
/// Thousands of parts can be merged as a tree, each node on its own machine, and the final archive still has the bytes
/// of a single run. Otherwise like [`merge`].
///
/// The first part of the coarser division must begin with the first part, and its last must end with the last one.
/// Parts of a division that are not adjacent are refused by the merge that joins them.
pub fn merge_run(
    shards: &[PathBuf],
    part: (u32, u32),
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Merged> {
    join(shards, Some(part), output, overwrite, monitor)
}

fn join(
    shards: &[PathBuf],
    of: Option<(u32, u32)>,
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Merged> {
    let parts = shards.iter().map(|path| OpenShard::open(path)).collect::<Result<Vec<_>>>()?;
    let (parts, copies) = in_order(parts, of.is_none())?;
    let (Some(first), Some(last)) = (parts.first(), parts.last()) else {
        return Err(Error::parameter(Parameter::Shard, "no part was given; name the archives of all parts"));
    };
    let coarser = of.map(|of| coarser(of, first, last)).transpose()?;
    monitor.stage("merge", parts.iter().map(|part| part.header.pages.total()).sum(), "pages");
    let existing = if overwrite { Existing::Replace } else { Existing::KeepSame };
    let plan = first.header.plan.clone();
    let mut writer = ArchiveWriter::begin(output, &plan, existing, shards.iter().collect())?;
    if first.header.levels.is_some() {
        writer.set_levels();
    }
    if let Some(colours) = first.header.colours {
        writer.set_colours(colours.plan);
    }
    let seen = has_seen(&first.header);
    if seen {
        writer.set_seen();
    }
    // Parts of one plan file agree, unless one was modified.
    let noise = first.noise.filter(|_| parts.iter().all(|part| part.noise == first.noise));
    let mut totals = Totals { crs: first.crs.clone(), units: first.units.clone(), noise, ..Totals::default() };
    for part in &parts {
        copy(part, &plan, &mut writer, monitor)?;
        add(&mut totals, part)?;
    }
    // Seen space follows all pages.
    for part in parts.iter().filter(|_| seen) {
        copy_seen(part, &mut writer)?;
    }
    let (unknown, dropped) = common_records(&parts);
    writer.set_unknown(unknown);
    if let Some(shard) = coarser {
        writer.set_shard(shard);
        writer.set_read(all_read(parts.iter().flat_map(|part| &part.read))?);
    }
    if monitor.cancelled_at_last() {
        return Err(Error::Interrupted);
    }
    let (header, written) = writer.finish_or_keep(totals)?;
    let (crs, units) = (first.crs.clone(), first.units.clone());
    Ok(Merged { header, crs, units, written, copies, dropped })
}

/// Returns the part of a coarser division that reaches from `first` to `last`.
fn coarser((index, count): (u32, u32), first: &OpenShard<'_>, last: &OpenShard<'_>) -> Result<Shard> {
    let shard = Shard { index, count, last: last.shard.last, ..first.shard };
    if shard.is_sound() {
        return Ok(shard);
    }
    let reason = format!(
        "{index}/{count} cannot be {} to {} of {}: the first part of a cut begins with part 1, its last part ends with part {}",
        first.shard.index, last.shard.index, first.shard.count, first.shard.count
    );
    Err(Error::parameter(Parameter::Shard, reason))
}

/// Joins the lists of inputs that several parts read; fails if there are more than one archive may list.
fn all_read<'a>(reads: impl Iterator<Item = &'a InputRead>) -> Result<Vec<InputRead>> {
    let all: BTreeMap<u32, &InputRead> = reads.map(|read| (read.input, read)).collect();
    if all.len() > InputRead::MOST {
        let what = "inputs that several of the joined parts read (join fewer parts at once)";
        return Err(Error::limit(what, all.len(), InputRead::MOST));
    }
    Ok(all.into_values().cloned().collect())
}

/// Returns metadata of unknown tags that all parts agree on, and describes the rest.
fn common_records(parts: &[OpenShard<'_>]) -> (Unknown, Vec<String>) {
    let all: BTreeMap<&Tag, &Vec<u8>> =
        parts.iter().flat_map(|part| &part.unknown).map(|(tag, content)| (tag, content)).collect();
    let (mut common, mut dropped) = (Unknown::new(), Vec::new());
    for (tag, content) in all {
        if parts.iter().all(|part| part.unknown.iter().any(|(other, same)| (other, same) == (tag, content))) {
            common.push((*tag, content.clone()));
        } else {
            dropped.push(format!("metadata {}, which is not the same in all parts", tag_name(tag)));
        }
    }
    dropped.extend(parts.iter().find_map(|part| beyond_this_version(&part.header)));
    (common, dropped)
}

/// Sorts the parts and sets aside copies. Fails unless they form one whole, or one run of neighbours.
fn in_order(parts: Vec<OpenShard<'_>>, whole: bool) -> Result<(Vec<OpenShard<'_>>, Vec<PathBuf>)> {
    let mut families: BTreeMap<_, usize> = BTreeMap::new();
    parts.iter().for_each(|part| *families.entry(part.family()).or_default() += 1);
    // With several families, report a part outside the largest one.
    let common = families.into_iter().max_by_key(|&(_, members)| members).map(|(family, _)| family);
    let Some(common) = common else { return Ok((parts, Vec::new())) };
    if let Some(foreign) = parts.iter().find(|part| part.family() != common) {
        let (plan, plan_file, _) = foreign.family();
        let relative = parts.iter().find(|part| part.family() == common);
        let what = match (plan == common.0, plan_file == common.1) {
            (false, _) => format!("its plan {plan:032x} is not that of the other parts, {:032x}", common.0),
            (_, false) => match relative.and_then(|relative| foreign.difference(relative)) {
                Some(difference) => return foreign.refuse(difference),
                None => "it was converted from other inputs than the other parts".to_owned(),
            },
            _ => format!("the other parts are of {}", common.2),
        };
        return foreign.refuse(format!("{what}; leave it out, or convert it again with their plan"));
    }
    let mut ordered: BTreeMap<u32, OpenShard<'_>> = BTreeMap::new();
    let mut copies = Vec::new();
    for part in parts {
        match ordered.get(&part.shard.index) {
            Some(same) if same_bytes(same, &part)? => copies.push(part.path.to_path_buf()),
            Some(other) => {
                let reason = format!("{} says the same of itself and holds something else", other.path.display());
                return part.refuse(format!("{reason}; leave one of them out"));
            }
            None => {
                ordered.insert(part.shard.index, part);
            }
        }
    }
    let ends = (ordered.keys().next().copied(), ordered.keys().next_back().copied());
    let (low, high) = match ends {
        (Some(low), Some(high)) if !whole => (low, high),
        _ => (1, common.2),
    };
    let missing = (low..=high).filter(|index| !ordered.contains_key(index));
    let missing = ranges(missing, MOST_RANGES);
    if !missing.is_empty() {
        let count = common.2;
        let reason = format!("missing of {count}: {missing}; convert these too");
        return Err(Error::parameter("parts", reason));
    }
    let ordered: Vec<_> = ordered.into_values().collect();
    for pair in ordered.windows(2) {
        if pair[0].shard.last.checked_add(1) != Some(pair[1].shard.first) {
            return pair[1].refuse(format!("its columns do not follow those of {}", pair[0].path.display()));
        }
        if let Some(difference) = pair[1].difference(&pair[0]) {
            return pair[1].refuse(difference);
        }
    }
    same_inputs(&ordered)?;
    Ok((ordered, copies))
}

/// Fails if two parts read different content of the same input.
fn same_inputs(parts: &[OpenShard<'_>]) -> Result<()> {
    let mut first: HashMap<u32, (&OpenShard<'_>, u128)> = HashMap::new();
    for part in parts {
        for read in &part.read {
            let (other, hash) = *first.entry(read.input).or_insert((part, read.hash));
            if hash != read.hash {
                let name = match &read.name[..] {
                    "" => format!("input {} of the plan", read.input),
                    name => name.to_owned(),
                };
                let reason = format!(
                    "it changed between two parts: {} ({}) and {} ({}) read different content; convert all parts again \
                     that read it",
                    other.shard,
                    other.path.display(),
                    part.shard,
                    part.path.display()
                );
                return Err(Error::input(name, "content", reason));
            }
        }
    }
    Ok(())
}

fn same_bytes(a: &OpenShard<'_>, b: &OpenShard<'_>) -> Result<bool> {
    let (a, b) = (open_named(a.path)?, open_named(b.path)?);
    if a.len() != b.len() {
        return Ok(false);
    }
    const CHUNK: u64 = 1 << 20;
    let (mut from_a, mut from_b) = (Vec::new(), Vec::new());
    for at in (0..a.len()).step_by(CHUNK as usize) {
        let len = (a.len() - at).min(CHUNK) as usize;
        for (source, bytes) in [(&a, &mut from_a), (&b, &mut from_b)] {
            bytes.resize(len, 0);
            source.read_at(at, bytes)?;
        }
        if from_a != from_b {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Copies all pages of `part` into `writer`, whose plan is `plan`, and checks the part's totals.
fn copy(part: &OpenShard<'_>, plan: &Plan, writer: &mut ArchiveWriter, monitor: &dyn Monitor) -> Result<()> {
    let archive = part.reopen()?;
    let encoder = PageEncoder::of_plan(plan).for_levels(writer.has_levels());
    let (mut decoder, mut copier) = (PageDecoder::new(), Copier::new());
    let mut colours = ColourReader::new(&archive).map_err(|error| named(part.path, error))?;
    let (mut coloured, mut pixels) = (0, PageDecoder::new());
    let (mut tiles, mut voxels, mut pages, mut matter) = (0, Voxels::default(), 0, Matter::default());
    for entry in archive.entries() {
        if monitor.cancelled() {
            return Err(Error::Interrupted);
        }
        let entry = entry.map_err(|error| named(part.path, error))?;
        if !part.shard.columns().contains(&entry.key.column()) {
            return part.refuse(format!("page {} lies outside its columns (rule T5); convert it again", entry.key));
        }
        let own = match &mut colours {
            Some(colours) => {
                let page = archive.page_with(&entry, &mut pixels).map_err(|error| named(part.path, error))?;
                colours.copied(entry.key, &page).map_err(|error| named(part.path, error))?
            }
            None => EncodedColours::default(),
        };
        coloured += own.voxels;
        let placed = copier.put(writer, entry.key, entry.content(), own, || {
            let page = archive.page_with(&entry, &mut decoder).map_err(|error| named(part.path, error))?;
            Ok(Some(encoder.copied(entry.key, &decoder.bytes, &page, decoder.inferred())))
        })?;
        if let Some(placed) = placed {
            tiles += u64::from(placed.slices.count_ones());
            voxels.occupied += placed.voxels.0;
            voxels.obstacle += placed.voxels.1;
            voxels.inferred += placed.inferred;
            matter.add(entry.key, &placed.bounds);
        }
        pages += 1;
        monitor.advance(1);
    }
    let header = &part.header;
    if header.colours.is_some_and(|colours| colours.voxels != coloured) {
        return part.refuse("its voxels with colours are not as many as it says (rule K10); convert it again".into());
    }
    if (pages, tiles, voxels) != (header.pages.total(), header.tiles.occupied, header.voxels) {
        return part.refuse("its totals are not those of its pages (rules T1 to T3); convert it again".into());
    }
    if let Err(broken) = matter.check(&header.plan, true, header.bounds.as_ref()) {
        let (expected, found) = (broken.expected, broken.found);
        return part.refuse(format!("rule T6: expected {expected}, found {found}; convert it again"));
    }
    Ok(())
}

/// Copies the seen space of `part` into `writer`. Every cell depends on its place alone, so those of all parts are
/// those of the whole.
fn copy_seen(part: &OpenShard<'_>, writer: &mut ArchiveWriter) -> Result<()> {
    let archive = part.reopen()?;
    let failed = |error| named(part.path, error);
    let Some(table) = archive.seen_table().map_err(failed)? else { return Ok(()) };
    let (mut reader, mut cells) = (SeenReader::new(&archive), 0);
    for entry in table.entries() {
        if !part.shard.columns().contains(&entry.key.column()) {
            return part.refuse(format!(
                "seen space of column {:016x} lies outside its columns (rule V5)",
                entry.key.column()
            ));
        }
        let block = reader.block(entry).map_err(failed)?;
        cells += block.cells();
        writer.put_seen(&block)?;
    }
    match cells == table.cells() {
        true => Ok(()),
        false => part.refuse("its seen cells are not as many as it says (rule V4); convert it again".into()),
    }
}

/// Adds the point counts of `part`; each input point counts in exactly one part.
fn add(totals: &mut Totals, part: &OpenShard<'_>) -> Result<()> {
    let header = &part.header;
    for (sum, more) in [
        (&mut totals.points_read, header.points_read),
        (&mut totals.points_kept, header.points_kept),
        (&mut totals.points_withheld, header.points_withheld),
        (&mut totals.points_excluded, header.points_excluded),
    ] {
        match sum.checked_add(more) {
            Some(new) => *sum = new,
            None => return part.refuse(format!("its {more} points make more than can be counted")),
        }
    }
    totals.bounds = joined(totals.bounds, header.bounds);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inputs_that_parts_share_count_once_up_to_the_most_that_an_archive_lists() {
        let most = InputRead::MOST as u32;
        let read = |input| InputRead { input, hash: 7, name: String::new() };
        let mut reads: Vec<_> = (0..most).map(read).collect();
        reads.extend((9..most).rev().map(read));
        let all = all_read(reads.iter()).unwrap();
        assert!(all.iter().map(|read| read.input).eq(0..most));
        reads.push(read(most));
        assert!(all_read(reads.iter()).unwrap_err().to_string().contains("join fewer parts at once"));
    }
}

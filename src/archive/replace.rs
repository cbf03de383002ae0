//! Replacement of a region by that of another archive: the rescan of a room in the scan of a building.
//!
//! Every voxel comes from one of two archives. A page that lies entirely on one side is copied; others are put together
//! pixel by pixel. Where voxels of both archives lie one above the other, at a *seam*, their spans join as a conversion
//! joins the spans of such voxels. Memory: one writer and a few pages.

use super::colour_section::{ColourReader, EncodedColours};
use super::copy::{self, Copier, beyond_this_version, has_seen};
use super::directory::{Content, PageEntry};
use super::head::{Bounds, Header};
use super::metadata::{Metadata, tag_name};
use super::page_coding::{PageDecoder, PageEncoder};
use super::reader::Archive;
use super::region::{PagePart, Region, Run, is_in, runs_of, spans_of};
use super::seen::{SeenReader, SeenTable};
use super::solid_bounds::joined;
use super::writer::{ArchiveWriter, Totals};
use crate::codec::{ColourBlock, ColourEncoder};
use crate::frame::{PAGE_SLICES, PageKey, SLICE_QUANTA};
use crate::output::{Existing, Protected};
use crate::page::{Inferred, Occupancy, Page, PageBuilder, joins};
use crate::plan::Plan;
use crate::seen::{SeenBlock, SeenPage};
use crate::text::number;
use crate::unit::LengthUnit;
use crate::{Error, Monitor, Result};
use std::iter::Peekable;
use std::path::Path;

/// Result of a replacement.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Replaced {
    /// Header of the new archive.
    pub header: Header,
    /// Coordinate reference system, empty if unknown.
    pub crs: String,
    /// Units of the inputs.
    pub units: Vec<LengthUnit>,
    /// True if the region is empty now, because the other archive holds nothing there.
    pub is_cleared: bool,
    /// Contents of both archives, besides what lies on the other side of the region, that the new one lacks, as text.
    pub dropped: Vec<String>,
}

/// Writes `archive` with the region `bounds` (m) of the archive `with` in place of its own as a new archive to `output`.
///
/// The region consists of the voxels that hold a place of the closed box `bounds`: whole pixels and slices. They come
/// from `with`, all others from `archive`. A span that crosses the top or bottom of the region is cut there and keeps
/// the whole slice at the cut. Spans of both archives that meet there join as in a conversion. So the bytes are those of
/// one conversion of the points that each archive contributes, if no span is cut, no class depends on points beyond the
/// faces of the region, and holes were not closed; except for the point counts, which are the sums of both archives,
/// replaced points included.
///
/// Overview levels are rebuilt if `archive` has them. The new archive has colours if `archive` has; those of `with` are
/// kept only if they were made alike. Seen cells inside the region are those of `with`, others those of `archive`;
/// cells on its border were seen if both say so. Metadata of unknown tags is dropped.
///
/// Both archives must have one plan (grid and options), and no different reference system or units. Errors name the
/// archive. Fails if `bounds` are inverted or NaN, if `output` exists and `overwrite` is false, if it is one of the
/// archives, or if `monitor` cancels. Cost: reads the directories, all pages of `archive` outside the region, and those
/// of `with` inside.
pub fn replace(
    archive: &Path,
    with: &Path,
    bounds: &Bounds,
    output: &Path,
    overwrite: bool,
    monitor: &dyn Monitor,
) -> Result<Replaced> {
    let sides = [Side::open(archive)?, Side::open(with)?];
    let [old, new] = &sides;
    new.agrees_with(old)?;
    let (plan, header) = (old.archive.plan().clone(), old.archive.header());
    let region = Region::of(&plan.frame, bounds)?;
    monitor.stage("replace", sides.iter().map(|side| side.archive.header().pages.total()).sum(), "pages");
    let mut writer =
        ArchiveWriter::begin(output, &plan, Existing::replaced_if(overwrite), Protected::from_iter([archive, with]))?;
    if header.levels.is_some() {
        writer.set_levels();
    }
    if let Some(colours) = header.colours {
        writer.set_colours(colours.plan);
    }
    if sides.iter().any(|side| has_seen(side.archive.header())) {
        writer.set_seen();
    }
    let is_cleared = Maker::new(&sides, &plan, header.levels.is_some())?.write(&region, &mut writer, monitor)?;
    replace_seen(&sides, &region, &mut writer)?;
    let inside = |bounds: &Bounds| region.bounds(&plan.frame, bounds);
    let bounds = joined(header.bounds, new.archive.header().bounds.as_ref().and_then(inside));
    let totals = Totals { bounds: writer.shrink(bounds), ..new.added_to(old)? };
    let (crs, units) = (totals.crs.clone(), totals.units.clone());
    let header = writer.finish(totals)?;
    Ok(Replaced { header, crs, units, is_cleared, dropped: dropped(old, new) })
}

/// One of the two archives.
struct Side<'a> {
    path: &'a Path,
    archive: Archive,
    metadata: Metadata,
}

/// Adds the path to an error about the content of an archive.
fn named(path: &Path, error: Error) -> Error {
    copy::named(path, error, "convert the scan again, or fetch the archive again")
}

impl<'a> Side<'a> {
    fn open(path: &'a Path) -> Result<Self> {
        let open = || {
            let archive = Archive::open(path)?;
            let metadata = archive.metadata()?;
            Ok((archive, metadata))
        };
        let (archive, metadata) = open().map_err(|error| named(path, error))?;
        Ok(Self { path, archive, metadata })
    }

    fn named<T>(&self, result: Result<T>) -> Result<T> {
        result.map_err(|error| named(self.path, error))
    }

    /// Fails unless this archive and `other` describe places and solid alike.
    fn agrees_with(&self, other: &Self) -> Result<()> {
        let refuse = |at: &str, reason: String| Err(Error::input(self.path, at, reason));
        let name = other.path.display();
        let (frame, expected) = (self.archive.frame(), other.archive.frame());
        if frame != expected {
            let grid = [frame, expected].map(|frame| (number(frame.pixel_m()), number(frame.slice_m())));
            let [(pixel, slice), (expected_pixel, expected_slice)] = grid;
            return refuse(
                "grid",
                format!(
                    "pixel {pixel} m and slice {slice} m, but {name} has pixel {expected_pixel} m and slice \
                     {expected_slice} m; convert it again with --pixel {expected_pixel} --slice {expected_slice}"
                ),
            );
        }
        let differing = differing(self.archive.plan(), other.archive.plan());
        if !differing.is_empty() {
            let differing = differing.join(", ");
            return refuse("options", format!("{differing} in {name}; convert it again with the options of {name}"));
        }
        let (own, expected) = (&self.metadata, &other.metadata);
        if own.crs != expected.crs && !own.crs.is_empty() && !expected.crs.is_empty() {
            return refuse(
                "reference system",
                format!("it is not that of {name}; transform the scan and convert it again"),
            );
        }
        if own.units != expected.units && !own.units.is_empty() && !expected.units.is_empty() {
            return refuse(
                "units of the inputs",
                format!("they are not those of {name}; check --units, and convert it again"),
            );
        }
        Ok(())
    }

    /// Returns the point counts of both archives together, and the metadata that they share.
    fn added_to(&self, other: &Self) -> Result<Totals> {
        let mut totals = Totals::of_points(other.archive.header());
        let more = Totals::of_points(self.archive.header());
        for (sum, more) in [
            (&mut totals.points_read, more.points_read),
            (&mut totals.points_kept, more.points_kept),
            (&mut totals.points_withheld, more.points_withheld),
            (&mut totals.points_excluded, more.points_excluded),
        ] {
            let added = sum.checked_add(more);
            *sum = added
                .ok_or_else(|| Error::input(self.path, "header", format!("its {more} points are too many to count")))?;
        }
        let (own, others) = (&self.metadata, &other.metadata);
        totals.crs.clone_from(if others.crs.is_empty() { &own.crs } else { &others.crs });
        totals.units.clone_from(if others.units.is_empty() { &own.units } else { &others.units });
        totals.noise = others.noise.filter(|_| own.noise == others.noise);
        Ok(totals)
    }
}

/// Describes the options in which two plans differ, by their names on the command line.
fn differing(own: &Plan, expected: &Plan) -> Vec<String> {
    let facts = |Plan { options, .. }: &Plan| {
        let on = |is_on: bool| if is_on { "on" } else { "off" }.to_owned();
        let classes: Vec<String> = options.exclude_classes.iter().map(|class| class.to_string()).collect();
        [
            ("--max-slope", number(options.max_slope_deg)),
            ("--tolerance", number(options.tolerance_m)),
            ("--classifier", options.classifier.name().to_owned()),
            ("--min-points", options.min_points.to_string()),
            ("--drop-floaters", options.drop_floaters.to_string()),
            ("--remove-moving", on(options.remove_moving)),
            ("--fill-holes", format!("of {} pixels", options.fill_holes)),
            ("--up", options.up.name().to_owned()),
            ("--exclude-class", if classes.is_empty() { "none".into() } else { classes.join(",") }),
        ]
    };
    let pairs = facts(own).into_iter().zip(facts(expected));
    let different = pairs.filter(|((_, own), (_, expected))| own != expected);
    different.map(|((option, own), (_, expected))| format!("{option} is {own} and not {expected} as")).collect()
}

/// Describes what the archive of both lacks.
fn dropped(old: &Side<'_>, new: &Side<'_>) -> Vec<String> {
    let mut dropped = Vec::new();
    for side in [old, new] {
        let name = side.path.display();
        let unknown = side.metadata.unknown.iter();
        dropped.extend(unknown.map(|(tag, _)| format!("metadata {} of {name}", tag_name(tag))));
        dropped.extend(beyond_this_version(side.archive.header()).map(|what| format!("{what}, of {name}")));
    }
    dropped.extend(old.metadata.shard.map(|shard| format!("that it is {shard}")));
    if old.metadata.noise != new.metadata.noise {
        dropped.push("noise of the scan, which is not the same in both".into());
    }
    let [colours, others] = [old, new].map(|side| side.archive.header().colours.map(|colours| colours.plan));
    if others.is_some() && others != colours {
        let why = if colours.is_some() { "were made otherwise than those of" } else { "have no place in" };
        let [old, new] = [old.path.display(), new.path.display()];
        dropped.push(format!("colours of {new}, which {why} {old}"));
    }
    dropped
}

/// Where the region lies in a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Place {
    /// First and last pixel.
    px: (u32, u32),
    py: (u32, u32),
    /// First and last slice, −2 to 64. Beyond the slices next to the page, it does not matter where the region begins and
    /// ends.
    slices: (i64, i64),
}

impl Place {
    /// Returns where `region` lies in page `key`; `None` if neither the region nor one of its seams meets the page.
    fn of(region: &Region, key: PageKey) -> Option<Self> {
        let (px, py) = region.pixels_of(key)?;
        let floor = i64::from(key.layer) * PAGE_SLICES;
        let slices = ((region.slices.0 - floor).max(-2), (region.slices.1 - floor).min(PAGE_SLICES));
        (slices.0 <= PAGE_SLICES && slices.1 >= -1).then_some(Self { px, py, slices })
    }

    /// Returns whether the whole page comes from the new archive, and no seam changes its spans.
    fn is_whole(&self) -> bool {
        let (first, last) = self.slices;
        (self.px, self.py) == (PagePart::WHOLE.px, PagePart::WHOLE.py) && first < 0 && last >= PAGE_SLICES
    }

    /// Returns whether a seam lies on the floor of the page, and whether one lies on its top.
    fn has_seams(&self) -> [bool; 2] {
        let (first, last) = self.slices;
        [first == 0 || last == -1, first == PAGE_SLICES || last == PAGE_SLICES - 1]
    }

    /// Returns whether the region holds the voxel in slice `k` of this pixel.
    fn holds(&self, (px, py): (u32, u32), k: u32) -> bool {
        is_in(self.px, px) && is_in(self.py, py) && (self.slices.0..=self.slices.1).contains(&i64::from(k))
    }
}

/// Joins the spans of voxels below and above the seam at the height `seam` as the conversion joins those of adjacent
/// voxels, and adds those above to `below`. `highest` is the slice of the highest voxel below; returns that of all.
fn join(below: &mut Vec<Run>, highest: Option<i64>, above: impl IntoIterator<Item = Run>, seam: i64) -> Option<i64> {
    let slice = seam.div_euclid(SLICE_QUANTA);
    let mut above = above.into_iter();
    let Some(mut upper) = above.next() else { return highest };
    let (first, mut last) = upper.slices();
    let meets = |_: &mut Run| highest.is_some_and(|highest| highest + 1 == slice) && first == slice;
    if let Some(mut lower) = below.pop_if(meets) {
        let gap = upper.bottom - lower.top;
        let is_joined = match (lower.inferred, upper.inferred) {
            (false, false) => joins(gap, [lower.obstacle, upper.obstacle]),
            (lower, upper) => lower == upper && gap == 0,
        };
        match lower.obstacle == upper.obstacle {
            true if is_joined => upper.bottom = lower.bottom,
            // Inferred floor has no points, so it may end a quantum before what was scanned begins.
            true if gap == 0 && lower.inferred => {
                lower.top -= 1;
                below.push(lower);
            }
            true if gap == 0 => {
                upper.bottom += 1;
                below.push(lower);
            }
            false if is_joined => {
                (lower.top, upper.bottom) = (seam, seam);
                below.push(lower);
            }
            _ => below.push(lower),
        }
    }
    below.extend((upper.bottom <= upper.top).then_some(upper));
    below.extend(above.inspect(|run| last = run.slices().1));
    Some(last)
}

/// Returns the parts of `runs` in `slices`. What only touches their floor from below belongs to them, too: points on the
/// boundary of two slices are points of the upper one, but end the span of the lower one if the two join.
fn above_seam(runs: &[Run], slices: (i64, i64)) -> impl Iterator<Item = Run> + '_ {
    let floor = slices.0 * SLICE_QUANTA;
    let ends = |run: &&Run| run.top == floor && run.bottom < floor && !run.inferred;
    let touch = runs.iter().find(ends).filter(|_| runs.iter().all(|run| run.bottom != floor));
    let touch = touch.map(|run| Run { bottom: floor, ..*run });
    touch.into_iter().chain(runs.iter().filter_map(move |run| run.cut(slices)))
}

/// A slice beyond all that a page and its neighbours hold.
const FAR: i64 = 4 * PAGE_SLICES;

/// Puts the runs of a pixel together in `out`: those of `new` in `slices`, those of `old` elsewhere.
fn put_together(old: &[Run], new: &[Run], slices: (i64, i64), out: &mut Vec<Run>) {
    out.clear();
    out.extend(old.iter().filter_map(|run| run.cut((-FAR, slices.0 - 1))));
    let highest = out.last().map(|run| run.slices().1);
    let highest = join(out, highest, above_seam(new, slices), slices.0 * SLICE_QUANTA);
    join(out, highest, above_seam(old, (slices.1 + 1, FAR)), (slices.1 + 1) * SLICE_QUANTA);
}

/// Pages of one archive around a key: the one below, at, and above it.
type Around<T> = [Option<T>; 3];

/// Contents that decide a page of the new archive: of the old and the new one, around its key.
type Origin = ([Around<Content>; 2], Place);

/// Pages of both archives that are remembered, since many may be alike: 600 bytes each.
const KNOWN_ORIGINS: usize = 1 << 12;

/// Writers of pages that are copied, by archive and content, and of those that are put together.
struct Copiers {
    whole: Copier<(usize, Content)>,
    mixed: Copier<Origin>,
}

/// Decoded page with its inferred spans.
type Marked = (Page, Inferred);

/// Writes the pages of the new archive.
struct Maker<'a> {
    sides: &'a [Side<'a>; 2],
    /// Readers of the colours that are kept.
    colours: [Option<ColourReader>; 2],
    decoders: [PageDecoder; 2],
    encoder: PageEncoder,
    colour_encoder: ColourEncoder,
    builder: PageBuilder,
    /// True if a page of the new archive with something in the region was seen.
    is_filled: bool,
}

impl<'a> Maker<'a> {
    fn new(sides: &'a [Side<'a>; 2], plan: &Plan, levels: bool) -> Result<Self> {
        let colours = |side: &Side<'_>| side.archive.header().colours.map(|colours| colours.plan);
        let wanted = colours(&sides[0]);
        let reader = |side: &Side<'_>| match wanted.is_some() && colours(side) == wanted {
            true => side.named(ColourReader::new(&side.archive)),
            false => Ok(None),
        };
        Ok(Self {
            sides,
            colours: [reader(&sides[0])?, reader(&sides[1])?],
            decoders: Default::default(),
            encoder: PageEncoder::of_plan(plan).for_levels(levels),
            colour_encoder: ColourEncoder::default(),
            builder: PageBuilder::default(),
            is_filled: false,
        })
    }

    /// Writes all pages. Returns whether nothing of the new archive lies in the region.
    fn write(mut self, region: &Region, writer: &mut ArchiveWriter, monitor: &dyn Monitor) -> Result<bool> {
        let mut copiers = Copiers { whole: Copier::new(), mixed: Copier::knowing(KNOWN_ORIGINS) };
        for pair in Pairs::new(self.sides, region) {
            if monitor.cancelled() {
                return Err(Error::Interrupted);
            }
            let (key, entries) = pair?;
            monitor.advance(entries.iter().flatten().count() as u64);
            match (Place::of(region, key), entries) {
                (None, [Some(entry), _]) => self.copy(0, &entry, &mut copiers, writer)?,
                (None, [None, _]) => {}
                (Some(place), [_, entry]) if place.is_whole() => {
                    if let Some(entry) = entry {
                        self.is_filled = true;
                        self.copy(1, &entry, &mut copiers, writer)?;
                    }
                }
                (Some(place), entries) => self.mix(key, place, entries, &mut copiers, writer)?,
            }
        }
        Ok(!self.is_filled)
    }

    /// Copies a page of one archive.
    fn copy(
        &mut self,
        side: usize,
        entry: &PageEntry,
        copiers: &mut Copiers,
        writer: &mut ArchiveWriter,
    ) -> Result<()> {
        let Self { sides, colours, decoders, encoder, .. } = self;
        let (from, decoder) = (&sides[side], &mut decoders[side]);
        let own = match &mut colours[side] {
            Some(colours) => {
                let page = from.named(from.archive.page_with(entry, decoder))?;
                from.named(colours.copied(entry.key, &page))?
            }
            None => EncodedColours::default(),
        };
        copiers.whole.put(writer, entry.key, (side, entry.content()), own, || {
            let page = from.named(from.archive.page_with(entry, decoder))?;
            Ok(Some(encoder.copied(entry.key, &decoder.bytes, &page, decoder.inferred())))
        })?;
        Ok(())
    }

    /// Writes a page of both archives.
    fn mix(
        &mut self,
        key: PageKey,
        place: Place,
        entries: [Option<PageEntry>; 2],
        copiers: &mut Copiers,
        writer: &mut ArchiveWriter,
    ) -> Result<()> {
        let [below, above] = place.has_seams();
        let neighbour = |side: usize, is_wanted: bool, by: i32| -> Result<Option<PageEntry>> {
            let layer = key.layer.checked_add(by).filter(|_| is_wanted);
            let Some(layer) = layer else { return Ok(None) };
            let Side { archive, .. } = &self.sides[side];
            self.sides[side].named(archive.find(PageKey { layer, ..key }))
        };
        let around = |side: usize| -> Result<Around<PageEntry>> {
            Ok([neighbour(side, below, -1)?, entries[side], neighbour(side, above, 1)?])
        };
        let around = [around(0)?, around(1)?];
        let contents = around.map(|around| around.map(|entry| entry.map(|entry| entry.content())));
        let (mut own, mut made) = (EncodedColours::default(), None);
        if self.colours.iter().any(Option::is_some) {
            let (page, inferred, here) = self.put_together(key, place, &around)?;
            own = self.colours_of(key, place, &page, &here)?;
            made = Some((page, inferred));
        }
        copiers.mixed.put(writer, key, (contents, place), own, || {
            let (page, inferred) = match made {
                Some(made) => made,
                None => self.put_together(key, place, &around).map(|(page, inferred, _)| (page, inferred))?,
            };
            Ok((page.slices() != 0).then(|| self.encoder.encode_inferred(key, &page, &inferred)))
        })?;
        Ok(())
    }

    /// Returns the page, which of its spans are inferred, and the pages of both archives under its key.
    fn put_together(
        &mut self,
        key: PageKey,
        place: Place,
        around: &[Around<PageEntry>; 2],
    ) -> Result<(Page, Inferred, [Option<Page>; 2])> {
        let [old, new] = [self.decoded(0, &around[0])?, self.decoded(1, &around[1])?];
        self.builder.clear();
        let (mut marks, mut column) = (Inferred::new(), Vec::new());
        let (mut runs, mut put) = ([Vec::new(), Vec::new()], Vec::new());
        for pixel in 0..64 * 64 {
            let (px, py) = (pixel & 63, pixel >> 6);
            column.clear();
            gather(&old, px, py, &mut runs[0]);
            let mask = if is_in(place.px, px) && is_in(place.py, py) {
                gather(&new, px, py, &mut runs[1]);
                self.is_filled |= above_seam(&runs[1], place.slices).next().is_some();
                put_together(&runs[0], &runs[1], place.slices, &mut put);
                spans_of(put.iter().copied(), &mut column)
            } else {
                spans_of(runs[0].iter().copied(), &mut column)
            };
            if column.is_empty() {
                continue;
            }
            if !self.builder.set_column(px, py, &column) {
                // A conversion never writes more.
                return Err(Error::limit(format!("spans of a pixel in page {key}"), column.len(), 64));
            }
            let in_order = marks.push(px, py, mask);
            debug_assert!(in_order, "pixels come in row order");
        }
        let here = [old, new].map(|[_, here, _]| here.map(|(page, _)| page));
        Ok((self.builder.build(), marks, here))
    }

    fn decoded(&mut self, side: usize, around: &Around<PageEntry>) -> Result<Around<Marked>> {
        let (from, decoder) = (&self.sides[side], &mut self.decoders[side]);
        let mut pages = Around::default();
        for (page, entry) in pages.iter_mut().zip(around) {
            if let Some(entry) = entry {
                let decoded = from.named(from.archive.page_with(entry, decoder))?;
                *page = Some((decoded, decoder.inferred().clone()));
            }
        }
        Ok(pages)
    }

    /// Returns the colours of the voxels of `page`, made of the pages `here` of both archives.
    fn colours_of(
        &mut self,
        key: PageKey,
        place: Place,
        page: &Page,
        here: &[Option<Page>; 2],
    ) -> Result<EncodedColours> {
        let mut blocks: [Option<ColourBlock>; 2] = [None, None];
        for (side, block) in blocks.iter_mut().enumerate() {
            if let (Some(reader), Some(page)) = (&mut self.colours[side], &here[side]) {
                let found = reader.find(key).and_then(|found| reader.block(&found, key, page));
                *block = self.sides[side].named(found)?;
            }
        }
        let occupancy = Occupancy::of(page);
        let colours = &self.colours;
        let voxels = occupancy.voxels().map(|(pixel, k)| {
            let side = usize::from(place.holds((pixel as u32 & 63, pixel as u32 >> 6), k));
            (side, colours[side].as_ref().and_then(|reader| reader.occupancy().find(pixel, k)))
        });
        let block = ColourBlock::pieced(blocks.each_ref().map(Option::as_ref), voxels);
        Ok(block.map_or_else(EncodedColours::default, |block| {
            EncodedColours::of_block(block, &occupancy, &mut self.colour_encoder)
        }))
    }
}

/// Collects the runs of a pixel of the page in the middle, and the neighbouring ones of the pages below and above.
fn gather(around: &Around<Marked>, px: u32, py: u32, out: &mut Vec<Run>) {
    out.clear();
    for ((page, inferred), layer) in around.iter().zip(-1..).filter_map(|(page, layer)| Some((page.as_ref()?, layer))) {
        out.extend(runs_of(page.column(px, py), inferred.of(px, py), layer));
    }
}

/// Keys of the new archive with the entries of both, in order. Some have neither: what only touches the floor of a page
/// may become a span there.
struct Pairs<'a> {
    sides: &'a [Side<'a>; 2],
    entries: [Peekable<Entries<'a>>; 2],
    region: &'a Region,
    /// Key of the page above the last one, if a seam lies between them.
    next: Option<PageKey>,
}

type Entries<'a> = Box<dyn Iterator<Item = Result<PageEntry>> + 'a>;

impl<'a> Pairs<'a> {
    fn new(sides: &'a [Side<'a>; 2], region: &'a Region) -> Self {
        let entries = |side: &'a Side<'a>| {
            let entries: Entries<'a> = Box::new(side.archive.entries());
            entries.peekable()
        };
        Self { sides, entries: [entries(&sides[0]), entries(&sides[1])], region, next: None }
    }
}

impl Iterator for Pairs<'_> {
    type Item = Result<(PageKey, [Option<PageEntry>; 2])>;

    fn next(&mut self) -> Option<Self::Item> {
        let Self { sides, entries, region, next } = self;
        for (entries, side) in entries.iter_mut().zip(sides.iter()) {
            if let Some(Err(error)) = entries.next_if(Result::is_err) {
                return Some(Err(named(side.path, error)));
            }
        }
        let key_of = |entry: &Result<PageEntry>| entry.as_ref().ok().map(|entry| entry.key);
        let [old, new] = entries.each_mut().map(|entries| entries.peek().and_then(key_of));
        let key = [old, new, next.take()].into_iter().flatten().min()?;
        let at_key = |entry: &Result<PageEntry>| key_of(entry) == Some(key);
        let found = entries.each_mut().map(|entries| entries.next_if(at_key).and_then(Result::ok));
        let has_seam_above = Place::of(region, key).is_some_and(|place| place.has_seams()[1]);
        if has_seam_above && found.iter().any(Option::is_some) {
            *next = key.layer.checked_add(1).map(|layer| PageKey { layer, ..key });
        }
        Some(Ok((key, found)))
    }
}

/// Writes the seen space: inside the region that of the new archive, outside that of the old one.
fn replace_seen(sides: &[Side<'_>; 2], region: &Region, writer: &mut ArchiveWriter) -> Result<()> {
    let [old, new] = sides;
    let table = |side: &Side<'_>| side.named(side.archive.seen_table());
    let tables = [table(old)?, table(new)?];
    let entries = tables.each_ref().map(|table| table.as_ref().map_or(&[][..], SeenTable::entries));
    let mut readers = [SeenReader::new(&old.archive), SeenReader::new(&new.archive)];
    let mut rest = entries.map(|entries| entries.iter().peekable());
    loop {
        let keys = rest.each_mut().map(|rest| rest.peek().map(|entry| entry.key));
        let Some(key) = keys.into_iter().flatten().min() else { return Ok(()) };
        // Zeroed each time; 256 KiB are too many for the stack of a thread.
        let mut pages = [(); 2].map(|()| vec![SeenPage::NOTHING; 64]);
        for side in 0..2 {
            if let Some(entry) = rest[side].next_if(|entry| entry.key == key)
                && (side == 0 || region.meets_block(key))
            {
                let block = sides[side].named(readers[side].block(entry))?;
                block.each_page().for_each(|(key, page)| pages[side][SeenBlock::place_of(key).1 as usize] = page);
            }
        }
        let [mut old, new] = pages;
        let mut block = SeenBlock::new(key);
        for (at, (page, other)) in (0..).zip(old.iter_mut().zip(&new)) {
            let key = PageKey { layer: key.layer * 64 + at as i32, ..key };
            if let Some(part) = region.part_of(key) {
                page.replace(other, &part.cells(true), &part.cells(false));
            }
            block.push(at, page);
        }
        if !block.is_empty() {
            writer.put_seen(&block)?;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inferred_floor_gives_way_to_what_was_scanned() {
        let floor = |bottom, top| Run { bottom, top, obstacle: false, inferred: false };
        let inferred = |bottom, top| Run { inferred: true, ..floor(bottom, top) };
        let obstacle = |bottom, top| Run { obstacle: true, ..floor(bottom, top) };
        for (lower, upper, expected) in [
            (floor(200, 210), floor(290, 300), vec![floor(200, 300)]),
            (floor(200, 210), floor(296, 300), vec![floor(200, 210), floor(296, 300)]),
            (obstacle(3, 5), obstacle(500, 509), vec![obstacle(3, 509)]),
            (floor(200, 210), obstacle(290, 300), vec![floor(200, 255), obstacle(255, 300)]),
            (floor(200, 210), obstacle(296, 300), vec![floor(200, 210), obstacle(296, 300)]),
            (floor(200, 210), floor(255, 255), vec![floor(200, 255)]),
            (floor(200, 255), obstacle(255, 255), vec![floor(200, 255), obstacle(255, 255)]),
            // Not in adjacent slices.
            (obstacle(3, 5), obstacle(510, 511), vec![obstacle(3, 5), obstacle(510, 511)]),
            (inferred(200, 201), floor(256, 300), vec![inferred(200, 201), floor(256, 300)]),
            (inferred(254, 255), floor(255, 300), vec![inferred(254, 254), floor(255, 300)]),
            (floor(254, 255), inferred(255, 256), vec![floor(254, 255), inferred(256, 256)]),
            (floor(254, 255), inferred(255, 255), vec![floor(254, 255)]),
            (inferred(254, 255), inferred(255, 256), vec![inferred(254, 256)]),
            (obstacle(3, 255), inferred(255, 256), vec![obstacle(3, 255), inferred(255, 256)]),
            (obstacle(3, 250), inferred(256, 300), vec![obstacle(3, 250), inferred(256, 300)]),
        ] {
            let mut found = vec![lower];
            let highest = join(&mut found, Some(lower.slices().1), [upper], 255);
            assert_eq!((found, highest), (expected, Some(upper.slices().1)));
        }
    }

    #[test]
    fn what_ends_on_a_seam_belongs_above_it_unless_something_begins_there() {
        let run = |bottom, top, inferred| Run { bottom, top, obstacle: false, inferred };
        let touch = run(255, 255, false);
        for (runs, expected) in [
            (vec![run(200, 255, false)], vec![touch]),
            (vec![run(200, 255, false), run(300, 400, false)], vec![touch, run(300, 400, false)]),
            (vec![run(200, 255, false), run(255, 400, false)], vec![run(255, 400, false)]),
            (vec![touch], vec![touch]),
            (vec![run(200, 254, false)], vec![]),
            (vec![run(200, 255, true)], vec![]),
            (vec![run(200, 300, false)], vec![run(255, 300, false)]),
        ] {
            assert_eq!(above_seam(&runs, (1, 9)).collect::<Vec<_>>(), expected, "{runs:?}");
        }
    }

    #[test]
    fn a_page_is_whole_if_the_region_holds_its_pixels_and_the_slices_beyond() {
        let key = PageKey { tx: 1, ty: -1, layer: 2 };
        let of = |i, j, slices| {
            let place = Place::of(&Region { i, j, slices }, key)?;
            Some((place.is_whole(), place.has_seams()))
        };
        // Pixels 64 to 127 and -64 to -1, slices 128 to 191.
        let (i, j) = ((64, 127), (-64, -1));
        for (slices, expected) in [
            ((-9, 999), Some((true, [false, false]))),
            ((127, 192), Some((true, [false, false]))),
            ((128, 192), Some((false, [true, false]))),
            ((127, 191), Some((false, [false, true]))),
            ((129, 190), Some((false, [false, false]))),
            // On the other side of a seam.
            ((-9, 127), Some((false, [true, false]))),
            ((192, 999), Some((false, [false, true]))),
            // Beyond.
            ((-9, 126), None),
            ((193, 999), None),
        ] {
            assert_eq!(of(i, j, slices), expected, "{slices:?}");
        }
        for (i, j) in [((65, 127), j), ((64, 126), j), (i, (-63, -1)), (i, (-64, -2))] {
            assert_eq!(of(i, j, (-9, 999)), Some((false, [false, false])), "{i:?} {j:?}");
        }
        assert_eq!(of((128, 999), j, (-9, 999)), None);
    }
}

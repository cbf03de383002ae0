//! `slicetool diff`: compares the contents of two archives, not their encoding.

use crate::{Failure, Outcome, changes, entries};
use serde_json::json;
use slicewalk::archive::{Archive, ColourReader, PageEntry, PageReader};
use slicewalk::colour::{LabTable, difference as lab_difference};
use slicewalk::frame::PageKey;
use slicewalk::page::{Colours, Inferred, Page, Span};
use slicewalk_base::text::{counted, grouped, one_line};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Counts of differences; voxels of both archives are compared by lowest bottom, highest top and kind.
#[derive(Clone, Copy, Default)]
struct Difference {
    pages_only_a: u64,
    pages_only_b: u64,
    pages_differing: u64,
    voxels_only_a: u64,
    voxels_only_b: u64,
    voxels_in_both: u64,
    /// In both, but an obstacle only in the first.
    obstacle_only_a: u64,
    obstacle_only_b: u64,
    /// In both, but inferred only in the first.
    inferred_only_a: u64,
    inferred_only_b: u64,
    /// In both, with different bottom or top.
    other_height: u64,
    greatest_bottom: Quanta,
    greatest_top: Quanta,
}

/// Differences between the colours of voxels.
#[derive(Clone, Copy, Default)]
struct ColourDifference {
    only_a: u64,
    only_b: u64,
    /// In both, with different colours.
    in_both: u64,
    other: u64,
    /// Sum and maximum of the differences (ΔE*ab).
    sum: f64,
    greatest: f32,
}

/// Bottom or top above the floor of a slice (quanta).
pub type Quanta = u8;

/// A page and its inferred spans.
type Marked<'a> = (&'a Page, &'a Inferred);

/// Archive and its path.
pub type Named<'a> = (&'a Archive, &'a Path);

/// Options of `slicetool diff`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Slice archive
    a: PathBuf,
    /// Slice archive on the same grid
    b: PathBuf,
    /// Write what is new in B, gone, or not seen in it, as a point per voxel; the extension selects the format (.csv,
    /// .ply). `-` writes CSV to standard output
    #[arg(long, value_name = "OUT")]
    changes: Option<PathBuf>,
    /// With --changes, a voxel counts only if the other archive holds nothing within this distance in metres along each
    /// axis, rounded up to whole pixels and slices [default: a pixel]
    #[arg(long, value_name = "METRES", requires = "changes", allow_negative_numbers = true, value_parser = within)]
    within: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn within(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v: &f64| *v >= 0.0 && v.is_finite());
    value.ok_or_else(|| "expected a distance of 0 or more".into())
}

/// Compares the archives, which must share their grid.
pub fn run(arguments: &Arguments) -> Outcome {
    let (a, b, json) = (&*arguments.a, &*arguments.b, arguments.json);
    crate::standard::refuse_two("--changes", arguments.changes.as_deref(), json)?;
    let (first, second) = (crate::open(a)?, crate::open(b)?);
    if first.frame() != second.frame() {
        let grid =
            |archive: &Archive| format!("pixel {} m, slice {} m", archive.frame().pixel_m(), archive.frame().slice_m());
        return Err(Failure::Text(format!(
            "{} and {} lie on different grids ({} and {}); convert one again with the other's --pixel and --slice",
            a.display(),
            b.display(),
            grid(&first),
            grid(&second)
        )));
    }
    let difference = compare((&first, a), (&second, b))?;
    let colours = compare_colours((&first, a), (&second, b))?;
    let same_colours = colours.is_none_or(|colours| colours.only_a + colours.only_b + colours.other == 0);
    let same_matter = difference.pages_only_a + difference.pages_only_b + difference.pages_differing == 0;
    let identical = same_matter && same_colours;
    let same_plan = first.header().plan_hash == second.header().plan_hash;
    let same_crs = first.crs().map_err(|e| crate::broken(a, &e))? == second.crs().map_err(|e| crate::broken(b, &e))?;
    let write = |path: &Path| changes::write((&first, a), (&second, b), path, arguments.within);
    let changes = arguments.changes.as_deref().map(write).transpose()?;
    let metres = |quanta: Quanta| f64::from(quanta) * first.frame().quantum_m();
    let (bottom, top) = (metres(difference.greatest_bottom), metres(difference.greatest_top));
    if json {
        let mut facts = json!({
            "identical": identical,
            "same_plan": same_plan,
            "same_crs": same_crs,
            "same_bounds": first.header().bounds == second.header().bounds,
            "pages": {
                "only_a": difference.pages_only_a,
                "only_b": difference.pages_only_b,
                "differing": difference.pages_differing,
            },
            "voxels": {
                "only_a": difference.voxels_only_a,
                "only_b": difference.voxels_only_b,
                "in_both": difference.voxels_in_both,
                "other_kind": difference.obstacle_only_a + difference.obstacle_only_b,
                "obstacle_only_a": difference.obstacle_only_a,
                "obstacle_only_b": difference.obstacle_only_b,
                "inferred_only_a": difference.inferred_only_a,
                "inferred_only_b": difference.inferred_only_b,
                "other_height": difference.other_height,
            },
            "colours": colours.map(|colours| json!({
                "only_a": colours.only_a,
                "only_b": colours.only_b,
                "in_both": colours.in_both,
                "other": colours.other,
                "mean_difference": colours.mean(),
                "greatest_difference": colours.greatest,
            })),
            "greatest_height_difference": bottom.max(top),
            "greatest_bottom_difference": bottom,
            "greatest_top_difference": top,
        });
        if let Some([new, gone, not_seen]) = changes {
            facts["changes"] = json!({ "new": new, "gone": gone, "not_seen": not_seen });
        }
        return Ok(format!("{facts:#}\n"));
    }
    let mut text = String::new();
    writeln!(text, "plans {}", if same_plan { "are the same" } else { "differ" })?;
    if identical {
        writeln!(text, "content is identical")?;
    } else if same_matter {
        writeln!(text, "matter is identical")?;
    } else {
        let Difference { pages_only_a, pages_only_b, pages_differing, .. } = &difference;
        let [only_a, only_b, differing] = [*pages_only_a, *pages_only_b, *pages_differing].map(grouped);
        writeln!(text, "pages: {only_a} only in A, {only_b} only in B, {differing} differ")?;
        let [only_a, only_b] = [difference.voxels_only_a, difference.voxels_only_b].map(grouped);
        writeln!(text, "voxels: {only_a} only in A, {only_b} only in B")?;
        writeln!(
            text,
            "voxels in both: {}; {} are obstacles only in A, {} only in B",
            grouped(difference.voxels_in_both),
            grouped(difference.obstacle_only_a),
            grouped(difference.obstacle_only_b)
        )?;
        if difference.inferred_only_a + difference.inferred_only_b > 0 {
            let [only_a, only_b] = [difference.inferred_only_a, difference.inferred_only_b].map(grouped);
            writeln!(text, "inferred voxels: {only_a} only in A, {only_b} only in B")?;
        }
        writeln!(
            text,
            "voxels of other height: {} (bottoms by up to {bottom:.4} m, tops by up to {top:.4} m)",
            grouped(difference.other_height)
        )?;
    }
    if let Some(colours) = colours.filter(|_| !same_colours) {
        let [only_a, only_b, other, both] =
            [colours.only_a, colours.only_b, colours.other, colours.in_both].map(grouped);
        writeln!(text, "voxels with colours: {only_a} only in A, {only_b} only in B; {other} of {both} differ")?;
        if colours.in_both > 0 {
            let (mean, greatest) = (colours.mean(), colours.greatest);
            writeln!(text, "colours differ by {mean:.2} ΔE on average, by {greatest:.2} at most")?;
        }
    }
    match (changes, &arguments.changes) {
        (Some(counts), Some(path)) => {
            let [new, gone, not_seen] = counts;
            let (new, gone, not_seen) = (counted(new, "voxel"), grouped(gone), grouped(not_seen));
            let name = path.to_string_lossy();
            writeln!(text, "{}: {new} new, {gone} gone, {not_seen} not seen", one_line(&name))?;
            crate::standard::written(path, &text)
        }
        _ => Ok(text),
    }
}

impl ColourDifference {
    fn mean(&self) -> f64 {
        if self.in_both == 0 { 0.0 } else { self.sum / self.in_both as f64 }
    }

    fn add(&mut self, a: Option<[u8; 3]>, b: Option<[u8; 3]>) {
        match (a, b) {
            (Some(a), Some(b)) => {
                self.in_both += 1;
                if a != b {
                    let table = LabTable::get();
                    let apart = lab_difference(table.of_8_bits(a), table.of_8_bits(b));
                    self.other += 1;
                    self.sum += f64::from(apart);
                    self.greatest = self.greatest.max(apart);
                }
            }
            (Some(_), None) => self.only_a += 1,
            (None, Some(_)) => self.only_b += 1,
            (None, None) => {}
        }
    }
}

/// Compares the colours of the voxels of two archives; `None` if neither has colours.
fn compare_colours((a, path_a): Named<'_>, (b, path_b): Named<'_>) -> Result<Option<ColourDifference>, Failure> {
    let reader = |archive: &Archive, path: &Path| ColourReader::new(archive).map_err(|e| crate::broken(path, &e));
    let (mut colours_a, mut colours_b) = (reader(a, path_a)?, reader(b, path_b)?);
    if colours_a.is_none() && colours_b.is_none() {
        return Ok(None);
    }
    let of = |reader: &mut Option<ColourReader>, entry: &PageEntry, path: &Path| -> Result<Option<Colours>, Failure> {
        let colours = reader.as_mut().map(|reader| reader.colours(entry)).transpose();
        colours.map_err(|error| crate::broken(path, &error))
    };
    let mut found = ColourDifference::default();
    for entry in entries(a, path_a) {
        let entry = entry?;
        let other = b.find(entry.key).map_err(|error| crate::broken(path_b, &error))?;
        let own = of(&mut colours_a, &entry, path_a)?;
        let other = other.map(|other| of(&mut colours_b, &other, path_b)).transpose()?.flatten();
        for (px, py, k, colour) in own.iter().flat_map(Colours::voxels) {
            found.add(colour, other.as_ref().and_then(|other| other.of(px, py, k)));
        }
        for (px, py, k, colour) in other.iter().flat_map(Colours::voxels) {
            // The loop above has handled the voxels occupied in the first archive.
            let pixel = (py << 6 | px) as usize;
            if own.as_ref().is_none_or(|own| own.occupancy().find(pixel, k).is_none()) {
                found.add(None, colour);
            }
        }
    }
    for entry in entries(b, path_b) {
        let entry = entry?;
        if a.find(entry.key).map_err(|error| crate::broken(path_a, &error))?.is_none() {
            let colours = of(&mut colours_b, &entry, path_b)?;
            colours.iter().flat_map(Colours::voxels).for_each(|(.., colour)| found.add(None, colour));
        }
    }
    Ok(Some(found))
}

impl Difference {
    /// Compares two pages of the same key; `None` where an archive has no such page.
    fn between(a: Option<Marked<'_>>, b: Option<Marked<'_>>, empty: Marked<'_>) -> Self {
        let mut difference = Self::default();
        match (a, b) {
            (Some(_), None) => difference.pages_only_a += 1,
            (None, Some(_)) => difference.pages_only_b += 1,
            (a, b) => difference.pages_differing += u64::from(a != b),
        }
        if a == b {
            difference.voxels_in_both += a.map_or(0, |(page, _)| page.voxel_counts().0);
        } else {
            count(a.unwrap_or(empty), b.unwrap_or(empty), &mut difference);
        }
        difference
    }

    fn add(&mut self, more: &Self) {
        self.pages_only_a += more.pages_only_a;
        self.pages_only_b += more.pages_only_b;
        self.pages_differing += more.pages_differing;
        self.voxels_only_a += more.voxels_only_a;
        self.voxels_only_b += more.voxels_only_b;
        self.voxels_in_both += more.voxels_in_both;
        self.obstacle_only_a += more.obstacle_only_a;
        self.obstacle_only_b += more.obstacle_only_b;
        self.inferred_only_a += more.inferred_only_a;
        self.inferred_only_b += more.inferred_only_b;
        self.other_height += more.other_height;
        self.greatest_bottom = self.greatest_bottom.max(more.greatest_bottom);
        self.greatest_top = self.greatest_top.max(more.greatest_top);
    }
}

/// Walks both directories in parallel and passes each key with the entries of both archives to `take`.
pub fn each_pair(
    (a, path_a): Named<'_>,
    (b, path_b): Named<'_>,
    mut take: impl FnMut(PageKey, [Option<PageEntry>; 2]) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let mut entries = [entries(a, path_a), entries(b, path_b)];
    let mut next = [entries[0].next().transpose()?, entries[1].next().transpose()?];
    while let Some(key) = next.iter().flatten().map(|entry| entry.key).min() {
        let found = next.map(|entry| entry.filter(|entry| entry.key == key));
        take(key, found)?;
        for (side, _) in found.iter().enumerate().filter(|(_, found)| found.is_some()) {
            next[side] = entries[side].next().transpose()?;
        }
    }
    Ok(())
}

/// Compares page by page; memory: one page of each.
fn compare((a, path_a): Named<'_>, (b, path_b): Named<'_>) -> Result<Difference, Failure> {
    let mut difference = Difference::default();
    let (mut pages_a, mut pages_b) = (PageReader::new(a), PageReader::new(b));
    let (empty, nothing) = (slicewalk::page::PageBuilder::default().build(), Inferred::new());
    // Equal pairs of contents tend to repeat, so the last result is kept.
    let mut last = None;
    each_pair((a, path_a), (b, path_b), |_, [entry_a, entry_b]| {
        let contents = (entry_a.map(|entry| entry.content()), entry_b.map(|entry| entry.content()));
        let between = match last {
            Some((same, between)) if same == contents => between,
            _ => {
                let page_a = entry_a.map(|entry| pages_a.page_and_inferred(&entry)).transpose();
                let page_a = page_a.map_err(|error| crate::broken(path_a, &error))?;
                let page_b = entry_b.map(|entry| pages_b.page_and_inferred(&entry)).transpose();
                let page_b = page_b.map_err(|error| crate::broken(path_b, &error))?;
                Difference::between(page_a, page_b, (&empty, &nothing))
            }
        };
        last = Some((contents, between));
        difference.add(&between);
        Ok(())
    })?;
    Ok(difference)
}

fn count((a, marks_a): Marked<'_>, (b, marks_b): Marked<'_>, difference: &mut Difference) {
    let slices = a.slices() | b.slices();
    for pixel in 0..64 * 64 {
        let (px, py) = (pixel & 63, pixel >> 6);
        let inferred = [inferred(a, marks_a, px, py), inferred(b, marks_b, px, py)];
        difference.inferred_only_a += u64::from((inferred[0] & !inferred[1]).count_ones());
        difference.inferred_only_b += u64::from((inferred[1] & !inferred[0]).count_ones());
        let (a, b) = (a.column(px, py), b.column(px, py));
        if a.is_empty() && b.is_empty() {
            continue;
        }
        for slice in (0..64).filter(|slice| slices >> slice & 1 == 1) {
            match (voxel(a, slice), voxel(b, slice)) {
                (Some((bottom_a, top_a, obstacle_a)), Some((bottom_b, top_b, obstacle_b))) => {
                    difference.voxels_in_both += 1;
                    difference.obstacle_only_a += u64::from(obstacle_a && !obstacle_b);
                    difference.obstacle_only_b += u64::from(obstacle_b && !obstacle_a);
                    let (bottom, top) = (bottom_a.abs_diff(bottom_b), top_a.abs_diff(top_b));
                    difference.other_height += u64::from(bottom.max(top) > 0);
                    difference.greatest_bottom = difference.greatest_bottom.max(bottom);
                    difference.greatest_top = difference.greatest_top.max(top);
                }
                (Some(_), None) => difference.voxels_only_a += 1,
                (None, Some(_)) => difference.voxels_only_b += 1,
                (None, None) => {}
            }
        }
    }
}

/// Returns the slices of a pixel whose solid is entirely inferred.
fn inferred(page: &Page, marks: &Inferred, px: u32, py: u32) -> u64 {
    let mask = marks.of(px, py);
    if mask == 0 {
        return 0;
    }
    let slices = page.column(px, py).iter().enumerate().fold([0; 2], |mut slices, (at, span)| {
        slices[(mask >> (at & 63) & 1) as usize] |= span.slice_mask();
        slices
    });
    slices[1] & !slices[0]
}

/// Returns lowest bottom and highest top in one slice of a pixel's spans, and whether any span is an obstacle.
pub fn voxel(spans: &[Span], slice: u32) -> Option<(Quanta, Quanta, bool)> {
    let parts = spans.iter().filter_map(|span| Some((span.within_slice(slice)?, span.is_obstacle())));
    parts
        .map(|((bottom, top), obstacle)| (bottom, top, obstacle))
        .reduce(|low, high| (low.0, low.1.max(high.1), low.2 | high.2))
}

//! The whole content of an archive as JSON, in the format of `spec/reader.py --json`.

use serde_json::{Value, json};
use slicewalk::archive::{Archive, ColourReader, Level, PageDecoder, PageEntry, Storage};
use slicewalk::frame::PageKey;
use slicewalk::page::Span;
use slicewalk::seen::SeenPage;
use slicewalk::{Error, NoMonitor, Result};
use slicewalk_convert::info;

/// Content of an archive, or the first rule that it breaks.
pub fn content_or_rule(bytes: Vec<u8>) -> Value {
    match Archive::from_bytes(bytes).and_then(|archive| checked(&archive)) {
        Ok(content) => content,
        Err(error) => json!({ "rule": rule_of(&error) }),
    }
}

/// The rule of the specification that an error refers to.
pub fn rule_of(error: &Error) -> &'static str {
    match error {
        Error::Format { rule, .. } => rule,
        Error::Unsupported { what, .. } if what.contains("H1") => "H1",
        Error::Unsupported { what, .. } if what.contains("H4") => "H4",
        Error::Unsupported { what, .. } if what.contains("H5") => "H5",
        error => panic!("{error}"),
    }
}

fn checked(archive: &Archive) -> Result<Value> {
    let mut rules = Vec::new();
    archive.verify(&NoMonitor, &mut |finding| rules.push(finding.rule))?;
    match rules.first() {
        Some(rule) => Ok(json!({ "rule": rule })),
        None => content(archive),
    }
}

/// Content of an archive: `info`, then each page with its pixels.
pub fn content(archive: &Archive) -> Result<Value> {
    let mut reader = ColourReader::new(archive)?;
    let one = |entry: Result<PageEntry>| {
        let entry = entry?;
        let mut value = page(archive, &entry)?;
        if let Some(reader) = &mut reader {
            value["colours"] = colours(reader, &entry)?;
        }
        Ok(value)
    };
    let pages = archive.entries().map(one).collect::<Result<Vec<_>>>()?;
    let mut content = json!({ "info": info::info(archive)?, "pages": pages });
    if let Some(space) = archive.seen_space(1 << 30)? {
        content["seen"] = space.pages().map(|(key, page)| seen(key, &page)).collect();
    }
    if archive.header().levels.is_some() {
        let levels = archive.levels()?.iter().map(|told| level(archive, told));
        content["levels"] = levels.collect::<Result<Vec<_>>>()?.into();
    }
    Ok(content)
}

/// Key of a page, and its seen cells: those of each slice in hexadecimal digits.
fn seen(key: PageKey, page: &SeenPage) -> Value {
    let slice = |words: &[u64; 4]| {
        let digits: String = words.iter().rev().map(|word| format!("{word:016x}")).collect();
        match digits.trim_start_matches('0') {
            "" => "0".to_owned(),
            digits => digits.to_owned(),
        }
    };
    let cells = match page.cells() {
        SeenPage::CELLS => "all".to_owned(),
        _ => page.slices().iter().map(slice).collect::<Vec<_>>().join(" "),
    };
    json!([key.tx, key.ty, key.layer, cells])
}

fn level(archive: &Archive, level: &Level) -> Result<Value> {
    let pages = level.catalog().header().pages.total();
    let mut value = json!({ "pages": pages, "pixel_size": level.frame().pixel_m() });
    let level = archive.level(level.number())?;
    if let Some(mut reader) = ColourReader::new(&level)? {
        let pages = level.entries().map(|entry| colours(&mut reader, &entry?));
        value["colours"] = pages.collect::<Result<Vec<_>>>()?.into();
    }
    Ok(value)
}

fn page(archive: &Archive, entry: &PageEntry) -> Result<Value> {
    let mut value = json!({
        "key": [entry.key.tx, entry.key.ty, entry.key.layer],
        "slices": format!("{:016x}", entry.slices),
    });
    let (kind, extent) = match &entry.storage {
        Storage::Stored(extent) => ("stored", extent),
        Storage::Shared(extent) => ("shared", extent),
        Storage::Uniform(span) => {
            value["kind"] = "uniform".into();
            value["span"] = triple(span);
            return Ok(value);
        }
    };
    value["kind"] = kind.into();
    value["offset"] = extent.offset.into();
    value["length"] = extent.len.into();
    value["blocks"] = entry.size.blocks().into();
    value["words"] = entry.size.words().into();
    let mut decoder = PageDecoder::new();
    let page = archive.page_with(entry, &mut decoder)?;
    let pixels = page.columns().map(|(px, py, spans)| {
        let inferred = decoder.inferred().of(px, py);
        let spans = spans.iter().enumerate().map(|(at, span)| match inferred >> (at & 63) & 1 {
            1 => json!([span.bottom(), span.top(), 2]),
            _ => triple(span),
        });
        [json!(px), json!(py)].into_iter().chain(spans).collect::<Value>()
    });
    value["pixels"] = pixels.collect();
    Ok(value)
}

/// The colours of a page's voxels as hexadecimal digits, `-` for a voxel without colour; null if no voxel has one.
fn colours(reader: &mut ColourReader, entry: &PageEntry) -> Result<Value> {
    let colours = reader.colours(entry)?;
    let text = colours.values().iter().map(|&[r, g, b, a]| match a {
        0 => "-".to_owned(),
        _ => format!("{r:02x}{g:02x}{b:02x}"),
    });
    Ok(if colours.count() == 0 { Value::Null } else { text.collect::<Vec<_>>().join(" ").into() })
}

/// Bottom, top (quanta above the page's floor), 1 for an obstacle.
fn triple(span: &Span) -> Value {
    json!([span.bottom(), span.top(), u8::from(span.is_obstacle())])
}

//! Archives with changed parts but correct lengths and checksums, which a fuzzer of plain bytes cannot reach.

#[path = "../common/forge.rs"]
mod forge;

use super::script::Script;
use super::{Read, encoded, page_of, read_archive, repair};
use forge::{Parts, word};
use slicewalk::codec::Unpacker;
use std::sync::LazyLock;

/// Sound archives of one leaf.
const SOUND: [&[u8]; 7] = [
    include_bytes!("../../spec/samples/two-pixels.slices"),
    include_bytes!("seeds/archive/few"),
    include_bytes!("../../spec/samples/holes.slices"),
    include_bytes!("seeds/archive/levels"),
    include_bytes!("seeds/archive/colours"),
    include_bytes!("../../spec/samples/units.slices"),
    include_bytes!("../../spec/samples/part.slices"),
];
/// Bytes before the body of a page.
const LEADER: usize = 24;
/// Bytes of unpacked metadata that may be changed.
const METADATA: usize = 1 << 16;

/// Splits a sound archive, changes its parts as the bytes say, recomputes lengths and checksums, and reads it.
pub fn forged(bytes: &[u8]) -> Read {
    static PARTS: LazyLock<[Parts; SOUND.len()]> = LazyLock::new(|| SOUND.map(Parts::of));
    let mut script = Script(bytes);
    let mut parts = PARTS[script.below(SOUND.len())].clone();
    let mut head_changes = Vec::new();
    for _ in 0..8 {
        if script.is_over() {
            break;
        }
        match script.below(5) {
            0 => head_changes.push([(); 8].map(|()| script.byte())),
            1 => script.change(&mut parts.leaf),
            2 => change_metadata(&mut parts, &mut script),
            3 => change_page(&mut parts, &mut script),
            _ => replace_page(&mut parts, &mut script),
        }
    }
    let bytes = parts.build(|head| {
        let end = head.len() - 4;
        for change in head_changes {
            Script(&change).change_in_place(&mut head[..end]);
        }
    });
    read_archive(repair(&bytes).unwrap_or(bytes))
}

fn change_metadata(parts: &mut Parts, script: &mut Script) {
    let mut raw = Unpacker::new().unpack(&parts.metadata, METADATA, "").map(<[u8]>::to_vec).unwrap_or_default();
    script.change(&mut raw);
    parts.metadata.clear();
    forge::pack(&raw, &mut parts.metadata);
}

/// Ranges of the pages in the section.
fn pages(parts: &Parts) -> Vec<std::ops::Range<usize>> {
    let (mut places, mut at) = (Vec::new(), 0);
    while parts.pages[at..].starts_with(b"\x89PAG") && at + LEADER <= parts.pages.len() {
        let end = at + LEADER + word(&parts.pages, at + 16);
        places.push(at..end);
        at = end;
    }
    places
}

/// Changes the leader or body of a page in place.
fn change_page(parts: &mut Parts, script: &mut Script) {
    let places = pages(parts);
    let Some(place) = places.get(script.below(places.len().max(1))).cloned() else { return };
    let page = &mut parts.pages[place];
    let before = page[20..LEADER].to_vec();
    let (leader, body) = page.split_at_mut(LEADER);
    let place = if script.below(4) == 0 { &mut leader[4..16] } else { &mut *body };
    script.change_in_place(place);
    let crc = crc32c::crc32c_append(crc32c::crc32c(&leader[..20]), body).to_le_bytes();
    leader[20..].copy_from_slice(&crc);
    // The leaf contains the same checksum, once for a page or several times for pages that share it.
    while let Some(at) = parts.leaf.windows(4).position(|bytes| bytes == before && bytes != crc) {
        parts.leaf[at..at + 4].copy_from_slice(&crc);
    }
}

/// Replaces the only page by another sound one, which need not match the leaf.
fn replace_page(parts: &mut Parts, script: &mut Script) {
    let is_single = matches!(&pages(parts)[..], [only] if only.end == parts.pages.len()) && parts.leaf.len() > 14;
    let page = page_of(script);
    if is_single && page.span_count() > 0 {
        *parts = parts.with_page(&encoded(&page));
    }
}

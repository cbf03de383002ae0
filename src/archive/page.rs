//! Pages as they lie in the file: a leader that tells what they are, and the encoded page (chapter 5).

use super::colours::EncodedColours;
use super::directory::{Extent, PageEntry, Storage, key_in_grid};
use super::head::hex;
use super::levels::{CoarseSpan, coarse};
use crate::Result;
use crate::bytes::crc;
use crate::codec::{Decoder, Encoder, MAX_BODY, Violation};
use crate::frame::{Frame, PageKey, TILE_PIXELS};
use crate::plan::Plan;
use crate::slice::{Inferred, Page, PageBounds, PageBuilder, PageSize, Span};
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// First bytes of a page.
pub(super) const MAGIC: [u8; 4] = *b"\x89PAG";
/// First bytes of a page of an overview level, which must never pass for one of the archive.
pub(super) const LEVEL_MAGIC: [u8; 4] = *b"\x89LVL";
/// Length of a page's leader (bytes).
pub(super) const LEADER: usize = 24;
/// Greatest length of a page with its leader (bytes).
pub(super) const MAX_STORED_PAGE: usize = LEADER + MAX_BODY;

/// A page ready to be put into an archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncodedPage {
    /// Leader and body; empty for a page that one span tells.
    pub(super) bytes: Vec<u8>,
    pub(super) uniform: Option<Span>,
    /// Identity of the body, for sharing.
    pub(super) hash: u64,
    pub(super) key: PageKey,
    /// Slices of the page with matter.
    pub slices: u64,
    pub(super) size: PageSize,
    /// `None` without matter.
    pub(super) bounds: Option<PageBounds>,
    /// Number of voxels with matter, and how many of them hold obstacle.
    pub voxels: (u64, u64),
    /// Number of voxels whose matter is inferred alone.
    pub inferred: u64,
    /// What the page gives to overview levels, if it is to give anything.
    pub(super) coarse: Option<Arc<[CoarseSpan]>>,
    /// Colours of its voxels, for an archive that gets colours.
    pub(super) colours: EncodedColours,
}

impl EncodedPage {
    /// Bytes that the page takes in the archive, unless it shares those of another.
    pub fn len_bytes(&self) -> usize {
        self.bytes.len()
    }

    /// The page with these colours of its voxels.
    pub fn with_colours(self, colours: EncodedColours) -> Self {
        Self { colours, ..self }
    }

    pub(super) fn crc(&self) -> u32 {
        leader_crc(&self.bytes)
    }

    /// A page of one archive, to be put into another under `key`: `bytes` are those of its extent, `page` what they
    /// hold, and which spans of that are inferred. The body stays as it is; of a shared page the leader names another key and is made anew. `levels`: whether the
    /// other archive has overview levels.
    pub(super) fn copied(key: PageKey, bytes: &[u8], page: &Page, inferred: &Inferred, levels: bool) -> Self {
        let Some(body) = bytes.get(LEADER..).filter(|body| !body.is_empty()) else {
            return Self { uniform: uniform_span(page), ..Self::without_bytes(key, page, inferred, levels) };
        };
        let mut bytes = leader(MAGIC, key);
        bytes.extend_from_slice(body);
        seal(&mut bytes);
        Self { hash: xxh3_64(body), bytes, ..Self::without_bytes(key, page, inferred, levels) }
    }

    fn without_bytes(key: PageKey, page: &Page, inferred: &Inferred, levels: bool) -> Self {
        Self {
            bytes: Vec::new(),
            uniform: None,
            hash: 0,
            key,
            slices: page.slices(),
            size: page.size(),
            bounds: page.bounds(),
            voxels: page.voxel_counts(),
            inferred: inferred.voxel_count(page),
            coarse: levels.then(|| coarse(page).into()),
            colours: EncodedColours::default(),
        }
    }

    fn with_bytes(self, mut bytes: Vec<u8>) -> Self {
        seal(&mut bytes);
        bytes.shrink_to_fit();
        Self { hash: xxh3_64(&bytes[LEADER..]), bytes, ..self }
    }

    /// The bytes that decide whether two pages are equal.
    pub(super) fn body(&self) -> &[u8] {
        &self.bytes[LEADER..]
    }
}

/// Checksum that a leader states.
pub(super) fn leader_crc(bytes: &[u8]) -> u32 {
    u32::from_le_bytes([bytes[20], bytes[21], bytes[22], bytes[23]])
}

/// Checksum of what a page's own covers of its leader.
pub(super) fn covered_crc(leader: &[u8]) -> u32 {
    crc::crc32c(&leader[..20])
}

/// Checksum of a page: its leader up to the checksum, then its body.
fn page_crc(bytes: &[u8]) -> u32 {
    crc::crc32c_append(covered_crc(bytes), &bytes[LEADER..])
}

/// A leader without length and checksum.
fn leader(magic: [u8; 4], key: PageKey) -> Vec<u8> {
    let mut bytes = magic.to_vec();
    for index in [key.tx, key.ty, key.layer] {
        bytes.extend(index.to_le_bytes());
    }
    bytes.resize(LEADER, 0);
    bytes
}

/// Writes length and checksum into the leader of the page `bytes`.
fn seal(bytes: &mut [u8]) {
    let len = (bytes.len() - LEADER) as u32;
    bytes[16..20].copy_from_slice(&len.to_le_bytes());
    let crc = page_crc(bytes);
    bytes[20..24].copy_from_slice(&crc.to_le_bytes());
}

/// Encodes pages; one per thread. Equal pages give equal bytes, whatever was encoded before.
#[derive(Debug)]
pub struct PageEncoder {
    encoder: Encoder,
    magic: [u8; 4],
    /// Whether pages are prepared for overview levels above them.
    levels: bool,
    body: Vec<u8>,
}

impl PageEncoder {
    /// An encoder for pages of an archive with this grid and no tolerance, with its own scratch memory (about 2 MiB once used).
    pub fn new(frame: Frame) -> Self {
        Self { encoder: Encoder::new(frame, 0), magic: MAGIC, levels: true, body: Vec::new() }
    }

    /// An encoder for pages of an archive of this plan.
    pub fn of_plan(plan: &Plan) -> Self {
        let encoder = Encoder::new(plan.frame, plan.tolerance_quanta());
        Self { encoder, magic: MAGIC, levels: true, body: Vec::new() }
    }

    /// Whether pages are prepared for overview levels, as they are unless this says otherwise. An archive without levels costs
    /// less if they are not; one with levels refuses pages that are not.
    pub fn for_levels(self, levels: bool) -> Self {
        Self { levels, ..self }
    }

    /// The page of another archive under `key`; see [`EncodedPage::copied`].
    pub(super) fn copied(&self, key: PageKey, bytes: &[u8], page: &Page, inferred: &Inferred) -> EncodedPage {
        EncodedPage::copied(key, bytes, page, inferred, self.levels)
    }

    /// An encoder for pages of overview levels.
    pub(super) fn of_levels() -> Self {
        Self { encoder: Encoder::of_levels(), magic: LEVEL_MAGIC, levels: false, body: Vec::new() }
    }

    /// Whether the page whose bytes with leader are `bytes` has the one encoding of `page`, which it holds (rule P10).
    pub(super) fn gives(&mut self, page: &Page, inferred: &Inferred, bytes: &[u8]) -> bool {
        if !self.encoder.admits(page) {
            return false;
        }
        self.body.clear();
        self.encoder.encode_inferred(page, inferred, &mut self.body);
        self.body == bytes[LEADER..]
    }

    /// Encodes `page` under `key`.
    pub fn encode(&mut self, key: PageKey, page: &Page) -> EncodedPage {
        self.encode_inferred(key, page, &Inferred::new())
    }

    /// Encodes `page`, some of whose spans are inferred, under `key`. Only archives whose plan
    /// [fills holes](crate::plan::PlanOptions::fill_holes) take such pages.
    pub fn encode_inferred(&mut self, key: PageKey, page: &Page, inferred: &Inferred) -> EncodedPage {
        let encoded = self.without_bytes(key, page, inferred);
        if encoded.uniform.is_some() || encoded.bounds.is_none() {
            return encoded;
        }
        let mut bytes = leader(self.magic, key);
        self.encoder.encode_inferred(page, inferred, &mut bytes);
        encoded.with_bytes(bytes)
    }

    /// As [`encode_inferred`](Self::encode_inferred), with heights coarsened by up to the tolerance of the plan; some spans may
    /// become one: the page as it was encoded comes with it. It must hold matter.
    pub fn encode_lossy(&mut self, key: PageKey, page: &Page, inferred: &Inferred) -> (EncodedPage, Page) {
        let mut bytes = leader(self.magic, key);
        let (page, inferred) = self.encoder.encode_lossy(page, inferred, &mut bytes);
        let encoded = self.without_bytes(key, &page, &inferred);
        (if encoded.uniform.is_some() { encoded } else { encoded.with_bytes(bytes) }, page)
    }

    /// All but the bytes.
    fn without_bytes(&self, key: PageKey, page: &Page, inferred: &Inferred) -> EncodedPage {
        let uniform = if inferred.is_empty() { uniform_span(page) } else { None };
        EncodedPage { uniform, ..EncodedPage::without_bytes(key, page, inferred, self.levels) }
    }
}

/// The span that every pixel of the page holds and nothing else, if so.
fn uniform_span(page: &Page) -> Option<Span> {
    if page.span_count() != (TILE_PIXELS * TILE_PIXELS) as usize {
        return None;
    }
    let &[span] = page.column(0, 0) else { return None };
    page.columns().all(|(_, _, spans)| spans == [span]).then_some(span)
}

/// Decodes pages; one per thread.
#[derive(Debug, Default)]
pub struct PageDecoder {
    decoder: Decoder,
    builder: PageBuilder,
    /// Whether inferred spans are left out.
    ignore_inferred: bool,
    /// Whether what the decoder says of inferred spans is of the last page.
    is_marked: bool,
    /// Bytes of the page in work, for whoever reads them.
    pub(super) bytes: Vec<u8>,
}

impl PageDecoder {
    /// A decoder with its own scratch memory (about 200 KiB, more for pages of many spans).
    pub fn new() -> Self {
        Self::default()
    }

    /// A decoder of pages of up to this size, of which it has [`scratch_bytes`](Self::scratch_bytes) at most.
    pub fn for_size(size: PageSize) -> Self {
        Self { decoder: Decoder::for_spans(size.words() as usize), ..Self::default() }
    }

    /// Bytes of scratch memory of a decoder made [`for_size`](Self::for_size).
    pub fn scratch_bytes(size: PageSize) -> usize {
        Decoder::scratch_bytes(size.words() as usize) + PageBuilder::scratch_bytes(0)
    }

    /// Whether pages come without their inferred spans from now on; they then differ from what their entries say of slices and
    /// size, and may hold no matter at all.
    pub fn set_ignore_inferred(&mut self, ignore: bool) {
        self.ignore_inferred = ignore;
    }

    /// Which spans of the page decoded last are inferred; none if they were left out.
    pub fn inferred(&self) -> &Inferred {
        static NONE: Inferred = Inferred::NONE;
        if self.is_marked && !self.ignore_inferred { self.decoder.inferred() } else { &NONE }
    }

    /// The page of `entry` from `bytes`, those of its [`extent`](PageEntry::extent); none are needed for a uniform
    /// page. Errors of the [`Format`](crate::Error::Format) family name the rule that `bytes` break.
    pub fn decode(&mut self, entry: &PageEntry, bytes: &[u8]) -> Result<Page> {
        let offset = entry.extent().map_or(0, |extent| extent.offset);
        self.check_and_decode(entry, bytes).map_err(|violation| violation.at(format!("page {}", entry.key), offset))
    }

    fn check_and_decode(&mut self, entry: &PageEntry, bytes: &[u8]) -> Result<Page, Violation> {
        let page = match entry.storage {
            Storage::Uniform(span) => {
                self.is_marked = false;
                self.uniform(span)
            }
            Storage::Stored(extent) | Storage::Shared(extent) => {
                check_key(entry, check_leader(extent, bytes)?)?;
                self.decode_body(bytes)?
            }
        };
        check_entry(entry, page.slices(), page.size())?;
        if self.ignore_inferred && self.is_marked && !self.decoder.inferred().is_empty() {
            return Ok(self.decoder.scanned(&page));
        }
        Ok(page)
    }

    /// The page whose leader and body are `bytes`, whatever its leader says.
    pub(super) fn decode_body(&mut self, bytes: &[u8]) -> Result<Page, Violation> {
        self.is_marked = true;
        self.decoder.decode(&bytes[LEADER..])
    }

    /// The page that `bytes` are by their own word, without a directory entry that tells of it: its key and what it
    /// holds; `None` if they are no sound page.
    pub(super) fn salvage(&mut self, bytes: &[u8]) -> Option<(PageKey, Page)> {
        let key = own_key(bytes).filter(|&key| key_in_grid(key))?;
        Some((key, self.decode_body(bytes).ok()?))
    }

    fn uniform(&mut self, span: Span) -> Page {
        self.builder.clear();
        for pixel in 0..(TILE_PIXELS * TILE_PIXELS) as u32 {
            let taken = self.builder.set_column(pixel % 64, pixel / 64, &[span]);
            debug_assert!(taken, "one span makes a column");
        }
        self.builder.build()
    }
}

/// Length with its leader of the page that begins at the start of `bytes`, by its own word; `None` if none begins there.
pub(super) fn stated_len(bytes: &[u8]) -> Option<usize> {
    if bytes.len() <= LEADER || bytes[..4] != MAGIC {
        return None;
    }
    let len = (Leader::of(bytes).body_len as usize).checked_add(LEADER)?;
    (len > LEADER && len <= MAX_STORED_PAGE).then_some(len)
}

/// The key of the page that `bytes` are by their own word; `None` if its length or checksum is wrong.
pub(super) fn own_key(bytes: &[u8]) -> Option<PageKey> {
    let right = stated_len(bytes)? == bytes.len() && page_crc(bytes) == leader_crc(bytes);
    right.then(|| Leader::of(bytes).key)
}

/// The fields of a leader.
struct Leader {
    key: PageKey,
    body_len: u32,
    crc: u32,
}

impl Leader {
    /// Of `bytes`, which are at least as long as a leader.
    fn of(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let key = PageKey { tx: word(4) as i32, ty: word(8) as i32, layer: word(12) as i32 };
        Self { key, body_len: word(16), crc: word(20) }
    }
}

/// The key that the leader of the page `bytes` states, where `bytes` are those of `extent` (rules P1 and P2).
pub(super) fn check_leader(extent: Extent, bytes: &[u8]) -> Result<PageKey, Violation> {
    if bytes.len() != extent.len as usize || bytes.len() <= LEADER {
        return Err(Violation::new("P1", format!("a page of {} bytes", extent.len), bytes.len()));
    }
    // Which of the two it is to be follows from the directory's checksum, too; `verify` looks.
    if bytes[..4] != MAGIC && bytes[..4] != LEVEL_MAGIC {
        return Err(Violation::new("P1", hex(&MAGIC), hex(&bytes[..4])));
    }
    let leader = Leader::of(bytes);
    if leader.body_len as usize != bytes.len() - LEADER {
        return Err(Violation::new("P1", format!("a body of {} bytes", bytes.len() - LEADER), leader.body_len));
    }
    let crc = page_crc(bytes);
    if crc != leader.crc || crc != extent.crc {
        let found = format!("{:08x}, and {:08x} in the directory", leader.crc, extent.crc);
        return Err(Violation::new("P2", format!("checksum {crc:08x}"), found));
    }
    Ok(leader.key)
}

/// Rule P3: the bytes of `entry`, of which the leader states `key`, are its own or those of an earlier page.
pub(super) fn check_key(entry: &PageEntry, key: PageKey) -> Result<(), Violation> {
    let fits = match entry.storage {
        Storage::Shared(_) => key < entry.key,
        _ => key == entry.key,
    };
    match fits {
        true => Ok(()),
        false => Err(Violation::new("P3", format!("the bytes of page {} or of one that it shares", entry.key), key)),
    }
}

/// Rules P9 and P11: a page with matter in `slices`, and of this size, is what `entry` says.
pub(super) fn check_entry(entry: &PageEntry, slices: u64, size: PageSize) -> Result<(), Violation> {
    if slices != entry.slices {
        let expected = format!("slices {:016x} as in the directory", entry.slices);
        return Err(Violation::new("P9", expected, format!("{slices:016x}")));
    }
    if size != entry.size {
        let words = |size: PageSize| format!("{} blocks and {} words", size.blocks(), size.words());
        return Err(Violation::new("P11", format!("{} as in the directory", words(entry.size)), words(size)));
    }
    Ok(())
}

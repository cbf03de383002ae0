//! Stored pages: a leader that identifies the page, then the encoded page (chapter 5).

use super::colour_section::EncodedColours;
use super::directory::{Extent, PageEntry, Storage, key_in_grid};
use super::head::hex;
use super::levels::{CoarseSpan, coarse};
use crate::Result;
use crate::bytes::crc;
use crate::codec::{Decoder, Encoder, MAX_BODY, Violation};
use crate::frame::{Frame, PageKey, TILE_PIXELS};
use crate::page::{Inferred, Page, PageBounds, PageBuilder, PageSize, Span};
use crate::plan::Plan;
use std::sync::Arc;
use xxhash_rust::xxh3::xxh3_64;

/// First bytes of a page.
pub(super) const MAGIC: [u8; 4] = *b"\x89PAG";
/// First bytes of a page of an overview level, which must never be taken for a page of the archive.
pub(super) const LEVEL_MAGIC: [u8; 4] = *b"\x89LVL";
/// Length of a page's leader (bytes).
pub(super) const LEADER: usize = 24;
/// Largest page with its leader (bytes).
pub(super) const MAX_STORED_PAGE: usize = LEADER + MAX_BODY;

/// Encoded page, ready for an archive.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct EncodedPage {
    /// Leader and body; empty for a uniform page.
    pub(super) bytes: Vec<u8>,
    pub(super) uniform: Option<Span>,
    /// Hash of the body, to find equal pages.
    pub(super) hash: u64,
    pub(super) key: PageKey,
    /// Slices of the page that contain solid, as bits.
    pub slices: u64,
    pub(super) size: PageSize,
    /// Extent of the solid; `None` for an empty page.
    pub(super) bounds: Option<PageBounds>,
    /// Number of occupied voxels, and how many of them contain an obstacle.
    pub voxels: (u64, u64),
    /// Number of voxels whose solid is only inferred.
    pub inferred: u64,
    /// Contribution to overview levels, if there are to be any.
    pub(super) coarse: Option<Arc<[CoarseSpan]>>,
    /// Colours of its voxels, for an archive with colours.
    pub(super) colours: EncodedColours,
}

impl EncodedPage {
    /// Returns the page with `colours` for its voxels.
    pub fn with_colours(self, colours: EncodedColours) -> Self {
        Self { colours, ..self }
    }

    pub(super) fn crc(&self) -> u32 {
        leader_crc(&self.bytes)
    }

    /// Copies a page of one archive for another, under `key`. `bytes` are those of its extent, `page` and `inferred`
    /// its content; `levels` is true if the other archive has overview levels. The body stays as it is; the leader is
    /// rebuilt because that of a shared page names another key.
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

    /// Returns the bytes that decide whether two pages are equal.
    pub(super) fn body(&self) -> &[u8] {
        &self.bytes[LEADER..]
    }
}

/// Returns the checksum that a leader states.
pub(super) fn leader_crc(bytes: &[u8]) -> u32 {
    u32::from_le_bytes([bytes[20], bytes[21], bytes[22], bytes[23]])
}

/// Returns the checksum of the leader's part that the page checksum covers.
pub(super) fn covered_crc(leader: &[u8]) -> u32 {
    crc::crc32c(&leader[..20])
}

/// Returns the checksum of a page: its leader up to the checksum, then its body.
fn page_crc(bytes: &[u8]) -> u32 {
    crc::crc32c_append(covered_crc(bytes), &bytes[LEADER..])
}

/// Returns a leader without length and checksum.
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

/// Encodes pages; use one per thread. Equal pages give equal bytes, whatever was encoded before.
#[derive(Debug)]
pub struct PageEncoder {
    encoder: Encoder,
    magic: [u8; 4],
    /// True if pages are prepared for overview levels.
    levels: bool,
    body: Vec<u8>,
}

impl PageEncoder {
    /// Creates an encoder for pages of an archive on this grid, without tolerance. Memory: about 2 MiB of scratch once
    /// used.
    pub fn new(frame: Frame) -> Self {
        Self { encoder: Encoder::new(frame, 0), magic: MAGIC, levels: true, body: Vec::new() }
    }

    /// Creates an encoder for pages of an archive of `plan`.
    pub fn of_plan(plan: &Plan) -> Self {
        let encoder = Encoder::new(plan.frame, plan.tolerance_quanta());
        Self { encoder, magic: MAGIC, levels: true, body: Vec::new() }
    }

    /// Sets whether pages are prepared for overview levels, which is the default. Encoding is cheaper without; an
    /// archive with levels refuses pages that are not prepared.
    pub fn for_levels(self, levels: bool) -> Self {
        Self { levels, ..self }
    }

    /// Copies a page of another archive under `key`; see [`EncodedPage::copied`].
    pub(super) fn copied(&self, key: PageKey, bytes: &[u8], page: &Page, inferred: &Inferred) -> EncodedPage {
        EncodedPage::copied(key, bytes, page, inferred, self.levels)
    }

    /// Creates an encoder for pages of overview levels.
    pub(super) fn of_levels() -> Self {
        Self { encoder: Encoder::of_levels(), magic: LEVEL_MAGIC, levels: false, body: Vec::new() }
    }

    /// Returns whether `bytes`, with leader, are the canonical encoding of `page` (rule P10).
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

    /// Encodes `page`, of which the spans in `inferred` are inferred, under `key`. Only archives whose plan [fills
    /// holes](crate::plan::PlanOptions::fill_holes) accept such pages.
    pub fn encode_inferred(&mut self, key: PageKey, page: &Page, inferred: &Inferred) -> EncodedPage {
        let encoded = self.without_bytes(key, page, inferred);
        if encoded.uniform.is_some() || encoded.bounds.is_none() {
            return encoded;
        }
        let mut bytes = leader(self.magic, key);
        self.encoder.encode_inferred(page, inferred, &mut bytes);
        encoded.with_bytes(bytes)
    }

    /// Like [`encode_inferred`](Self::encode_inferred), but coarsens heights by up to the tolerance of the plan. Spans
    /// may merge, so the coarsened page is returned, too. `page` must not be empty.
    pub fn encode_lossy(&mut self, key: PageKey, page: &Page, inferred: &Inferred) -> (EncodedPage, Page) {
        let mut bytes = leader(self.magic, key);
        let (page, inferred) = self.encoder.encode_lossy(page, inferred, &mut bytes);
        let encoded = self.without_bytes(key, &page, &inferred);
        (if encoded.uniform.is_some() { encoded } else { encoded.with_bytes(bytes) }, page)
    }

    /// Returns the encoded page without its bytes.
    fn without_bytes(&self, key: PageKey, page: &Page, inferred: &Inferred) -> EncodedPage {
        let uniform = if inferred.is_empty() { uniform_span(page) } else { None };
        EncodedPage { uniform, ..EncodedPage::without_bytes(key, page, inferred, self.levels) }
    }
}

/// Returns the span that every pixel of the page holds as its only one, if there is such a span.
fn uniform_span(page: &Page) -> Option<Span> {
    if page.span_count() != (TILE_PIXELS * TILE_PIXELS) as usize {
        return None;
    }
    let &[span] = page.column(0, 0) else { return None };
    page.columns().all(|(_, _, spans)| spans == [span]).then_some(span)
}

/// Decodes pages; use one per thread.
#[derive(Debug, Default)]
pub struct PageDecoder {
    decoder: Decoder,
    builder: PageBuilder,
    /// True if inferred spans are left out.
    ignore_inferred: bool,
    /// True if the inferred spans held by the decoder belong to the last page.
    is_marked: bool,
    /// Buffer for the bytes of the current page, used by readers.
    pub(super) bytes: Vec<u8>,
}

impl PageDecoder {
    /// Creates a decoder. Memory: about 200 KiB of scratch, more for pages of many spans.
    pub fn new() -> Self {
        Self::default()
    }

    /// Creates a decoder for pages of up to this size, with or [without](Self::set_ignore_inferred) their inferred
    /// spans. It needs at most [`scratch_bytes`](Self::scratch_bytes) of memory.
    pub fn for_size(size: PageSize, ignore_inferred: bool) -> Self {
        let (mut builder, spans) = (PageBuilder::default(), size.words() as usize);
        if ignore_inferred {
            builder.reserve(spans);
        }
        Self { decoder: Decoder::for_spans(spans), builder, ignore_inferred, ..Self::default() }
    }

    /// Returns the scratch memory of a decoder created by [`for_size`](Self::for_size) (bytes).
    pub fn scratch_bytes(size: PageSize, ignore_inferred: bool) -> usize {
        let spans = size.words() as usize;
        Decoder::scratch_bytes(spans) + PageBuilder::scratch_bytes(if ignore_inferred { spans } else { 0 })
    }

    /// Sets whether later pages come without their inferred spans. They then differ from the slices and size of their
    /// entries, and may be empty.
    pub fn set_ignore_inferred(&mut self, ignore: bool) {
        self.ignore_inferred = ignore;
    }

    /// Returns which spans of the last decoded page are inferred; none if they were left out.
    pub fn inferred(&self) -> &Inferred {
        static NONE: Inferred = Inferred::NONE;
        if self.is_marked && !self.ignore_inferred { self.decoder.inferred() } else { &NONE }
    }

    /// Decodes the page of `entry` from `bytes`, those of its [`extent`](PageEntry::extent); a uniform page needs none.
    /// [`Format`](crate::Error::Format) errors name the broken rule.
    pub fn decode(&mut self, entry: &PageEntry, bytes: &[u8]) -> Result<Page> {
        let offset = entry.bytes().start;
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
            return Ok(self.decoder.inferred().without(&page, &mut self.builder));
        }
        Ok(page)
    }

    /// Decodes the page with leader and body `bytes` and ignores what its leader says.
    pub(super) fn decode_body(&mut self, bytes: &[u8]) -> Result<Page, Violation> {
        self.is_marked = true;
        self.decoder.decode(&bytes[LEADER..])
    }

    /// Decodes a page without a directory entry: returns its own key and its content, or `None` if it is not sound.
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

/// Returns the length, with leader, that the page at the start of `bytes` states; `None` if no page begins there.
pub(super) fn stated_len(bytes: &[u8]) -> Option<usize> {
    if bytes.len() <= LEADER || bytes[..4] != MAGIC {
        return None;
    }
    let len = (Leader::of(bytes).body_len as usize).checked_add(LEADER)?;
    (len > LEADER && len <= MAX_STORED_PAGE).then_some(len)
}

/// Returns the key that the page `bytes` states; `None` if its length or checksum is wrong.
pub(super) fn own_key(bytes: &[u8]) -> Option<PageKey> {
    let right = stated_len(bytes)? == bytes.len() && page_crc(bytes) == leader_crc(bytes);
    right.then(|| Leader::of(bytes).key)
}

/// Fields of a leader.
struct Leader {
    key: PageKey,
    body_len: u32,
    crc: u32,
}

impl Leader {
    /// Decodes the fields from `bytes`, which must hold a whole leader.
    fn of(bytes: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let key = PageKey { tx: word(4) as i32, ty: word(8) as i32, layer: word(12) as i32 };
        Self { key, body_len: word(16), crc: word(20) }
    }
}

/// Checks the leader of the page `bytes`, read from `extent`, and returns its key (rules P1 and P2).
pub(super) fn check_leader(extent: Extent, bytes: &[u8]) -> Result<PageKey, Violation> {
    if bytes.len() != extent.len as usize || bytes.len() <= LEADER {
        return Err(Violation::new("P1", format!("a page of {} bytes", extent.len), bytes.len()));
    }
    // Accept both: the directory's checksum already settles which one is right, and `verify` checks it.
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

/// Checks rule P3: the key in the leader is that of `entry`, or of an earlier page if the bytes are shared.
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

/// Checks rules P9 and P11: `entry` states the occupied slices and the size of its page.
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

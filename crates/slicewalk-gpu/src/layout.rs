//! Pages as the words of `shaders/pages.wgsl`.

use crate::error::{Error, Result};
use slicewalk::frame::{Frame, PAGE_QUANTA, PageKey, TILE_PIXELS};
use slicewalk::page::{BLOCK_PIXELS, BlockView, Page, Span};
use slicewalk::store::Snapshot;

/// A slot or a page without words.
pub(crate) const NONE: u32 = u32::MAX;
/// Greatest extent of a scene along each axis (pixels or quanta), so that sums of two positions fit 32 bits.
const FARTHEST: i64 = 1 << 30;

/// Where positions on the device count from, and how far they go.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    pub frame: Frame,
    /// First pixel along x and y, and lowest height (quanta).
    pub origin: [i64; 3],
    /// Pixels along x and y, and quanta.
    pub size: [i64; 3],
}

impl Place {
    /// Returns the place of all pages of `pages`; of no page, one that nothing reaches.
    fn of(pages: &Snapshot) -> Result<Self> {
        let units = [TILE_PIXELS, TILE_PIXELS, PAGE_QUANTA];
        let (mut origin, mut size) = ([0; 3], [0; 3]);
        if let Some(bounds) = pages.bounds() {
            origin = [0, 1, 2].map(|axis| i64::from(bounds.min[axis]) * units[axis]);
            size = [0, 1, 2].map(|axis| (i64::from(bounds.max[axis]) + 1) * units[axis] - origin[axis]);
        }
        for (what, size) in ["pixels along x", "pixels along y", "quanta of height"].into_iter().zip(size) {
            if size > FARTHEST {
                return Err(Error::TooLarge { what, found: size as u64, limit: FARTHEST as u64 });
            }
        }
        Ok(Self { frame: *pages.frame(), origin, size })
    }

    /// Returns the number of tiles along x or y.
    pub fn tiles(&self, axis: usize) -> i64 {
        self.size[axis] / TILE_PIXELS
    }
}

/// All words of a scene.
#[derive(Debug)]
pub(crate) struct Image {
    pub place: Place,
    pub buckets: Vec<[u32; 4]>,
    pub slots: Vec<[u32; 4]>,
    pub words: Vec<u32>,
    /// Keys of the pages in the order of `slots`.
    pub keys: Vec<PageKey>,
}

impl Image {
    /// Lays out the pages in memory, and what is known of the others. Fails if a buffer exceeds `limit` (bytes).
    pub fn new(pages: &Snapshot, limit: u64) -> Result<Self> {
        let place = Place::of(pages)?;
        let mut image = Self {
            place,
            buckets: vec![[0; 4]; (2 * pages.column_count()).next_power_of_two()],
            slots: Vec::new(),
            words: Vec::new(),
            keys: Vec::new(),
        };
        fits("slots of tile columns", image.buckets.len(), limit)?;
        for number in 0..pages.column_count() {
            let (tx, ty, slots) = pages.column_at(number);
            let first = image.slots.len() as u32;
            for slot in slots {
                let key = PageKey { tx, ty, layer: slot.layer() };
                let layer = i64::from(slot.layer()) - place.origin[2] / PAGE_QUANTA;
                let begin = match slot.page() {
                    Some(page) => image.page(page, limit)?,
                    None => NONE,
                };
                image.slots.push([layer as u32, slot.slices() as u32, (slot.slices() >> 32) as u32, begin]);
                image.keys.push(key);
            }
            fits("slots of pages", image.slots.len(), limit)?;
            let tile =
                [(tx, 0), (ty, 1)].map(|(tile, axis)| (i64::from(tile) - place.origin[axis] / TILE_PIXELS) as u32);
            image.put(tile, first, slots.len() as u32);
        }
        Ok(image)
    }

    /// Puts a tile column into a free bucket.
    fn put(&mut self, [x, y]: [u32; 2], first: u32, count: u32) {
        let mask = self.buckets.len() as u32 - 1;
        let at = x.wrapping_mul(0x9e37_79b1).wrapping_add(y.wrapping_mul(0x85eb_ca77));
        let mut at = (at ^ at >> 15) & mask;
        while self.buckets[at as usize][3] != 0 {
            at = (at + 1) & mask;
        }
        self.buckets[at as usize] = [x, y, first, count];
    }

    /// Appends a page; returns its first word.
    fn page(&mut self, page: &Page, limit: u64) -> Result<u32> {
        let begin = self.words.len();
        let blocks: Vec<(u32, BlockView<'_>)> = (0..64)
            .map(|number| (number, page.block(number % 8, number / 8)))
            .filter(|(_, block)| block.pixels() != 0)
            .collect();
        let mask = blocks.iter().fold(0u64, |mask, (number, _)| mask | 1 << number);
        self.words.extend(halves(mask));
        let mut record = self.words.len();
        self.words.resize(record + RECORD * blocks.len(), 0);
        for (_, block) in blocks {
            self.block(block, record);
            record += RECORD;
        }
        fits("pages", self.words.len().div_ceil(4), limit)?;
        Ok(begin as u32)
    }

    /// Appends the unions and spans of a block, and fills its record.
    fn block(&mut self, block: BlockView<'_>, record: usize) {
        let unions = self.words.len();
        self.words.extend(block.unions().map(|span| word(span, 0)));
        let spans = self.words.len();
        let mut rows = [0u32; BLOCK_PIXELS as usize];
        for (y, begin) in (0..).zip(&mut rows) {
            *begin = (self.words.len() - spans) as u32;
            for x in 0..BLOCK_PIXELS {
                self.words.extend(block.column(8 * y + x).iter().map(|span| word(*span, x)));
            }
        }
        let counts = (spans - unions) as u32 | ((self.words.len() - spans) as u32) << 16;
        let [low, high] = halves(block.pixels());
        let pairs = [0, 2, 4, 6].map(|y| rows[y] | rows[y + 1] << 16);
        self.words[record..record + 4].copy_from_slice(&[low, high, unions as u32, counts]);
        self.words[record + 4..record + RECORD].copy_from_slice(&pairs);
    }
}

/// Words of a block's record.
const RECORD: usize = 8;

fn halves(mask: u64) -> [u32; 2] {
    [mask as u32, (mask >> 32) as u32]
}

/// Returns the word of a span in a pixel with this `x % 8`.
fn word(span: Span, lane: u32) -> u32 {
    span.bottom() | span.top() << 14 | u32::from(span.is_obstacle()) << 28 | lane << 29
}

/// Fails if `count` groups of four words exceed `limit` (bytes).
fn fits(what: &'static str, count: usize, limit: u64) -> Result<()> {
    let found = 16 * count as u64;
    if found <= limit { Ok(()) } else { Err(Error::TooLarge { what, found, limit }) }
}

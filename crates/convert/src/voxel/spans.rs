//! Conversion of classified voxels to the pages of a tile column.

use super::accumulate::{Area, Patch, Voxel};
use super::record::{BLOCK_SLICES, PATCH_PIXELS};
use crate::frame::{PAGE_QUANTA, PAGE_SLICES, SLICE_QUANTA, TILE_PIXELS};
use crate::page::{Page, RowBuilder, Span, joins};

/// Part of a span inside one page, as one number: layer, pixel, bottom, top, kind, from the highest bits down. So
/// pieces sort in place by page, pixel and height, and a column of many millions stays small.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Piece(u64);

const _: () = assert!(PAGE_QUANTA < 1 << 14 && BLOCK_SLICES / PAGE_SLICES < 1 << 23);

impl Piece {
    fn new(layer: i64, pixel: u16, span: Span) -> Self {
        let heights = u64::from(span.bottom()) << 15 | u64::from(span.top()) << 1 | u64::from(span.is_obstacle());
        Self((layer as u64) << 41 | u64::from(pixel) << 29 | heights)
    }

    /// Layer above the column block's lowest.
    fn layer(self) -> i64 {
        (self.0 >> 41) as i64
    }

    fn pixel(self) -> u32 {
        (self.0 >> 29) as u32 & 0xFFF
    }

    fn span(self) -> Option<Span> {
        let field = |shift: u32| (self.0 >> shift) as u32 & 0x3FFF;
        Span::new(field(15), field(1), self.0 & 1 == 1)
    }
}

/// Capacity in pieces that is kept for the next column.
const KEPT_PIECES: usize = 1 << 16;

/// Collects the spans of one tile column and returns its pages. Memory: 8 bytes per span.
#[derive(Debug, Default)]
pub struct ColumnPages {
    pieces: Vec<Piece>,
    builder: RowBuilder,
    column: Vec<Span>,
    /// Layer of the page in `builder`, if the column was added without pieces.
    page: Option<i64>,
}

impl ColumnPages {
    /// Adds the spans of all pixels in `area`, with one class (true: obstacle) per voxel of `patch`.
    pub fn add(&mut self, patch: &Patch, area: Area, voxel_classes: &[bool]) {
        if area == Area::TILE && self.add_page(patch, voxel_classes) {
            return;
        }
        for pixel in patch.occupied().filter(|&pixel| area.holds(pixel)) {
            let (x, y) = place(pixel);
            each_span(patch, pixel, voxel_classes, |span| self.push((y << 6 | x) as u16, span));
        }
    }

    /// Adds the spans of a whole tile column if they form one page; else returns `false`.
    fn add_page(&mut self, patch: &Patch, voxel_classes: &[bool]) -> bool {
        let layer_of = |voxel: &Voxel| voxel.slice / PAGE_SLICES as u32;
        let Some(layer) = patch.voxels().first().map(layer_of) else { return false };
        if patch.voxels().iter().any(|voxel| layer_of(voxel) != layer) {
            return false;
        }
        let mut rows = [0u64; TILE_PIXELS as usize];
        let pixels = || patch.occupied().filter(|&pixel| Area::TILE.holds(pixel));
        for (x, y) in pixels().map(place) {
            rows[y] |= 1 << x;
        }
        let Self { column, builder, page, .. } = self;
        *page = (rows != [0; TILE_PIXELS as usize]).then_some(layer.into());
        builder.begin(rows);
        let floor = i64::from(layer) * PAGE_QUANTA;
        for pixel in pixels() {
            column.clear();
            each_span(patch, pixel, voxel_classes, |OpenSpan { bottom, top, obstacle, .. }| {
                column.extend(Span::new((bottom - floor) as u32, (top - floor) as u32, obstacle));
            });
            let (x, y) = place(pixel);
            push_column(builder, x as u32, y as u32, column);
        }
        true
    }

    /// Cuts a span at page boundaries.
    fn push(&mut self, pixel: u16, span: OpenSpan) {
        let mut bottom = span.bottom;
        loop {
            let layer = bottom / PAGE_QUANTA;
            let page_floor = layer * PAGE_QUANTA;
            let top = span.top.min(page_floor + PAGE_QUANTA);
            let piece = Span::new((bottom - page_floor) as u32, (top - page_floor) as u32, span.obstacle);
            self.pieces.extend(piece.map(|span| Piece::new(layer, pixel, span)));
            if top >= span.top {
                return;
            }
            bottom = top;
        }
    }

    /// Passes the pages to `give`, lowest layer first, and clears the column. `first_slice` is the column block's
    /// lowest slice.
    pub fn finish<E>(
        &mut self,
        first_slice: i64,
        mut give: impl FnMut(i32, &Page) -> std::result::Result<(), E>,
    ) -> std::result::Result<(), E> {
        let layer_at = |layer: i64| (first_slice.div_euclid(PAGE_SLICES) + layer) as i32;
        let Self { pieces, builder, column, page } = self;
        if let Some(layer) = page.take() {
            give(layer_at(layer), &builder.build())?;
        }
        if !pieces.is_sorted() {
            pieces.sort_unstable();
        }
        for page in pieces.chunk_by(|a, b| a.layer() == b.layer()) {
            let mut rows = [0; TILE_PIXELS as usize];
            page.iter().map(|piece| piece.pixel()).for_each(|pixel| rows[pixel as usize >> 6] |= 1 << (pixel & 63));
            builder.begin(rows);
            for pixel in page.chunk_by(|a, b| a.pixel() == b.pixel()) {
                column.clear();
                column.extend(pixel.iter().filter_map(|piece| piece.span()));
                let (px, py) = (pixel[0].pixel() & 63, pixel[0].pixel() >> 6);
                push_column(builder, px, py, column);
            }
            give(layer_at(page[0].layer()), &builder.build())?;
        }
        pieces.clear();
        pieces.shrink_to(KEPT_PIECES);
        Ok(())
    }
}

/// Adds the spans of the next occupied pixel, lowest first.
#[inline]
fn push_column(builder: &mut RowBuilder, px: u32, py: u32, spans: &[Span]) {
    debug_assert!(spans.windows(2).all(|pair| pair[0].lies_below(pair[1])), "pixel ({px}, {py}): {spans:?}");
    spans.iter().for_each(|&span| builder.push(px, span));
    builder.end_pixel(px, py);
}

/// Position in the tile of a patch pixel that is not in the halo.
#[inline]
fn place(patch_pixel: usize) -> (usize, usize) {
    (patch_pixel % PATCH_PIXELS - 1, patch_pixel / PATCH_PIXELS - 1)
}

/// Calls `give` with the spans of a pixel's voxels, lowest first.
#[inline]
fn each_span(patch: &Patch, patch_pixel: usize, voxel_classes: &[bool], mut give: impl FnMut(OpenSpan)) {
    let range = patch.range(patch_pixel);
    let mut open: Option<OpenSpan> = None;
    for (voxel, &obstacle) in patch.voxels()[range.clone()].iter().zip(&voxel_classes[range]) {
        let floor = i64::from(voxel.slice) * SLICE_QUANTA;
        let (bottom, top) = (floor + i64::from(voxel.bottom), floor + i64::from(voxel.top));
        open = Some(match open {
            Some(below) if below.slice + 1 == voxel.slice && joins(bottom - below.top, [below.obstacle, obstacle]) => {
                if below.obstacle == obstacle {
                    OpenSpan { top, slice: voxel.slice, ..below }
                } else {
                    give(OpenSpan { top: floor, ..below });
                    OpenSpan { bottom: floor, top, obstacle, slice: voxel.slice }
                }
            }
            apart => {
                apart.into_iter().for_each(&mut give);
                OpenSpan { bottom, top, obstacle, slice: voxel.slice }
            }
        });
    }
    open.into_iter().for_each(give);
}

/// A span under construction, in quanta above the column block's floor.
#[derive(Debug, Clone, Copy)]
struct OpenSpan {
    bottom: i64,
    top: i64,
    obstacle: bool,
    /// Slice of its highest voxel.
    slice: u32,
}

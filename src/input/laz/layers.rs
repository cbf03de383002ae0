//! Points in layers (LAZ of formats 6 to 10): only the point's own fields. Items behind the point (colours, extra bytes,
//! waveforms) are stepped over: nothing of them is read, and no models are made for them.

use super::Wanted;
use laz::DecompressionSelection;
use laz::las::{v3, v4};
use laz::record::LayeredFieldDecompressor;
use std::io::{Read, Result, Seek, SeekFrom};

/// Bytes of a decoded point.
pub(super) const POINT_BYTES: usize = 30;
/// Layers of a point.
pub(super) const LAYERS: usize = 9;

/// Places and flags of points, and what else is wanted.
pub(super) fn selection(wanted: Wanted) -> DecompressionSelection {
    let mut selection = DecompressionSelection::base().decompress_z().decompress_flags();
    if wanted.classes {
        selection = selection.decompress_classification();
    }
    if wanted.intensity {
        selection = selection.decompress_intensity();
    }
    if wanted.source_ids {
        selection = selection.decompress_point_source_id();
    }
    if wanted.times {
        selection = selection.decompress_gps_time();
    }
    selection
}

/// Decodes one chunk.
pub(super) enum Layers {
    V3(Box<v3::LasPoint6Decompressor>),
    V4(Box<v4::LasPoint6Decompressor>),
}

impl Layers {
    /// Whether there is a decoder of points of this version.
    pub fn exist(version: u16) -> bool {
        matches!(version, 3 | 4)
    }

    /// A decoder of points of this version. It takes most of a millisecond to make, and serves one chunk only.
    pub fn new(version: u16) -> Self {
        match version {
            4 => Self::V4(Box::default()),
            _ => Self::V3(Box::default()),
        }
    }

    fn decoder<R: Read + Seek>(&mut self) -> &mut dyn LayeredFieldDecompressor<R> {
        match self {
            Self::V3(decoder) => &mut **decoder,
            Self::V4(decoder) => &mut **decoder,
        }
    }

    /// Begins the chunk at `window`: decodes its first point. Behind the point lie `others` bytes of other items, and behind
    /// the sizes of its layers `sizes` bytes with those of theirs.
    pub fn begin<R: Read + Seek>(
        &mut self,
        window: &mut R,
        record: &mut [u8],
        others: usize,
        sizes: usize,
        wanted: Wanted,
    ) -> Result<()> {
        let decoder = self.decoder::<R>();
        decoder.set_selection(selection(wanted));
        decoder.init_first_point(window, record, &mut 0)?;
        // Behind the other items stands the number of points, which is known.
        window.seek(SeekFrom::Current(others as i64 + 4))?;
        decoder.read_layers_sizes(window)?;
        window.seek(SeekFrom::Current(sizes as i64))?;
        decoder.read_layers(window)
    }

    /// Decodes the next point.
    pub fn next<R: Read + Seek>(&mut self, record: &mut [u8]) -> Result<()> {
        self.decoder::<R>().decompress_field_with(record, &mut 0)
    }
}

//! Compares the decoders with those of the crate `laz`: same records from the same bytes, whole, cut and damaged.

use std::io::{Cursor, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use laz::compressors::IntegerCompressorBuilder;
use laz::encoders::ArithmeticEncoder;
use laz::las::{gps, point0};
use laz::models::ArithmeticModelBuilder;
use laz::record::{
    FieldCompressor, LayeredPointRecordCompressor, LayeredPointRecordDecompressor, RecordCompressor,
    RecordDecompressor, SequentialPointRecordCompressor, SequentialPointRecordDecompressor,
};
use laz::{DecompressionSelection, LazItem, LazItemRecordBuilder, LazItemType, LazVlr};
use proptest::prelude::*;

use super::items::{Item, LaszipRecord};
use super::layers::{Layers, POINT_BYTES, places};
use super::sequence::{Items, Sequence};
use super::{Packing, Wanted};
use crate::Error;
use crate::diagnostics::Findings;
use crate::header::{LasHeader, u32_at};
use crate::source::Source;

/// Change of a field from one record to the next.
#[derive(Debug, Clone, Copy)]
enum Change {
    Stays,
    /// A small difference, as between neighbours.
    By(i8),
    /// This multiple of the last difference.
    Times(i16),
    Becomes(u64),
}

fn change() -> impl Strategy<Value = Change> {
    prop_oneof![
        6 => Just(Change::Stays),
        4 => any::<i8>().prop_map(Change::By),
        2 => (-12i16..12).prop_map(Change::Times),
        1 => (-700i16..700).prop_map(Change::Times),
        1 => (any::<u64>(), 0u32..64).prop_map(|(number, bits)| Change::Becomes(number >> bits)),
    ]
}

/// Returns the bytes of each field of a record.
fn fields(items: &[LazItem]) -> Vec<usize> {
    let of = |item: &LazItem| match item.item_type() {
        LazItemType::Point10 => vec![4, 4, 4, 2, 1, 1, 1, 1, 2],
        LazItemType::GpsTime => vec![8],
        LazItemType::WavePacket13 => vec![1, 8, 4, 4, 4, 4, 4],
        LazItemType::RGB12 | LazItemType::RGB14 => vec![2, 2, 2],
        LazItemType::RGBNIR14 => vec![2, 2, 2, 2],
        LazItemType::Point14 => vec![4, 4, 4, 2, 1, 1, 1, 1, 2, 2, 8],
        _ => vec![1; usize::from(item.size())],
    };
    items.iter().flat_map(of).collect()
}

/// Returns the greatest value of each field of a record.
fn limits(items: &[LazItem]) -> Vec<u64> {
    let is_packet = |item: &&LazItem| item.item_type() == LazItemType::WavePacket13;
    let before: Vec<LazItem> = items.iter().take_while(|item| !is_packet(item)).copied().collect();
    let size_of_packet = items.iter().any(|item| is_packet(&item)).then(|| fields(&before).len() + 2);
    let limit = |(number, bytes): (usize, usize)| match bytes {
        // The compressor of `laz` assumes that time differences do not overflow.
        8 => u64::MAX >> 2,
        // It takes a packet of 2³¹ bytes or more for one that ends before it begins, and its decompressor does not.
        4 if Some(number) == size_of_packet => i32::MAX as u64,
        _ => u64::MAX,
    };
    fields(items).into_iter().enumerate().map(limit).collect()
}

/// Creates a record for each row of `changes`, which apply to its fields; a row that is too short repeats.
fn records(items: &[LazItem], changes: &[Vec<Change>]) -> Vec<u8> {
    let fields: Vec<_> = fields(items).into_iter().zip(limits(items)).collect();
    let mut last = vec![(0u64, 0u64); fields.len()];
    let mut all = Vec::new();
    for row in changes {
        for (((bytes, limit), (value, step)), change) in fields.iter().zip(&mut last).zip(row.iter().cycle()) {
            let next = match *change {
                Change::Stays => *value,
                Change::By(by) => value.wrapping_add_signed(i64::from(by)),
                Change::Times(times) => value.wrapping_add(step.wrapping_mul(i64::from(times) as u64)),
                Change::Becomes(next) => next,
            };
            let next = if *bytes == 8 { next >> 2 } else { next & limit };
            if next != *value {
                (*value, *step) = (next, next.wrapping_sub(*value));
            }
            all.extend(&value.to_le_bytes()[..*bytes]);
        }
    }
    all
}

fn record_bytes(items: &[LazItem]) -> usize {
    items.iter().map(|item| usize::from(item.size())).sum()
}

/// Creates a LASzip record of `items`, as a program of that version of each would write it.
fn laszip_record(compressor: u8, items: &[(LazItemType, u16)]) -> Vec<u8> {
    let mut record = vec![0; 34];
    record[0] = compressor;
    record[12] = 1;
    record[32] = items.len() as u8;
    for &(kind, version) in items {
        let mut builder = LazItemRecordBuilder::new();
        builder.add_item(kind);
        record.extend([kind.into(), builder.build()[0].size(), version].map(u16::to_le_bytes).as_flattened());
    }
    record
}

/// Returns the items as Slicewalk reads them.
fn own(items: &[LazItem]) -> Vec<Item> {
    let items: Vec<_> = items.iter().map(|item| (item.item_type(), item.version())).collect();
    let compressor = if items[0].0 == LazItemType::Point14 { 3 } else { 2 };
    LaszipRecord::read(&laszip_record(compressor, &items)).unwrap().items
}

fn old_items(time: bool, colour: bool, packet: bool, extra: u16) -> Vec<LazItem> {
    let mut builder = LazItemRecordBuilder::new();
    builder.add_item(LazItemType::Point10);
    if time {
        builder.add_item(LazItemType::GpsTime);
    }
    if colour {
        builder.add_item(LazItemType::RGB12);
    }
    if packet {
        builder.add_item(LazItemType::WavePacket13);
    }
    if extra > 0 {
        builder.add_item(LazItemType::Byte(extra));
    }
    builder.build()
}

/// Packs consecutive chunks of `chunk_points` points.
fn pack(items: &[LazItem], records: &[u8], chunk_points: usize) -> Vec<u8> {
    let mut packed = Vec::new();
    for chunk in records.chunks(record_bytes(items) * chunk_points) {
        let mut compressor = SequentialPointRecordCompressor::new(Vec::new());
        compressor.set_fields_from(&items.to_vec()).unwrap();
        chunk.chunks_exact(record_bytes(items)).for_each(|record| compressor.compress_next(record).unwrap());
        compressor.done().unwrap();
        packed.extend(compressor.into_inner());
    }
    packed
}

/// Creates a file of `bytes`; dropping the second value removes it.
fn source(bytes: &[u8]) -> (Source, tempfile::NamedTempFile) {
    let mut file = tempfile::NamedTempFile::new().unwrap();
    file.write_all(bytes).unwrap();
    (Source::open(file.path(), None).unwrap(), file)
}

/// Decodes up to `points` records by a decoder of `laz`, until the first that fails.
fn whole_by_laz<R>(decoder: &mut impl RecordDecompressor<R>, items: &[LazItem], points: usize) -> Vec<u8> {
    let mut records = vec![0; points * record_bytes(items)];
    let mut whole = 0;
    for record in records.chunks_exact_mut(record_bytes(items)) {
        // `laz` panics on damage.
        if !matches!(catch_unwind(AssertUnwindSafe(|| decoder.decompress_next(record))), Ok(Ok(()))) {
            break;
        }
        whole += record.len();
    }
    records.truncate(whole);
    records
}

/// Returns the whole records that `laz` decodes from one chunk, and the bytes consumed if all are whole.
fn by_laz(packed: &[u8], items: &[LazItem], points: usize) -> (Vec<u8>, Option<u64>) {
    let mut decoder = SequentialPointRecordDecompressor::new(Cursor::new(packed));
    decoder.set_fields_from(&items.to_vec()).unwrap();
    let records = whole_by_laz(&mut decoder, items, points);
    let all = records.len() == points * record_bytes(items);
    (records, all.then(|| decoder.get().position()))
}

/// Returns the records that Slicewalk decodes, `at_a_time` per call, and the bytes consumed if all chunks are whole.
fn by_ours(
    source: &Source,
    items: &[LazItem],
    len: u64,
    points: usize,
    chunk_points: u64,
    at_a_time: usize,
) -> (Vec<u8>, Option<u64>) {
    let mut decoder = Sequence::new(source, Items::of(&own(items)).unwrap(), (0, len), points as u64, chunk_points);
    let mut records = vec![0; points * record_bytes(items)];
    let mut whole = 0;
    for slab in records.chunks_mut(at_a_time * record_bytes(items)) {
        let mut filled = 0;
        let outcome = decoder.next(slab, &mut filled);
        whole += filled * record_bytes(items);
        if outcome.is_err() {
            break;
        }
    }
    records.truncate(whole);
    (records, (decoder.whole() == points as u64).then(|| decoder.position()))
}

fn a_few(most: usize) -> impl Strategy<Value = Vec<Vec<Change>>> {
    proptest::collection::vec(proptest::collection::vec(change(), 1..30), 1..most)
}

proptest! {
    #[test]
    fn a_sequence_gives_back_what_was_packed(
        changes in a_few(40), repeats in 1usize..60, time: bool, colour: bool, packet: bool, extra in 0u16..4,
        chunk_points in 1usize..900, at_a_time in 1usize..300
    ) {
        let items = old_items(time, colour, packet, extra);
        let changes = vec![changes; repeats].concat();
        let packed = pack(&items, &records(&items, &changes), chunk_points);
        let (source, _file) = source(&packed);
        let len = packed.len() as u64;
        let (ours, taken) = by_ours(&source, &items, len, changes.len(), chunk_points as u64, at_a_time);
        prop_assert!(ours == records(&items, &changes));
        prop_assert_eq!(taken, Some(len));
    }

    #[test]
    fn a_cut_or_damaged_sequence_gives_what_laz_finds_in_it(
        changes in a_few(40), repeats in 1usize..30, time: bool, colour: bool, packet: bool, extra in 0u16..4,
        cut in 0.0f64..1.0, flips in proptest::collection::vec((0.0f64..1.0, 1u8..), 0..3)
    ) {
        let items = old_items(time, colour, packet, extra);
        let changes = vec![changes; repeats].concat();
        let mut packed = pack(&items, &records(&items, &changes), usize::MAX / 100);
        for (at, bits) in &flips {
            let at = (at * packed.len() as f64) as usize;
            packed[at] ^= bits;
        }
        let (source, _file) = source(&packed);
        let len = ((1.0 - cut * cut) * packed.len() as f64) as u64;
        let (ours, taken) = by_ours(&source, &items, len, changes.len(), changes.len() as u64, usize::MAX / 100);
        let (theirs, taken_by_laz) = by_laz(&packed[..len as usize], &items, changes.len());
        // Slicewalk continues where `laz` panics on damage; no writer changes the sequence of a time more than four
        // times.
        let shared = ours.len().min(theirs.len());
        prop_assert!(ours[..shared] == theirs[..shared]);
        if flips.is_empty() || !time {
            prop_assert!(ours.len() >= theirs.len());
        }
        if flips.is_empty() {
            prop_assert_eq!(ours.len(), theirs.len());
            prop_assert_eq!(taken, taken_by_laz);
        }
    }
}

/// More bytes than are held at once, and chunks that end within them.
#[test]
fn a_long_sequence_is_read_piece_by_piece() {
    let items = old_items(true, true, true, 1);
    let mut seed = 1u64;
    let mut random = || {
        seed = seed.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
        seed >> 33
    };
    let changes: Vec<Vec<Change>> =
        (0..60_000).map(|_| (0..21).map(|_| Change::Becomes(random() << 20 ^ random())).collect()).collect();
    let records = records(&items, &changes);
    let packed = pack(&items, &records, 25_000);
    assert!(packed.len() > 20 << 16);
    let (source, _file) = source(&packed);
    let len = packed.len() as u64;
    let (ours, taken) = by_ours(&source, &items, len, changes.len(), 25_000, 1000);
    assert!(ours == records);
    assert_eq!(taken, Some(len));
}

/// Returns items of points in layers, optionally with RGB, or RGB and near infrared.
fn new_items(version: u16, colour: Option<(LazItemType, u16)>, extra: u16) -> Vec<LazItem> {
    let extra = (extra > 0).then_some((LazItemType::Byte14(extra), version));
    let items: Vec<_> = [(LazItemType::Point14, version)].into_iter().chain(colour).chain(extra).collect();
    // The builders only know version 3.
    LazVlr::from_buffer(laszip_record(3, &items)).unwrap().items().clone()
}

fn pack_layers(items: &[LazItem], records: &[u8]) -> Vec<u8> {
    let mut compressor = LayeredPointRecordCompressor::new(std::io::Cursor::new(Vec::new()));
    compressor.set_fields_from(&items.to_vec()).unwrap();
    records.chunks_exact(record_bytes(items)).for_each(|record| compressor.compress_next(record).unwrap());
    compressor.done().unwrap();
    compressor.into_inner().into_inner()
}

/// Returns the wanted fields, one per bit.
fn wanted(bits: u8) -> Wanted {
    let bit = |n: u8| bits >> n & 1 == 1;
    Wanted { classes: bit(0), intensity: bit(1), rgb: bit(2), source_ids: bit(3), times: bit(4) }
}

/// Returns the whole records that `laz` decodes, limited to these fields.
fn layers_by_laz(packed: &[u8], items: &[LazItem], wanted: Wanted, points: usize) -> Vec<u8> {
    let add = |all: DecompressionSelection, wanted, with: fn(DecompressionSelection) -> DecompressionSelection| {
        match wanted {
            true => with(all),
            false => all,
        }
    };
    let all = DecompressionSelection::base().decompress_z().decompress_flags();
    let all = add(all, wanted.classes, DecompressionSelection::decompress_classification);
    let all = add(all, wanted.intensity, DecompressionSelection::decompress_intensity);
    let all = add(all, wanted.rgb, DecompressionSelection::decompress_rgb);
    let all = add(all, wanted.source_ids, DecompressionSelection::decompress_point_source_id);
    let selection = add(all, wanted.times, DecompressionSelection::decompress_gps_time);
    let mut decoder = LayeredPointRecordDecompressor::new(std::io::Cursor::new(packed));
    decoder.set_fields_from(&items.to_vec()).unwrap();
    decoder.set_selection(selection);
    whole_by_laz(&mut decoder, items, points)
}

/// Returns the whole records that Slicewalk decodes, and whether all layers end after the last one.
fn layers_by_ours(
    packed: &[u8],
    items: &[LazItem],
    wanted: Wanted,
    points: usize,
    at_a_time: usize,
) -> (Vec<u8>, bool) {
    let (first, rest) = packed.split_at(record_bytes(items));
    let colour = (items.get(1)).filter(|item| matches!(item.item_type(), LazItemType::RGB14 | LazItemType::RGBNIR14));
    let layers: usize = own(items).iter().map(Item::layers).sum();
    let size = |layer: usize| u32_at(rest, 4 + 4 * layer) as usize;
    let places = places(wanted, 9);
    let (mut bytes, mut sizes) = (Vec::new(), [0; 8]);
    for (place, to) in places.iter().zip(&mut sizes) {
        let Some(place) = place.filter(|place| *place < layers) else { continue };
        let at = 4 + 4 * layers + (0..place).map(size).sum::<usize>();
        // Data that were cut off are missing.
        let layer = &rest[at.min(rest.len())..(at + size(place)).min(rest.len())];
        bytes.extend(layer);
        *to = layer.len();
    }
    let colour = colour.filter(|_| wanted.rgb).map(|item| (POINT_BYTES, item.version()));
    let mut decoder = Layers::new(first, bytes, sizes, items[0].version(), colour);
    // All other fields stay as in the first record.
    let mut records = first.repeat(points);
    let mut whole = first.len();
    for slab in records[first.len()..].chunks_mut(at_a_time * first.len()) {
        let mut filled = 0;
        let outcome = decoder.next(slab, first.len(), &mut filled);
        whole += filled * first.len();
        if outcome.is_err() {
            records.truncate(whole);
            return (records, false);
        }
    }
    (records, points == 1 || decoder.are_at_end())
}

fn colour() -> impl Strategy<Value = Option<(LazItemType, u16)>> {
    let item = proptest::sample::select(vec![LazItemType::RGB14, LazItemType::RGBNIR14]);
    proptest::option::of((item, 3u16..=4))
}

/// Returns the point of each record and, if wanted, its colour.
fn shown(records: &[u8], items: &[LazItem], wanted: Wanted) -> Vec<u8> {
    let colour = usize::from(wanted.rgb && items.len() > 1) * 6;
    records
        .chunks_exact(record_bytes(items))
        .flat_map(|record| &record[..(POINT_BYTES + colour).min(record.len())])
        .copied()
        .collect()
}

proptest! {
    #[test]
    fn layers_give_what_laz_finds_in_them(
        changes in a_few(40), repeats in 1usize..40, version in 3u16..=4, colour in colour(), extra in 0u16..2,
        bits: u8, at_a_time in 1usize..300, flips in proptest::collection::vec((0.0f64..1.0, 1u8..), 0..3)
    ) {
        let items = new_items(version, colour, if colour.is_some() { extra } else { 0 });
        let wanted = Wanted { rgb: wanted(bits).rgb && colour.is_some(), ..wanted(bits) };
        let changes = vec![changes; repeats].concat();
        let records = records(&items, &changes);
        let mut packed = pack_layers(&items, &records);
        let layers_at = record_bytes(&items) + 4 + 4 * (9 + 3);
        for (at, bits) in &flips {
            let at = layers_at + (at * packed.len().saturating_sub(layers_at) as f64) as usize;
            packed.get_mut(at).into_iter().for_each(|byte| *byte ^= bits);
        }
        let (ours, are_at_end) = layers_by_ours(&packed, &items, wanted, changes.len(), at_a_time);
        let ours = shown(&ours, &items, wanted);
        let theirs = shown(&layers_by_laz(&packed, &items, wanted, changes.len()), &items, wanted);
        if flips.is_empty() {
            prop_assert!(are_at_end);
            prop_assert_eq!(ours.len(), theirs.len());
            let all = Wanted { classes: true, intensity: true, rgb: wanted.rgb, source_ids: true, times: true };
            if bits & 0b11011 == 0b11011 {
                let whole = shown(&records, &items, all);
                let same = |at: usize| !(17..20).contains(&(at % (whole.len() / changes.len())));
                prop_assert!((0..whole.len()).filter(|&at| same(at)).all(|at| ours[at] == whole[at]));
            }
        }
        let shared = ours.len().min(theirs.len());
        prop_assert!(ours[..shared] == theirs[..shared]);
        if !wanted.times {
            prop_assert!(ours.len() >= theirs.len());
        }
    }
}

/// A writer may leave out the layer of a field that no point changes.
#[test]
fn fields_without_a_layer_stay_as_in_the_first_point() {
    const LAYERS: usize = 10;
    let rows: Vec<Vec<Change>> = (0..6)
        .map(|row| {
            let field = |field| match (row, field) {
                (0, _) => Change::Becomes(7),
                (_, 0) => Change::By(3),
                _ => Change::Stays,
            };
            (0..14).map(field).collect()
        })
        .collect();
    for version in [3, 4] {
        let items = new_items(version, Some((LazItemType::RGB14, version)), 0);
        let records = records(&items, &rows);
        let packed = pack_layers(&items, &records);
        let sizes_at = record_bytes(&items) + 4;
        let size = |layer: usize| u32_at(&packed, sizes_at + 4 * layer) as usize;
        // Heights and colours.
        for layer in [1, 9] {
            let at = sizes_at + 4 * LAYERS + (0..layer).map(size).sum::<usize>();
            let mut without = packed.clone();
            without.drain(at..at + size(layer));
            without[sizes_at + 4 * layer..][..4].fill(0);
            let (found, are_at_end) = layers_by_ours(&without, &items, wanted(0b11111), rows.len(), 4);
            assert!(found == records && are_at_end, "version {version}, layer {layer}");
        }
    }
}

#[test]
fn records_of_items_that_are_none_are_refused() {
    let good = laszip_record(2, &[(LazItemType::Point10, 2), (LazItemType::GpsTime, 2)]);
    assert!(LaszipRecord::read(&good).is_ok());
    let with = |at: usize, new: &[u8]| {
        let mut record = good.clone();
        record[at..at + new.len()].copy_from_slice(new);
        record
    };
    for (record, words) in [
        (good[..33].to_vec(), "33 bytes long, expected 34 or more"),
        (with(2, &[1]), "its coder is 1"),
        (with(12, &[0; 4]), "its chunks have 0 points"),
        (with(32, &[0, 0]), "it lists 0 items"),
        (with(32, &[3, 0]), "it lists 3 items in 46 bytes"),
        (with(34, &[5]), "items of type 5 are unknown"),
        (with(36, &[21]), "its Point10 has 21 bytes, expected 20"),
        (laszip_record(2, &[(LazItemType::GpsTime, 2)]), "its first item is GpsTime11, expected a point"),
        (with(0, &[3]), "compressor 3 does not fit its items"),
    ] {
        let reason = LaszipRecord::read(&record).unwrap_err();
        assert!(reason.contains(words), "{words}: {reason}");
    }
}

/// The list of chunks takes memory: a table of more chunks than may be listed is refused before it is read.
#[test]
fn chunks_beyond_the_memory_are_refused() {
    let mut file = vec![0; 227];
    let mut put = |at: usize, bytes: &[u8]| file[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, b"LASF");
    put(24, &[1, 2]);
    put(94, &[227, 0, 227]);
    put(104, &[0x80, 20, 0, 100]);
    (0..3).for_each(|axis| put(131 + 8 * axis, &1f64.to_le_bytes()));
    // The place of the table, 40 bytes of points, and the head of the table: its version and the number of chunks.
    file.extend(275u64.to_le_bytes());
    file.extend([7; 40]);
    file.extend([0, 0, 0, 0, 5, 0, 0, 0]);
    let (source, _file) = source(&file);
    let header = LasHeader::read(&source, file.len() as u64).unwrap();
    let packing = Packing::read(&source, &laszip_record(2, &[(LazItemType::Point10, 2)]), 1 << 20).unwrap();
    let body = |most_chunks: u64| {
        let (notes, lost) = (Vec::new(), Vec::new());
        let mut findings = Findings { path: source.path(), allow_incomplete: false, notes, lost, points: 0 };
        packing.body(&source, &header, file.len() as u64, most_chunks, &mut findings).map(|_| findings.notes)
    };
    assert!(matches!(body(4), Err(Error::Limit { .. })));
    // The table is cut behind its head.
    assert!(body(5).unwrap()[0].contains("chunk table is cut"));
}

/// LASzip drops the intensity of the first point, so an intensity of 0 after it counts as unchanged.
#[test]
fn an_intensity_of_nothing_may_follow_the_first() {
    let items = old_items(false, false, false, 0);
    let row =
        |intensity| (0..9).map(|field| if field == 3 { Change::Becomes(intensity) } else { Change::Stays }).collect();
    let changes: Vec<Vec<Change>> = [7, 0, 0, 9, 9].map(row).into();
    let records = records(&items, &changes);
    let packed = pack(&items, &records, 5);
    let (source, _file) = source(&packed);
    assert_eq!(by_ours(&source, &items, packed.len() as u64, 5, 5, 5).0, records);
}

/// Packs points and times of version 1 by `laz`. Its colours and extra bytes of that version differ from LASzip's, so
/// these are packed here.
fn pack_version_one(records: &[u8], time: bool, colour: bool, extra: usize) -> Vec<u8> {
    let len = 20 + 8 * usize::from(time) + 6 * usize::from(colour) + extra;
    let (point_bytes, extra_at) = (20 + 8 * usize::from(time), len - extra);
    let (first, others) = records.split_at(len);
    let mut encoder = ArithmeticEncoder::new(first.to_vec());
    let mut point = point0::v1::LasPoint0Compressor::default();
    let mut times = gps::v1::LasGpsTimeCompressor::default();
    let numbers = |contexts| IntegerCompressorBuilder::new().bits(8).contexts(contexts).build_initialized();
    let mut changes = ArithmeticModelBuilder::new(64).build();
    let (mut colours, mut bytes) = (numbers(6), numbers(extra.max(1) as u32));
    point.compress_first(&mut Vec::new(), &first[..20]).unwrap();
    if time {
        times.compress_first(&mut Vec::new(), &first[20..28]).unwrap();
    }
    let mut last = first;
    for record in others.chunks_exact(len) {
        point.compress_with(&mut encoder, &record[..20]).unwrap();
        if time {
            times.compress_with(&mut encoder, &record[20..28]).unwrap();
        }
        let differ = |at: &usize| last[point_bytes + at] != record[point_bytes + at];
        if colour {
            let changed = (0..6).filter(differ).fold(0, |changed, at| changed | 1 << at);
            encoder.encode_symbol(&mut changes, changed).unwrap();
            for at in (0..6).filter(differ) {
                let [before, now] = [last, record].map(|record| i32::from(record[point_bytes + at]));
                colours.compress(&mut encoder, before, now, at as u32).unwrap();
            }
        }
        for at in 0..extra {
            let [before, now] = [last, record].map(|record| i32::from(record[extra_at + at]));
            bytes.compress(&mut encoder, before, now, at as u32).unwrap();
        }
        last = record;
    }
    encoder.done().unwrap();
    encoder.into_inner()
}

proptest! {
    #[test]
    fn a_sequence_of_the_first_version_gives_back_what_was_packed(
        changes in a_few(40), repeats in 1usize..60, time: bool, colour: bool, extra in 0usize..4, at_a_time in 1usize..300
    ) {
        let kinds = [(true, LazItemType::Point10), (time, LazItemType::GpsTime), (colour, LazItemType::RGB12)];
        let kinds = kinds.into_iter().chain([(extra > 0, LazItemType::Byte(extra as u16))]);
        let listed: Vec<_> = kinds.filter(|(is_there, _)| *is_there).map(|(_, kind)| (kind, 1)).collect();
        let items = LazVlr::from_buffer(laszip_record(2, &listed)).unwrap().items().clone();
        let changes = vec![changes; repeats].concat();
        // `laz` assumes that differences of coordinates, and small multiples of time differences, do not overflow.
        let mut records = records(&items, &changes);
        for record in records.chunks_exact_mut(record_bytes(&items)) {
            record[..12].chunks_exact_mut(4).for_each(|number| number[3] &= 0x3F);
            if time {
                record[23] &= 0x01;
            }
        }
        let packed = pack_version_one(&records, time, colour, extra);
        let (source, _file) = source(&packed);
        let len = packed.len() as u64;
        let (ours, taken) = by_ours(&source, &items, len, changes.len(), changes.len() as u64, at_a_time);
        prop_assert!(ours == records);
        prop_assert_eq!(taken, Some(len));
    }
}

//! LAZ files, sound and damaged: chunks, their table, counts and items.

mod flips;

use crate::las::{Folder, RECORD_BYTES, Scan, chunk_places, numbers, read, read_one, read_strictly, refusal, varied};
use laz::laszip::{ChunkTable, ChunkTableEntry};
use slicewalk::colour::ColourSource;
use slicewalk::{Error, NoMonitor};
use slicewalk_convert::{ColourMode, ConvertOptions, PixelSize, convert};
use slicewalk_input::{InputOptions, InputSet, PointCounts, PointDecoder, Tag};

/// For chunks of any length.
#[test]
fn the_same_records_plain_and_packed_give_the_same_archive() {
    let folder = Folder::new();
    let mut random = numbers(88_172_645_463_325_252);
    let modes = [ColourMode::Auto, ColourMode::Of(ColourSource::Intensity), ColourMode::Of(ColourSource::Class)];
    let archive = |bytes: &[u8], name: &str, exclude: bool, colour: ColourMode| {
        let path = folder.file(name, bytes);
        let mut options = ConvertOptions::new(vec![path], folder.0.path().join("a.slices"));
        options.grid.pixel = PixelSize::Metres(5.0);
        options.overwrite = true;
        options.sections.colour = colour;
        if exclude {
            options.plan.exclude_classes = [3].into_iter().collect();
        }
        // If all values are 0, both are refused.
        match convert(&options, &NoMonitor) {
            Ok(_) => std::fs::read(&options.output).unwrap(),
            Err(error) => error.to_string().into_bytes(),
        }
    };
    let mut archives = 0;
    for round in 0..44u64 {
        let format = (round % 11) as u8;
        let (points, extra) = (1 + random() as u32 % 900, random() as usize % 4);
        let scan = varied(format, points, extra, &mut random);
        let chunk = [0, 1 + random() as u32 % 40, 50 + random() as u32 % 400, 50_000][round as usize / 11];
        let (exclude, colour) = (random() & 1 == 0, modes[random() as usize % 3]);
        let [plain, packed] = [(scan.las(), "a.las"), (scan.laz(chunk), "b.laz")]
            .map(|(bytes, name)| archive(&bytes, name, exclude, colour));
        assert!(plain == packed, "format {format}, chunks of {chunk}");
        archives += usize::from(plain.len() > 300);
    }
    assert!(archives > 30, "{archives}");
}

/// On a machine with very many processors, a thread's share of a small budget is less than a chunk.
#[test]
fn chunks_larger_than_the_share_of_a_thread_are_read() {
    let folder = Folder::new();
    for format in [1, 7] {
        let path = folder.file("a.laz", &Scan::new(4, format, 20_000).laz(9_000));
        let archive = |threads: usize| {
            let mut options = ConvertOptions::new(vec![path.clone()], folder.0.path().join("a.slices"));
            options.grid.pixel = PixelSize::Metres(5.0);
            options.overwrite = true;
            (options.resources.threads, options.resources.memory_bytes) = (threads, 64 << 20);
            convert(&options, &NoMonitor).unwrap();
            std::fs::read(&options.output).unwrap()
        };
        assert!(archive(500) == archive(1), "format {format}");
    }
}

#[test]
fn extra_bytes_are_stepped_over_and_bound_the_memory() {
    let folder = Folder::new();
    for format in [1, 7] {
        let mut scan = Scan::new(4, format, 600);
        scan.records.iter_mut().for_each(|r| r.extend((0..192).map(|i| i as u8)));
        for (name, bytes) in [("a.las", scan.las()), ("b.laz", scan.laz(250))] {
            let path = folder.file(name, &bytes);
            assert!(read_one(&path).unwrap().points == scan.expected());
            let options = InputOptions { memory_bytes: 1 << 20, ..InputOptions::default() };
            match read(&[path], options) {
                // Of layered points, only needed layers are decoded.
                Ok(found) => assert!((name == "a.las" || format == 7) && found.points.len() == 600),
                Err(error) => {
                    assert!(matches!(error, Error::Limit { .. }) && error.to_string().contains("give more memory"))
                }
            }
        }
    }
}

#[test]
fn items_and_not_the_header_state_where_times_and_colours_lie() {
    let folder = Folder::new();
    let open =
        |bytes: &[u8]| InputSet::open(&[folder.file("a.laz", bytes)], InputOptions::default(), &NoMonitor).unwrap();
    let decode = |set: &InputSet| {
        let (mut values, mut tags) = (Vec::new(), 0);
        let chunk = set.chunks().next().unwrap();
        let counts = PointDecoder::new().decode(set, &chunk, &mut |batch| {
            values.extend_from_slice(&batch.values);
            tags += batch.tags.len();
            Ok(())
        });
        assert_eq!(counts.unwrap().read, 50);
        (values, tags)
    };
    // A header of format 1, items of format 0.
    let mut bytes = Scan::new(4, 0, 100).laz(50);
    bytes[104] = 0x81;
    bytes[105..107].copy_from_slice(&28u16.to_le_bytes());
    let mut set = open(&bytes);
    assert!(!set.files()[0].has_tags(Tag::GpsTime));
    set.set_tag(Some(Tag::GpsTime));
    assert_eq!(decode(&set).1, 0);
    // A header of format 0, items of format 3.
    let mut scan = Scan::new(4, 3, 100);
    scan.records.iter_mut().for_each(|record| record[28..34].copy_from_slice(&[1, 0, 2, 0, 3, 0]));
    let mut bytes = scan.laz(50);
    bytes[104] = 0x80;
    bytes[105..107].copy_from_slice(&20u16.to_le_bytes());
    let mut set = open(&bytes);
    assert!(set.files()[0].has_tags(Tag::GpsTime));
    set.set_tag(Some(Tag::GpsTime));
    set.set_colour(Some(ColourSource::Rgb));
    assert_eq!(decode(&set), (vec![[1, 2, 3]; 50], 50));
}

#[test]
fn points_that_no_chunk_holds_are_counted_as_missing() {
    let folder = Folder::new();
    for format in [1, 7] {
        let mut bytes = Scan::new(4, format, 120).laz(50);
        bytes[107..111].copy_from_slice(&200u32.to_le_bytes());
        bytes[247..255].copy_from_slice(&200u64.to_le_bytes());
        let options = InputOptions { allow_incomplete: true, ..InputOptions::default() };
        let set = InputSet::open(&[folder.file("a.laz", &bytes)], options, &NoMonitor).unwrap();
        let (mut decoder, mut counts) = (PointDecoder::new(), PointCounts::default());
        set.chunks().for_each(|chunk| counts += decoder.decode(&set, &chunk, &mut |_| Ok(())).unwrap());
        set.check_complete(&NoMonitor).unwrap();
        let missing = set.points_missing() + counts.missing;
        assert_eq!((counts.read + missing, set.is_complete()), (200, false), "format {format}");
        assert_eq!(counts.read, if format == 1 { 100 } else { 120 });
    }
}

#[test]
fn a_cut_laz_gives_the_points_before_the_cut_or_one_line() {
    let folder = Folder::new();
    for (format, chunk) in [(1u8, 500), (7, 500), (3, 0), (6, 0)] {
        let scan = Scan::new(4, format, 2400);
        let (whole, expected) = (scan.laz(chunk), scan.expected());
        let mut most = 0;
        for len in (0..whole.len()).step_by(97).chain([whole.len() - 1, whole.len() - 9]) {
            let path = folder.file("cut.laz", &whole[..len]);
            match read_one(&path) {
                Ok(found) => {
                    // Only whole chunks count, because the last points before a cut cannot be checked.
                    let n = found.points.len();
                    assert!(n <= 2400 && found.points[..] == expected[..n], "format {format}, {len} bytes");
                    assert!(chunk == 0 || n % chunk as usize == 0 || n == 2400, "format {format}, {len} bytes: {n}");
                    assert!(
                        found.warnings.contains("cut") || found.warnings.contains("ends before"),
                        "{}",
                        found.warnings
                    );
                    most = most.max(n);
                }
                Err(error) => assert!(!error.to_string().contains('\n')),
            }
        }
        // In formats 0 to 5, chunks of varying length cannot be found without their table.
        assert!(if (format, chunk) == (3, 0) { most == 0 } else { most > 1800 }, "format {format}: {most}");
    }
}

#[test]
fn a_lost_chunk_table_costs_nothing_where_chunks_can_be_found() {
    let folder = Folder::new();
    for (format, chunk) in [(0u8, 500), (6, 500), (7, 0)] {
        let scan = Scan::new(4, format, 1700);
        let good = scan.laz(chunk);
        let at = u32::from_le_bytes(good[96..100].try_into().unwrap()) as usize;
        let table = i64::from_le_bytes(good[at..at + 8].try_into().unwrap());
        for place in [-1, 0, 17, i64::MAX, i64::MIN, table + 1, table - 1, good.len() as i64 - 3] {
            let mut bytes = good.clone();
            bytes[at..at + 8].copy_from_slice(&place.to_le_bytes());
            let found = read_strictly(&[folder.file("lost.laz", &bytes)], InputOptions::default());
            let found = found.unwrap_or_else(|error| panic!("format {format}, table at {place}: {error}"));
            assert!(found.points == scan.expected(), "format {format}, {place}: {}", found.points.len());
            assert!(found.warnings.contains("chunk table"), "{}", found.warnings);
        }
        // Written to a pipe: the position of the table is at the end of the file.
        let mut bytes = good.clone();
        bytes[at..at + 8].copy_from_slice(&(-1i64).to_le_bytes());
        bytes.extend(table.to_le_bytes());
        let found = read_one(&folder.file("pipe.laz", &bytes)).unwrap();
        assert!(found.points == scan.expected() && !found.warnings.contains("chunk table"), "{}", found.warnings);
    }
}

#[test]
fn chunk_tables_that_lie_lose_no_point_unnoticed() {
    let folder = Folder::new();
    for (format, chunk) in [(1u8, 300), (6, 300), (7, 0), (3, 0)] {
        let scan = Scan::new(4, format, 2450);
        let (good, vlr) = (scan.laz(chunk), scan.vlr(chunk));
        let points_at = u32::from_le_bytes(good[96..100].try_into().unwrap()) as u64;
        let table_at = u64::from_le_bytes(good[points_at as usize..][..8].try_into().unwrap()) as usize;
        let mut file = std::io::Cursor::new(&good);
        file.set_position(points_at);
        let table = ChunkTable::read_from(&mut file, &vlr).unwrap();
        let entries: Vec<(u64, u64)> = table.as_ref().iter().map(|e| (e.point_count, e.byte_count)).collect();
        assert!(entries.len() > 4);
        let mut lies =
            vec![entries[..1].to_vec(), entries[..entries.len() - 1].to_vec(), entries[1..].to_vec(), vec![]];
        lies.push([&entries[..], &entries[..2]].concat());
        lies.push([&entries[..], &[(1, 40)]].concat());
        lies.push(vec![(2450, entries.iter().map(|e| e.1).sum())]);
        // A chunk that is too short for anything.
        let mut short = entries.clone();
        (short[1].1, short[2].1) = (5, short[2].1 + short[1].1 - 5);
        lies.push(short);
        for (at, from) in [(0, 1), (2, 3), (entries.len() - 2, entries.len() - 1)] {
            for bytes in [1, 7, 500].map(|bytes: u64| bytes.min(entries[at].1).min(entries[from].1)) {
                let mut shifted = entries.clone();
                (shifted[at].1, shifted[from].1) = (shifted[at].1 + bytes, shifted[from].1 - bytes);
                lies.push(shifted);
                let mut less = entries.clone();
                less[at].1 -= bytes;
                lies.push(less);
                let mut more = entries.clone();
                more[at].1 += bytes;
                lies.push(more);
            }
            for points in [1, 90].into_iter().filter(|&points| points <= entries[at].0) {
                let mut counts = entries.clone();
                counts[at].0 -= points;
                lies.push(counts.clone());
                counts[from].0 += points;
                lies.push(counts);
            }
        }
        let (mut whole, mut refused) = (0, 0);
        for (number, lie) in lies.iter().enumerate() {
            let mut table = ChunkTable::with_capacity(lie.len());
            lie.iter().for_each(|&(point_count, byte_count)| table.push(ChunkTableEntry { point_count, byte_count }));
            for stated in [2450u32, lie.iter().map(|e| e.0 as u32).sum::<u32>().min(2450), 2449] {
                let mut bytes = good[..table_at].to_vec();
                bytes[107..111].copy_from_slice(&stated.to_le_bytes());
                bytes[247..255].copy_from_slice(&u64::from(stated).to_le_bytes());
                table.write_to(&mut bytes, &vlr).unwrap();
                let path = folder.file("lie.laz", &bytes);
                match read_strictly(std::slice::from_ref(&path), InputOptions::default()) {
                    Ok(found) => {
                        let read = found.points.len();
                        assert!(stated == 2450, "format {format}, lie {number}: {stated} stated, {read} points");
                        assert!(found.points == scan.expected(), "format {format}, lie {number}: {read} points");
                        whole += 1;
                    }
                    Err(error) => {
                        assert!(!error.to_string().contains('\n'), "{error}");
                        refused += 1;
                    }
                }
                if lie == &entries && stated == 2450 {
                    assert!(refused == 0);
                }
            }
        }
        println!("format {format}, chunks of {chunk}: {whole} read whole, {refused} refused");
        assert!(refused > 5 && (whole > 5 || format == 3), "format {format}: {whole} {refused}");
    }
}

#[test]
fn chunks_of_few_points_give_them_and_cost_what_they_hold() {
    let folder = Folder::new();
    for (format, points, chunk) in [(0u8, 700, 1), (3, 700, 1), (6, 700, 1), (8, 700, 1), (7, 700, 2), (1, 700, 3)] {
        let scan = Scan::new(4, format, points);
        let path = folder.file("few.laz", &scan.laz(chunk));
        let found = read_strictly(std::slice::from_ref(&path), InputOptions::default()).unwrap();
        assert!(found.points == scan.expected(), "format {format}, chunks of {chunk}");
        assert!(found.warnings.lines().all(|line| line.contains("no unit")), "{}", found.warnings);
    }
}

#[test]
fn counts_that_lie_are_survived() {
    let folder = Folder::new();
    let scan = Scan::new(2, 0, 1700);
    let expected = scan.expected();
    let stating = |bytes: &[u8], count: u32| {
        let mut bytes = bytes.to_vec();
        bytes[107..111].copy_from_slice(&count.to_le_bytes());
        bytes
    };
    for count in [1, 1500, 1690, 1701, 2001, u32::MAX] {
        let found = read_one(&folder.file("lie.las", &stating(&scan.las(), count))).unwrap();
        assert_eq!(found.points, expected[..(count as usize).min(1700)]);
        if count == 1701 {
            // Indistinguishable from damage in the last chunk, which is more likely.
            let text = refusal(&folder.file("lie.laz", &stating(&scan.laz(500), count)));
            assert!(text.contains("LAZ chunk 3: damaged") && text.contains("of 201"), "{text}");
        }
        let path = folder.file("lie.laz", &stating(&scan.laz(500), count));
        refusal(&path);
        // The last chunk is dropped: nothing states how many points it has.
        let found = read_one(&path).unwrap();
        assert!(found.points == expected[..1500], "{count}: {} points", found.points.len());
    }
    for bytes in [scan.las(), scan.laz(500)] {
        let text = refusal(&folder.file("zero.laz", &stating(&bytes, 0)));
        assert!(text.contains("states 0 points") && text.contains("interrupted"), "{text}");
    }
    // Layered chunks state their number of points.
    let scan = Scan::new(4, 6, 1700);
    for count in [0u64, 1, 1500, 1699, 1701, u64::MAX] {
        let mut bytes = scan.laz(500);
        bytes[107..111].copy_from_slice(&0u32.to_le_bytes());
        bytes[247..255].copy_from_slice(&count.to_le_bytes());
        let path = folder.file("lie.laz", &bytes);
        let text = refusal(&path);
        assert!(text.contains(&format!("the header states {count} points, its chunks hold 1700")), "{text}");
        let found = read_one(&path).unwrap();
        assert!(found.points == scan.expected(), "{count}");
        assert!(found.warnings.contains("its chunks hold 1700"), "{}", found.warnings);
    }
}

/// On a straight line, points cost no bits: only the numbers by return show how many there are.
#[test]
fn a_count_other_than_that_by_return_is_refused_where_the_data_end_soundly_after_both() {
    let folder = Folder::new();
    for (format, chunk) in [(0, 700), (1, 50_000)] {
        let mut scan = Scan::new(2, format, 1000);
        for (i, record) in (0i32..).zip(&mut scan.records) {
            record[..12].copy_from_slice(&[i * 10, 7, 7].map(i32::to_le_bytes).concat());
            record[15] = 2;
        }
        let stating = |count: u32, by_return: u32| {
            let mut bytes = scan.laz(chunk);
            bytes[107..111].copy_from_slice(&count.to_le_bytes());
            bytes[111..115].copy_from_slice(&by_return.to_le_bytes());
            folder.file("line.laz", &bytes)
        };
        for count in [999, 1001] {
            let path = stating(count, 1000);
            let words = format!("the header states {count} points, but 1000 by return");
            let said = refusal(&path);
            assert!(said.contains(&words), "{said}");
            let found = read_one(&path).unwrap();
            assert!(found.points.len() <= count as usize && found.warnings.contains(&words), "{}", found.warnings);
        }
        assert_eq!(read_one(&stating(1000, 1000)).unwrap().points, scan.expected());
        // Numbers by return that the data contradict, or none.
        for by_return in [0, 12, 60_000] {
            let found = read_strictly(&[stating(1000, by_return)], InputOptions::default());
            assert_eq!(found.unwrap().points, scan.expected(), "{by_return}");
        }
    }
    // Returns that the header does not count; chunks that state their own numbers of points.
    let scan = Scan::new(2, 1, 1000);
    for chunk in [50_000, 0] {
        let mut bytes = scan.laz(chunk);
        bytes[111..115].copy_from_slice(&990u32.to_le_bytes());
        let found = read_strictly(&[folder.file("many.laz", &bytes)], InputOptions::default());
        assert_eq!(found.unwrap().points, scan.expected(), "chunks of {chunk}");
    }
}

/// The count in the head of the last chunk is not trusted if the header contradicts it.
#[test]
fn a_count_in_a_layered_chunk_that_lies_is_refused() {
    let folder = Folder::new();
    for (format, chunk, points) in [(6u8, 50_000, 600u32), (8, 500, 600), (7, 0, 600)] {
        let scan = Scan::new(4, format, points);
        let good = scan.laz(chunk);
        let places = chunk_places(&good, &scan, chunk);
        let filled = places.windows(2).rfind(|place| place[1] - place[0] > 4).unwrap();
        let at = filled[0] + RECORD_BYTES[usize::from(format)];
        let held = u32::from_le_bytes(good[at..at + 4].try_into().unwrap());
        for count in [0, 1, held - 1, held + 1, u32::MAX] {
            let mut bad = good.clone();
            bad[at..at + 4].copy_from_slice(&count.to_le_bytes());
            let path = folder.file("count.laz", &bad);
            refusal(&path);
            // Every point that is left is one of the file.
            let found = read_one(&path).unwrap();
            assert!(found.points == scan.expected()[..(points - held) as usize], "format {format}, {count}");
        }
    }
}

/// Without a chunk table, the points must end where the table begins, or at the end of the file.
#[test]
fn garbage_behind_points_without_a_chunk_table_is_refused() {
    let folder = Folder::new();
    for (format, chunk) in [(1u8, 1), (1, 100), (3, 700), (6, 100)] {
        let scan = Scan::new(4, format, 600);
        let good = scan.laz(chunk);
        let place = u32::from_le_bytes(good[96..100].try_into().unwrap()) as usize;
        let table = *chunk_places(&good, &scan, chunk).last().unwrap();
        // The table's offset is lost, or its count.
        let mut lost = good.clone();
        lost[place..place + 8].copy_from_slice(&(-1i64).to_le_bytes());
        let mut wrong = good.clone();
        wrong[table + 7] ^= 2;
        for bytes in [&lost, &wrong] {
            let path = folder.file("table.laz", bytes);
            assert!(read_strictly(&[path], InputOptions::default()).unwrap().points == scan.expected());
            // Within layers of coordinates.
            let places = chunk_places(&good, &scan, chunk);
            let damaged = if format < 6 { [table - 40, table - 300] } else { [places[1] + 100, places[4] + 150] };
            for at in damaged {
                let mut bad = bytes.clone();
                bad[at..at + 16].iter_mut().enumerate().for_each(|(n, byte)| *byte ^= 0x5A + n as u8);
                refusal(&folder.file("damaged.laz", &bad));
            }
            // Bytes other than the table's where it should begin.
            let mut bad = bytes.clone();
            bad.splice(table..table, [7; 100]);
            if bytes == &lost {
                refusal(&folder.file("behind.laz", &bad));
            }
        }
    }
}

/// Chunks of equal length without a table, as LASzip's first versions wrote them: one for the whole file.
#[test]
fn a_file_of_one_sequence_reads_whole_or_not_at_all() {
    let folder = Folder::new();
    let scan = Scan::new(2, 3, 700);
    let chunked = scan.laz(50_000);
    let places = chunk_places(&chunked, &scan, 50_000);
    // Remove the table's offset and the table; compressor 1.
    let mut whole = chunked[..places[0] - 8].to_vec();
    let record = 227 + 54;
    assert_eq!(whole[record], 2);
    whole[record] = 1;
    whole.extend(&chunked[places[0]..places[1]]);
    let found = read_strictly(&[folder.file("whole.laz", &whole)], InputOptions::default()).unwrap();
    assert!(found.points == scan.expected());
    let refused =
        [whole[..whole.len() - 1].to_vec(), whole[..whole.len() / 2].to_vec(), [&whole[..], &[1; 40]].concat(), {
            let mut bad = whole.clone();
            bad[places[0] + 3000] ^= 1;
            bad
        }];
    for (number, bytes) in refused.iter().enumerate() {
        let path = folder.file("bad.laz", bytes);
        refusal(&path);
        // All points before unknown bytes are read.
        let left = read_one(&path).unwrap().points.len();
        assert_eq!(left, if number == 2 { 700 } else { 0 });
    }
}

/// Empty chunks: one in a file without points, one after the last.
#[test]
fn empty_chunks_and_empty_files_are_sound() {
    let folder = Folder::new();
    for format in 0..=10u8 {
        let scan = Scan::new(4, format, 130);
        let nothing = Scan { records: Vec::new(), ..scan.clone() };
        for chunk in [0, 50, 65, 130] {
            let good = scan.laz(chunk);
            let vlr = scan.vlr(chunk);
            let places = chunk_places(&good, &scan, chunk);
            let entry = |points: u64, bytes: usize| ChunkTableEntry { point_count: points, byte_count: bytes as u64 };
            let with_table = |mut body: Vec<u8>, entries: &[ChunkTableEntry]| {
                let at = body.len() as u64;
                let place = u32::from_le_bytes(body[96..100].try_into().unwrap()) as usize;
                body[place..place + 8].copy_from_slice(&at.to_le_bytes());
                let mut table = ChunkTable::with_capacity(entries.len());
                entries.iter().for_each(|entry| table.push(*entry));
                table.write_to(&mut body, &vlr).unwrap();
                body
            };
            // As `laz` ends it, with a chunk of only an encoder's end, and with an empty chunk.
            let mut file = std::io::Cursor::new(&good);
            file.set_position(places[0] as u64 - 8);
            let table = ChunkTable::read_from(&mut file, &vlr).unwrap();
            let filled: Vec<_> = table.as_ref().iter().filter(|entry| entry.byte_count > 4).copied().collect();
            let end = places[0] + filled.iter().map(|entry| entry.byte_count as usize).sum::<usize>();
            let plain = good[..end].to_vec();
            let mut cases = vec![good.clone(), with_table(plain.clone(), &[&filled[..], &[entry(0, 0)]].concat())];
            if format < 6 {
                let one_more = [&plain[..], &[1, 0, 0, 0]].concat();
                cases.push(with_table(one_more, &[&filled[..], &[entry(0, 4)]].concat()));
                let other = [&plain[..], &[1, 0, 2, 0]].concat();
                let other = with_table(other, &[&filled[..], &[entry(0, 4)]].concat());
                refusal(&folder.file("other.laz", &other));
            }
            for bytes in cases {
                let found = read_strictly(&[folder.file("full.laz", &bytes)], InputOptions::default()).unwrap();
                assert!(found.points == scan.expected(), "format {format}, chunks of {chunk}");
            }
            let head = nothing.laz(chunk)[..places[0]].to_vec();
            let mut empty: Vec<_> =
                [vec![], vec![entry(0, 0)]].iter().map(|entries| with_table(head.clone(), entries)).collect();
            // Points by return that no chunk holds.
            let mut returned = empty[0].clone();
            returned[111] = 9;
            // The file ends where points would begin, or has no table; chunks of any length cannot do without.
            let before = head[..places[0] - 8].to_vec();
            empty.extend([returned, before]);
            if format >= 6 || chunk > 0 {
                empty.push(head);
            } else {
                refusal(&folder.file("empty.laz", &head));
            }
            for (number, bytes) in empty.iter().enumerate() {
                let (empty, full) = (folder.file("empty.laz", bytes), folder.file("full.laz", &good));
                let found = read_strictly(&[empty, full], InputOptions::default())
                    .unwrap_or_else(|error| panic!("format {format}, chunks of {chunk}, empty {number}: {error}"));
                assert!(found.points == scan.expected(), "format {format}, chunks of {chunk}, empty {number}");
            }
        }
    }
}

/// An item that a layered record cannot have has no layer, so nothing may be read at its index.
#[test]
fn items_of_other_point_formats_are_refused_in_one_line() {
    let folder = Folder::new();
    for (format, from, to, names) in [(7, 11u16, 8u16, "Point14 and RGB12"), (3, 8, 11, "Point10 and RGB14")] {
        let mut bytes = Scan::new(4, format, 100).laz(50);
        // Each item of the record: type, bytes, version.
        let item = |kind: u16| [kind.to_le_bytes(), 6u16.to_le_bytes()].concat();
        let at = bytes.windows(4).position(|window| window == item(from)).unwrap();
        bytes[at..at + 4].copy_from_slice(&item(to));
        let text = refusal(&folder.file("mixed.laz", &bytes));
        assert!(text.contains("LASzip record") && text.contains(names), "{text}");
    }
}

/// A colour of an unknown version is refused only where colours are wanted.
#[test]
fn colours_of_an_unknown_version_are_refused_where_they_are_wanted() {
    let folder = Folder::new();
    let scan = Scan::new(4, 7, 100);
    let mut bytes = scan.laz(50);
    let item = [11u16.to_le_bytes(), 6u16.to_le_bytes()].concat();
    let at = bytes.windows(4).position(|window| window == item).unwrap();
    bytes[at + 4] = 9;
    let path = [folder.file("new.laz", &bytes)];
    assert_eq!(read_strictly(&path, InputOptions::default()).unwrap().points, scan.expected());
    let options = InputOptions { colour: Some(ColourSource::Rgb), ..InputOptions::default() };
    let error = read_strictly(&path, options).unwrap_err().to_string();
    assert!(error.contains("LAZ chunk 0") && error.contains("no decoder"), "{error}");
}

#[test]
fn a_chunk_that_does_not_fit_the_memory_is_refused() {
    let folder = Folder::new();
    let scan = Scan::new(4, 6, 600);
    let path = [folder.file("a.laz", &scan.laz(50_000))];
    let with = |memory_bytes| read_strictly(&path, InputOptions { memory_bytes, ..InputOptions::default() });
    assert_eq!(with(1 << 16).unwrap().points, scan.expected());
    let error = with(100).unwrap_err();
    assert!(
        matches!(error, Error::Limit { .. }) && error.to_string().contains("LAZ chunk 0: compressed bytes"),
        "{error}"
    );
}

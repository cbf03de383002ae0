//! Resuming from what another run left.

use super::*;
use std::time::SystemTime;

#[path = "../../../../tests/cloud/write.rs"]
mod write;

/// Names in the folder for temporary data.
fn temporary(job: &Job) -> Vec<String> {
    let entries = fs::read_dir(&job.options.resources.temp_dir).unwrap();
    entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
}

/// Interrupts a conversion with resuming after `points` points; returns how many points it read and how many it kept.
fn interrupt(job: &Job, points: u64) -> (u64, u64) {
    let stops = Stops::after(points);
    match job.convert(true, &stops) {
        Err(Error::Resumable { source, path, points, bytes }) => {
            assert!(
                matches!(*source, Error::Interrupted) && path.starts_with(&job.options.resources.temp_dir) && bytes > 0
            );
            assert_eq!(temporary(job).len(), 2);
            (stops.points(), points)
        }
        Err(Error::Interrupted) => (stops.points(), 0),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_conversion_goes_on_where_others_were_interrupted_and_makes_the_same_bytes() {
    let job = Job::new();
    let all = 2 * POINTS as u64;
    // Interrupt repeatedly, each time a little later.
    let mut kept_before = 0;
    for points in (1..=4).map(|fifths| fifths * all / 5) {
        let (read, kept) = interrupt(&job, points);
        // A run under construction, and the current batch.
        assert!(read.saturating_sub(kept) <= 8192 + POINTS as u64, "{read} read, {kept} kept");
        assert!(kept >= kept_before);
        kept_before = kept;
    }
    assert!(kept_before > all / 4, "{kept_before}");
    let report = job.convert(true, &NoMonitor).unwrap();
    assert_eq!(report.resumed.map(|resumed| resumed.points), Some(kept_before));
    assert!(fs::read(&job.options.output).unwrap() == job.new);
    assert!(temporary(&job).is_empty());
    assert_eq!(report.header.points_kept, all);
}

/// Monitor that cancels in the second pass.
struct InSecondPass(Stops);

impl Monitor for InSecondPass {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        self.0.stage(name, total, unit);
    }
    fn cancelled(&self) -> bool {
        self.0.stages.lock().unwrap().last().is_some_and(|stage| stage == "writing slices")
    }
}

#[test]
fn interrupted_while_it_writes_pages_a_conversion_reads_no_point_again() {
    let job = Job::new();
    let error = job.convert(true, &InSecondPass(Stops::after(0))).unwrap_err();
    assert!(matches!(error, Error::Resumable { points, .. } if points == 2 * POINTS as u64), "{error}");
    let said = error.to_string();
    assert!(said.starts_with("interrupted: nothing was written; resuming continues from 9000 points"), "{said}");
    let report = job.convert(true, &NoMonitor).unwrap();
    assert_eq!(report.resumed.map(|resumed| resumed.points), Some(2 * POINTS as u64));
    assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty());
}

#[test]
fn with_nothing_to_resume_a_conversion_begins_anew_and_without_the_option_it_cleans_up() {
    let job = Job::new();
    let report = job.convert(true, &NoMonitor).unwrap();
    assert!(report.resumed.is_none() && fs::read(&job.options.output).unwrap() == job.new);
    interrupt(&job, POINTS as u64 * 3 / 2);
    // Data for an archive of the same name in another folder belongs to another conversion.
    let mut other = job.options.clone();
    other.output = job.folder.path().join("other.d").join("a.slices");
    fs::create_dir(job.folder.path().join("other.d")).unwrap();
    convert_within(&other, Job::limits(), &NoMonitor).unwrap();
    assert_eq!(temporary(&job).len(), 2);
    let report = job.convert(false, &NoMonitor).unwrap();
    assert!(report.resumed.is_none() && temporary(&job).is_empty());
    // An interrupted run without `resume` leaves nothing.
    let error = job.convert(false, &Stops::after(POINTS as u64)).unwrap_err();
    assert!(matches!(error, Error::Interrupted) && temporary(&job).is_empty(), "{error}");
}

#[test]
fn changed_inputs_and_other_options_are_refused_and_what_was_kept_stays() {
    let job = Job::new();
    // Both scans were read completely.
    assert!(job.convert(true, &InSecondPass(Stops::after(0))).is_err());
    let kept = 2 * POINTS as u64;
    let refused = |options: &ConvertOptions, with: &[&str]| {
        let options = ConvertOptions { resume: true, ..options.clone() };
        let said = convert_within(&options, Job::limits(), &NoMonitor).unwrap_err().to_string();
        assert!(with.iter().all(|text| said.contains(text)) && said.lines().count() == 1, "{said}");
        assert_eq!(temporary(&job).len(), 2);
        assert!(fs::read(&job.options.output).unwrap() == job.old);
    };
    let scan = |name: &str| job.folder.path().join(name);
    for name in ["plain.las", "packed.laz"] {
        let (bytes, about) = (fs::read(scan(name)).unwrap(), fs::metadata(scan(name)).unwrap());
        let set = |bytes: &[u8], time: SystemTime| {
            fs::write(scan(name), bytes).unwrap();
            fs::File::options().write(true).open(scan(name)).unwrap().set_modified(time).unwrap();
        };
        let time = about.modified().unwrap();
        // Change a byte among the first points and keep the modification time.
        let mut changed = bytes.clone();
        changed[bytes.len() / 9] ^= 1;
        set(&changed, time);
        refused(&job.options, &[name, "changed", "resuming"]);
        set(&bytes, SystemTime::UNIX_EPOCH);
        refused(&job.options, &[name, "changed"]);
        let mut longer = bytes.clone();
        longer.push(0);
        set(&longer, time);
        refused(&ConvertOptions { allow_incomplete: true, ..job.options.clone() }, &[name, "changed"]);
        set(&bytes, time);
    }
    let mut options = job.options.clone();
    options.grid.pixel = PixelSize::Metres(0.2);
    refused(&options, &["resuming", "other options"]);
    options.grid.pixel = PixelSize::Auto;
    refused(&options, &["resuming", "other options"]);
    let mut options = job.options.clone();
    options.inputs.pop();
    refused(&options, &["resuming", "not named now"]);
    let mut options = job.options.clone();
    fs::copy(scan("plain.las"), scan("more.las")).unwrap();
    options.inputs.push(scan("more.las"));
    refused(&options, &["resuming", "more.las"]);
    // With everything restored, the conversion resumes.
    let report = job.convert(true, &NoMonitor).unwrap();
    assert_eq!(report.resumed.map(|resumed| resumed.points), Some(kept));
    assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty());
}

/// Monitor that cancels while the data of an earlier run is checked.
struct WhileChecking(Stops);

impl Monitor for WhileChecking {
    fn stage(&self, name: &str, total: u64, unit: &str) {
        self.0.stage(name, total, unit);
    }
    fn cancelled(&self) -> bool {
        self.0.stages.lock().unwrap().last().is_some_and(|stage| stage == "checking")
    }
}

#[test]
fn of_several_data_of_one_archive_the_largest_is_resumed_and_a_stop_meanwhile_keeps_it() {
    let job = Job::new();
    let temp_dir = &job.options.resources.temp_dir;
    let all = 2 * POINTS as u64;
    // Runs at the same time leave data under different digits.
    let move_to = |digit: &str| {
        for name in temporary(&job) {
            let (start, end) = name.split_once(".slicewalk-").unwrap();
            let (digits, end) = end.split_at(16);
            if digits != digit.repeat(16) {
                fs::rename(temp_dir.join(&name), temp_dir.join(format!("{start}.slicewalk-{}{end}", digit.repeat(16))))
                    .unwrap();
            }
        }
    };
    let copied = job.folder.path().join("less");
    fs::create_dir(&copied).unwrap();
    assert!(interrupt(&job, POINTS as u64 * 3 / 2).1 > 0);
    move_to("5");
    for name in temporary(&job) {
        fs::copy(temp_dir.join(&name), copied.join(&name)).unwrap();
    }
    assert!(job.convert(true, &InSecondPass(Stops::after(0))).is_err());
    move_to("b");
    for less in ["3", "e"] {
        for name in fs::read_dir(&copied).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()) {
            fs::copy(copied.join(&name), temp_dir.join(name.replace(&"5".repeat(16), &less.repeat(16)))).unwrap();
        }
    }
    assert_eq!(temporary(&job).len(), 6);
    assert!(matches!(job.convert(true, &WhileChecking(Stops::after(0))), Err(Error::Interrupted)));
    assert_eq!(temporary(&job).len(), 2);
    let report = job.convert(true, &NoMonitor).unwrap();
    assert_eq!(report.resumed.map(|resumed| resumed.points), Some(all));
    assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty());
}

#[test]
fn a_pixel_size_that_was_chosen_automatically_is_not_chosen_again() {
    let mut job = Job::new();
    job.options.grid.pixel = PixelSize::Auto;
    let whole = job.convert(false, &NoMonitor).unwrap();
    let new = fs::read(&job.options.output).unwrap();
    assert!(interrupt(&job, POINTS as u64 * 3 / 2).1 > 0);
    let stops = Stops::after(u64::MAX);
    let report = job.convert(true, &stops).unwrap();
    assert_eq!(report.spacing, whole.spacing);
    assert!(!stops.stages.lock().unwrap().iter().any(|stage| stage == "spacing"));
    assert!(fs::read(&job.options.output).unwrap() == new);
}

#[test]
fn parts_of_a_conversion_go_on_and_merge_to_the_same_bytes() {
    let mut job = Job::new();
    let mut parts = Vec::new();
    for index in 1..=2 {
        job.options.shard = Some(ShardOptions { index, count: 2 });
        job.options.output = job.folder.path().join(format!("part{index}.slices"));
        // Interrupt once while points are read, and once after that.
        assert!(job.convert(true, &Stops::after(POINTS as u64 / 2)).is_err());
        assert!(job.convert(true, &InSecondPass(Stops::after(0))).is_err());
        assert!(job.convert(true, &NoMonitor).unwrap().resumed.is_some_and(|resumed| resumed.points > 0));
        parts.push(job.options.output.clone());
    }
    let output = job.folder.path().join("whole.slices");
    crate::archive::merge(&parts, &output, false, &NoMonitor).unwrap();
    assert!(fs::read(&output).unwrap() == job.new);
}

/// Removes moving points in a job with a station next to each scan; returns the report.
fn moving(job: &mut Job) -> Report {
    let table = job.folder.path().join("stations.csv");
    fs::write(&table, "file,x,y,z\nplain.las,2,2,1\npacked.laz,7,7,1\n").unwrap();
    job.options.plan.remove_moving = true;
    job.options.stations = Some(table);
    let report = convert(&job.options, &NoMonitor).unwrap();
    assert!(report.points_moving > 20, "{}", report.points_moving);
    job.new = fs::read(&job.options.output).unwrap();
    report
}

#[test]
fn moving_points_are_removed_alike_by_runs_that_go_on_and_by_parts() {
    let mut job = Job::new();
    moving(&mut job);
    let limits = Limits { views_bytes: 16 << 20, ..Job::limits() };
    let run = |job: &Job, monitor: &dyn Monitor| {
        convert_within(&ConvertOptions { resume: true, ..job.options.clone() }, limits, monitor)
    };
    for points in (1..=4).map(|fifths| fifths * 2 * POINTS as u64 / 5) {
        assert!(run(&job, &Stops::after(points)).is_err());
    }
    assert!(run(&job, &InSecondPass(Stops::after(0))).is_err());
    assert!(run(&job, &NoMonitor).unwrap().resumed.is_some_and(|resumed| resumed.points > 0));
    assert!(fs::read(&job.options.output).unwrap() == job.new);

    let (mut parts, mut moved) = (Vec::new(), 0);
    for index in 1..=3 {
        job.options.shard = Some(ShardOptions { index, count: 3 });
        job.options.output = job.folder.path().join(format!("part{index}.slices"));
        assert!(run(&job, &InSecondPass(Stops::after(0))).is_err());
        moved += run(&job, &NoMonitor).unwrap().points_moving;
        parts.push(job.options.output.clone());
    }
    let output = job.folder.path().join("whole.slices");
    crate::archive::merge(&parts, &output, false, &NoMonitor).unwrap();
    assert!(fs::read(&output).unwrap() == job.new && moved > 20, "{moved}");
    // A part with other stations does not merge with the others.
    fs::write(job.options.stations.as_ref().unwrap(), "file,x,y,z\nplain.las,2,2,1\npacked.laz,7,7,2\n").unwrap();
    run(&job, &NoMonitor).unwrap();
    assert!(crate::archive::merge(&parts, &output, true, &NoMonitor).is_err());
}

#[test]
fn parts_count_what_they_leave_out_once_where_holes_are_closed() {
    let mut job = Job::new();
    let listed = job.folder.path().join("removed.las");
    job.options.removed = Some(listed.clone());
    job.options.plan.min_points = 2;
    job.options.grid.fill_holes = Some(HoleWidth::Metres(0.5));
    let whole = moving(&mut job);
    assert!(whole.voxels_dropped > 1000, "{}", whole.voxels_dropped);
    // Header and record of a removed point.
    let listed = || (fs::metadata(&listed).unwrap().len() - 375) / 30;
    assert_eq!(listed(), whole.points_moving);

    let (mut parts, mut left_out) = (Vec::new(), [0; 3]);
    for index in 1..=3 {
        job.options.shard = Some(ShardOptions { index, count: 3 });
        job.options.output = job.folder.path().join(format!("part{index}.slices"));
        let report = convert(&job.options, &NoMonitor).unwrap();
        let of_part = [report.points_moving, listed(), report.voxels_dropped];
        left_out = [0, 1, 2].map(|number| left_out[number] + of_part[number]);
        parts.push(job.options.output.clone());
    }
    assert_eq!(left_out, [whole.points_moving, whole.points_moving, whole.voxels_dropped]);
    let output = job.folder.path().join("whole.slices");
    crate::archive::merge(&parts, &output, false, &NoMonitor).unwrap();
    assert!(fs::read(&output).unwrap() == job.new);
}

#[test]
fn a_kill_costs_no_more_than_256_mib_of_runs_whatever_the_budget() {
    for memory_bytes in [64 << 20, 128 << 20, 512 << 20, 1 << 30, 4 << 30, 64u64 << 30] {
        for threads in [1, 2, 7, 64] {
            let mut options = ConvertOptions::new(Vec::new(), "a".into());
            options.resources.memory_bytes = memory_bytes;
            let limits = Limits::for_threads(threads, &options);
            let in_memory = limits.retain_bytes.min(crate::voxel::runs::MOST_IN_MEMORY_WHILE_SPILLING);
            let built = limits.build_bytes / crate::voxel::runs::BUILD_BYTES * 8 * threads as u64;
            assert!(in_memory + built <= 240 << 20, "{memory_bytes} bytes, {threads} threads");
        }
    }
}

#[test]
fn text_is_resumed_within_a_piece_plain_and_compressed() {
    use std::fmt::Write as _;
    use std::io::Write as _;
    const ROWS: u64 = 150_000;
    let mut job = Job::new();
    let (mut random, mut text) = (Random(8), String::new());
    for _ in 0..ROWS {
        let mut metres = |most: u64| random.below(most) as f64 / 1000.0;
        writeln!(text, "{} {} {}", metres(9000), metres(9000), metres(2000)).unwrap();
    }
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(text.as_bytes()).unwrap();
    let [plain, packed] = ["a.xyz", "b.xyz.gz"].map(|name| job.folder.path().join(name));
    fs::write(&plain, text).unwrap();
    fs::write(&packed, gzip.finish().unwrap()).unwrap();
    job.options.inputs = vec![plain, packed];
    convert(&job.options, &NoMonitor).unwrap();
    job.new = fs::read(&job.options.output).unwrap();
    let mut before = 0;
    for points in [ROWS / 2, ROWS * 5 / 4, ROWS * 7 / 4] {
        let (_, kept) = interrupt(&job, points);
        assert!(kept > before && kept < 2 * ROWS, "{kept} after {before}");
        before = kept;
    }
    let report = job.convert(true, &NoMonitor).unwrap();
    assert_eq!(report.resumed.map(|resumed| resumed.points), Some(before));
    assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty());
}

#[test]
fn e57_and_binary_clouds_are_resumed() {
    for colour in [ColourMode::Off, ColourMode::Auto] {
        clouds_are_resumed(colour);
    }
}

fn clouds_are_resumed(colour: ColourMode) {
    const POINTS: usize = 150_000;
    let mut job = Job::with(colour);
    let mut random = Random(8);
    let points: Vec<[f64; 3]> =
        (0..POINTS).map(|_| [9000, 9000, 2000].map(|most: u64| random.below(most) as f64 / 1024.0)).collect();
    let [e57, pcd] = ["a.e57", "b.pcd"].map(|name| job.folder.path().join(name));
    let cloud = |points| write::Cloud { points, form: write::E57::Scaled, posed: true, mixed: true };
    write::e57(&e57, &[cloud(&points[..100_000]), cloud(&points[100_000..])], None);
    fs::write(&pcd, write::pcd(&points, write::Pcd::Packed)).unwrap();
    job.options.inputs = vec![e57, pcd];
    let header = convert(&job.options, &NoMonitor).unwrap().header;
    assert_eq!(header.colours.map(|colours| colours.plan.scale.high), (colour == ColourMode::Auto).then_some(255));
    job.new = fs::read(&job.options.output).unwrap();
    let mut before = 0;
    for fifths in 1..5 {
        let (_, kept) = interrupt(&job, (POINTS * 2 * fifths / 5) as u64);
        assert!(kept >= before && kept < 2 * POINTS as u64, "{kept} after {before}");
        before = kept;
    }
    assert!(before > POINTS as u64, "{before}");
    let report = job.convert(true, &NoMonitor).unwrap();
    assert_eq!(report.resumed.map(|resumed| resumed.points), Some(before));
    assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty());
}

#[test]
fn colours_go_on_where_others_were_interrupted_and_make_the_same_bytes() {
    let all = 2 * POINTS as u64;
    for source in [ColourSource::Intensity, ColourSource::Class] {
        let job = Job::with(ColourMode::Of(source));
        let (mut kept_before, mut read_again) = (0, 0);
        for points in (1..=8).map(|ninths| ninths * all / 9) {
            let (read, kept) = interrupt(&job, points);
            assert!(kept >= kept_before && kept <= read, "{kept} of {read} after {kept_before}");
            kept_before = kept;
            read_again += 1;
        }
        assert!(kept_before > all / 4 && read_again > 0, "{kept_before}");
        let report = job.convert(true, &NoMonitor).unwrap();
        assert_eq!(report.resumed.map(|resumed| resumed.points), Some(kept_before));
        assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty(), "{source:?}");
        // With all runs present, only the values that decide the source of colours are read again.
        fs::write(&job.options.output, &job.old).unwrap();
        job.convert(true, &InSecondPass(Stops::after(0))).unwrap_err();
        let stops = Stops::after(u64::MAX);
        let report = job.convert(true, &stops).unwrap();
        assert_eq!((report.resumed.map(|resumed| resumed.points), stops.points()), (Some(all), all));
        assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty(), "{source:?}");
        // Other colours, or none, count as other options.
        job.convert(true, &InSecondPass(Stops::after(0))).unwrap_err();
        for colour in [
            ColourMode::Off,
            ColourMode::Of(if source == ColourSource::Class { ColourSource::Intensity } else { ColourSource::Class }),
        ] {
            let mut options = ConvertOptions { resume: true, ..job.options.clone() };
            options.sections.colour = colour;
            let said = convert_within(&options, Job::limits(), &NoMonitor).unwrap_err().to_string();
            assert!(said.contains("other options"), "{said}");
        }
        assert!(job.convert(true, &NoMonitor).unwrap().resumed.is_some());
        assert!(fs::read(&job.options.output).unwrap() == job.new);
    }
}

#[test]
fn a_tolerance_that_was_chosen_automatically_is_not_chosen_again() {
    let mut job = Job::new();
    let path = job.folder.path().join("noisy.las");
    let mut random = Random(12);
    let mut noise = || (0..12).map(|_| random.below(1000) as f64 / 1000.0).sum::<f64>() - 6.0;
    let floor: Vec<_> = (0..90_000u32)
        .map(|number| [f64::from(number % 300) * 0.02, f64::from(number / 300) * 0.02, 0.31 + 0.004 * noise()])
        .collect();
    write_las(&path, floor.iter().copied(), &WriteSpec::for_path(&path)).unwrap();
    job.options.inputs = vec![path];
    job.options.grid.tolerance_auto = true;
    let whole = job.convert(false, &NoMonitor).unwrap();
    let noise = whole.noise.unwrap();
    assert!(noise.regions > 0 && (0.002..0.008).contains(&noise.noise_m), "{noise:?}");
    assert!(whole.header.plan.options.tolerance_m > 0.0);
    job.new = fs::read(&job.options.output).unwrap();
    assert!(interrupt(&job, 60_000).1 > 0);
    let stops = Stops::after(u64::MAX);
    let report = job.convert(true, &stops).unwrap();
    assert!(report.resumed.is_some_and(|resumed| resumed.points > 0) && report.noise == Some(noise));
    assert!(!stops.stages.lock().unwrap().iter().any(|stage| stage == "noise"));
    assert!(fs::read(&job.options.output).unwrap() == job.new && temporary(&job).is_empty());
}

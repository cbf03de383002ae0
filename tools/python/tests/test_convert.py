"""Conversion of files and of arrays."""

from __future__ import annotations

import json
import os
import pathlib
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

import scan
import slicewalk


@pytest.fixture
def las(tmp_path):
    """A scan of 6000 points."""
    path = tmp_path / "scan.las"
    path.write_bytes(scan.las(scan.rubble(6000, 3)))
    return path


def test_options_are_those_of_the_command_line(las, tmp_path):
    def converted(**options):
        return slicewalk.convert(las, tmp_path / "a.slices", force=True, **{"units": "m", **options})

    report = converted(pixel=0.2)
    assert report["pixel_size"] == 0.2
    assert report["points_kept"] == 6000
    assert report["seconds"] > 0
    json.dumps(report)
    assert converted()["point_spacing"] > 0
    assert converted(pixel="auto")["pixel_size"] > 0
    assert converted(pixel="0.2")["pixel_size"] == 0.2
    assert converted(pixel=0.2, slice=0.4)["slice_height"] == 0.4
    assert converted(pixel=0.2, max_slope=30)["max_slope"] == 30
    assert converted(pixel=0.2, tolerance=0.01)["tolerance"] == 0.01
    assert converted(pixel=0.2, classifier="span")["classifier"] == "span"
    assert converted(pixel=0.2, memory="64MiB", threads=1)["points_kept"] == 6000
    assert converted(pixel=0.2, memory=64 << 20, temp_dir=tmp_path)["points_kept"] == 6000
    with pytest.warns(slicewalk.errors.SlicewalkWarning, match="nothing is kept"):
        assert converted(pixel=0.2, exclude_class=[0])["points_excluded"] == 6000
    assert converted(pixel=0.2, min_points=2)["voxels_dropped"] > 0
    assert converted(pixel=0.2, drop_isolated=True)["drop_isolated"]
    assert converted(pixel=0.2, up="y")["up"] == "y"
    assert converted(pixel=0.2, units="ft")["unit"]["name"] == "ft"
    assert converted(pixel=0.2, units=2)["unit"]["factor"] == 2
    assert "25832" in str(converted(pixel=0.2, crs="EPSG:25832")["crs"])
    assert converted(pixel=0.2, mesh="sampled", allow_incomplete=True, quiet=True)["complete"]
    assert converted(pixel=0.2, slice=None, threads=None)["points_kept"] == 6000


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"pixel": -1}, slicewalk.ParameterError, "pixel"),
        ({"pixel": "wide"}, slicewalk.ParameterError, "auto"),
        ({"pixel": 0.2, "classifier": "guess"}, slicewalk.ParameterError, "plane"),
        ({"pixel": 0.2, "memory": "12parsecs"}, slicewalk.ParameterError, "unit"),
        ({"pixel": 0.2, "memory": 5}, slicewalk.ParameterError, "64MiB"),
        ({"pixel": 0.2, "max_slope": 91}, slicewalk.ParameterError, "slope"),
        ({"pixel": 0.2, "exclude_class": [256]}, OverflowError, None),
        ({"pixel": [1]}, TypeError, None),
        ({"pixels": 0.2}, TypeError, "unexpected keyword argument"),
        ({"pixel": 0.2, "crs": "local"}, slicewalk.ParameterError, "EPSG:25832"),
        ({"pixel": 0.2, "shard": "3"}, slicewalk.ParameterError, "2/8"),
        ({"pixel": 0.2, "shard": (9, 8)}, slicewalk.ParameterError, "9/8"),
        ({"pixel": 0.2, "plan": "nowhere.json"}, FileNotFoundError, "nowhere.json"),
    ],
)
def test_options_that_make_no_sense(las, tmp_path, options, error, says):
    with pytest.raises(error, match=says):
        slicewalk.convert(las, tmp_path / "a.slices", quiet=True, **options)
    assert sorted(os.listdir(tmp_path)) == ["scan.las"]


def test_outputs_are_kept(las, tmp_path):
    target = tmp_path / "a.slices"
    slicewalk.convert([las], str(target), pixel=0.2, units="m")
    before = target.read_bytes()
    with pytest.raises(slicewalk.OutputError) as raised:
        slicewalk.convert(las, target, pixel=0.1, units="m")
    assert raised.value.path == str(target)
    assert target.read_bytes() == before
    with pytest.raises(slicewalk.OutputError):
        slicewalk.convert(las, las, pixel=0.1, force=True, units="m")
    with pytest.raises(slicewalk.Error):
        slicewalk.convert(tmp_path / "none.las", tmp_path / "b.slices", pixel=0.1)


def test_damaged_input(las, tmp_path):
    data = las.read_bytes()
    las.write_bytes(data[:-1000])
    with pytest.raises(slicewalk.InputError) as raised:
        slicewalk.convert(las, tmp_path / "a.slices", pixel=0.2, units="m")
    assert raised.value.path == str(las)
    assert raised.value.at
    assert raised.value.reason
    with pytest.warns(slicewalk.SlicewalkWarning, match="incomplete"):
        report = slicewalk.convert(las, tmp_path / "a.slices", pixel=0.2, allow_incomplete=True, units="m")
    assert not report["complete"]
    with pytest.raises(slicewalk.SlicewalkWarning):
        # These tests turn warnings into errors, and an error ends the work.
        slicewalk.convert(las, tmp_path / "b.slices", pixel=0.2, allow_incomplete=True, units="m")
    slicewalk.convert(las, tmp_path / "c.slices", pixel=0.2, allow_incomplete=True, quiet=True)


def test_progress(las, tmp_path):
    told = []
    slicewalk.convert(las, tmp_path / "a.slices", pixel=0.2, units="m", progress=lambda *news: told.append(news))
    stages = list(dict.fromkeys(news[0] for news in told))
    assert stages[0] == "reading points"
    assert stages[-1] == "writing slices"
    assert ("reading points", 6000, 6000, "points") in told
    assert all(stage and done >= 0 and total >= 0 and unit for stage, done, total, unit in told)


def test_what_a_callback_raises_ends_the_work(las, tmp_path):
    def progress(*_):
        message = "enough"
        raise KeyError(message)

    with pytest.raises(KeyError, match="enough"):
        slicewalk.convert(las, tmp_path / "a.slices", pixel=0.2, units="m", progress=progress)
    assert os.listdir(tmp_path) == ["scan.las"]

    def at_the_end(stage, *_):
        if stage == "writing slices":
            raise KeyError(stage)

    slicewalk.convert(las, tmp_path / "a.slices", pixel=0.5, units="m")
    before = (tmp_path / "a.slices").read_bytes()
    with pytest.raises(KeyError, match="writing slices"):
        slicewalk.convert(las, tmp_path / "a.slices", pixel=0.2, units="m", force=True, progress=at_the_end)
    assert (tmp_path / "a.slices").read_bytes() == before
    writer = slicewalk.Writer(tmp_path / "b.slices", pixel=0.2)
    writer.write([[0.0, 0.0, 0.0]])
    with pytest.raises(KeyError, match="enough"):
        writer.finish(progress=progress)
    assert sorted(os.listdir(tmp_path)) == ["a.slices", "scan.las"]


def test_a_plan_carries_which_sections_are_stored(las, tmp_path):
    (tmp_path / "stations.csv").write_text("file,x,y,z\nscan.las,0,0,1.5\n")
    stations = tmp_path / "stations.csv"
    options = {"pixel": 0.2, "units": "m"}
    slicewalk.convert(las, tmp_path / "whole.slices", free_space=True, stations=stations, **options)
    plan = tmp_path / "plan.json"
    slicewalk.write_plan(las, plan, free_space=True, **options)
    parts = [tmp_path / f"{number}.slices" for number in (1, 2)]
    for number, part in enumerate(parts, 1):
        with pytest.raises(slicewalk.ParameterError, match="stations"):
            slicewalk.convert(las, part, plan=plan, shard=(number, 2))
        slicewalk.convert(las, part, plan=plan, shard=(number, 2), stations=stations)
    slicewalk.merge(parts, tmp_path / "merged.slices")
    assert (tmp_path / "merged.slices").read_bytes() == (tmp_path / "whole.slices").read_bytes()
    with pytest.raises(slicewalk.ParameterError, match="free_space"):
        slicewalk.convert(las, parts[0], plan=plan, shard=(1, 2), free_space=False, force=True)
    with pytest.raises(TypeError, match="removed"):
        slicewalk.write_plan(las, plan, removed=tmp_path / "removed.las", force=True, **options)


def test_keyboard_interrupt(tmp_path):
    points = scan.rubble(3_000_000, 5)
    (tmp_path / "large.las").write_bytes(scan.las(points))
    script = """
        import signal, sys, slicewalk
        signal.signal(signal.SIGINT, signal.default_int_handler)  # jobs in the background of a shell ignore it
        try:
            slicewalk.convert("large.las", "large.slices", pixel=0.01, tolerance=0.002, threads=1, quiet=True,
                              progress=lambda *news: print(*news, flush=True))
        except KeyboardInterrupt:
            sys.exit(77)
    """
    for _ in range(3):
        with subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path, stdout=subprocess.PIPE, text=True
        ) as process:
            assert process.stdout.readline().startswith("reading points")
            process.send_signal(signal.SIGINT)
            started = time.monotonic()
            process.stdout.read()
            assert process.wait(timeout=60) == 77
            assert time.monotonic() - started < 30
        assert os.listdir(tmp_path) == ["large.las"]


def test_inputs_are_placed_as_on_the_command_line(las, tmp_path):
    matrix = tmp_path / "matrix.txt"
    matrix.write_text("1 0 0 5\n0 1 0 -3\n0 0 1 2\n0 0 0 1\n")

    def bounds(**options):
        slicewalk.convert(las, tmp_path / "placed.slices", pixel=0.1, force=True, **options)
        return np.array(slicewalk.open(tmp_path / "placed.slices").bounds)

    as_it_is = bounds(units="m")
    assert np.allclose(bounds(units="m", transform=matrix), as_it_is + [5, -3, 2], atol=0.01)
    assert np.allclose(bounds(scale_from=((0, 0, 0), (2, 0, 0), 1.0)), as_it_is / 2, atol=0.01)
    down = bounds(units="m", up="-z")
    assert np.allclose(np.diff(down, axis=0), np.diff(as_it_is, axis=0), atol=0.01)
    assert np.allclose(sorted(-down[:, 2]), as_it_is[:, 2], atol=0.01)
    with pytest.raises(slicewalk.ParameterError, match="up"):
        bounds(units="m", up="down")
    with pytest.raises(slicewalk.ParameterError, match="the two places are the same"):
        bounds(scale_from=((0, 0, 0), (0, 0, 0), 1.0))
    with pytest.raises(slicewalk.ParameterError, match="is the unit"):
        bounds(units="m", scale_from=((0, 0, 0), (2, 0, 0), 1.0))
    with pytest.raises(slicewalk.ParameterError, match="opacity"):
        bounds(units="m", opacity=2.0)


def test_parts_join_to_one(las, tmp_path):
    plan = slicewalk.write_plan(las, tmp_path / "plan.json", pixel=0.1, units="m")
    assert (plan["pixel_size"], plan["inputs"]) == (0.1, 1)
    shards = [(1, 3), "2/3", (3, 3)]
    reports = [
        slicewalk.convert(las, tmp_path / f"{number}.slices", plan=tmp_path / "plan.json", shard=shard)
        for number, shard in enumerate(shards)
    ]
    assert [report["shard"]["index"] for report in reports] == [1, 2, 3]
    assert sum(report["points_kept"] for report in reports) == 6000
    with pytest.raises(slicewalk.ParameterError, match="contradicts the plan"):
        slicewalk.convert(las, tmp_path / "x.slices", plan=tmp_path / "plan.json", pixel=0.2)
    with pytest.raises(TypeError):
        slicewalk.write_plan(las, tmp_path / "y.json", shard=(1, 2))


def test_writer_makes_the_bytes_of_a_conversion(las, tmp_path):
    points = scan.rubble(6000, 3)
    slicewalk.convert(las, tmp_path / "file.slices", pixel=0.1, units="m")
    expected = (tmp_path / "file.slices").read_bytes()
    for name, batches in (
        ("one", [points]),
        ("many", np.array_split(points[::-1], 17)),
        ("rows", [points[:, ::-1][:, ::-1]]),
    ):
        with slicewalk.Writer(tmp_path / name, pixel=0.1) as writer:
            for batch in batches:
                writer.write(batch)
            assert writer.points == 6000
        assert writer.report["points_kept"] == 6000
        assert (tmp_path / name).read_bytes() == expected


def test_writer_from_many_threads(las, tmp_path):
    points = scan.rubble(6000, 3)
    slicewalk.convert(las, tmp_path / "file.slices", pixel=0.1, units="m")
    with slicewalk.Writer(tmp_path / "a.slices", pixel=0.1) as writer:
        threads = [threading.Thread(target=writer.write, args=(part,)) for part in np.array_split(points, 8)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
    assert (tmp_path / "a.slices").read_bytes() == (tmp_path / "file.slices").read_bytes()


def test_writer_publishes_all_or_nothing(tmp_path):
    def fail():
        with slicewalk.Writer(tmp_path / "a.slices", pixel=0.1) as writer:
            writer.write([[0, 0, 0]])
            message = "no"
            raise RuntimeError(message)

    with pytest.raises(RuntimeError):
        fail()
    assert os.listdir(tmp_path) == []
    writer = slicewalk.Writer(tmp_path / "a.slices", pixel=0.1, crs="local grid", up="y")
    writer.write([[0, 0, 0], [np.nan, 0, 0], [1, 2, 3]])
    report = writer.finish()
    assert report["points_not_finite"] == 1
    archive = slicewalk.open(tmp_path / "a.slices")
    assert archive.crs == "local grid"
    assert (archive.bounds == [[0, -3, 0], [1, 0, 2]]).all()
    for ended in (lambda: writer.write([[0, 0, 0]]), writer.finish):
        with pytest.raises(ValueError, match="ended"):
            ended()
    with pytest.raises(slicewalk.OutputError):
        slicewalk.Writer(tmp_path / "a.slices", pixel=0.1)
    slicewalk.Writer(tmp_path / "b.slices", pixel=0.1).discard()
    del writer
    assert os.listdir(tmp_path) == ["a.slices"]
    with pytest.raises(slicewalk.ParameterError, match="pixel"):
        slicewalk.Writer(tmp_path / "b.slices", pixel="auto")
    with pytest.raises(TypeError, match="units"):
        slicewalk.Writer(tmp_path / "b.slices", pixel=0.1, units="ft")
    with slicewalk.Writer(tmp_path / "b.slices", pixel=0.01) as writer, pytest.raises(slicewalk.LimitError):
        writer.write([[1e11, 0, 0]])


def test_points_of_which_none_is_a_place_replace_no_archive(tmp_path):
    slicewalk.from_numpy([[0, 0, 0]], tmp_path / "a.slices", pixel=0.1)
    before = (tmp_path / "a.slices").read_bytes()
    for nowhere in (np.full((5, 3), np.nan), np.full((5, 3), 1e13)):
        with pytest.raises(slicewalk.ParameterError, match="none of 5 has a finite position"):
            slicewalk.from_numpy(nowhere, tmp_path / "a.slices", pixel=0.1, force=True)
    assert (tmp_path / "a.slices").read_bytes() == before
    assert os.listdir(tmp_path) == ["a.slices"]
    assert slicewalk.from_numpy(np.empty((0, 3)), tmp_path / "b.slices", pixel=0.1).points_read == 0


@pytest.mark.skipif(not pathlib.Path("/proc/self/status").exists(), reason="needs /proc")
def test_writer_keeps_its_budget(tmp_path):
    script = """
        import numpy as np, re, slicewalk
        def peak():
            return int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) << 10
        random = np.random.default_rng(1)
        batch = random.uniform(0, 100, (1 << 18, 3))
        before = peak()
        with slicewalk.Writer("a.slices", pixel=0.5, memory="64MiB", threads=1) as writer:
            for _ in range(64):
                writer.write(batch)
        assert writer.report["temp_bytes"] > 64 << 20, writer.report
        print(peak() - before)
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    assert int(done.stdout) <= 128 << 20


def test_real_scan(real, tmp_path):
    points, archive = real("pump_room.laz")
    assert archive.points_kept == len(points)
    with slicewalk.Writer(tmp_path / "a.slices", pixel=0.1) as writer:
        writer.write(points)
    again = slicewalk.open(tmp_path / "a.slices")
    assert again.voxels == archive.voxels
    assert (again.bounds == archive.bounds).all()


def test_colours_are_the_means_of_the_points(tmp_path):
    points = scan.millimetres(np.random.default_rng(4).uniform(0, (2, 2, 0.2), (5000, 3)))
    rgb = np.stack([points[:, 0] * 30000, points[:, 1] * 20000 + 5000, 65535 - points[:, 0] * 9000], axis=1).astype(
        "u2"
    )
    (tmp_path / "a.las").write_bytes(scan.las(points, rgb))
    slicewalk.convert(tmp_path / "a.las", tmp_path / "a.slices", pixel=0.1, units="m", colour="rgb", colour_error=0)
    archive = slicewalk.open(tmp_path / "a.slices")
    assert archive.info()["colour"] == {"source": "rgb", "range": [0, 65535], "error": 0, "voxels": archive.voxels}
    colours, page = archive.colours((0, 0, 0)), archive.page((0, 0, 0))
    assert colours.shape == (archive.voxels, 4)
    assert colours.dtype == np.uint8
    assert (colours[:, 3] == 255).all()
    pixels = np.flatnonzero(page.occupancy.ravel())
    at = np.floor(points[:, 1] * 10).astype(int) * 64 + np.floor(points[:, 0] * 10).astype(int)
    # One slice, so one voxel per pixel.
    means = np.array([rgb[at == pixel].mean(axis=0) / 257 for pixel in pixels])
    assert np.abs(colours[:, :3] - means).max() <= 0.51
    assert archive.colours((9, 9, 9)) is None
    with pytest.raises(slicewalk.ParameterError):
        slicewalk.convert(tmp_path / "a.las", tmp_path / "b.slices", colour="blue")


def test_levels_have_the_means_of_their_voxels(tmp_path):
    points = scan.millimetres(np.random.default_rng(5).uniform(0, (9, 2, 0.2), (60_000, 3)))
    rgb = np.stack([points[:, 0] * 7000, points[:, 1] * 30000, 65535 - points[:, 0] * 7000], axis=1).astype("u2")
    (tmp_path / "a.las").write_bytes(scan.las(points, rgb))
    options = {"pixel": 0.1, "units": "m", "colour": "rgb", "colour_error": 0}
    slicewalk.convert(tmp_path / "a.las", tmp_path / "a.slices", levels=True, **options)
    archive = slicewalk.open(tmp_path / "a.slices")

    def voxels(pages, level):
        """Colours of voxels by pixel along x and y, in the only slice."""
        found = {}
        for key in map(tuple, pages.keys()):
            colours = archive.colours(key, level=level)
            pixels = np.flatnonzero(pages.page(key).occupancy.ravel())
            assert colours.shape == (len(pixels), 4)
            assert (colours[:, 3] == 255).all()
            for pixel, colour in zip(pixels, colours[:, :3], strict=True):
                found[key[0] * 64 + pixel % 64, key[1] * 64 + pixel // 64] = colour
        return found

    fine, coarse = voxels(archive, 0), voxels(archive.level(1), 1)
    assert archive.level(1).pixel_size == pytest.approx(0.4)
    inside = {}
    for (x, y), colour in fine.items():
        inside.setdefault((x // 4, y // 4), []).append(colour)
    assert inside.keys() == coarse.keys()
    for place, colours in inside.items():
        assert np.abs(np.mean(colours, axis=0) - coarse[place]).max() <= 0.51
    assert archive.colours((9, 9, 9), level=1) is None
    for ask in (archive.level, lambda level: archive.colours((0, 0, 0), level=level)):
        with pytest.raises(slicewalk.ParameterError, match="the archive has levels 1 to"):
            ask(9)
    slicewalk.convert(tmp_path / "a.las", tmp_path / "b.slices", **options)
    with pytest.raises(slicewalk.ParameterError, match="no overview levels"):
        slicewalk.open(tmp_path / "b.slices").colours((0, 0, 0), level=1)


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"threads": 0}, ValueError, "threads: expected a number of threads from 1 to 65535, found 0"),
        ({"threads": "two"}, TypeError, "threads: expected .* found 'two'"),
        ({"crs": 28992}, TypeError, "crs: expected a text such as .EPSG:25832., found 28992"),
        ({"levels": 1}, TypeError, "levels: expected True or False, found 1"),
        ({"pixel": [1]}, TypeError, "pixel: expected metres, or .auto., found "),
        ({"slice": "high"}, TypeError, "slice: expected metres, found 'high'"),
        ({"max_slope": None, "tolerance": {}}, TypeError, "tolerance: "),
        ({"memory": 1.5}, TypeError, "memory: expected a whole number of bytes"),
        ({"min_points": 0}, ValueError, "min_points: "),
        ({"min_points": -1}, OverflowError, "min_points: expected .* found -1"),
        ({"drop_floaters": 0}, ValueError, "drop_floaters: "),
        ({"drop_floaters": 70_000}, OverflowError, "drop_floaters: "),
        ({"drop_isolated": "yes"}, TypeError, "drop_isolated: expected True or False"),
        ({"drop_isolated": True, "drop_floaters": 5}, ValueError, "drop_isolated: .*leave one of them out"),
        ({"exclude_class": "7,x"}, ValueError, "exclude_class: expected classes from 0 to 255, such as .* found"),
        ({"exclude_class": ""}, ValueError, "exclude_class: "),
        ({"exclude_class": "18-7"}, ValueError, "exclude_class: "),
        ({"exclude_class": [300]}, OverflowError, "exclude_class: .* found 300"),
        ({"exclude_class": [7, "x"]}, TypeError, "exclude_class: .* found 'x'"),
        ({"exclude_class": 7.5}, TypeError, "exclude_class: "),
        ({"stations": "a.csv"}, ValueError, "stations: .*remove_moving"),
        ({"removed": "a.las"}, ValueError, "removed: .*remove_moving"),
        ({"temp_dir": 5}, TypeError, "temp_dir: expected a folder, found 5"),
        ({"units": []}, TypeError, "units: "),
        ({"up": 3}, TypeError, "up: expected one of auto, z, y, x, -z, -y, -x, found 3"),
        ({"colour": True}, TypeError, "colour: "),
        ({"threads": True}, TypeError, "threads: expected a number of threads from 1 to 65535, found True"),
        ({"memory": True}, TypeError, "memory: expected a whole number of bytes"),
        ({"fill_holes": True}, TypeError, "fill_holes: expected metres, or .auto., found True"),
        ({"pixel": np.True_}, TypeError, "pixel: expected metres, or .auto., found "),
        ({"columns": 3}, TypeError, "columns: "),
        ({"shard": 3}, TypeError, "shard: "),
        ({"plan": 3}, TypeError, "plan: expected a file, found 3"),
    ],
)
def test_errors_name_the_option(las, tmp_path, options, error, says):
    with pytest.raises(error, match=says):
        slicewalk.convert(las, tmp_path / "a.slices", quiet=True, **{"pixel": 0.2, "units": "m", **options})
    assert sorted(os.listdir(tmp_path)) == ["scan.las"]


def test_classes_are_given_as_on_the_command_line(las, tmp_path):
    def excluded(classes):
        report = slicewalk.convert(
            las, tmp_path / "a.slices", pixel=0.2, units="m", force=True, quiet=True, exclude_class=classes
        )
        assert report["warnings"] == [] or "nothing is kept" in str(report["warnings"])
        return report["points_excluded"]

    for classes in ("0,18", " 0 ", "0-3,7", 0, [0, 7], {0}, range(3), np.array([0, 7]), (one for one in [0])):
        assert excluded(classes) == 6000
    for classes in ("7,18", "64-255", 7, []):
        assert excluded(classes) == 0


def test_inputs_come_in_any_iterable(las, tmp_path):
    expected = slicewalk.convert(las, tmp_path / "a.slices", pixel=0.2, units="m")["points_kept"]
    for inputs in (tmp_path.glob("*.las"), {las}, iter([str(las)]), dict.fromkeys([las])):
        report = slicewalk.convert(inputs, tmp_path / "a.slices", pixel=0.2, units="m", force=True)
        assert report["points_kept"] == expected
    slicewalk.write_plan(tmp_path.glob("*.las"), tmp_path / "plan.json", pixel=0.2, units="m")
    slicewalk.convert(las, tmp_path / "1.slices", plan=tmp_path / "plan.json", shard=(1, 1))
    assert slicewalk.merge(tmp_path.glob("1.slices"), tmp_path / "b.slices")["shards"] == 1
    for inputs, error in (
        ([], slicewalk.ParameterError),
        (5, TypeError),
        ([las, 5], TypeError),
        (b"scan.las", TypeError),
    ):
        with pytest.raises(error, match="inputs: "):
            slicewalk.convert(inputs, tmp_path / "c.slices", pixel=0.2)
    with pytest.raises(slicewalk.ParameterError, match="parts: "):
        slicewalk.merge(iter([]), tmp_path / "c.slices")
    with pytest.raises(slicewalk.ParameterError, match=r"^part: 1/0 cannot be"):
        slicewalk.merge([tmp_path / "1.slices"], tmp_path / "c.slices", part=(1, 0))


@pytest.mark.parametrize("up", ["auto", "x", "-x", "-y", "-z"])
def test_a_writer_turns_no_points(tmp_path, up):
    with pytest.raises(slicewalk.ParameterError, match=r"^up: expected .z. or .y.") as raised:
        slicewalk.Writer(tmp_path / "a.slices", pixel=0.1, up=up)
    assert "placement" not in str(raised.value)


def test_a_writer_refuses_options_of_files_and_keeps_its_count(tmp_path):
    for name in ("removed", "colour_error", "columns", "colour", "stations", "remove_moving", "exclude_class", "wide"):
        with pytest.raises(TypeError, match=name):
            slicewalk.Writer(tmp_path / "a.slices", pixel=0.1, **{name: "1"})
    with slicewalk.Writer(tmp_path / "a.slices", pixel=0.1) as writer:
        writer.write(np.zeros((5, 3)))
        assert "a.slices" in repr(writer)
        assert "5 points, open" in repr(writer)
    assert writer.points == 5
    assert "5 points, ended" in repr(writer)
    writer = slicewalk.Writer(tmp_path / "b.slices", pixel=0.1)
    writer.write(np.zeros((3, 3)))
    writer.discard()
    assert writer.points == 3
    with pytest.raises(TypeError, match="resume"):
        slicewalk.write_plan("a.las", tmp_path / "y.json", resume=True)

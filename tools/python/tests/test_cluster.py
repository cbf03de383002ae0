"""Conversion on a cluster gives the bytes of a single run, whichever process dies."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("distributed")

import cloudpickle
import dask
import distributed

import slicewalk
import tiles
from slicewalk import cluster as sut

HERE = Path(__file__).parent
# Dask leaves its own sockets and event loops behind at the end of a test.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tiles")
    inputs = tiles.tiles(folder)
    slicewalk.convert(inputs, folder / "single.slices", **tiles.OPTIONS)
    return inputs, (folder / "single.slices").read_bytes()


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit="1GiB"
        ) as local,
        distributed.Client(local) as client,
    ):
        yield client


def converted(scans, folder, client, **options):
    given = {"parts": 9, "fan_in": 3, "memory": "64MiB", **tiles.OPTIONS, **options}
    return sut.convert(scans[0], folder / "out.slices", client, **given)


def stopped(call):
    """Call with a progress callback that ends the conversion once there are only checks left."""

    def enough(stage, *_):
        if stage == "verify":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        call(progress=enough)


def test_twelve_files_in_nine_parts_equal_the_single_run(scans, tmp_path, client):
    told = []
    report = converted(scans, tmp_path, client, progress=lambda *news: told.append(news))
    assert (tmp_path / "out.slices").read_bytes() == scans[1]
    assert os.listdir(tmp_path) == ["out.slices"]
    assert (report["parts"], report["retries"], report["skipped"]) == (9, 0, 0)
    assert report["seconds"] > 0
    assert report["output"] == str(tmp_path / "out.slices")
    assert report["info"]["points_kept"] == 12 * 12_000
    kinds = [one["kind"] for one in report["ran"]]
    assert kinds == ["part"] * 9 + ["merge"] * 4 + ["verify"]
    assert {one["worker"] for one in report["ran"]} <= set(client.nthreads())
    assert len({one["pid"] for one in report["ran"]}) == 2
    assert all(one["memory"] == 64 << 20 for one in report["ran"][:9])
    stages = list(dict.fromkeys(news[0] for news in told))
    assert [stage for stage in stages if stage != "plan"] in (["parts", "merge", "verify"], ["parts", "verify"])
    assert told[-1] == ("verify", 1, 1, "archives")


@pytest.mark.parametrize(("parts", "fan_in"), [(1, 2), (2, 2), (9, 64), (5, 2)])
def test_any_tree_gives_the_same_bytes(scans, tmp_path, client, parts, fan_in):
    report = converted(scans, tmp_path, client, parts=parts, fan_in=fan_in, memory=None)
    assert (tmp_path / "out.slices").read_bytes() == scans[1]
    assert report["ran"][0]["memory"] > 256 << 20


def test_trees_hold_every_part_once():
    for count in [*range(1, 70), 1000, 4097]:
        for fan_in in (2, 3, 7, 64):
            steps = sut._tree("key", count, fan_in)
            made = {step.name: step for step in steps}
            assert len(made) == len(steps)
            used = [name for step in steps for name in step.members]
            assert sorted(used) == sorted(set(made) - {steps[-1].name})
            assert all(len(step.members) <= fan_in for step in steps)

            def leaves(step, made=made):
                if step.kind == "part":
                    return [step.index]
                return [leaf for name in step.members for leaf in leaves(made[name])]

            assert leaves(steps[-2]) == list(range(1, count + 1))


def test_what_is_there_is_judged_first(scans, tmp_path, client):
    out = tmp_path / "out.slices"
    out.write_bytes(b"something else")
    for force in (False, True):
        with pytest.raises(slicewalk.OutputError) as raised:
            converted(scans, tmp_path, client, force=force)
        assert raised.value.path == str(out)
    assert os.listdir(tmp_path) == ["out.slices"]
    shutil.copy(scans[0][0].parent / "single.slices", out)
    with pytest.raises(slicewalk.OutputError, match="exists already"):
        converted(scans, tmp_path, client)
    slicewalk.convert(scans[0][:1], out, force=True, **tiles.OPTIONS)
    out.chmod(0o600)
    converted(scans, tmp_path, client, force=True)
    assert out.read_bytes() == scans[1]
    if os.name == "posix":
        assert out.stat().st_mode & 0o777 == 0o600
    for wrong, kind in (
        ({"parts": 0}, slicewalk.ParameterError),
        ({"fan_in": 1}, slicewalk.ParameterError),
        ({"threads": 0}, slicewalk.ParameterError),
        ({"parts": 65_537}, slicewalk.ParameterRangeError),
        ({"failures": -1}, slicewalk.ParameterRangeError),
        ({"parts": 2.5}, slicewalk.ParameterTypeError),
    ):
        with pytest.raises(kind, match=next(iter(wrong))):
            converted(scans, tmp_path, client, **wrong)


def test_cancelled_work_goes_on_with_the_next_call(scans, tmp_path, client):
    def enough(stage, done, *_):
        if stage == "merge" or (stage == "parts" and done >= 4):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        converted(scans, tmp_path, client, progress=enough)
    assert not (tmp_path / "out.slices").exists()
    (work,) = tmp_path.iterdir()
    made = sorted(work.glob("*-0-*.slices"))
    assert len(made) >= 4
    # Steps of an earlier call are reused only if they are sound.
    damaged = bytearray(made[0].read_bytes())
    damaged[len(damaged) // 2] ^= 1
    made[0].write_bytes(damaged)
    made[1].write_bytes(made[2].read_bytes())
    report = converted(scans, tmp_path, client)
    assert report["skipped"] >= 2
    assert not report["ran"][int(made[0].name.split("-")[2]) - 1]["skipped"]
    assert not report["ran"][int(made[1].name.split("-")[2]) - 1]["skipped"]
    assert (tmp_path / "out.slices").read_bytes() == scans[1]
    assert os.listdir(tmp_path) == ["out.slices"]


@pytest.mark.parametrize("option", ["free_space", "remove_moving"])
def test_parts_get_the_stations(folder, tmp_path, client, option):
    room, table = folder / "room.las", tmp_path / "stations.csv"

    def equals_a_single_run(**more):
        given = {option: True, "stations": table, **tiles.OPTIONS}
        slicewalk.convert(room, tmp_path / "single.slices", force=True, **given)
        report = sut.convert(room, tmp_path / "out.slices", client, parts=2, force=True, **given, **more)
        assert (tmp_path / "out.slices").read_bytes() == (tmp_path / "single.slices").read_bytes()
        return report

    table.write_text("file,x,y,z\nroom.las,4,3,1.5\n")
    stopped(equals_a_single_run)
    # Steps of other stations are of no use.
    table.write_text("file,x,y,z\nroom.las,2,2,1.2\n")
    assert equals_a_single_run()["skipped"] == 0
    assert sorted(os.listdir(tmp_path)) == ["out.slices", "single.slices", "stations.csv"]


def test_a_plan_of_another_matrix_is_of_no_use(scans, tmp_path, client):
    matrix, inputs = tmp_path / "m.txt", scans[0][:2]
    given = {"units": "m", "quiet": True, "transform": matrix}

    def convert(**more):
        return sut.convert(inputs, tmp_path / "out.slices", client, parts=2, **given, **more)

    matrix.write_text("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    stopped(convert)
    matrix.write_text("1 0 0 100\n0 1 0 0\n0 0 1 0\n0 0 0 1\n")
    assert convert()["skipped"] == 0
    slicewalk.convert(inputs, tmp_path / "single.slices", **given)
    assert (tmp_path / "out.slices").read_bytes() == (tmp_path / "single.slices").read_bytes()


@pytest.mark.parametrize("pixel", [0.1, "auto"])
def test_parts_of_an_input_that_was_changed_are_of_no_use(scans, tmp_path, client, pixel):
    inputs = [Path(shutil.copy(path, tmp_path)) for path in scans[0][:2]]
    given = {**tiles.OPTIONS, "pixel": pixel}

    def convert(**more):
        return sut.convert(inputs, tmp_path / "out.slices", client, parts=2, **given, **more)

    stopped(convert)
    # Records in the middle, where the plan takes no sample of a file.
    data, first = bytearray(inputs[0].read_bytes()), 227 + 20 * 6000
    data[first : first + 20 * 100] = data[227:247] * 100
    inputs[0].write_bytes(data)
    assert convert()["skipped"] == 0
    slicewalk.convert(inputs, tmp_path / "single.slices", **given)
    assert (tmp_path / "out.slices").read_bytes() == (tmp_path / "single.slices").read_bytes()


def test_parts_that_may_lack_points_are_of_no_use_to_a_call_that_must_have_all(scans, tmp_path, client):
    stopped(lambda **more: converted(scans, tmp_path, client, allow_incomplete=True, **more))
    report = converted(scans, tmp_path, client)
    assert (report["skipped"], report["complete"]) == (0, True)
    assert (tmp_path / "out.slices").read_bytes() == scans[1]


def test_errors_of_workers_come_with_their_facts_and_a_repaired_input_converts(scans, tmp_path, client):
    inputs = [Path(shutil.copy(path, tmp_path)) for path in scans[0]]
    good = inputs[5].read_bytes()
    inputs[5].write_bytes(good[:-200_000])
    with pytest.raises(slicewalk.InputError) as raised:
        converted((inputs, None), tmp_path, client)
    assert raised.value.path == str(inputs[5])
    inputs[5].write_bytes(good)
    converted((inputs, None), tmp_path, client)
    assert (tmp_path / "out.slices").read_bytes() == scans[1]
    assert tiles.leftovers(tmp_path) == []


def to_store(scans, folder, client, **options):
    given = {"parts": 5, "fan_in": 3, "memory": "64MiB", "work": folder, **tiles.OPTIONS, **options}
    return sut.convert(scans[0], "s3://bucket/out/city.slices", client, **given)


def test_scans_in_a_store_become_the_archive_of_a_single_run_there(scans, tmp_path, store):
    for path in scans[0]:
        store.put(f"/bucket/tiles/{path.name}", path.read_bytes())
    told = []
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, memory_limit="1GiB", env=store.environment()
        ) as local,
        distributed.Client(local) as client,
    ):
        report = to_store((["s3://bucket/tiles/"],), tmp_path, client, progress=lambda *news: told.append(news))
    assert store.objects["/bucket/out/city.slices"] == scans[1]
    assert os.listdir(tmp_path) == []
    assert (report["parts"], report["skipped"], report["output"]) == (5, 0, "s3://bucket/out/city.slices")
    assert report["info"]["points_kept"] == 12 * 12_000
    assert told[-1] == ("upload", len(scans[1]), len(scans[1]), "bytes")
    assert sum(line.startswith("PUT") for line in store.requests) == 1


def test_what_is_there_in_a_store_is_judged_first_and_replaced_with_force(scans, tmp_path, client, store):
    for folder in (None, tmp_path / "none"):
        with pytest.raises(slicewalk.ParameterError, match="work: "):
            to_store(scans, folder, client)
    with pytest.raises(slicewalk.ParameterError, match="work: "):
        converted(scans, tmp_path, client, work=tmp_path)
    store.put("/bucket/out/city.slices", b"something else")
    for force in (False, True):
        with pytest.raises(slicewalk.OutputError, match="not a slice archive"):
            to_store(scans, tmp_path, client, force=force)
    store.put("/bucket/out/city.slices", scans[1][:5000])
    with pytest.raises(slicewalk.OutputError, match="exists already; force=True"):
        to_store(scans, tmp_path, client)
    with pytest.raises(slicewalk.ParameterError, match="can be written"):
        sut.convert(scans[0], f"{store.address}/bucket/x.slices", client, work=tmp_path)
    assert os.listdir(tmp_path) == []
    to_store(scans, tmp_path, client, force=True)
    assert store.objects["/bucket/out/city.slices"] == scans[1]
    assert os.listdir(tmp_path) == []


def test_an_upload_that_fails_leaves_the_steps_for_the_next_call(scans, tmp_path, client, store):
    store.fails = lambda line: line.startswith("PUT")
    with pytest.raises(slicewalk.FileError, match="cannot write") as raised:
        to_store(scans, tmp_path, client)
    assert "very-secret" not in str(raised.value)
    assert "/bucket/out/city.slices" not in store.objects
    assert len(os.listdir(tmp_path)) == 1
    store.fails = lambda _line: False
    report = to_store(scans, tmp_path, client)
    # Seven archives are skipped; the check runs again.
    assert report["skipped"] == len(report["ran"]) - 1
    assert store.objects["/bucket/out/city.slices"] == scans[1]
    assert os.listdir(tmp_path) == []
    # A file that another writer made meanwhile stays, and so do the steps.
    del store.objects["/bucket/out/city.slices"]

    def rival(stage, *_):
        if stage == "verify":
            store.put("/bucket/out/city.slices", b"first")

    with pytest.raises(slicewalk.OutputError):
        to_store(scans, tmp_path, client, progress=rival)
    assert store.objects["/bucket/out/city.slices"] == b"first"
    assert not store.uploads
    assert sut.discard("s3://bucket/out/city.slices", work=tmp_path)
    assert not sut.discard("s3://bucket/out/city.slices", work=tmp_path)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("options", "error", "says"),
    [
        ({"memory": "lots"}, slicewalk.ParameterError, "memory: expected a whole number of bytes, .* found 'lots'"),
        ({"memory": 1e9}, slicewalk.ParameterTypeError, "memory: expected a whole number of bytes, .* 1000000000.0"),
        ({"memory": True}, slicewalk.ParameterTypeError, "memory: expected a whole number of bytes, .* found True"),
        ({"memory": 5}, slicewalk.ParameterError, "64MiB"),
        ({"pixel": -1}, slicewalk.ParameterError, "pixel"),
        ({"pixels": 1}, TypeError, "pixels"),
        ({"exclude_class": "7,x"}, slicewalk.ParameterError, "exclude_class: "),
        ({"drop_isolated": True, "drop_floaters": 3}, slicewalk.ParameterError, "drop_isolated: "),
        ({"parts": 2.5}, slicewalk.ParameterTypeError, "parts: expected a whole number"),
        ({"threads": "1"}, slicewalk.ParameterTypeError, "threads: expected a whole number"),
        ({"fan_in": None}, slicewalk.ParameterTypeError, "fan_in: expected a whole number, 2 or more, found None"),
        ({"patience": "600"}, slicewalk.ParameterTypeError, "patience: expected seconds, 0 or more, found '600'"),
        ({"patience": float("nan")}, slicewalk.ParameterError, "patience: expected seconds, 0 or more, found nan"),
        ({"patience": -1}, slicewalk.ParameterError, "patience: expected seconds, 0 or more, found -1"),
        ({"progress": 3}, slicewalk.ParameterTypeError, "progress: expected a function, or None, found 3"),
        ({"force": 1}, slicewalk.ParameterTypeError, "force: expected True or False, found 1"),
        ({"temp_dir": 5}, slicewalk.ParameterTypeError, "temp_dir: expected a path, found 5"),
        ({"free_space": True, "stations": 5}, slicewalk.ParameterTypeError, "stations: expected a path, found 5"),
        ({"free_space": True, "stations": "none.csv"}, slicewalk.MissingFileError, "none.csv: cannot read"),
        ({"output": None}, slicewalk.ParameterTypeError, "output: expected a path, found None"),
        ({"client": None}, slicewalk.ParameterTypeError, "client: expected a synchronous .*Client, found None"),
        ({"inputs": "none.las"}, slicewalk.Error, "none.las"),
        ({"inputs": []}, slicewalk.ParameterError, "inputs: "),
        ({"inputs": 5}, slicewalk.ParameterTypeError, "inputs: expected a path, or several, found 5"),
        ({"inputs": [b"a.las"]}, slicewalk.ParameterTypeError, "inputs: item 0: expected a path, found b'a.las'"),
    ],
)
def test_errors_before_the_first_step_leave_nothing(scans, tmp_path, client, options, error, says):  # noqa: PLR0917
    given = {"parts": 2, "memory": "64MiB", "client": client, "inputs": scans[0], **tiles.OPTIONS}
    with pytest.raises(error, match=says):
        sut.convert(**{"output": tmp_path / "out.slices", **given, **options})
    assert os.listdir(tmp_path) == []


def test_a_folder_that_is_not_there_is_named(scans, tmp_path, client):
    with pytest.raises(slicewalk.OutputError, match="its folder does not exist") as raised:
        converted(scans, tmp_path / "none", client)
    assert raised.value.path == str(tmp_path / "none" / "out.slices")
    assert "slicewalk-cluster" not in str(raised.value)


def test_a_call_whose_steps_another_one_removed_says_so(scans, tmp_path, client):
    def rival(*_):
        shutil.rmtree(tmp_path / ".out.slices.slicewalk-cluster", ignore_errors=True)
        shutil.copy(scans[0][0].parent / "single.slices", tmp_path / "out.slices")

    with pytest.raises(slicewalk.OutputError, match="exists already") as raised:
        converted(scans, tmp_path, client, progress=rival)
    assert "slicewalk-cluster" not in str(raised.value)
    assert os.listdir(tmp_path) == ["out.slices"]


def test_what_is_missing_is_said_once(scans, tmp_path, client):
    inputs = [Path(shutil.copy(path, tmp_path)) for path in scans[0]]
    good = inputs[5].read_bytes()
    inputs[5].write_bytes(good[: 227 + 20 * 8000])
    options = {**tiles.OPTIONS, "quiet": False, "allow_incomplete": True}
    with pytest.warns(slicewalk.SlicewalkWarning) as single:
        slicewalk.convert(inputs, tmp_path / "single.slices", **options)
    with pytest.warns(slicewalk.SlicewalkWarning) as told:
        report = converted((inputs, None), tmp_path, client, **options)
    assert (tmp_path / "out.slices").read_bytes() == (tmp_path / "single.slices").read_bytes()
    missing = [str(one.message) for one in single if "8000 whole ones" in str(one.message)]
    assert missing
    assert not report["complete"]
    for text in missing:
        assert report["warnings"].count(text) == 1
        assert sum(str(one.message) == text for one in told) == 1
    (tmp_path / "out.slices").unlink()
    quiet = converted((inputs, None), tmp_path, client, **{**options, "quiet": True})
    assert quiet["warnings"] == report["warnings"]
    (tmp_path / "out.slices").unlink()

    # Steps of an earlier call report it too.
    def enough(stage, *_):
        if stage == "verify":
            raise KeyError

    with pytest.raises(KeyError):
        converted((inputs, None), tmp_path, client, **{**options, "quiet": True}, progress=enough)
    again = converted((inputs, None), tmp_path, client, **{**options, "quiet": True})
    assert again["skipped"] > 9
    assert (again["complete"], again["warnings"]) == (False, report["warnings"])
    inputs[5].write_bytes(good)
    (tmp_path / "out.slices").unlink()
    whole = converted((inputs, None), tmp_path, client, **{**tiles.OPTIONS, "quiet": False})
    assert (whole["complete"], whole["warnings"]) == (True, [])


def test_discard_removes_what_is_left(scans, tmp_path, client):
    def enough(*_):
        raise ValueError

    with pytest.raises(ValueError):
        converted(scans, tmp_path, client, progress=enough)
    assert sut.discard(tmp_path / "out.slices")
    assert not sut.discard(tmp_path / "out.slices")
    assert os.listdir(tmp_path) == []


def test_a_worker_with_too_little_memory_says_so(scans, tmp_path):
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=4, dashboard_address=None, memory_limit="400MiB"
        ) as local,
        distributed.Client(local) as client,
        pytest.raises(slicewalk.LimitError, match="start workers with"),
    ):
        converted(scans, tmp_path, client)
    assert os.listdir(tmp_path) == []


def test_a_step_that_kills_its_workers_ends_the_conversion(scans, tmp_path):
    cloudpickle.register_pickle_by_value(tiles)
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as local,
        distributed.Client(local) as client,
    ):
        client.register_plugin(tiles.Murder(1, 0, 1, surely=True))
        with pytest.raises(sut.WorkerLostError, match="lost its worker 2 times"):
            converted(scans, tmp_path, client, parts=2, failures=1)
    assert not (tmp_path / "out.slices").exists()


def test_without_workers_patience_ends(scans, tmp_path):
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as local,
        distributed.Client(local) as client,
        pytest.raises(sut.WorkerLostError, match="no worker for 3 s"),
    ):
        converted(scans, tmp_path, client, patience=3)


@pytest.mark.parametrize("who", ["workers", "scheduler"])
def test_whatever_is_killed_the_bytes_are_those_of_the_single_run(who):
    runs = {"workers": "3", "scheduler": "2"}[who]
    done = subprocess.run([sys.executable, HERE / "murder.py", who, runs], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "all bytes equal, nothing left" in done.stdout


def test_example(folder, tmp_path, monkeypatch):
    import doctest

    shutil.copy(folder / "room.las", tmp_path)
    monkeypatch.chdir(tmp_path)
    for text in (sut.__doc__, sut.discard.__doc__):
        test = doctest.DocTestParser().get_doctest(text, {"slicewalk": slicewalk}, "cluster", None, 0)
        runner = doctest.DocTestRunner()
        runner.run(test, out=sys.stderr.write)
        assert runner.tries > 0
        assert runner.failures == 0

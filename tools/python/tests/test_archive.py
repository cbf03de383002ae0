"""Opening, metadata, pickles, memory leaks."""

from __future__ import annotations

import gc
import json
import mmap
import os
import pathlib
import pickle
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

import scan
import slicewalk


def test_facts(folder):
    archive = slicewalk.open(folder / "room.slices")
    assert archive.pixel_size == scan.PIXEL
    assert archive.slice_height == pytest.approx(scan.SLICE)
    assert archive.height_quantum == pytest.approx(scan.SLICE / 255)
    assert np.allclose(archive.bounds, [[0.025, 0.025, 0], [7.975, 5.975, 2.5]], rtol=1e-12)
    assert archive.points_read == archive.points_kept == len(scan.room())
    assert archive.path == str(folder / "room.slices")
    info = archive.info()
    assert info["slices"] == archive.slices == 9
    assert info["voxels"]["occupied"] == archive.voxels
    assert info["format_version"] == archive.format_version
    assert info["max_slope"] == archive.max_slope == 45
    assert archive.tolerance == 0
    assert archive.crs == ""
    assert "room.slices" in repr(archive)
    assert isinstance(archive, slicewalk.Pages)
    with pytest.raises(TypeError):
        slicewalk.Archive()


def test_every_kind_of_source(folder):
    path = folder / "room.slices"
    data = path.read_bytes()
    sources = [path, str(path), os.fsencode(path).decode(), path.as_uri(), data, bytearray(data), memoryview(data)]
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        voxels = {slicewalk.open(source).voxels for source in [*sources, mapped]}
    assert len(voxels) == 1
    with pytest.raises(TypeError, match="source: expected a path, an address or bytes"):
        slicewalk.open(5)


def test_bytes_are_not_copied(folder):
    data = (folder / "room.slices").read_bytes()
    before = sys.getrefcount(data)
    archive = slicewalk.open(data)
    assert sys.getrefcount(data) > before, "the archive holds the object itself"
    archive.load()
    del archive
    assert sys.getrefcount(data) == before


class Ranges(BaseHTTPRequestHandler):
    """Serves ranges of one file."""

    data = b""

    def do_GET(self):
        if self.path.split("?")[0] != "/room.slices":
            return self.send_error(404)
        first, last = self.headers["Range"].removeprefix("bytes=").split("-")
        body = self.data[int(first) : int(last) + 1]
        self.send_response(206)
        self.send_header("Content-Range", f"bytes {first}-{int(first) + len(body) - 1}/{len(self.data)}")
        self.send_header("Content-Length", str(len(body)))
        self.send_header("ETag", '"1"')
        self.end_headers()
        self.wfile.write(body)
        return None

    def log_message(self, *arguments):
        """Log nothing."""


@pytest.fixture
def server(folder):
    Ranges.data = (folder / "room.slices").read_bytes()
    with ThreadingHTTPServer(("127.0.0.1", 0), Ranges) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"127.0.0.1:{server.server_port}"
        server.shutdown()


def test_addresses(server, folder):
    archive = slicewalk.open(f"http://user:secret@{server}/room.slices?key=secret", timeout=30)
    assert archive.path == f"http://{server}/room.slices"
    boxes = scan.boxes(np.random.default_rng(1), *archive.bounds, 100)
    assert (archive.overlaps(boxes) == slicewalk.open(folder / "room.slices").overlaps(boxes)).all()
    with pytest.raises(slicewalk.FileError) as raised:
        slicewalk.open(f"http://{server}/other.slices?key=secret")
    assert "secret" not in str(raised.value)


def test_no_file(tmp_path):
    with pytest.raises(FileNotFoundError) as raised:
        slicewalk.open(tmp_path / "a.slices")
    error = raised.value
    assert isinstance(error, slicewalk.MissingFileError)
    assert error.path == error.filename == str(tmp_path / "a.slices")
    assert (error.errno, error.action) == (2, "open")


def test_a_name_of_any_bytes_opens_again(folder, tmp_path):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/\xffname.slices")
    try:
        pathlib.Path(path).write_bytes((folder / "room.slices").read_bytes())
    except OSError:
        pytest.skip("no such names here")
    archive = slicewalk.open(path)
    assert archive.path == path
    assert slicewalk.open(archive.path).voxels == archive.voxels


def test_damage(folder, rubble, tmp_path):
    data = bytearray((folder / "rubble.slices").read_bytes())
    with pytest.raises(slicewalk.FormatError, match="rule") as raised:
        slicewalk.open(data[:1000])
    assert raised.value.rule
    assert raised.value.expected
    assert raised.value.found
    assert isinstance(raised.value, ValueError)
    # The damage is in a page: opening succeeds, loading reports the place.
    data[len(data) // 2] ^= 1
    path = tmp_path / "damaged.slices"
    path.write_bytes(data)
    archive = slicewalk.open(path)
    with pytest.raises(slicewalk.FormatError) as raised:
        archive.overlaps([[0, 0, 0, 1, 1, 1]])
    assert raised.value.path == str(path)
    assert str(path) in str(raised.value)
    assert raised.value.offset > 0
    assert [finding.rule for finding in archive.verify()]
    with pytest.raises(slicewalk.FormatError):
        archive.overlaps([[0, 0, 0, 1, 1, 1]])


def test_errors_survive_pickling(folder):
    kinds = [
        kind for kind in vars(slicewalk.errors).values() if isinstance(kind, type) and issubclass(kind, slicewalk.Error)
    ]
    assert len(kinds) > 10
    for kind in kinds:
        error = kind("what is wrong", path="a.slices", expected="1", found="2", errno=5)
        again = pickle.loads(pickle.dumps(error))
        assert type(again) is kind
        assert str(again) == "what is wrong"
        assert (again.path, again.expected, again.found, again.errno) == ("a.slices", "1", "2", 5)
        assert again.hint is None
    with pytest.raises(slicewalk.FormatError) as raised:
        slicewalk.open(b"no archive")
    assert str(pickle.loads(pickle.dumps(raised.value))) == str(raised.value)


def test_pickled_archives(folder, tmp_path):
    path = tmp_path / "a.slices"
    path.write_bytes((folder / "room.slices").read_bytes())
    pickled = pickle.dumps(slicewalk.open(path))
    assert pickle.loads(pickled).voxels == slicewalk.open(path).voxels
    data = path.read_bytes()
    assert pickle.loads(pickle.dumps(slicewalk.open(data))).voxels == slicewalk.open(path).voxels
    points = scan.room()
    points[:, 2] += 0.01
    with slicewalk.Writer(path, pixel=scan.PIXEL, force=True) as writer:
        writer.write(points)
    with pytest.raises(slicewalk.Error, match="another archive"):
        pickle.loads(pickled)


@pytest.mark.parametrize("kind", [str, pathlib.Path])
def test_pickled_archives_are_found_from_any_folder(folder, tmp_path, monkeypatch, kind):
    (tmp_path / "a.slices").write_bytes((folder / "room.slices").read_bytes())
    monkeypatch.chdir(tmp_path)
    archive = slicewalk.open(kind("a.slices"))
    assert archive.path == "a.slices"
    monkeypatch.chdir(folder)
    again = pickle.loads(pickle.dumps(archive))
    assert (again.path, again.voxels) == (str(tmp_path / "a.slices"), archive.voxels)


def resident_bytes():
    return int(pathlib.Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.skipif(not pathlib.Path("/proc/self/statm").exists(), reason="needs /proc")
def test_a_hundred_thousand_opens_leak_nothing(folder):
    path = folder / "room.slices"
    data = path.read_bytes()
    before = sys.getrefcount(data)

    def opens(count):
        for _ in range(count):
            slicewalk.open(data)

    opens(5000)
    gc.collect()
    settled = resident_bytes()
    opens(100_000)
    # 100,000 leaked heads would be gigabytes, 100,000 leaked objects tens of megabytes.
    assert resident_bytes() - settled < 4 << 20
    assert sys.getrefcount(data) == before
    files = len(os.listdir("/proc/self/fd"))
    for _ in range(2000):
        slicewalk.open(path)
    assert len(os.listdir("/proc/self/fd")) == files


def test_use_leaks_nothing(folder):
    data = (folder / "room.slices").read_bytes()

    def use():
        archive = slicewalk.open(data)
        archive.overlaps([[0, 0, 0, 1, 1, 1]])
        archive.page((0, 0, 0)).tops.sum()
        archive.column(1, 1).tops.sum()
        archive.region((0, 0, 0, 1, 1, 1)).kind.sum()
        with slicewalk.Stream(archive, "4MiB") as stream:
            stream.load([[0, 0, 0, 1, 1, 1]])
            stream.view().overlaps([[0, 0, 0, 1, 1, 1]])
            slicewalk.Walker((4, 3, 0.1)).step(stream, 0.1)
        with pytest.raises(ValueError):
            archive.overlaps([[np.nan] * 6])

    for _ in range(50):
        use()
    gc.collect()
    settled = resident_bytes()
    for _ in range(500):
        use()
    gc.collect()
    assert resident_bytes() - settled < 8 << 20


def test_info_is_that_of_the_specification(folder):
    keys = {"format_version", "pixel_size", "slice_height", "origin", "bounds", "points_read", "points_kept", "slices",
            "tiles", "voxels", "bytes", "max_slope", "tolerance", "crs", "unit"}  # fmt: skip
    info = slicewalk.open(folder / "room.slices").info()
    assert keys <= set(info)
    json.dumps(info)

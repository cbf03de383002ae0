"""Scans and archives that many tests read."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import scan
import slicewalk
import store as stores


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """A folder with room.las, room.slices and seen.slices, which the examples of the documentation use."""
    folder = tmp_path_factory.mktemp("scans")
    (folder / "room.las").write_bytes(scan.las(scan.room()))
    slicewalk.convert(folder / "room.las", folder / "room.slices", pixel=scan.PIXEL, units="m")
    (folder / "stations.csv").write_text("file,x,y,z\nroom.las,4,3,1.5\n")
    options = {"free_space": True, "stations": folder / "stations.csv"}
    slicewalk.convert(folder / "room.las", folder / "seen.slices", pixel=scan.PIXEL, units="m", **options)
    return folder


@pytest.fixture
def store(monkeypatch):
    """An empty object store, bucket ``bucket``, with its settings in this process's environment."""
    with stores.serving() as store:
        for name, value in store.environment().items():
            monkeypatch.setenv(name, value)
        yield store


@pytest.fixture(scope="session")
def rubble(folder):
    """Points and their archive."""
    points = scan.rubble(6000, 1)
    with slicewalk.Writer(folder / "rubble.slices", pixel=scan.PIXEL) as writer:
        writer.write(points)
    return points, slicewalk.open(folder / "rubble.slices")


@pytest.fixture(params=["path", "bytes", "stream"])
def doors(request, folder, rubble):
    """The archive of `rubble`, opened in each way."""
    path = folder / "rubble.slices"
    if request.param == "path":
        yield slicewalk.open(path)
    elif request.param == "bytes":
        yield slicewalk.open(path.read_bytes())
    else:
        archive = slicewalk.open(path)
        with slicewalk.Stream(archive, "64MiB") as stream:
            low, high = archive.bounds
            assert stream.load([[*(low - 2), *(high + 2)]])["left_out"] == 0
            yield stream.view()


@pytest.fixture(scope="session")
def real(folder):
    """Real scans by name, converted once; skips without them."""
    data = os.environ.get("SLICEWALK_DATA")
    made: dict[str, slicewalk.Archive] = {}

    def get(name: str, pixel: float = 0.1) -> tuple[np.ndarray, slicewalk.Archive]:
        if not data or not Path(data, name).exists():
            pytest.skip("SLICEWALK_DATA names no folder with real scans")
        laspy = pytest.importorskip("laspy")
        if name not in made:
            target = folder / f"{name}.slices"
            slicewalk.convert(Path(data, name), target, pixel=pixel, quiet=True)
            made[name] = slicewalk.open(target)
        return laspy.read(Path(data, name)).xyz, made[name]

    return get

"""Scans, plans, parts and archives in an object store on loopback."""

from __future__ import annotations

import os

import pytest

import scan
import slicewalk

OPTIONS = {"pixel": scan.PIXEL, "units": "m"}


def test_plans_and_parts_in_a_store_merge_there(folder, store):
    store.put("/bucket/tiles/room.las", (folder / "room.las").read_bytes())
    slicewalk.write_plan("s3://bucket/tiles/", "s3://bucket/plan.json", **OPTIONS)
    parts = [f"s3://bucket/{part}.slices" for part in (1, 2)]
    for part, output in enumerate(parts, 1):
        slicewalk.convert("s3://bucket/tiles/", output, plan="s3://bucket/plan.json", shard=(part, 2))
    assert slicewalk.merge(parts, "s3://bucket/whole.slices")["written"]
    assert store.objects["/bucket/whole.slices"] == (folder / "room.slices").read_bytes()
    assert not slicewalk.merge(parts, "s3://bucket/whole.slices")["written"]
    with pytest.raises(slicewalk.ParameterError, match="missing of 2: 1"):
        slicewalk.merge(parts[1:], "s3://bucket/other.slices")
    store.fails = lambda line: "/1.slices" in line
    with pytest.raises(slicewalk.FileError, match="403") as raised:
        slicewalk.merge(parts, "s3://bucket/other.slices")
    assert "very-secret" not in str(raised.value)
    assert "/bucket/other.slices" not in store.objects


def test_the_environment_counts_that_the_process_has_when_it_opens(folder, store, monkeypatch):
    store.put("/bucket/room.slices", (folder / "room.slices").read_bytes())
    asked = len(store.requests)
    slicewalk.open("s3://bucket/room.slices")
    assert len(store.requests) > asked
    monkeypatch.setenv("AWS_ENDPOINT", "http://127.0.0.1:9")
    with pytest.raises(slicewalk.FileError):
        slicewalk.open("s3://bucket/room.slices", timeout=1)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore")
def test_after_a_fork_an_archive_says_that_it_is_to_be_opened_again(folder, store, tmp_path):
    slicewalk.convert(folder / "room.las", tmp_path / "room.slices", pixel=0.02, units="m")
    store.put("/bucket/room.slices", (tmp_path / "room.slices").read_bytes())
    # More than the first request returns.
    assert len(store.objects["/bucket/room.slices"]) > 20_000
    archive = slicewalk.open("s3://bucket/room.slices")
    assert archive.verify() == []
    process = os.fork()
    if process == 0:
        told = 1
        try:
            found = archive.verify()
            told = 0 if any("open it again" in str(one) for one in found) else 2
        except slicewalk.Error as error:
            told = 0 if "open it again" in str(error) else 3
        finally:
            if told == 0 and slicewalk.open("s3://bucket/room.slices").verify() != []:
                told = 4
            os._exit(told)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0

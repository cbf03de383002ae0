"""The example Snakefile makes the bytes of a single run, and resumes after a kill."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

import slicewalk
import tiles

SNAKEFILE = Path(__file__).parents[1] / "examples" / "Snakefile"
PROGRAMS = os.environ.get("SLICEWALK_PROGRAMS")
pytestmark = [
    pytest.mark.skipif(shutil.which("snakemake") is None, reason="needs snakemake"),
    pytest.mark.skipif(PROGRAMS is None, reason="SLICEWALK_PROGRAMS names no folder with sliceconv and slicetool"),
]


def snakemake(folder, *more):
    command = ["snakemake", "--snakefile", SNAKEFILE, "--cores", "2", "--quiet", "all", "--nolock", *more]
    command += ["--config", "inputs=*.las", "output=out.slices", "parts=9", "fan_in=4", "memory=64MiB"]
    command += ["options=--pixel 0.1 --units m"]
    path = f"{PROGRAMS}{os.pathsep}{os.environ['PATH']}"
    return subprocess.Popen(command, cwd=folder, env={**os.environ, "PATH": path, "HOME": str(folder)})


def test_snakemake_makes_the_bytes_of_a_single_run_even_after_a_kill(tmp_path):
    assert len(SNAKEFILE.read_text().splitlines()) <= 60
    slicewalk.convert(tiles.tiles(tmp_path), tmp_path / "single.slices", **tiles.OPTIONS)
    process = snakemake(tmp_path)
    while process.poll() is None and not list(tmp_path.glob("out.slices.work/part-*.slices")):
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    time.sleep(1)
    assert not (tmp_path / "out.slices").exists() or process.returncode == 0
    assert snakemake(tmp_path, "--rerun-incomplete").wait(timeout=180) == 0
    assert (tmp_path / "out.slices").read_bytes() == (tmp_path / "single.slices").read_bytes()
    assert sorted(path.name for path in tmp_path.glob("out.slices.work/*")) == ["plan.json"]

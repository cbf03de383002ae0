"""Check the memory of planning, parts and merging with very many tiles: `python many.py [TILES] [PARTS]`.

Generates small tiles, each with a header and 20 points, plans them, and converts them in parts and in a single run.
Fails if a step takes more than its memory budget plus 64 MiB, or if the merged parts differ from the single run.
`.ci/long tiles` runs this script.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import numpy as np

import scan

MEMORY_MIB = 64
STEP = """
import re, sys, time, slicewalk
def status(name): return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024
before, started = status("VmRSS"), time.process_time()
options = dict(memory="%dMiB", threads=2, quiet=True, force=True)
%s
print(status("VmHWM") - before, time.process_time() - started)
"""


def step(folder: Path, what: str, code: str) -> None:
    """Run `code` in its own process; fail if its memory grows too far."""
    said = subprocess.check_output([sys.executable, "-c", STEP % (MEMORY_MIB, code)], cwd=folder, text=True)
    peak, seconds = map(float, said.split()[-2:])
    print(f"{what}: {peak:.0f} MiB beyond the interpreter, {seconds:.1f} s of processor time", flush=True)
    assert peak <= MEMORY_MIB + 64, what


def main(tiles: int, parts: int) -> None:
    """Generate, plan, convert and merge."""
    side = int(tiles**0.5) + 1
    points = scan.millimetres(np.random.default_rng(1).uniform(0, (99, 99, 3), (20, 3)))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "tiles").mkdir()
        for n in range(tiles):
            corner = np.array([100.0 * (n % side), 100.0 * (n // side), 0])
            (folder / "tiles" / f"{n:06}.las").write_bytes(scan.las(scan.millimetres(points + corner)))
        step(folder, "plan", "slicewalk.write_plan('tiles', 'plan.json', pixel=0.5, units='m', **options)")
        print(f"plan file: {os.path.getsize(folder / 'plan.json') / tiles:.0f} bytes a tile")
        for part in range(1, parts + 1):
            code = f"slicewalk.convert('tiles', '{part}.slices', plan='plan.json', shard=({part}, {parts}), **options)"
            step(folder, f"part {part} of {parts}", code)
        names = [f"{part}.slices" for part in range(1, parts + 1)]
        step(folder, "merge", f"slicewalk.merge({names}, 'merged.slices')")
        step(folder, "whole", "slicewalk.convert('tiles', 'whole.slices', pixel=0.5, units='m', **options)")
        assert (folder / "merged.slices").read_bytes() == (folder / "whole.slices").read_bytes(), "other bytes"
        print("the merged parts have the bytes of the single run")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000, int(sys.argv[2]) if len(sys.argv) > 2 else 64)

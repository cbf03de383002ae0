#!/usr/bin/env python3
"""coverage.py REPORT [--places]: shares of regions that tests run, by part, from the JSON of
`cargo llvm-cov report --json --skip-functions`; with `--places`, also where the others start, file by file.

A region is a piece of code that runs as a whole (LLVM's source-based coverage).
"""

import json
import sys
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Parts and the folders that they lie in.
PARTS = {
    "archive": "src/archive/",
    "codec": "src/codec/",
    "store": "src/store/",
    "query": "src/query/",
    "walk": "src/walk/",
    "reach": "src/reach/",
    "others of the library": "src/",
    "readers": "crates/input/src/",
    "splats": "crates/splat/src/",
    "meshes": "crates/mesh/src/",
    "conversion": "crates/convert/src/",
    "base": "crates/base/src/",
    "cube": "crates/cube/src/",
}


def uncovered(file: dict) -> list[tuple[int, int]]:
    """Lines and columns at which regions start that no test ran."""
    found = []
    for line, column, count, has_count, is_entry, is_gap in file["segments"]:
        if has_count and is_entry and not is_gap and count == 0:
            found.append((line, column))
    return found


def main() -> None:
    report = json.loads(Path(sys.argv[1]).read_text())["data"][0]
    regions, run = defaultdict(int), defaultdict(int)
    for file in report["files"]:
        path = Path(file["filename"])
        if not path.is_relative_to(ROOT):
            continue
        name = path.relative_to(ROOT).as_posix()
        part = next((part for part, folder in PARTS.items() if name.startswith(folder)), None)
        if part is None or "tests/" in name or name.endswith("tests.rs"):
            continue
        totals = file["summary"]["regions"]
        regions[part] += totals["count"]
        run[part] += totals["covered"]
        missed = totals["count"] - totals["covered"]
        if missed and "--places" in sys.argv:
            print(f"{name}: {missed} of {totals['count']}, from", *(f"{line}:{column}" for line, column in uncovered(file)))
    for part in [*PARTS, "all"]:
        count, ran = (sum(regions.values()), sum(run.values())) if part == "all" else (regions[part], run[part])
        if count:
            print(f"{part:21} {ran:6} of {count:6} regions, {100 * ran / count:.2f} %")


main()

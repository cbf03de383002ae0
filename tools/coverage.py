#!/usr/bin/env python3
"""coverage.py REPORT [--places]: shares of regions that tests run, by part, and what the others are, from the JSON of
`cargo llvm-cov report --json --skip-functions`; with `--places`, also where the others start, file by file.

A region is a piece of code that runs as a whole (LLVM's source-based coverage); here each call and each name in an expression is one.
The others are of three kinds, told by their source: a `?` whose call never failed, words of a refusal (a line that makes an error),
and all else.
"""

import json
import re
import sys
from collections import Counter, defaultdict
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


REFUSAL = re.compile(r"\bErr\(|Error::|Violation::|\b(?:ok_or_else|map_err|broken|refuse\w*|fail\w*|wrong|unreachable!|panic!)\b")


def kind_of(line: bytes, column: int) -> str:
    """Returns the kind of a region that no test ran, by its line and first column."""
    if line[column - 1 : column] == b"?":
        return "passed on"
    return "refusal" if REFUSAL.search(line.decode()) else "other"


def unrun(file: dict) -> list[tuple[int, int, str]]:
    """Returns line, column and kind of each region that no test ran."""
    lines = Path(file["filename"]).read_bytes().split(b"\n")
    starts = [
        (line, column) for line, column, count, has, is_entry, is_gap in file["segments"] if has and is_entry and not is_gap and count == 0
    ]
    return [(line, column, kind_of(lines[line - 1], column)) for line, column in starts]


def main() -> None:
    report = json.loads(Path(sys.argv[1]).read_text())["data"][0]
    regions, run = Counter(), Counter()
    kinds = defaultdict(Counter)
    for file in report["files"]:
        path = Path(file["filename"])
        if not path.is_relative_to(ROOT):
            continue
        name = path.relative_to(ROOT).as_posix()
        part = next((part for part, folder in PARTS.items() if name.startswith(folder)), None)
        if part is None or "tests/" in name or name.endswith("tests.rs"):
            continue
        totals = file["summary"]["regions"]
        missed = unrun(file)
        for of in (part, "all"):
            regions[of] += totals["count"]
            run[of] += totals["covered"]
            kinds[of].update(kind for _, _, kind in missed)
        if missed and "--places" in sys.argv:
            print(f"{name}: {len(missed)} of {totals['count']}, from", *(f"{line}:{column} ({kind})" for line, column, kind in missed))
    for part in [*PARTS, "all"]:
        if count := regions[part]:
            others = ", ".join(f"{kinds[part][kind]} {kind}" for kind in ("passed on", "refusal", "other"))
            print(f"{part:21} {run[part]:6} of {count:6} regions, {100 * run[part] / count:.2f} %; {others}")


main()

#!/usr/bin/env python3
"""coverage.py REPORT [--places | --list]: shares of regions that tests run, by part, from the JSON of
`cargo llvm-cov report --json --skip-functions`, and whether the others are those of `coverage-reasons.txt`.

A region is a piece of code that runs as a whole (LLVM's source-based coverage). `--places` also says where those start
that no test ran, file by file. `--list` prints the lines for `coverage-reasons.txt` that this report asks for.

Fails where a file has more regions of a kind than the list, and where an entry of the list has no region any more. A `?`
only passes on the error of a call, and tests inside of source files are no code of the library: they need no reason.
"""

import json
import re
import sys
from collections import Counter, defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
REASONS = Path(__file__).with_name("coverage-reasons.txt")

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


def listed() -> tuple[list[tuple[str, re.Pattern]], dict[str, Counter]]:
    """Kinds of regions with the pattern of their lines, and how many of each kind a file may have."""
    kinds, most = [], {}
    for line in REASONS.read_text().splitlines():
        if match := re.fullmatch(r"= (\w+) /(.*)/: .+", line):
            kinds.append((match[1], re.compile(match[2])))
        elif line and not line.startswith("#"):
            name, *counts = line.split()
            most[name] = Counter({counts[at]: int(counts[at + 1]) for at in range(0, len(counts), 2)})
    return kinds, most


def kinds_of(name: str, starts: list[tuple[int, int]], kinds: list[tuple[str, re.Pattern]]) -> Counter:
    """Numbers of regions that need a reason, by kind."""
    lines = (ROOT / name).read_text().splitlines()
    bodies = [at for at, line in enumerate(lines) if re.match(r"(pub\S* )?mod tests? \{", line)]
    tests = bodies[0] if bodies else len(lines)
    found = Counter()
    for line, column in starts:
        text = lines[line - 1]
        if line <= tests and text[column - 1 : column] != "?":
            found[next(kind for kind, pattern in kinds if pattern.search(text))] += 1
    return found


def compare(found: dict[str, Counter], most: dict[str, Counter]) -> bool:
    """Prints where the regions without a test differ from the list; returns whether the list holds."""
    wrong = []
    for name in sorted(found.keys() | most.keys()):
        for kind in sorted(found[name].keys() | most.get(name, Counter()).keys()):
            count, allowed = found[name][kind], most.get(name, Counter())[kind]
            if count > allowed:
                wrong.append(f"{name}: {count} regions of kind {kind} without a test, {allowed} have a reason")
            elif count == 0:
                wrong.append(f"{name}: no region of kind {kind} is without a test any more; drop it from the list")
    print(*wrong, sep="\n", end="\n" if wrong else "")
    without = sum(counts["refuse"] + counts["open"] for counts in found.values())
    print(f"{sum(map(Counter.total, found.values()))} regions ask for a reason, {without} of them have none yet")
    return not wrong


def main() -> None:
    report = json.loads(Path(sys.argv[1]).read_text())["data"][0]
    regions, run = defaultdict(int), defaultdict(int)
    kinds, most = listed()
    found = defaultdict(Counter)
    for file in report["files"]:
        path = Path(file["filename"])
        if not path.is_relative_to(ROOT):
            continue
        name = path.relative_to(ROOT).as_posix()
        part = next((part for part, folder in PARTS.items() if name.startswith(folder)), None)
        if part is None or "tests/" in name or name.endswith(("tests.rs", "testing.rs")) or "/testing/" in name:
            continue
        totals = file["summary"]["regions"]
        regions[part] += totals["count"]
        run[part] += totals["covered"]
        missed = totals["count"] - totals["covered"]
        starts = uncovered(file)
        if counts := kinds_of(name, starts, kinds):
            found[name] = counts
        if missed and "--places" in sys.argv:
            print(f"{name}: {missed} of {totals['count']}, from", *(f"{line}:{column}" for line, column in starts))
    if "--list" in sys.argv:
        for name, counts in sorted(found.items()):
            print(name, *(f"{kind} {counts[kind]}" for kind, _ in kinds if counts[kind]))
        return
    for part in [*PARTS, "all"]:
        count, ran = (sum(regions.values()), sum(run.values())) if part == "all" else (regions[part], run[part])
        if count:
            print(f"{part:21} {ran:6} of {count:6} regions, {100 * ran / count:.2f} %")
    if not compare(found, most):
        sys.exit("the list of tools/coverage-reasons.txt does not hold")


main()

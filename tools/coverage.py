#!/usr/bin/env python3
"""coverage.py REPORT [--places]: shares of regions that tests run, by part, from the JSON of `cargo llvm-cov report --json
--skip-functions`, and for how many of the others a reason is written down. Fails if a region has neither a test nor a reason.

A region is a piece of code that runs as a whole (LLVM's source-based coverage); here each call and each name in an expression is one.
The `?` of a call that never failed needs no reason of its own: it passes on an error that is made elsewhere. `coverage.toml`, beside
this script, has reasons for all others, by file and function, or by the function and words of a line in it ("function: words").
`--places` tells where those without one are, and which reasons fit nothing.
"""

import json
import re
import sys
import tomllib
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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

FUNCTION = re.compile(r"^(\s*)(?:pub(?:\([a-z: ]+\))? )?(?:(?:const|async|unsafe|extern \"C\") )*fn (\w+)")


@dataclass
class Part:
    """Regions of a part, those that tests run, and the others by whether they have a reason."""

    count: int = 0
    run: int = 0
    others: Counter[str] = field(default_factory=Counter)

    def add(self, other: "Part") -> None:
        self.count += other.count
        self.run += other.run
        self.others += other.others

    def __str__(self) -> str:
        share = 100 * self.run / self.count
        others = ", ".join(f"{self.others[what]} {what}" for what in ("passed on", "with a reason", "without one"))
        return f"{self.run:6} of {self.count:6} regions, {share:.2f} %; {others}"


def function_of(lines: list[str], number: int) -> str:
    """Returns the name of the function that a line belongs to, or nothing; lines count from 1."""
    indent = len(lines[number - 1]) - len(lines[number - 1].lstrip())
    for at in range(number - 1, -1, -1):
        begins = FUNCTION.match(lines[at])
        # The end of a function is as far to the right as its beginning.
        if begins and (at == number - 1 or len(begins[1]) < indent or lines[number - 1].strip() == "}" and len(begins[1]) == indent):
            return begins[2]
    return ""


def keys_of(function: str, line: str, reasons: dict[str, str]) -> list[str]:
    """Returns the keys of the reasons that fit a line of a function."""
    parted = ((key, *key.partition(": ")[::2]) for key in reasons)
    return [key for key, name, words in parted if name == function and words in line]


def read(file: dict[str, Any], reasons: dict[str, str]) -> tuple[Part, list[str], set[str]]:
    """Returns the regions of a file, the places without a reason, and the keys of the reasons that fit."""
    text = Path(file["filename"]).read_text()
    lines = text.split("\n")
    tests = text.find("#[cfg(test)]\nmod tests {")
    end = text[:tests].count("\n") if tests >= 0 else len(lines)
    part, places, fit = Part(), [], set()
    for line, column, count, has_count, is_entry, is_gap in file["segments"]:
        if not (has_count and is_entry and not is_gap) or line > end:
            continue
        part.count += 1
        if count > 0:
            part.run += 1
        elif lines[line - 1].encode()[column - 1 : column] == b"?":
            part.others["passed on"] += 1
        elif keys := keys_of(function_of(lines, line), lines[line - 1], reasons):
            part.others["with a reason"] += 1
            fit.update(keys)
        else:
            part.others["without one"] += 1
            places.append(f"{line}:{column} in {function_of(lines, line) or 'no function'}: {lines[line - 1].strip()}")
    return part, places, fit


def main() -> None:
    report = json.loads(Path(sys.argv[1]).read_text())["data"][0]
    reasons = tomllib.loads(Path(__file__).with_suffix(".toml").read_text())
    parts = {part: Part() for part in [*PARTS, "all"]}
    for file in report["files"]:
        path = Path(file["filename"])
        if not path.is_relative_to(ROOT):
            continue
        name = path.relative_to(ROOT).as_posix()
        part = next((part for part, folder in PARTS.items() if name.startswith(folder)), None)
        if part is None or "tests/" in name or name.endswith("tests.rs"):
            continue
        own = reasons.get(name, {})
        found, places, fit = read(file, own)
        parts[part].add(found)
        parts["all"].add(found)
        if "--places" in sys.argv:
            for place in places:
                print(f"{name}:{place}: no reason")
            for unfit in sorted(own.keys() - fit):
                print(f"{name}: tests run all of {unfit}")
    for name, all_of in parts.items():
        if all_of.count:
            print(f"{name:21} {all_of}")
    if parts["all"].others["without one"]:
        sys.exit("some regions have neither a test nor a reason; --places tells where")


main()

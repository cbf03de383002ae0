#!/usr/bin/env python3
"""Compares the tables of docs/dependencies.md with the crates that users get, and fails for each crate without a row.

Each crate with the word `unsafe` in the code of its library needs a row that names it and its version in the first cell. Cargo
takes newer compatible versions without a change here, so these are only printed, as are rows that nothing needs any more; an
incompatible version needs a new review. Reads what Cargo has fetched, and nothing from the network.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

PAGE = Path("docs/dependencies.md")
NATIVE = ["slicewalk", "sliceconv", "slicetool", "slicewalk-python", "slicewalk-c"]
SYSTEMS = ["x86_64-unknown-linux-gnu", "aarch64-unknown-linux-gnu", "x86_64-pc-windows-gnu"]
SHIPPED = [
    ["--all-features", *(f"--package={name}" for name in NATIVE), *(f"--target={system}" for system in SYSTEMS)],
    ["--package=slicewalk-engine", "--target=wasm32-unknown-unknown"],
]
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
FORBIDDEN = re.compile(r"#!\[(?:cfg_attr\(not\(test\), )?forbid\(\s*unsafe_code")


def cargo(*arguments: str) -> str:
    return subprocess.run(["cargo", *arguments, "--offline"], check=True, stdout=subprocess.PIPE, text=True).stdout


def code(path: Path) -> str:
    return COMMENT.sub("", path.read_text(encoding="utf-8"))


def places(library: Path) -> int:
    """Counts `unsafe` in the code of a library; 0 if the library forbids it."""
    if FORBIDDEN.search(code(library)):
        return 0
    files = (path for path in library.parent.rglob("*.rs") if not {"tests", "tests.rs"} & set(path.parts))
    return sum(len(re.findall(r"\bunsafe\b", code(path))) for path in files)


def line_of(name: str, version: str) -> str:
    """Returns the name and the numbers that compatible versions share: Cargo picks one version of each such line."""
    numbers = re.split("[.+-]", version)
    kept = next((at for at, number in enumerate(numbers) if number != "0"), 2) + 1
    return f"{name} {'.'.join(numbers[:kept])}"


def with_unsafe() -> dict[str, tuple[str, int]]:
    """Returns version and number of places of each crate that reaches users, by its line."""
    sources = {
        (package["name"], package["version"]): Path(target["src_path"])
        for package in json.loads(cargo("metadata", "--format-version=1"))["packages"]
        for target in package["targets"]
        if {"lib", "rlib"} & set(target["kind"])
    }
    rows = [row for of in SHIPPED for row in cargo("tree", "--edges=normal,no-proc-macro", "--prefix=none", *of).splitlines()]
    found = {}
    for row in {row.removesuffix(" (*)") for row in rows}:
        # A third word is the folder of a package of this workspace.
        match row.split():
            case [name, version] if count := places(sources[name, version[1:]]):
                found[line_of(name, version[1:])] = (version[1:], count)
    return found


def main() -> int:
    found = with_unsafe()
    cells = (line.split("|")[1] for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("|"))
    rows = [row for cell in cells for row in re.findall(r"`([\w-]+) (\d[^`]*)`", cell)]
    reviewed = {line_of(*row): row[1] for row in rows}
    faults = [f"{line}: two rows" for line, count in Counter(line_of(*row) for row in rows).items() if count > 1]
    for line in sorted(found.keys() - reviewed.keys()):
        faults.append(f"{line}: no row; version {found[line][0]} has unsafe code in {found[line][1]} places")
    for fault in faults:
        print(f"{PAGE}: {fault}", file=sys.stderr)
    unlike = (line for line in sorted(found.keys() & reviewed.keys()) if found[line][0] != reviewed[line])
    newer = [f"{line.split()[0]} {found[line][0]}, reviewed {reviewed[line]}" for line in unlike]
    print(f"unsafe code: {len(found)} crates, {len(newer)} in another version than reviewed", *newer, sep="\n  ")
    gone = sorted(reviewed.keys() - found.keys())
    if gone:
        print(f"rows without a crate: {', '.join(gone)}")
    return min(len(faults), 1)


if __name__ == "__main__":
    sys.exit(main())

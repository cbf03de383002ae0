#!/usr/bin/env python3
"""Compares the symbols that slice-archive.md shows, chapter 14, with those that reader.py prints today."""

import pathlib
import subprocess
import sys

FOLDER = pathlib.Path(__file__).parent
PROMPT = "$ reader.py "


def printed(command):
    arguments = [sys.executable, "reader.py", *command.split()]
    return subprocess.run(arguments, cwd=FOLDER, check=True, capture_output=True, text=True).stdout


def main():
    blocks = (FOLDER / "slice-archive.md").read_text(encoding="utf-8").split("```\n")[1::2]
    shown = [block for block in blocks if block.startswith(PROMPT)]
    for block in shown:
        command, lines = block.removeprefix(PROMPT).split("\n", 1)
        header, lines = lines.split("\n", 1)
        text = printed(command)
        for part in lines.split("  ...\n"):
            if not text.startswith(header + "\n") or "\n" + part not in text:
                sys.exit(f"slice-archive.md: {command}: the symbols shown are not those that reader.py prints")
    print(f"slice-archive.md: {len(shown)} excerpts agree")
    if not shown:
        sys.exit("slice-archive.md: no excerpt found")


if __name__ == "__main__":
    main()

"""Stream served archives at random for a while: `python soak.py SECONDS ADDRESS...`.

Opens an archive, walks through it by a small stream, compares the stream's answers with those of a whole copy, closes
it. Prints its counts once a minute and at the end; fails if an answer differs.
"""

from __future__ import annotations

import contextlib
import random
import sys
import time

import numpy as np

import slicewalk

BUDGET = "4MiB"
WALKED_S = 20


def places(archive: slicewalk.Archive, count: int) -> np.ndarray:
    """Boxes of a pawn anywhere."""
    low, high = archive.bounds
    feet = np.random.default_rng().uniform(low, high, (count, 3))
    return np.hstack([feet - (0.25, 0.25, 0), feet + (0.25, 0.25, 1.8)])


def walk(address: str) -> tuple[int, int]:
    """Walk and ask; return the numbers of steps and of answers."""
    whole = slicewalk.open(address)
    whole.load()
    steps = answers = 0
    with slicewalk.Stream(slicewalk.open(address), BUDGET) as stream:
        low, high = whole.bounds
        walker = slicewalk.Walker([random.uniform(*ends) for ends in zip(low, high, strict=True)])
        ends = time.monotonic() + WALKED_S
        while time.monotonic() < ends:
            heading = random.uniform(0, 2 * np.pi)
            for _ in range(60):
                walker.step(stream, 1 / 60, direction=(np.cos(heading), np.sin(heading)))
                steps += 1
            if walker.state == "falling" and walker.feet[2] < low[2] - 10:
                walker.place([random.uniform(*ends) for ends in zip(low, high, strict=True)])
            boxes = places(whole, 100)
            told, known = stream.view().overlaps(boxes), whole.overlaps(boxes)
            if not ((told == known) | (told == slicewalk.NOT_LOADED)).all():
                sys.exit(f"{address}: the stream answers otherwise than the archive")
            answers += int((told != slicewalk.NOT_LOADED).sum())
    return steps, answers


def main() -> None:
    """Walk until the time is over."""
    seconds, addresses = float(sys.argv[1]), sys.argv[2:]
    end, told = time.monotonic() + seconds, 0.0
    steps = answers = opened = 0
    while time.monotonic() < end:
        more = walk(random.choice(addresses))
        steps, answers, opened = steps + more[0], answers + more[1], opened + 1
        if time.monotonic() > told + 60:
            told = time.monotonic()
            print(f"{opened} streams, {steps} steps, {answers} answers, all equal", flush=True)


if __name__ == "__main__":
    # The soak ends by an interrupt.
    with contextlib.suppress(KeyboardInterrupt):
        main()

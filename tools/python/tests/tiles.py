"""Twelve adjacent scans and dying processes, shared by the cluster's tests and their long forms."""

from __future__ import annotations

import os
import random
import signal
import threading
import time
from pathlib import Path

import numpy as np
from distributed import WorkerPlugin

import scan

OPTIONS = {"pixel": 0.1, "units": "m", "quiet": True}


YOUNG = 1.0
"""Seconds for which a new worker is not killed."""


def tiles(folder: Path, points: int = 12_000) -> list[Path]:
    """Twelve files of 10 × 8 m, four by three, that overlap a little."""
    paths = []
    for number in range(12):
        at = np.array([9.5 * (number % 4), 7.5 * (number // 4), 0.0])
        paths.append(folder / f"tile{number:02}.las")
        paths[-1].write_bytes(scan.las(scan.millimetres(scan.rubble(points, number) + at)))
    return paths


class Murder(WorkerPlugin):
    """Worker plugin that kills the workers of some steps by SIGKILL, during the step or after it.

    Most of these steps wait for the kill once they are done, however fast the machine is; the others may deliver their
    result first.
    """

    name = "murder"
    idempotent = True

    def __init__(self, share: float, within: float, seed: int, surely: bool = False) -> None:
        self.share, self.within, self.seed, self.surely = share, within, seed, surely

    def setup(self, worker=None) -> None:
        from slicewalk import cluster

        born = time.monotonic()
        make, dice = cluster._make, random.Random((self.seed, os.getpid(), time.time_ns()).__hash__())

        def deadly(*arguments):
            if dice.random() < self.share:
                # Dask does not replace a worker that dies before its nanny knows about it.
                time.sleep(max(0.0, born + YOUNG - time.monotonic()))
                threading.Timer(dice.uniform(0, self.within), os.kill, (os.getpid(), signal.SIGKILL)).start()
                if self.surely:
                    time.sleep(60)
                made = make(*arguments)
                if dice.random() < 0.75:
                    time.sleep(60)
                return made
            return make(*arguments)

        if not hasattr(make, "deadly"):
            deadly.deadly = True
            cluster._make = deadly


def leftovers(folder: Path) -> list[str]:
    """Files in `folder` other than scans and archives."""
    return sorted(path.name for path in folder.iterdir() if not path.name.endswith((".las", ".slices")))

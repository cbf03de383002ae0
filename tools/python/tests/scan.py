"""Generated scans, and reference answers computed with numpy."""

from __future__ import annotations

import struct

import numpy as np

PIXEL = 0.1
SLICE = 0.3


def millimetres(points: np.ndarray) -> np.ndarray:
    """Round points to millimetres, as in a file."""
    return np.round(points * 1000) * 0.001


def room() -> np.ndarray:
    """A room of 8 × 6 × 2.5 m with a point every 5 cm on its floor, its ceiling and its four walls."""
    x, y, z = (np.arange(0.025, size, 0.05) for size in (8, 6, 2.5))

    def face(*axes):
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    ends_x, ends_y = np.array([0.025, 7.975]), np.array([0.025, 5.975])
    faces = [face(x, y, np.array([0.0, 2.5])), face(ends_x, y, z), face(x, ends_y, z)]
    return millimetres(np.concatenate(faces))


def rubble(count: int, seed: int) -> np.ndarray:
    """Scattered points, clusters and a slope, in whole millimetres."""
    random = np.random.default_rng(seed)
    scattered = random.uniform((-5, -4, 1.8), (5, 4, 6), (count // 3, 3))
    centres = random.uniform((-5, -4, 1.8), (5, 4, 6), (12, 3))
    clusters = centres[random.integers(0, 12, count // 3)] + random.normal(0, 0.2, (count // 3, 3))
    ground = random.uniform((-5, -4, 0), (5, 4, 0), (count // 3, 3))
    ground[:, 2] = 1 + 0.1 * ground[:, 0]
    return millimetres(np.concatenate([scattered, clusters, ground]))


def las(points: np.ndarray, rgb: np.ndarray | None = None) -> bytes:
    """LAS 1.2, point format 0, or 2 with red, green and blue, in steps of a millimetre."""
    fields = [("xyz", "<i4", 3), ("rest", "u1", 8)]
    records = np.zeros(len(points), dtype=fields if rgb is None else [*fields, ("rgb", "<u2", 3)])
    if rgb is not None:
        records["rgb"] = rgb
    form = 0 if rgb is None else 2
    records["xyz"] = np.round(points * 1000).astype("i4")
    low, high = points.min(axis=0), points.max(axis=0)
    head = struct.pack(
        "<4sHHIHH8sBB32s32sHHHIIBHI5I3d3d6d",
        *(b"LASF", 0, 0, 0, 0, 0, b"", 1, 2, b"test", b"test"),
        *(1, 2025, 227, 227, 0, form, records.itemsize, len(points)),
        *(len(points), 0, 0, 0, 0, *[0.001] * 3, *[0.0] * 3),
        *(high[0], low[0], high[1], low[1], high[2], low[2]),
    )
    return head + records.tobytes()


def boxes(random: np.random.Generator, low: np.ndarray, high: np.ndarray, count: int) -> np.ndarray:
    """Boxes around a scan, from tiny ones to a quarter of it."""
    size = (high - low) * 10 ** random.uniform(-3, -0.6, (count, 3))
    corner = random.uniform(low - 0.5, high + 0.5, (count, 3))
    return np.hstack([corner, corner + size])


class Spans:
    """All spans of an archive, read from its pages, as the reference for answers."""

    def __init__(self, pages):
        self.pixel, self.quantum = pages.pixel_size, pages.height_quantum
        # One multiplication, rounded as in the grid.
        self.per_metre = np.array([1 / pages.pixel_size] * 2 + [255 / pages.slice_height])
        columns = []
        for tx, ty, layer in pages.keys():
            page = pages.page((tx, ty, layer))
            pixel = np.repeat(np.arange(4096), np.diff(page.starts.astype(int)))
            base = layer * 64 * 255
            i, j = tx * 64 + pixel % 64, ty * 64 + pixel // 64
            columns.append(np.stack([i, j, base + page.bottoms, base + page.tops, page.obstacle], axis=1))
        self.all = np.concatenate(columns).astype(np.int64)

    def under(self, box):
        """Spans in the pixels under a box."""
        (i0, j0), (i1, j1) = np.floor(box[:2] * self.per_metre[:2]), np.floor(box[3:5] * self.per_metre[:2])
        i, j = self.all[:, 0], self.all[:, 1]
        return self.all[(i0 <= i) & (i <= i1) & (j0 <= j) & (j <= j1)]

    def overlap(self, box) -> bool:
        spans = self.under(box)
        low, high = np.ceil(box[2] * self.per_metre[2]), np.floor(box[5] * self.per_metre[2])
        return bool(((spans[:, 2] <= high) & (spans[:, 3] >= low)).any())

    def floor(self, box) -> float:
        spans = self.under(box)
        tops = spans[(spans[:, 4] == 0), 3] * self.quantum
        return max(tops[(tops >= box[2]) & (tops <= box[5])], default=-np.inf)

    def corners(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest corners of all spans (m)."""
        size = np.array([self.pixel, self.pixel, self.quantum])
        low = self.all[:, [0, 1, 2]] * size
        high = (self.all[:, [0, 1, 3]] + [1, 1, 0]) * size
        return low, high

    def first(self, low, high, motion) -> float:
        """Fraction of a motion after which the box from low to high meets solid; inf if it never does."""
        span_low, span_high = self.corners()
        with np.errstate(divide="ignore", invalid="ignore"):
            enter = np.where(motion > 0, span_low - high, span_high - low) / motion
            leave = np.where(motion > 0, span_high - low, span_low - high) / motion
        still = motion == 0
        apart = (span_low >= high) | (span_high <= low)
        enter[:, still] = np.where(apart[:, still], np.inf, -np.inf)
        leave[:, still] = np.where(apart[:, still], -np.inf, np.inf)
        first, last = enter.max(axis=1), leave.min(axis=1)
        return max(0.0, first[(first < last) & (last > 0)].min(initial=np.inf))

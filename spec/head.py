"""The head: chapter 3 of slice-archive.md."""

import math
import struct
import sys

import colours
from encoding import crc32c, xxh3_128
from page import need

MAGIC = b"\x89SLA\r\n\x1a\n"
DRAFT_MAGIC = b"\x89SLIC\r\n\x1a"
FOOTER_LEN = 24
FIXED_LEN = 384
RECORD_LEN = 28
INDEX = 1 << 36

FIELDS = (
    "magic:8s major:H minor:H head_len:I features_required:Q features_optional:Q file_len:Q plan_hash:16s "
    "pixel_size:d slice_height:d max_slope:d tolerance:d classifier:B up:B drop_floaters:H min_points:I "
    "exclude_classes:32s points_read:Q points_kept:Q points_withheld:Q points_excluded:Q min:24s max:24s "
    "slice_first:q slice_last:q tiles_occupied:Q tiles_stored:Q tiles_unique:Q voxels_occupied:Q voxels_obstacle:Q "
    "pages_stored:Q pages_shared:Q pages_uniform:Q pages_len:Q directory_len:Q metadata_len:Q metadata_crc:I "
    "leaf_entries:I leaf_count:I has_bounds:B reserved:59s"
)
NAMES, TYPES = zip(*(field.split(":") for field in FIELDS.split()))
LEVELS = struct.Struct("<B2sQII")
INFERRED = slice(LEVELS.size, LEVELS.size + 8)
FIXED = struct.Struct("<" + "".join(TYPES))
assert FIXED.size == FIXED_LEN


def plain(number, low, high):
    """Whether a number lies within limits and is no NaN and no negative zero."""
    return low <= number <= high and (number != 0 or math.copysign(1, number) > 0)


class Head:
    def __init__(self, data):
        need(data[:8] != DRAFT_MAGIC, "H1", "an archive of an unreleased version; convert the scan again")
        need(data[:8] == MAGIC, "H1", "not a slice archive")
        need(len(data) >= 412, "H2", f"{len(data)} bytes")
        head_len = int.from_bytes(data[12:16], "little")
        need(388 <= head_len <= min(16384, len(data)), "H2", f"a head of {head_len} bytes")
        self.bytes = head = data[:head_len]
        self.crc = int.from_bytes(head[-4:], "little")
        need(crc32c(head[:-4]) == self.crc, "H3", "the checksum of the head is wrong")
        self.__dict__.update(zip(NAMES, FIXED.unpack(head[:FIXED_LEN])))
        need(self.major == 1, "H4", f"version {self.major} is not supported")
        need(self.features_required <= 1, "H5", f"features {self.features_required:#x} are not supported")
        need(self.file_len == len(data), "H6", f"{len(data)} bytes, should have {self.file_len}")
        self.check_plan()
        self.read_inferred()
        self.check_totals()
        sections = head_len + self.pages_len + self.directory_len + self.metadata_len + FOOTER_LEN
        need(sections == self.file_len, "H9", f"sections of {sections} bytes in a file of {self.file_len}")
        need(self.metadata_len <= 1 << 20, "H9", f"metadata of {self.metadata_len} bytes")
        self.read_levels()
        colours.read_head(self)
        root_end = FIXED_LEN + RECORD_LEN * self.leaf_count
        need(root_end + 4 <= head_len, "R1", f"{self.leaf_count} leaves in a head of {head_len} bytes")
        need(not any(head[root_end:-4]), "H10", "padding is not zero")
        records = head[FIXED_LEN:root_end]
        self.root = check_root(self.pages, self.leaf_entries, self.leaf_count, records, self.directory_len)

    def read_levels(self):
        """The fields of chapter 9; `pages_len` is then without the levels."""
        self.has_levels = self.features_optional & 1 == 1
        zero = self.has_levels or not any(self.reserved[: LEVELS.size])
        need(self.minor > 0 or zero, "H10", "reserved bytes are not zero")
        self.level_count = self.levels_len = self.table_len = self.table_crc = 0
        if self.has_levels:
            fields = LEVELS.unpack(self.reserved[: LEVELS.size])
            self.level_count, zero, self.levels_len, self.table_len, self.table_crc = fields
            some = 0 < self.level_count <= 16 and 0 < self.table_len < self.levels_len and self.table_len <= 295552
            need(zero == b"\0\0" and (some or not any(fields[2:]) and not self.level_count), "L1", f"levels {fields}")
            need(self.levels_len <= self.pages_len, "L1", f"levels of {self.levels_len} bytes")
        self.pages_len -= self.levels_len

    def read_inferred(self):
        """The fields of inferred spans."""
        self.fill_holes = self.up >> 2
        fills = self.features_required & 1 == 1
        right = fills == (self.fill_holes > 0)
        need(right, "H7", f"holes of {self.fill_holes} pixels, features {self.features_required}")
        zero = fills or not any(self.reserved[INFERRED])
        need(self.minor > 0 or zero, "H10", "reserved bytes are not zero")
        self.voxels_inferred = int.from_bytes(self.reserved[INFERRED], "little") if fills else 0

    def check_plan(self):
        plan = (
            plain(self.pixel_size, 1e-6, 1e6)
            and plain(self.slice_height, 1e-6, 1e6)
            and plain(self.max_slope, 0, 90)
            and plain(self.tolerance, 0, 1e6)
            and self.classifier <= 2
            and self.up >> 2 <= 45
            and self.min_points >= 1
        )
        need(plan, "H7", "the plan is not within its limits")
        hash = xxh3_128(self.bytes[56:128])
        need(hash == int.from_bytes(self.plan_hash, "little"), "H7", "the hash of the plan is wrong")

    def check_totals(self):
        points = self.points_kept + self.points_withheld + self.points_excluded
        need(points <= self.points_read, "H8", f"{points} points of {self.points_read}")
        self.pages = self.pages_stored + self.pages_shared + self.pages_uniform
        tiles = self.pages <= self.tiles_occupied <= self.voxels_occupied
        unique = self.tiles_unique <= self.tiles_stored <= self.tiles_occupied
        need(tiles and unique, "H8", "the numbers of pages, tiles and voxels contradict each other")
        known = self.voxels_obstacle + self.voxels_inferred
        need(known <= self.voxels_occupied, "H8", "more voxels of obstacles and inferred ones than voxels")
        need(self.pages <= 1 << 29, "H8", f"{self.pages} pages")
        self.bounds = None
        need(self.has_bounds <= 1, "H8", f"has_bounds is {self.has_bounds}")
        if self.has_bounds:
            lows, highs = struct.unpack("<3d", self.min), struct.unpack("<3d", self.max)
            finite = all(plain(number, -sys.float_info.max, sys.float_info.max) for number in lows + highs)
            need(finite and all(map(float.__le__, lows, highs)), "H8", f"bounds {lows} to {highs}")
            self.bounds = {"min": list(lows), "max": list(highs)}
        else:
            need(not any(self.min + self.max), "H8", "bounds of no points")
        if self.pages:
            slices = -INDEX <= self.slice_first <= self.slice_last < INDEX
        else:
            slices = (self.slice_first, self.slice_last) == (0, -1)
        need(slices, "H8", f"slices {self.slice_first} to {self.slice_last}")


def check_root(pages, leaf_entries, leaf_count, records, directory_len):
    """The records of a root directory."""
    allowed = 1 << 12 <= leaf_entries <= 1 << 20 and leaf_entries.bit_count() == 1
    need(allowed, "R1", f"{leaf_entries} entries a leaf")
    need(leaf_count == -(-pages // leaf_entries) <= 512, "R1", f"{leaf_count} leaves of {pages} pages")
    root = list(struct.iter_unpack("<QiIIII", records))
    for before, after in zip(root, root[1:]):
        need(before[:2] < after[:2], "R2", f"a leaf from {after[:2]} after one from {before[:2]}")
    left = pages
    for _, _, entries, *_ in root:
        need(entries == min(left, leaf_entries), "R3", f"a leaf of {entries} entries")
        left -= entries
    stored = sum(record[3] for record in root)
    need(stored == directory_len, "R4", f"leaves of {stored} bytes, not {directory_len}")
    return root

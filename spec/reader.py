#!/usr/bin/env python3
"""A second reader of slice archives, written from slice-archive.md alone.

reader.py ARCHIVE              checks every rule and prints what the archive holds in short
reader.py ARCHIVE --json       prints all content as JSON
reader.py ARCHIVE --twin FILE  compares content, or the rule that is broken, with a JSON file

A broken rule is one line on standard error and exit code 1. Needs the package `zstandard`.
"""

import argparse
import json
import math
import struct
import sys
from bisect import bisect_left
from collections import deque

import zstandard

from page import SIDE, Page, Refused, check_span, need, size_of, slices_of

MAGIC = b"\x89SLIC\r\n\x1a"
END_MAGIC = b"\x89CILS\r\n\x1a"
PAGE_MAGIC = b"\x89PAG"
FOOTER_LEN = 24
LEADER_LEN = 24
FIXED_LEN = 384
RECORD_LEN = 28
INDEX = 1 << 36
TILE = 1 << 30
WINDOW = 65536

# Chapter 2: checksums and numbers.


def crc_table():
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return table


CRC_TABLE = crc_table()


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc = crc >> 8 ^ CRC_TABLE[(crc ^ byte) & 255]
    return crc ^ 0xFFFFFFFF


XXH_SECRET = bytes.fromhex(
    "b8fe6c3923a44bbe7c01812cf721ad1cded46de9839097db7240a4a4b7b3671fcb79e64eccc0e578825ad07dccff7221"
    "b8084674f743248ee03590e6813a264c3c2852bb91c300cb88d0658b1b532ea371644897a20df94e3819ef46a9deacd8"
)
PRIME_1, PRIME_2, PRIME_4 = 0x9E3779B185EBCA87, 0xC2B2AE3D27D4EB4F, 0x85EBCA77C2B2AE63
U64 = (1 << 64) - 1


def xxh3_128(data):
    """XXH3-128, seed 0, of 65 to 96 bytes."""
    word = lambda of, at: int.from_bytes(of[at : at + 8], "little")

    def mix(at, secret):
        product = (word(data, at) ^ word(XXH_SECRET, secret)) * (word(data, at + 8) ^ word(XXH_SECRET, secret + 8))
        return (product ^ product >> 64) & U64

    def avalanche(value):
        value = (value ^ value >> 37) * 0x165667919E3779F9 & U64
        return value ^ value >> 32

    low, high = len(data) * PRIME_1, 0
    for at in (32, 16, 0):
        end = len(data) - 16 - at
        low = (low + mix(at, 2 * at) & U64) ^ (word(data, end) + word(data, end + 8) & U64)
        high = (high + mix(end, 2 * at + 16) & U64) ^ (word(data, at) + word(data, at + 8) & U64)
    mixed = low * PRIME_1 + high * PRIME_4 + len(data) * PRIME_2 & U64
    return (-avalanche(mixed) & U64) << 64 | avalanche(low + high & U64)


def spread_bits(value):
    return sum((value >> bit & 1) << 2 * bit for bit in range(32))


def gather_bits(value):
    return sum((value >> 2 * bit & 1) << bit for bit in range(32))


def column_of(tx, ty):
    return spread_bits(tx + (1 << 31)) | spread_bits(ty + (1 << 31)) << 1


def tile_of(column):
    return gather_bits(column) - (1 << 31), gather_bits(column >> 1) - (1 << 31)


class Bytes:
    """Takes numbers from the content of a leaf."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        need(count <= len(self.data) - self.at, "D3", "a column ends early")
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self):
        value = 0
        for place in range(10):
            byte = self.take(1)[0]
            value |= (byte & 127) << 7 * place
            if byte < 128:
                need(byte or not place, "D3", "a varint longer than necessary")
                need(value <= U64, "D3", "a varint of more than 64 bits")
                return value
        raise Refused("D3", "a varint of more than 10 bytes")

    def zigzag(self):
        value = self.varint()
        return -(value + 1 >> 1) if value & 1 else value >> 1


def unpack_frame(data, content_len, rule):
    """The content of exactly one zstd frame."""
    need(data[:4] == b"\x28\xb5\x2f\xfd", rule, "no zstd frame")
    try:
        frame = zstandard.get_frame_parameters(data)
        need(frame.content_size == content_len, rule, f"content of {frame.content_size} bytes, not {content_len}")
        need(frame.dict_id == 0, rule, "a frame with a dictionary")
        decoder = zstandard.ZstdDecompressor().decompressobj()
        content = decoder.decompress(data)
    except zstandard.ZstdError as error:
        raise Refused(rule, str(error)) from None
    need(decoder.eof and not decoder.unused_data and len(content) == content_len, rule, "not exactly one frame")
    return content


# Chapter 3: head.

FIELDS = (
    "magic:8s major:H minor:H head_len:I features_required:Q features_optional:Q file_len:Q plan_hash:16s "
    "pixel_size:d slice_height:d max_slope:d tolerance:d classifier:B up:B drop_isolated:B reserved_plan:B min_points:I "
    "exclude_classes:32s points_read:Q points_kept:Q points_withheld:Q points_excluded:Q min:24s max:24s "
    "slice_first:q slice_last:q tiles_occupied:Q tiles_stored:Q tiles_unique:Q voxels_occupied:Q voxels_obstacle:Q "
    "pages_stored:Q pages_shared:Q pages_uniform:Q pages_len:Q directory_len:Q metadata_len:Q metadata_crc:I "
    "leaf_entries:I leaf_count:I has_bounds:B reserved:59s"
)
NAMES, TYPES = zip(*(field.split(":") for field in FIELDS.split()))
FIXED = struct.Struct("<" + "".join(TYPES))
assert FIXED.size == FIXED_LEN


def plain(number, low, high):
    """Whether a number lies within limits and is no NaN and no negative zero."""
    return low <= number <= high and (number != 0 or math.copysign(1, number) > 0)


class Head:
    def __init__(self, data):
        need(data[:8] == MAGIC, "H1", "not a slice archive")
        need(len(data) >= 412, "H2", f"{len(data)} bytes")
        head_len = int.from_bytes(data[12:16], "little")
        need(388 <= head_len <= min(16384, len(data)), "H2", f"a head of {head_len} bytes")
        self.bytes = head = data[:head_len]
        self.crc = int.from_bytes(head[-4:], "little")
        need(crc32c(head[:-4]) == self.crc, "H3", "the checksum of the head is wrong")
        self.__dict__.update(zip(NAMES, FIXED.unpack(head[:FIXED_LEN])))
        need(self.major == 1, "H4", f"version {self.major} is not supported")
        need(self.features_required == 0, "H5", f"features {self.features_required:#x} are not supported")
        need(self.file_len == len(data), "H6", f"{len(data)} bytes, should have {self.file_len}")
        self.check_plan()
        self.check_totals()
        sections = head_len + self.pages_len + self.directory_len + self.metadata_len + FOOTER_LEN
        need(sections == self.file_len, "H9", f"sections of {sections} bytes in a file of {self.file_len}")
        need(self.metadata_len <= 1 << 20, "H9", f"metadata of {self.metadata_len} bytes")
        need(self.minor or not any(self.reserved), "H10", "reserved bytes are not zero")
        self.check_root()

    def check_plan(self):
        plan = (
            plain(self.pixel_size, 1e-6, 1e6)
            and plain(self.slice_height, 1e-6, 1e6)
            and plain(self.max_slope, 0, 90)
            and plain(self.tolerance, 0, 1e6)
            and self.classifier <= 2
            and self.up <= 1
            and self.drop_isolated <= 1
            and self.reserved_plan == 0
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
        need(self.voxels_obstacle <= self.voxels_occupied, "H8", "more voxels of obstacles than voxels")
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

    def check_root(self):
        allowed = 1 << 12 <= self.leaf_entries <= 1 << 20 and self.leaf_entries.bit_count() == 1
        need(allowed, "R1", f"{self.leaf_entries} entries a leaf")
        leaves = -(-self.pages // self.leaf_entries)
        root_end = FIXED_LEN + RECORD_LEN * self.leaf_count
        count = self.leaf_count == leaves <= 512 and root_end + 4 <= len(self.bytes)
        need(count, "R1", f"{self.leaf_count} leaves of {self.pages} pages")
        need(not any(self.bytes[root_end:-4]), "H10", "padding is not zero")
        self.root = list(struct.iter_unpack("<QiIIII", self.bytes[FIXED_LEN:root_end]))
        for before, after in zip(self.root, self.root[1:]):
            need(before[:2] < after[:2], "R2", f"a leaf from {after[:2]} after one from {before[:2]}")
        left = self.pages
        for _, _, entries, *_ in self.root:
            need(entries == min(left, self.leaf_entries), "R3", f"a leaf of {entries} entries")
            left -= entries
        stored = sum(record[3] for record in self.root)
        need(stored == self.directory_len, "R4", f"leaves of {stored} bytes, not {self.directory_len}")


# Chapter 4: leaves.


class Entry:
    KINDS = "stored", "shared", "uniform"

    def __init__(self, column, layer, kind):
        self.column, self.layer, self.kind = column, layer, kind
        self.tx, self.ty = tile_of(column)
        self.span = None

    def key(self):
        return self.column, self.layer

    def same(self):
        """What a shared entry has in common with the stored one."""
        return self.offset, self.length, self.crc, self.mask, self.blocks, self.words


def read_leaf(data, record, end_key, pages_len):
    """Entries of a leaf, whose keys end below `end_key`."""
    column, layer, count, stored_len, raw_len, crc = record
    need(crc32c(data) == crc, "D1", "the checksum of a leaf is wrong")
    need(raw_len <= 10 + 47 * count, "D2", f"{raw_len} bytes for {count} entries")
    content = Bytes(unpack_frame(data, raw_len, "D2"))
    place = content.varint()
    columns = [content.varint() for _ in range(count)]
    layers = [content.zigzag() for _ in range(count)]
    kinds = content.take(count)
    need(max(kinds) <= 2, "D5", f"kind {max(kinds)}")
    paged = count - kinds.count(2)
    planes = content.take(8 * paged)
    masks = [int.from_bytes(planes[at::paged], "little") for at in range(paged)]
    lengths = [content.varint() for _ in range(paged)]
    distances = [content.varint() for _ in range(kinds.count(1))]
    crcs = struct.unpack(f"<{paged}I", content.take(4 * paged))
    blocks = [1 + number for number in content.take(paged)]
    words = [content.varint() for _ in range(paged)]
    spans = struct.unpack(f"<{count - paged}I", content.take(4 * (count - paged)))
    need(content.at == raw_len, "D3", f"{raw_len - content.at} bytes after the columns")

    entries, paged, shared, uniform = [], 0, 0, 0
    at_column, at_layer = column, layer
    for at in range(count):
        at_column, at_layer = at_column + columns[at], at_layer + layers[at]
        key = at_column, at_layer
        need(at or key == (column, layer), "D4", f"a leaf begins with {key}, not {(column, layer)}")
        need(not at or entries[-1].key() < key, "D4", f"entry {key} after {entries and entries[-1].key()}")
        need(at_column <= U64, "D4", f"column {at_column}")
        entry = Entry(*key, Entry.KINDS[kinds[at]])
        need(all(-TILE <= v < TILE for v in (entry.tx, entry.ty, entry.layer)), "D4", f"page {key} is not in the grid")
        entries.append(entry)
        if entry.kind == "uniform":
            read_span(entry, spans[uniform])
            uniform += 1
            continue
        entry.mask, entry.length, entry.crc = masks[paged], lengths[paged], crcs[paged]
        entry.blocks, entry.words = blocks[paged], blocks[paged] + words[paged]
        paged += 1
        need(entry.mask, "D7", f"page {key} has no slices")
        sizes = 1 <= entry.blocks <= 64 and entry.words <= 524480
        need(sizes, "D11", f"page {key} of {entry.blocks} blocks and {entry.words} words")
        need(25 <= entry.length <= 6299951, "D6", f"page {key} of {entry.length} bytes")
        entry.offset = place
        if entry.kind == "stored":
            place += entry.length
        else:
            entry.offset -= distances[shared]
            shared += 1
            need(0 <= entry.offset <= place - entry.length, "D6", f"page {key} shares bytes that are not before it")
        need(entry.offset + entry.length <= pages_len, "D6", f"page {key} ends after the pages")
    last = entries[-1].key()
    need(end_key is None or last < end_key, "D4", f"{last} in a leaf before that from {end_key}")
    return entries


def read_span(entry, word):
    bottom, top, obstacle = word & 16383, word >> 14 & 16383, word >> 28
    need(obstacle <= 1, "D8", f"uniform page with bits {word:#x}")
    check_span(bottom, top, "D8")
    entry.span = bottom, top, obstacle
    entry.mask = slices_of(bottom, top)


# Chapter 5: pages.


def read_page(entry, data, slice_height):
    magic, tx, ty, layer, body_len, crc = struct.unpack("<4siiiII", data[:LEADER_LEN])
    need(magic == PAGE_MAGIC, "P1", "a page does not begin as one")
    need(body_len == len(data) - LEADER_LEN, "P1", f"a body of {body_len} bytes, not {len(data) - LEADER_LEN}")
    right = crc32c(data[:20] + data[LEADER_LEN:])
    need(crc == right == entry.crc, "P2", f"the checksum of a page is {right:#x}, not {crc:#x} and {entry.crc:#x}")
    key = (column_of(tx, ty), layer) if max(abs(tx), abs(ty)) <= TILE else None
    if entry.kind == "stored":
        need((tx, ty, layer) == (entry.tx, entry.ty, entry.layer), "P3", f"page {(tx, ty, layer)} is elsewhere")
    else:
        need(key is not None and key < entry.key(), "P3", f"page {(tx, ty, layer)} is shared by an earlier one")
    page = Page(data[LEADER_LEN:])
    mask = 0
    for column in page.columns:
        for span in column:
            mask |= slices_of(span.bottom, span.top)
    need(mask == entry.mask, "P9", f"slices {mask:#x}, not {entry.mask:#x}")
    size = size_of(page.columns)
    need(size == (entry.blocks, entry.words), "P11", f"{size} blocks and words, not {(entry.blocks, entry.words)}")
    page.check_encoding(slice_height)
    return page


def voxels_of(columns):
    """Voxels with matter, and with an obstacle."""
    occupied = obstacle = 0
    for spans in columns:
        slices = obstacles = 0
        for bottom, top, kind in spans:
            bits = slices_of(bottom, top)
            slices |= bits
            obstacles |= bits if kind else 0
        occupied += slices.bit_count()
        obstacle += obstacles.bit_count()
    return occupied, obstacle


# Chapter 7: metadata.


def read_metadata(data, crc):
    need(crc32c(data) == crc, "M1", "the checksum of the metadata is wrong")
    records, at, before = {}, 0, b""
    while at < len(data):
        need(at + 8 <= len(data), "M2", "a record ends early")
        tag, size = data[at : at + 4], int.from_bytes(data[at + 4 : at + 8], "little")
        at += 8 + size
        need(at <= len(data), "M2", f"record {tag} ends early")
        need(before < tag, "M2", f"record {tag} after {before}")
        records[tag] = data[at - size : at]
        before = tag
    crs, part = None, None
    if b"CRS " in records:
        try:
            crs = records[b"CRS "].decode("utf-8")
        except UnicodeDecodeError:
            raise Refused("M3", "the CRS is not UTF-8") from None
        need(crs, "M3", "the CRS is empty")
    if b"SHRD" in records:
        record = records[b"SHRD"]
        need(len(record) == 40, "M4", f"the record of a part has {len(record)} bytes")
        index, count, first, last = struct.unpack("<IIQQ", record[:24])
        numbers = 1 <= count <= 1 << 16 and 1 <= index <= count and first <= last
        ends = (first == 0) == (index == 1) and (last == U64) == (index == count)
        need(numbers and ends, "M4", f"part {index} of {count} with columns {first} to {last}")
        part = {"index": index, "count": count, "first": first, "last": last, "job": record[:23:-1].hex()}
    return crs, part


# Chapter 8: the whole file.


def check_footer(head, footer):
    need(footer[16:] == END_MAGIC, "F1", "the file does not end as an archive")
    need(crc32c(footer[:12]) == int.from_bytes(footer[12:16], "little"), "F2", "the checksum of the footer is wrong")
    same = struct.unpack("<QI", footer[:12]) == (head.file_len, head.crc)
    need(same, "F3", "head and footer are of different archives")


def read_entries(head, directory):
    entries, place, at, window = [], 0, 0, deque(maxlen=WINDOW)
    ends = [record[:2] for record in head.root[1:]] + [None]
    for record, end_key in zip(head.root, ends):
        leaf = read_leaf(directory[at : at + record[3]], record, end_key, head.pages_len)
        at += record[3]
        for entry in leaf:
            if entry.kind == "stored":
                need(entry.offset == place, "D9", f"page {entry.key()} lies at {entry.offset}, not {place}")
                place = entry.offset + entry.length
                window.append(entry.same())
            elif entry.kind == "shared":
                found = bisect_left(window, entry.offset, key=lambda same: same[0])
                same = found < len(window) and window[found] == entry.same()
                need(same, "D10", f"page {entry.key()} shares bytes of no page")
        entries += leaf
    need(place == head.pages_len, "D9", f"pages of {place} bytes in a section of {head.pages_len}")
    return entries


def check_entries(head, entries, part):
    kinds = [sum(entry.kind == kind for entry in entries) for kind in Entry.KINDS]
    need(kinds == [head.pages_stored, head.pages_shared, head.pages_uniform], "T1", f"pages {kinds}")
    tiles = lambda kinds: sum(entry.mask.bit_count() for entry in entries if entry.kind in kinds)
    counts = tiles(Entry.KINDS), tiles(("stored", "shared")), tiles(("stored",))
    need(counts == (head.tiles_occupied, head.tiles_stored, head.tiles_unique), "T2", f"tiles {counts}")
    if entries:
        first = min(64 * entry.layer + (entry.mask & -entry.mask).bit_length() - 1 for entry in entries)
        last = max(64 * entry.layer + entry.mask.bit_length() - 1 for entry in entries)
        need((first, last) == (head.slice_first, head.slice_last), "T4", f"slices {first} to {last}")
    for entry in entries:
        if part:
            need(part["first"] <= entry.column <= part["last"], "T5", f"page {entry.key()} belongs to another part")


def read_archive(data):
    """Checks an archive and gives its content as a structure of lists and dictionaries."""
    head = Head(data)
    ends = [len(head.bytes)]
    for length in (head.pages_len, head.directory_len, head.metadata_len):
        ends.append(ends[-1] + length)
    pages, directory, metadata = (data[a:b] for a, b in zip(ends, ends[1:]))
    check_footer(head, data[ends[-1] :])
    crs, part = read_metadata(metadata, head.metadata_crc)
    entries = read_entries(head, directory)
    occupied = obstacle = 0
    decoded, contents = {}, []
    for entry in entries:
        item = {
            "key": [entry.tx, entry.ty, entry.layer],
            "kind": entry.kind,
            "slices": f"{entry.mask:016x}",
        }
        if entry.span:
            item["span"] = list(entry.span)
            columns = [[entry.span]] * SIDE * SIDE
        else:
            stored = pages[entry.offset : entry.offset + entry.length]
            # Shared pages are compared with their entry by rule D10; their leader and key are checked here.
            if entry.kind == "stored" or entry.offset not in decoded:
                page = read_page(entry, stored, head.slice_height)
                decoded[entry.offset] = [
                    [(span.bottom, span.top, span.obstacle) for span in column] for column in page.columns
                ]
            columns = decoded[entry.offset]
            item |= {"offset": ends[0] + entry.offset, "length": entry.length}
            item |= {"blocks": entry.blocks, "words": entry.words}
            item["pixels"] = [
                [at % SIDE, at // SIDE, *map(list, spans)] for at, spans in enumerate(columns) if spans
            ]
        counts = voxels_of(columns)
        occupied, obstacle = occupied + counts[0], obstacle + counts[1]
        contents.append(item)
    check_entries(head, entries, part)
    right = (occupied, obstacle) == (head.voxels_occupied, head.voxels_obstacle)
    need(right, "T3", f"{occupied} voxels, {obstacle} of obstacles")
    return {"info": show(head, crs, part), "pages": contents}


def show(head, crs, part):
    """As `slicetool info --json` shows it."""
    named = lambda prefix, *names: {name: getattr(head, f"{prefix}_{name}") for name in names}
    facts = {
        "format_version": f"{head.major}.{head.minor}",
        "pixel_size": head.pixel_size,
        "slice_height": head.slice_height,
        "height_quantum": head.slice_height / 255,
        "origin": [0.0, 0.0, 0.0],
        "bounds": head.bounds,
        "slices": head.slice_last - head.slice_first + 1,
        "lowest_slice": head.slice_first if head.pages else None,
        "tiles": named("tiles", "occupied", "stored", "unique"),
        "pages": named("pages", "stored", "shared", "uniform"),
        "voxels": named("voxels", "occupied", "obstacle"),
        "bytes": {
            "file": head.file_len,
            "tiles": head.pages_len,
            "directory": len(head.bytes) + head.directory_len,
        },
        "max_slope": head.max_slope,
        "tolerance": head.tolerance,
        "classifier": ("span", "thesis", "plane")[head.classifier],
        "min_points": head.min_points,
        "drop_isolated": bool(head.drop_isolated),
        "up": "zy"[head.up],
        "excluded_classes": [c for c in range(256) if head.exclude_classes[c // 8] >> c % 8 & 1],
        "plan_hash": head.plan_hash[::-1].hex(),
        "crs": crs,
    }
    for name in ("read", "kept", "withheld", "excluded"):
        facts[f"points_{name}"] = getattr(head, f"points_{name}")
    if part:
        columns = {f"{end}_column": f"{part[end]:016x}" for end in ("first", "last")}
        facts["shard"] = {"index": part["index"], "count": part["count"], "job": part["job"], **columns}
    return facts


def difference(mine, twin, where="content"):
    """The first place where two structures differ."""
    if isinstance(mine, dict) and isinstance(twin, dict) and mine.keys() == twin.keys():
        found = (difference(mine[key], twin[key], f"{where}.{key}") for key in mine)
        return next(filter(None, found), None)
    if isinstance(mine, list) and isinstance(twin, list) and len(mine) == len(twin):
        found = (difference(a, b, f"{where}[{at}]") for at, (a, b) in enumerate(zip(mine, twin)))
        return next(filter(None, found), None)
    return None if mine == twin else f"{where} is {json.dumps(mine)[:200]}, should be {json.dumps(twin)[:200]}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("archive")
    parser.add_argument("--json", action="store_true", help="print all content")
    parser.add_argument("--twin", metavar="FILE", help="compare with a JSON file")
    options = parser.parse_args()
    try:
        with open(options.archive, "rb") as file:
            data = file.read()
        twin = None
        if options.twin:
            with open(options.twin, encoding="utf-8") as file:
                twin = json.load(file)
    except (OSError, ValueError) as error:
        sys.exit(f"reader.py: {error}")
    broken = None
    try:
        content = read_archive(data)
    except Refused as refused:
        broken, content = refused, {"rule": refused.rule}
    if twin is not None:
        differs = difference(content, twin)
        if differs:
            sys.exit(f"{options.archive}: {differs} {broken or ''}")
        print(f"{options.archive}: agrees{f', {broken.rule}' if broken else ''}")
    elif broken:
        sys.exit(f"{options.archive}: {broken}")
    elif options.json:
        json.dump(content, sys.stdout, ensure_ascii=False)
        print()
    else:
        print(json.dumps(content["info"], ensure_ascii=False, indent=2))


if __name__ == "__main__":
    main()

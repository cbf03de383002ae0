#!/usr/bin/env python3
"""A second reader of slice archives, written from slice-archive.md alone.

reader.py ARCHIVE              checks every rule and prints a summary of the archive
reader.py ARCHIVE --json       prints all content as JSON
reader.py ARCHIVE --symbols N  prints the symbols of the page of entry N, from 0, one a line
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

from colours import SOURCES, check_colours, show_block
from encoding import U64, Bytes, column_of, crc32c, tile_of, unpack_frame
from head import INDEX, Head
from levels import check_levels, read_table
from page import SIDE, SLICE, TOP, Page, Refused, check_span, need, size_of, slices_of
from seen import read_seen

END_MAGIC = b"\x89ALS\r\n\x1a\n"
PAGE_MAGIC = b"\x89PAG"
LEVEL_MAGIC = b"\x89LVL"
LEADER_LEN = 24
LONGEST_PAGE = 3983681
TILE = 1 << 30
WINDOW = 65536

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
        """The fields that a shared entry has in common with the stored one."""
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
        need(25 <= entry.length <= LONGEST_PAGE, "D6", f"page {key} of {entry.length} bytes")
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


def read_page(entry, data, slice_height=None, fills=False, moved=0, of_level=False):
    """The page of an entry of an archive in which holes are closed or not, or of a level."""
    magic, tx, ty, layer, body_len, crc = struct.unpack("<4siiiII", data[:LEADER_LEN])
    need(magic == (LEVEL_MAGIC if of_level else PAGE_MAGIC), "P1", "a page does not begin as one")
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
    need(fills or of_level or not page.runs(), "P13", "inferred spans in an archive without closed holes")
    page.check_encoding(slice_height, moved, of_level)
    return page


def voxels_of(columns):
    """Occupied voxels, those of obstacles, and inferred ones; kind 2 is inferred floor."""
    occupied = obstacle = inferred = 0
    for spans in columns:
        kinds = [0, 0, 0]
        for bottom, top, kind in spans:
            kinds[kind] |= slices_of(bottom, top)
        occupied += (kinds[0] | kinds[1] | kinds[2]).bit_count()
        obstacle += kinds[1].bit_count()
        inferred += (kinds[2] & ~(kinds[0] | kinds[1])).bit_count()
    return occupied, obstacle, inferred


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
    crs, part, units = None, None, []
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
        part = {"index": index, "count": count, "first": first, "last": last, "plan_file": record[:23:-1].hex()}
    if b"UNIT" in records:
        record = records[b"UNIT"]
        need(len(record) % 16 == 0 and 16 <= len(record) <= 4096, "M5", f"units in {len(record)} bytes")
        units = list(struct.iter_unpack("<dd", record))
        need(all(1e-9 <= number <= 1e9 for unit in units for number in unit), "M5", f"units {units}")
        need(all(a < b for a, b in zip(units, units[1:])), "M5", f"units {units}")
    if b"READ" in records:
        check_inputs(records[b"READ"])
    noise = None
    if b"NOIS" in records:
        record = records[b"NOIS"]
        need(len(record) == 24, "M7", f"the record of the noise has {len(record)} bytes")
        noise = struct.unpack("<dQd", record)
        sound = lambda length: 0 <= length <= 1e6 and math.copysign(1, length) > 0
        need(sound(noise[0]) and sound(noise[2]), "M7", f"noise {noise}")
    return crs, part, units, noise


def check_inputs(record):
    at, before = 0, -1
    while at < len(record) or before < 0:
        need(at + 21 <= len(record), "M6", "an input ends early")
        (number,) = struct.unpack_from("<I", record, at)
        name = record[at + 21 : at + 21 + record[at + 20]]
        need(len(name) == record[at + 20], "M6", f"the name of input {number} ends early")
        try:
            name.decode("utf-8")
        except UnicodeDecodeError:
            raise Refused("M6", f"the name of input {number} is not UTF-8") from None
        need(before < number, "M6", f"input {number} after {before}")
        at, before = at + 21 + len(name), number


# Chapter 8: the whole file.


def check_footer(head, footer):
    need(footer[16:] == END_MAGIC, "F1", "the file does not end as an archive")
    need(crc32c(footer[:12]) == int.from_bytes(footer[12:16], "little"), "F2", "the checksum of the footer is wrong")
    same = struct.unpack("<QI", footer[:12]) == (head.file_len, head.crc)
    need(same, "F3", "head and footer are of different archives")


def read_entries(head, directory, seen_len=0):
    """The entries of all leaves; `seen_len` bytes of seen space end the section of pages."""
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
    need(place == head.pages_len - seen_len, "D9", f"pages of {place} bytes in a section of {head.pages_len}")
    return entries


def box_of(columns):
    """Least and greatest pixel x, pixel y and height of the spans of a page."""
    pixels = [at for at, spans in enumerate(columns) if spans]
    xs, ys = [at % SIDE for at in pixels], [at // SIDE for at in pixels]
    bottoms, tops = [columns[at][0][0] for at in pixels], [columns[at][-1][1] for at in pixels]
    return (min(xs), min(ys), min(bottoms)), (max(xs), max(ys), max(tops))


class Extent:
    """The least box around all spans: pixels, and quanta along z."""

    def __init__(self):
        self.low, self.high = [math.inf] * 3, [-math.inf] * 3

    def add(self, entry, box):
        corner = SIDE * entry.tx, SIDE * entry.ty, TOP * entry.layer
        low, high = ([a + b for a, b in zip(corner, place)] for place in box)
        self.low, self.high = list(map(min, self.low, low)), list(map(max, self.high, high))


def on_grid(metres, per_metre, direction):
    """Pixels or quanta; what lies far beyond the grid is cut."""
    return direction(max(min(metres * per_metre, 2.0**50), -(2.0**50)))


def moved_by(head):
    """How far heights may have been coarsened (quanta)."""
    return min(255, math.floor(head.tolerance / (head.slice_height / 255)))


def check_bounds(head, part, extent):
    borrows = part and head.fill_holes > 0
    need(head.bounds or not head.pages or borrows, "T6", "spans without bounds")
    if not head.bounds:
        return
    units = 1 / head.pixel_size, 1 / head.pixel_size, 255 / head.slice_height
    moved = moved_by(head)
    tight = head.min_points == 1 and not head.drop_floaters and not head.up & 2 and not part
    for axis, unit in enumerate(units):
        low = on_grid(head.bounds["min"][axis], unit, math.floor)
        high = on_grid(head.bounds["max"][axis], unit, math.ceil if axis == 2 else math.floor)
        text = f"bounds from {head.bounds['min'][axis]} to {head.bounds['max'][axis]} along axis {axis}"
        end = INDEX * SLICE if axis == 2 else INDEX
        need(-end <= low and high <= end, "T6", f"{text}, beyond the grid")
        if not head.pages or borrows:
            continue
        slack = moved if axis == 2 else 0
        least, greatest = extent.low[axis], extent.high[axis]
        need(low <= least + slack and greatest - slack <= high, "T6", f"{text}, of spans from {least} to {greatest}")
        margin = TOP if axis == 2 else SIDE
        near = least - margin <= low and high <= greatest + margin
        need(near or not tight, "T6", f"{text}, far from spans from {least} to {greatest}")


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
    for length in (head.pages_len, head.colours_len, head.levels_len, head.directory_len, head.metadata_len):
        ends.append(ends[-1] + length)
    pages, colours, section, directory, metadata = (data[a:b] for a, b in zip(ends, ends[1:]))
    check_footer(head, data[ends[-1] :])
    crs, part, units, noise = read_metadata(metadata, head.metadata_crc)
    seen_len, cells, seen = read_seen(head, pages, part)
    entries = read_entries(head, directory, seen_len)
    occupied = obstacle = inferred = 0
    extent = Extent()
    decoded, contents, all_columns = {}, [], {}
    for entry in entries:
        item = {
            "key": [entry.tx, entry.ty, entry.layer],
            "kind": entry.kind,
            "slices": f"{entry.mask:016x}",
        }
        if entry.span:
            item["span"] = list(entry.span)
            bottom, top, kind = entry.span
            voxels = SIDE * SIDE * entry.mask.bit_count()
            counts, box = (voxels, voxels * kind, 0), ((0, 0, bottom), (SIDE - 1, SIDE - 1, top))
            columns = [[entry.span]] * (SIDE * SIDE)
        else:
            stored = pages[entry.offset : entry.offset + entry.length]
            # Shared pages are compared with their entry by rule D10; their leader and key are checked here.
            if entry.kind == "stored" or entry.offset not in decoded:
                page = read_page(entry, stored, head.slice_height, head.fill_holes > 0, moved_by(head))
                kind = lambda span: 2 if span.inferred else span.obstacle
                kinds = [[(span.bottom, span.top, kind(span)) for span in column] for column in page.columns]
                pixels = [[at % SIDE, at // SIDE, *map(list, spans)] for at, spans in enumerate(kinds) if spans]
                columns = [[(span.bottom, span.top, span.obstacle) for span in column] for column in page.columns]
                decoded[entry.offset] = pixels, voxels_of(kinds), box_of(columns), columns
            item["pixels"], counts, box, columns = decoded[entry.offset]
            item |= {"offset": ends[0] + entry.offset, "length": entry.length}
            item |= {"blocks": entry.blocks, "words": entry.words}
        occupied, obstacle, inferred = (sum(pair) for pair in zip((occupied, obstacle, inferred), counts))
        extent.add(entry, box)
        contents.append(item)
        if head.has_levels or head.has_colours:
            all_columns[entry.tx, entry.ty, entry.layer] = columns
    check_entries(head, entries, part)
    right = (occupied, obstacle, inferred) == (head.voxels_occupied, head.voxels_obstacle, head.voxels_inferred)
    need(right, "T3", f"{occupied} voxels, {obstacle} of obstacles, {inferred} inferred")
    check_bounds(head, part, extent)
    content = {"info": show(head, crs, part, units, noise), "pages": contents}
    if seen is not None:
        content["seen"] = seen
        content["info"]["seen"] = {"cells": cells, "bytes": seen_len}
        content["info"]["bytes"]["tiles"] -= seen_len
    keys = list(all_columns)
    blocks, parts = check_colours(head, colours, keys, all_columns.get)
    for item, block in zip(contents, blocks or ()):
        item["colours"] = show_block(block)
    if head.has_levels:
        levels = read_table(head, section)
        coloured = parts, list(zip(keys, blocks or ()))
        content["levels"] = check_levels(head, levels, all_columns, coloured, read_entries, level_columns)
    return content


def level_columns(entry, pages):
    """The spans of a page of a level, checked."""
    if entry.span:
        return [[entry.span]] * (SIDE * SIDE)
    stored = pages[entry.offset : entry.offset + entry.length]
    page = read_page(entry, stored, of_level=True)
    return [[(span.bottom, span.top, span.obstacle) for span in column] for column in page.columns]


def show(head, crs, part, units, noise):
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
        "empty": head.voxels_occupied == 0,
        "voxels": named("voxels", "occupied", "obstacle", "inferred"),
        "bytes": {
            "file": head.file_len,
            "tiles": head.pages_len,
            "directory": len(head.bytes) + head.directory_len,
            "levels": head.levels_len,
            "colours": head.colours_len,
        },
        "max_slope": head.max_slope,
        "tolerance": head.tolerance,
        "classifier": ("span", "thesis", "plane")[head.classifier],
        "min_points": head.min_points,
        "drop_isolated": head.drop_floaters > 0,
        "up": "zy"[head.up & 1],
        "excluded_classes": [c for c in range(256) if head.exclude_classes[c // 8] >> c % 8 & 1],
        "plan_hash": head.plan_hash[::-1].hex(),
        "crs": crs,
        "unit": show_units(units),
    }
    if head.has_colours:
        facts["colour"] = {
            "source": SOURCES[head.colour_source - 1],
            "range": [head.colour_low, head.colour_high],
            "error": head.colour_error / 1000,
            "voxels": head.voxels_coloured,
        }
    if head.up & 2:
        facts["remove_moving"] = True
    if head.fill_holes:
        facts["fill_holes"] = {"pixels": head.fill_holes, "metres": head.fill_holes * head.pixel_size}
    if head.drop_floaters > 1:
        facts["drop_floaters"] = head.drop_floaters
    for name in ("read", "kept", "withheld", "excluded"):
        facts[f"points_{name}"] = getattr(head, f"points_{name}")
    if noise:
        facts["tolerance_auto"] = {"noise": noise[0], "regions": noise[1], "region_size": noise[2]}
    if part:
        columns = {f"{end}_column": f"{part[end]:016x}" for end in ("first", "last")}
        facts["shard"] = {"index": part["index"], "count": part["count"], "plan_file": part["plan_file"], **columns}
    return facts


def show_units(units):
    names = {1.0: "m", 0.3048: "ft", 1200 / 3937: "us-ft"}
    one = lambda factor: {"name": names.get(factor, "other"), "factor": factor}
    whole = lambda ground, up: one(ground) if up == ground else {**one(ground), "vertical": one(up)}
    if len(units) > 1:
        return {"name": "mixed", "factor": None, "units": [whole(*unit) for unit in units]}
    return whole(*units[0]) if units else None


def show_symbols(data, entry):
    """Model, value, interval, number and value of the state after each symbol of a page, and what the symbols mean."""
    if "offset" not in entry:
        sys.exit("reader.py: a uniform page has no symbols")
    number = iter(range(1 << 30))

    def show(text, is_symbol):
        print(f"{next(number):5}  {text}" if is_symbol else f"       {text}")

    print("    #  model          value  start count  state after")
    Page(data[entry["offset"] + LEADER_LEN : entry["offset"] + entry["length"]], show)


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
    parser.add_argument("--symbols", type=int, metavar="N", help="print the symbols of the page of entry N, from 0")
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
    if options.symbols is not None and not broken:
        show_symbols(data, content["pages"][options.symbols])
    elif twin is not None:
        if "some_pages" in twin and not broken:
            pages = content.pop("pages")
            content["some_pages"] = {number: pages[int(number)] for number in twin["some_pages"]}
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

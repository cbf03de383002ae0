"""Overview levels: chapter 9 of slice-archive.md."""

import struct
from types import SimpleNamespace

from colours import check_blocks, check_level_colours, show_block
from encoding import column_of, crc32c, unpack_frame
from page import SIDE, SLICE, THIRD, TOP, need
from head import RECORD_LEN, check_root

FACTOR = 4


class Level:
    """A level by its record in the table; `pages` and `directory` are its bytes."""


def read_table(head, section):
    """The levels in the bytes of their section."""
    if not head.level_count:
        return []
    table = section[len(section) - head.table_len :]
    need(crc32c(table) == head.table_crc, "L2", "the checksum of the table of levels is wrong")
    table = unpack_frame(table, None, "L3", 16 * (40 + 512 * RECORD_LEN))
    levels, at, place, below = [], 0, 0, head.pages
    for number in range(1, head.level_count + 1):
        need(max(head.pixel_size, head.slice_height) * FACTOR**number <= 1e6, "L4", f"level {number} is too coarse")
        need(at + 40 <= len(table), "L3", "the table of levels ends early")
        level = Level()
        level.number = number
        level.pages_len, level.directory_len, stored, uniform, level.leaf_entries, level.leaf_count = struct.unpack_from(
            "<QQQQII", table, at
        )
        level.kinds = [stored, 0, uniform]
        need(1 <= stored + uniform <= below, "L4", f"{stored + uniform} pages in level {number} above {below}")
        at += 40
        records = table[at : at + RECORD_LEN * level.leaf_count]
        need(len(records) == RECORD_LEN * level.leaf_count, "L3", "the table of levels ends early")
        at += len(records)
        level.root = check_root(stored + uniform, level.leaf_entries, level.leaf_count, records, level.directory_len)
        ends = place + level.pages_len, place + level.pages_len + level.directory_len
        level.pages, level.directory = section[place : ends[0]], section[ends[0] : ends[1]]
        place, below = ends[1], stored + uniform
        levels.append(level)
    need(at == len(table), "L3", f"{len(table) - at} bytes after the last level")
    need(place == len(section) - head.table_len, "L4", f"levels of {place} bytes in a section of {len(section)}")
    return levels


def joined(spans):
    """One span of all that share a slice or a height."""
    out = []
    for bottom, top, obstacle in sorted(spans):
        if out:
            low, high, other = out[-1]
            last = max(low // SLICE, (high - 1) // SLICE)
            if bottom <= high or bottom // SLICE <= last:
                out[-1] = low, max(high, top), max(other, obstacle)
                continue
        out.append((bottom, top, obstacle))
    return out


def above(pages):
    """The pages of the next level: columns of 64 x 64 pixels by key, as `pages` are."""
    level, below = {}, {}
    for (tx, ty, layer), columns in pages.items():
        key = tx >> 2, ty >> 2, layer >> 2
        upper = level.setdefault(key, {})
        below[key] = below.get(key, 0) + sum(map(len, columns))
        floor = TOP // FACTOR * (layer & 3)
        for at, spans in enumerate(columns):
            if spans:
                x, y = (SIDE * (tx & 3) + at % SIDE) // FACTOR, (SIDE * (ty & 3) + at // SIDE) // FACTOR
                pixel = upper.setdefault(SIDE * y + x, [])
                for bottom, top, obstacle in spans:
                    low, high = bottom // (FACTOR * THIRD) * THIRD, -(-top // (FACTOR * THIRD)) * THIRD
                    pixel.append((floor + low, floor + high, obstacle))
    out = {key: [joined(upper.get(at, [])) for at in range(SIDE * SIDE)] for key, upper in level.items()}
    for key, columns in out.items():
        if 4 * sum(map(len, columns)) > below[key]:
            out[key] = [joined(map(to_slices, spans)) for spans in columns]
    return out


def to_slices(span):
    """Of a sparse page."""
    bottom, top, obstacle = span
    return bottom // SLICE * SLICE, -(-top // SLICE) * SLICE, obstacle


def levels_of(head, pages):
    """All levels that the archive's pages make."""
    number = 1
    while len(pages) > 1 and any(index not in (0, -1) for key in pages for index in key) and number <= 16:
        if max(head.pixel_size, head.slice_height) * FACTOR**number > 1e6:
            return
        pages = above(pages)
        yield dict(sorted(pages.items(), key=lambda page: (column_of(*page[0][:2]), page[0][2])))
        number += 1


def check_levels(head, levels, pages, coloured, read_entries, read_columns):
    """Reads all levels and compares them with those that the archive's pages and their colours make; as the twins show them."""
    parts, archive = coloured
    made = list(levels_of(head, pages))
    need(len(made) == len(levels), "L5", f"{len(levels)} levels, should be {len(made)}")
    shown = []
    for level, wanted in zip(levels, made):
        like = SimpleNamespace(root=level.root, pages_len=level.pages_len)
        entries = read_entries(like, level.directory)
        need(all(entry.kind != "shared" for entry in entries), "D10", "a shared page in a level")
        kinds = [sum(entry.kind == kind for entry in entries) for kind in ("stored", "shared", "uniform")]
        need(kinds == level.kinds, "L5", f"pages {kinds} in level {level.number}, not {level.kinds}")
        keys = [(entry.tx, entry.ty, entry.layer) for entry in entries]
        need(keys == list(wanted), "L5", f"pages of level {level.number}")
        for entry, key in zip(entries, keys):
            columns = read_columns(entry, level.pages)
            need(columns == wanted[key], "L5", f"page {key} of level {level.number} is not what the pages below make")
        shown.append({"pages": len(entries), "pixel_size": head.pixel_size * FACTOR**level.number})
        if parts:
            section, voxels, crc = parts[level.number - 1]
            need(len(section) >= 12 * level.leaf_count, "K11", f"colours of level {level.number} of {len(section)} bytes")
            blocks = check_blocks(section, level.root, crc, voxels, 0, keys, wanted.get)
            check_level_colours(level.number, keys, blocks, wanted.get, archive)
            shown[-1]["colours"] = [show_block(block) for block in blocks]
    return shown

"""Seen space: chapter 15 of slice-archive.md."""

import struct

from encoding import U64, Bytes, crc32c, tile_of, unpack_frame
from page import need

MAGIC = b"\x89SEE\r\n\x1a\n"
TRAILER = struct.Struct("<8sQQIIII")
PAGE = 2048
TILE = 1 << 30


def read_seen(head, pages, part):
    """Bytes of the section at the end of those of the pages, the number of cells, and the cells of its pages."""
    if not head.features_optional & 4:
        return 0, None, None
    need(len(pages) >= TRAILER.size, "V1", "no room for the trailer of seen space")
    trailer = pages[-TRAILER.size :]
    magic, size, cells, blocks, table_len, table_crc, crc = TRAILER.unpack(trailer)
    need(magic == MAGIC, "V1", "no trailer of seen space")
    need(crc == crc32c(trailer[:-4]), "V1", "the checksum of the trailer is wrong")
    need(blocks <= 1 << 20 and 1 <= table_len <= 24 << 20, "V1", f"{blocks} blocks, a table of {table_len} bytes")
    need(TRAILER.size + table_len + blocks <= size <= len(pages), "V1", f"a section of {size} bytes")
    section = pages[len(pages) - size :]
    table = section[size - TRAILER.size - table_len : size - TRAILER.size]
    need(crc32c(table) == table_crc, "V2", "the checksum of the table of seen space is wrong")
    content = Bytes(unpack_frame(table, None, "V2", 24 * blocks), "V2")
    columns = [content.varint() for _ in range(blocks)]
    groups = [content.zigzag() for _ in range(blocks)]
    counts = content.take(blocks)
    lengths = [content.varint() for _ in range(blocks)]
    crcs = struct.unpack(f"<{blocks}I", content.take(4 * blocks))
    need(content.at == len(content.data), "V2", "bytes after the columns of the table")
    place, column, group, before, found, shown = 0, 0, 0, None, 0, []
    entries = []
    for at in range(blocks):
        column, group = column + columns[at], group + groups[at]
        need(column <= U64, "V2", f"column {column}")
        key = (*tile_of(column), group)
        need(all(-TILE <= v < TILE for v in (*key[:2], 64 * group)), "V2", f"block {key} is not in the grid")
        need(before is None or before < (column, group), "V2", f"block {key} is out of order")
        need(counts[at] <= 64 and 1 <= lengths[at] <= 135184, "V2", f"block {key} of {lengths[at]} bytes")
        before = column, group
        entries.append((key, column, section[place : place + lengths[at]], crcs[at], counts[at]))
        place += lengths[at]
    need(place == len(section) - TRAILER.size - table_len, "V2", f"blocks of {place} bytes")
    for key, column, data, crc, count in entries:
        need(not part or part["first"] <= column <= part["last"], "V5", f"block {key} belongs to another part")
        need(crc32c(struct.pack("<iii", *key) + data) == crc, "V3", f"the checksum of block {key} is wrong")
        for page, number in block_pages(key, data, count):
            found += number
            shown.append(page)
    need(found == cells, "V4", f"{found} seen cells, not {cells}")
    return size, cells, shown


def block_pages(key, data, count):
    """Pages of a block with their number of cells."""
    content = unpack_frame(data, None, "V3", 16 + 64 * PAGE)
    need(len(content) >= 16, "V3", f"a block of {len(content)} bytes")
    full, part = struct.unpack_from("<QQ", content)
    need(not full & part and full | part and part.bit_count() == count, "V3", f"masks {full:016x} and {part:016x}")
    need(len(content) == 16 + PAGE * count, "V3", f"a block of {len(content)} bytes")
    at = 16
    for layer in range(64):
        place = [*key[:2], 64 * key[2] + layer]
        if full >> layer & 1:
            yield [*place, "all"], 16 * 16 * 64
        elif part >> layer & 1:
            below, slices = 0, []
            for slice_at in range(at, at + PAGE, 32):
                below ^= int.from_bytes(content[slice_at : slice_at + 32], "little")
                slices.append(below)
            at += PAGE
            number = sum(cells.bit_count() for cells in slices)
            need(0 < number < 16 * 16 * 64, "V3", f"{number} cells in a page seen in part")
            yield [*place, " ".join(f"{cells:x}" for cells in slices)], number

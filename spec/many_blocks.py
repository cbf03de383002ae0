"""Checks that the second reader takes seen space of more blocks than any sample has: a table of over 230,016 bytes."""

import struct
from types import SimpleNamespace

import zstandard

from encoding import column_of, crc32c, tile_of, varint
from seen import MAGIC, TRAILER, read_seen

BLOCKS = 30_000
# One page, all of it seen.
block = zstandard.compress(struct.pack("<QQ", 1, 0))
first = column_of(0, 0)
keys = [struct.pack("<iii", *tile_of(first + number), 0) for number in range(BLOCKS)]
columns = varint(first) + b"\1" * (BLOCKS - 1)
groups, counts, lengths = bytes(BLOCKS), bytes(BLOCKS), varint(len(block)) * BLOCKS
table = columns + groups + counts + lengths + b"".join(struct.pack("<I", crc32c(key + block)) for key in keys)
packed = zstandard.compress(table)
size = BLOCKS * len(block) + len(packed) + TRAILER.size
trailer = TRAILER.pack(MAGIC, size, BLOCKS * 16 * 16 * 64, BLOCKS, len(packed), crc32c(packed), 0)[:-4]
section = block * BLOCKS + packed + trailer + struct.pack("<I", crc32c(trailer))
found, cells, pages = read_seen(SimpleNamespace(features_optional=4), section, None)
assert len(table) > 230_016 and (found, cells, len(pages)) == (size, BLOCKS * 16 * 16 * 64, BLOCKS)

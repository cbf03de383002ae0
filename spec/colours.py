"""Colours of voxels: chapter 17 of slice-archive.md."""

import struct

from encoding import Bytes, crc32c, unpack_frame
from page import SIDE, Refused, Symbols, bits, need, nibbles, slices_of

MOST_BLOCK = 5242888
CLASSES = (0, 1, 2, 3, 3, 4, 4, 5, 5, 5, 6, 6)
LONG = [8, 8, 8, 8, 4, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]
SOURCES = "rgb", "intensity", "class"


def read_head(head):
    """What the head says of colours; `pages_len` is then that of the pages alone."""
    head.colours_len = head.voxels_coloured = 0
    head.has_colours = head.minor >= 3 and head.features_optional & 2 == 2
    fields = head.reserved[27:]
    if not head.has_colours:
        need(head.minor > 4 or not any(fields), "H10", "reserved bytes are not zero")
        return
    fields = struct.unpack("<QQIHHHB5s", fields)
    head.colours_len, head.voxels_coloured, head.colours_crc, head.colour_low, head.colour_high = fields[:5]
    head.colour_error, head.colour_source, zero = fields[5:]
    right = 1 <= head.colour_source <= 3 and head.colour_low < head.colour_high
    need(right and (head.minor > 4 or not any(zero)), "K1", f"colours {fields}")
    need(12 * head.leaf_count <= head.colours_len, "K1", f"colours of {head.colours_len} bytes")
    need(head.colours_len <= head.pages_len, "L1", f"colours of {head.colours_len} bytes")
    need(head.voxels_coloured <= head.voxels_occupied, "K1", f"{head.voxels_coloured} voxels with colours")
    head.pages_len -= head.colours_len


def read_table(head, section):
    """Where each colour leaf lies, and what the table says of it."""
    if not head.has_colours:
        return []
    table = section[len(section) - 12 * head.leaf_count :]
    need(crc32c(table) == head.colours_crc, "K2", "the checksum of the table of colours is wrong")
    leaves, end = [], len(section) - len(table)
    for number, (stored_len, raw_len, crc) in reversed(list(enumerate(struct.iter_unpack("<III", table)))):
        need(raw_len <= 10 + 9 * head.root[number][2], "K2", f"a colour leaf of {raw_len} bytes")
        need(stored_len <= end, "K2", "colour leaves lie outside their section")
        end -= stored_len
        leaves.insert(0, (end, stored_len, raw_len, crc))
    return leaves


def read_leaf(section, leaf, count, blocks_end):
    """Place, length and checksum of the blocks of `count` entries."""
    start, stored_len, raw_len, crc = leaf
    data = section[start : start + stored_len]
    need(crc32c(data) == crc, "K3", "the checksum of a colour leaf is wrong")
    content = Bytes(unpack_frame(data, raw_len, "K3"), "K3")
    at = content.varint()
    need(at <= blocks_end, "K4", f"blocks from {at} on")
    places = []
    for _ in range(count):
        length = content.varint()
        need(length <= MOST_BLOCK and length <= blocks_end - at, "K4", f"a block of {length} bytes")
        places.append((at, length))
        at += length
    blocks = [(at, length, int.from_bytes(content.take(4), "little") if length else 0) for at, length in places]
    need(content.at == len(content.data), "K3", "bytes behind the checksums")
    return blocks


def klass(v):
    return CLASSES[v] if v < len(CLASSES) else 7


def rgb(values, steps):
    y, o, g = (value * step for value, step in zip(values, steps))
    t = y - (g >> 1)
    green, blue = g + t, t - (o >> 1)
    return [max(0, min(255, channel)) for channel in (blue + o, green, blue)]


def number_models():
    def weights(context):
        s = 0 if context % 8 < 2 else 1 if context % 8 < 5 else 2
        falling = [1 + (4096 >> (i >> s)) for i in range(15)]
        return falling + [1 + (falling[14] >> 1)]

    return [
        [nibbles(f"number[{i}][{context}]", 1, weights(context)) for context in range(24)] for i in range(3)
    ]


def read_block(data, voxels):
    """Colours of `voxels`, pairs of pixel and slice in order; None for those without."""
    need(len(data) >= 4 and data[0] == 1 and all(data[1:4]), "K5", f"a block that begins with {data[:4].hex()}")
    steps = data[1:4]
    try:
        found, sound = walk(Symbols(b"\1" + data[4:]), steps, voxels)
    except Refused as refused:
        raise Refused("K6", str(refused)) from None
    need(sound and any(found.values()), "K7", "numbers beyond colours, or no colour")
    return [rgb(found[voxel], steps) if found[voxel] else None for voxel in voxels]


def walk(symbols, steps, voxels):
    present, number, long = bits("present", 4, 31744), number_models(), nibbles("long", 3, LONG)
    last, a, b, sound = (128 // steps[0], 0, 0), 1, 1, True
    limits = [(255 + step // 2) // step for step in steps]
    found, top = {}, {}
    for pixel, k in voxels:
        px, py = pixel % SIDE, pixel // SIDE
        p = symbols.bit(present, 2 * a + b)
        a, b = p, a
        found[pixel, k] = None
        if not p:
            continue
        near = []
        if found.get((pixel, k - 1)):
            near.append((found[pixel, k - 1], 3))
        for x, y, weight in ((px - 1, py, 3), (px, py - 1, 3), (px - 1, py - 1, 1), (px + 1, py - 1, 2)):
            if 0 <= x < SIDE and y >= 0:
                slices = (found.get((SIDE * y + x, at)) for at in (k, k - 1, k + 1))
                beside = next(filter(None, slices), None)
                if beside:
                    near.append((beside, weight))
        values, before = [], 0
        for i in range(3):
            column = [value[i] for value, _ in near]
            if near:
                total = sum(weight for _, weight in near)
                mean = sum(value[i] * weight for value, weight in near)
                expected = (2 * mean + total) // (2 * total)
            else:
                expected = top.get(pixel, last)[i]
            s = (7, 5)[len(near)] if len(near) < 2 else klass(max(column) - min(column))
            context = s + 8 * (min(max(len(near) - 1, 0), 2) if i == 0 else before)
            n = symbols.nibble(number[i][context], 0)
            if n == 15:
                e = min(symbols.nibble(long, i), 12)
                n = 14 + (1 << e) + (symbols.raw(e) if e else 0)
            value = expected + (-(n + 1 >> 1) if n & 1 else n >> 1)
            before = min(n + 1 >> 1, 2)
            least = 0 if i == 0 else -limits[i]
            sound = sound and least <= value <= limits[i]
            values.append(max(least, min(limits[i], value)))
        found[pixel, k] = last = top[pixel] = tuple(values)
    symbols.finish()
    return found, sound


def check_colours(head, section, entries, columns_of):
    """Reads all colours; for each page those of its voxels as hexadecimal digits, `-` where there is none."""
    if not head.has_colours:
        return None
    leaves = read_table(head, section)
    blocks_end = leaves[0][0] if leaves else len(section)
    place, coloured, shown, at = 0, 0, [], 0
    for leaf, record in zip(leaves, head.root):
        count = record[2]
        for entry, (start, length, crc) in zip(entries[at : at + count], read_leaf(section, leaf, count, blocks_end)):
            need(start == place, "K8", f"colours at {start}, not {place}")
            place = start + length
            if not length:
                shown.append(None)
                continue
            data = section[start : start + length]
            key = struct.pack("<iii", entry.tx, entry.ty, entry.layer)
            need(crc32c(key + data) == crc, "K4", f"the checksum of the colours of page {entry.key()} is wrong")
            voxels = []
            for pixel, spans in enumerate(columns_of(entry)):
                mask = 0
                for bottom, top, *_ in spans:
                    mask |= slices_of(bottom, top)
                voxels += [(pixel, k) for k in range(64) if mask >> k & 1]
            colours = read_block(data, voxels)
            coloured += sum(colour is not None for colour in colours)
            shown.append(" ".join("-" if colour is None else bytes(colour).hex() for colour in colours))
        at += count
    need(place == blocks_end, "K8", f"blocks of {place} bytes before leaves at {blocks_end}")
    need(coloured == head.voxels_coloured, "K10", f"{coloured} voxels with colours, not {head.voxels_coloured}")
    return shown

"""Colours of voxels: chapter 10 of slice-archive.md."""

import struct
from bisect import bisect_right

from encoding import Bytes, crc32c, unpack_frame
from page import B, LOW, SCALE, SIDE, Bits, Symbols, need, slices_of, starts, unfold

MOST_BLOCK = 5242888
CLASSES = (0, 1, 2, 3, 3, 4, 4, 5, 5, 5, 6, 6)
LONG = [8, 8, 8, 8, 4, 2, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]
SOURCES = "rgb", "intensity", "class"


def read_head(head):
    """The fields of colours; `pages_len` is then that of the pages alone."""
    head.colours_len = head.voxels_coloured = 0
    head.levels_have_colours = False
    head.has_colours = head.features_optional & 2 == 2
    fields = head.reserved[27:]
    if not head.has_colours:
        need(head.minor > 0 or not any(fields), "H10", "reserved bytes are not zero")
        return
    fields = struct.unpack("<QQIHHHB5s", fields)
    head.colours_len, head.voxels_coloured, head.colours_crc, head.colour_low, head.colour_high = fields[:5]
    head.colour_error, head.colour_source, zero = fields[5:]
    right = 1 <= head.colour_source <= 3 and head.colour_low < head.colour_high
    need(right and (head.minor > 0 or not any(zero)), "K1", f"colours {fields}")
    head.levels_have_colours = head.level_count > 0
    tables = 12 * head.leaf_count + (20 * head.level_count + 4 if head.levels_have_colours else 0)
    need(tables <= head.colours_len, "K1", f"colours of {head.colours_len} bytes")
    need(head.colours_len <= head.pages_len, "L1", f"colours of {head.colours_len} bytes")
    need(head.voxels_coloured <= head.voxels_occupied, "K1", f"{head.voxels_coloured} voxels with colours")
    head.pages_len -= head.colours_len


def read_table(section, root, table_crc):
    """Where each colour leaf lies, and what the table says of it; a leaf for each record of a root directory."""
    table = section[len(section) - 12 * len(root) :]
    need(crc32c(table) == table_crc, "K2", "the checksum of the table of colours is wrong")
    leaves, end = [], len(section) - len(table)
    for number, (stored_len, raw_len, crc) in reversed(list(enumerate(struct.iter_unpack("<III", table)))):
        need(raw_len <= 10 + 9 * root[number][2], "K2", f"a colour leaf of {raw_len} bytes")
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


# Section 10.2: blocks, and their coder of one state.

N = [2, 3, 3, 3, 3, 4, 4, 4, 4, 4, 5, 5, 5, 5, 5, 6]


def moved(at, target, rate):
    """`at`, moved towards `target` by 1 / 2^rate of the way, which is rounded towards zero."""
    return at + (target - at >> rate if target > at else -(at - target >> rate))


class ColourSymbols(Symbols):
    def learn(self, index, value):
        first, seen = self.models[index]
        targets = (i if i <= value else 32752 + i for i in range(17))
        self.models[index] = [[moved(f, target, N[seen]) for f, target in zip(first, targets)], min(seen + 1, 15)]


class ColourBits(Bits):
    def learn(self, index, value):
        ones, seen = self.models[index]
        self.models[index] = [moved(ones, 32736 if value else 32, B[seen]), min(seen + 1, 15)]


class ColourDecoder:
    """Takes symbols from the bytes of a block."""

    def __init__(self, data):
        need(len(data) >= 4 and len(data) % 2 == 0, "K6", f"{len(data)} bytes of state and shorts")
        self.state = int.from_bytes(data[:4], "little")
        need(self.state >= LOW, "K6", f"state {self.state} at the start")
        self.shorts = [int.from_bytes(data[at : at + 2], "little") for at in range(len(data) - 2, 2, -2)]

    def _take(self, start, count):
        state = count * (self.state >> 15) + self.state % SCALE - start
        if state < LOW:
            need(self.shorts, "K6", "shorts are missing")
            state = state << 16 | self.shorts.pop()
        self.state = state

    def symbol(self, models, index):
        first = models.first(index)
        value = bisect_right(first, self.state % SCALE, 0, 16) - 1
        self._take(first[value], first[value + 1] - first[value])
        models.learn(index, value)
        return value

    def bit(self, models, index):
        ones = models.ones(index)
        value = int(self.state % SCALE >= SCALE - ones)
        self._take(*((SCALE - ones, ones) if value else (0, SCALE - ones)))
        models.learn(index, value)
        return value

    def raw(self, n):
        value = self.state % SCALE >> 15 - n
        self._take(value << 15 - n, 1 << 15 - n)
        return value

    def finish(self):
        left = len(self.shorts)
        need(self.state == LOW and not left, "K6", f"state {self.state}, {left} shorts at the end")


def class_of(v):
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

    return [ColourSymbols(f"number[{i}]", [starts(weights(c)) for c in range(24)]) for i in range(3)]


def read_block(data, voxels):
    """Steps, and the numbers of `voxels`, pairs of pixel and slice; None for those without a colour."""
    need(len(data) >= 4 and data[0] == 1 and all(data[1:4]), "K5", f"a block that begins with {data[:4].hex()}")
    steps = data[1:4]
    found, sound = walk(ColourDecoder(data[4:]), steps, voxels)
    need(sound and any(found.values()), "K7", "numbers beyond colours, or no colour")
    return steps, found


def walk(decoder, steps, voxels):
    present, number = ColourBits("present", [31744] * 4), number_models()
    long = ColourSymbols("long", [starts(LONG)] * 3)
    last, a, b, sound = (128 // steps[0], 0, 0), 1, 1, True
    limits = [(255 + step // 2) // step for step in steps]
    found, top = {}, {}
    for pixel, k in voxels:
        px, py = pixel % SIDE, pixel // SIDE
        p = decoder.bit(present, 2 * a + b)
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
            s = (7, 5)[len(near)] if len(near) < 2 else class_of(max(column) - min(column))
            context = s + 8 * (min(max(len(near) - 1, 0), 2) if i == 0 else before)
            n = decoder.symbol(number[i], context)
            if n == 15:
                e = decoder.symbol(long, i)
                n = 14 + (1 << e) + (decoder.raw(e) if e else 0)
            value = expected + unfold(n)
            before = min(n + 1 >> 1, 2)
            least = 0 if i == 0 else -limits[i]
            sound = sound and least <= value <= limits[i]
            values.append(max(least, min(limits[i], value)))
        found[pixel, k] = last = top[pixel] = tuple(values)
    decoder.finish()
    return found, sound


def voxels_of(columns):
    """Pixel and slice of the voxels of a page in order."""
    voxels = []
    for pixel, spans in enumerate(columns):
        mask = 0
        for bottom, top, *_ in spans:
            mask |= slices_of(bottom, top)
        voxels += [(pixel, k) for k in range(64) if mask >> k & 1]
    return voxels


def check_blocks(section, root, table_crc, coloured, place, keys, columns_of):
    """Reads all blocks of a section, or of the part of a level, from `place` on: steps and numbers for each page, None without colours."""
    leaves = read_table(section, root, table_crc)
    blocks_end = leaves[0][0] if leaves else len(section)
    count, blocks, keys = 0, [], iter(keys)
    for leaf, record in zip(leaves, root):
        for start, length, crc in read_leaf(section, leaf, record[2], blocks_end):
            key = next(keys)
            need(start == place, "K8", f"colours at {start}, not {place}")
            place = start + length
            if not length:
                blocks.append(None)
                continue
            data = section[start : start + length]
            right = crc32c(struct.pack("<iii", *key) + data) == crc
            need(right, "K4", f"the checksum of the colours of page {key} is wrong")
            blocks.append(read_block(data, voxels_of(columns_of(key))))
            count += sum(numbers is not None for numbers in blocks[-1][1].values())
    need(place == blocks_end, "K8", f"blocks of {place} bytes before leaves at {blocks_end}")
    need(count == coloured, "K10", f"{count} voxels with colours, not {coloured}")
    return blocks


def show_block(block):
    """As the twins show it: six hexadecimal digits for each voxel, `-` where there is no colour."""
    if not block:
        return None
    steps, found = block
    return " ".join(bytes(rgb(numbers, steps)).hex() if numbers else "-" for numbers in found.values())


def check_colours(head, section, keys, columns_of):
    """Reads all colours of the archive; blocks in order, and the parts of its levels."""
    if not head.has_colours:
        return None, []
    parts, place = level_parts(head, section)
    crc, coloured = head.colours_crc, head.voxels_coloured
    return check_blocks(section, head.root, crc, coloured, place, keys, columns_of), parts


def level_parts(head, section):
    """For each level the bytes of its colours, how many voxels they are of, the checksum of their table; where the last part ends."""
    if not head.levels_have_colours:
        return [], 0
    size = 20 * head.level_count
    right = crc32c(section[:size]) == int.from_bytes(section[size : size + 4], "little")
    need(right, "K11", "the checksum of the table of levels in the colours is wrong")
    records, place, parts = list(struct.iter_unpack("<QQI", section[:size])), size + 4, []
    for length, voxels, crc in reversed(records):
        need(length <= len(section) - 12 * head.leaf_count - place, "K11", "colours of levels beyond their section")
        parts.insert(0, (section[place : place + length], voxels, crc))
        place += length
    return parts, place


def indices(key, voxel):
    """Indices of a voxel of a page on the whole grid."""
    pixel, k = voxel
    return SIDE * key[0] + pixel % SIDE, SIDE * key[1] + pixel // SIDE, SIDE * key[2] + k


def numbers_of(means, steps):
    """The numbers of steps of a mean colour."""
    if set(steps) == {1}:
        r, g, b = ((mean + 128) // 257 for mean in means)
        o = r - b
        t = b + (o >> 1)
        return t + (g - t >> 1), o, g - t
    red, green, blue = means
    found = []
    for value, step in zip(((red + 2 * green + blue + 2) // 4, red - blue, green - (red + blue) // 2), steps):
        size = (abs(value) + 257 * step // 2) // (257 * step)
        found.append(size if value >= 0 else -size)
    return tuple(found)


def check_level_colours(number, keys, blocks, columns_of, archive):
    """Compares the colours of level `number` with those of the archive's voxels, of which `archive` has key and block."""
    sums = {}
    for key, block in archive:
        for voxel, numbers in block[1].items() if block else ():
            if numbers:
                place = tuple(index >> 2 * number for index in indices(key, voxel))
                count, *sum_of = sums.get(place, (0, 0, 0, 0))
                sums[place] = count + 1, *(a + b for a, b in zip(sum_of, rgb(numbers, block[0])))
    for key, block in zip(keys, blocks):
        for voxel in voxels_of(columns_of(key)):
            numbers = block[1][voxel] if block else None
            sum_of = sums.get(indices(key, voxel))
            need(block or not sum_of, "K12", f"page {key} of level {number} without its colours")
            expected = None
            if sum_of:
                count, *sum_of = sum_of
                means = [(65535 * s + 255 * count // 2) // (255 * count) for s in sum_of]
                expected = numbers_of(means, block[0])
            need(numbers == expected, "K12", f"a colour of page {key} of level {number} is {numbers}, not {expected}")

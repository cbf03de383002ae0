"""Checksums, numbers and frames: chapter 2 of slice-archive.md."""

import zstandard

from page import Refused, need

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
    """Takes numbers from bytes, by default the content of a leaf."""

    def __init__(self, data, rule="D3"):
        self.data, self.at, self.rule = data, 0, rule

    def take(self, count):
        need(count <= len(self.data) - self.at, self.rule, "a column ends early")
        self.at += count
        return self.data[self.at - count : self.at]

    def varint(self):
        value = 0
        for place in range(10):
            byte = self.take(1)[0]
            value |= (byte & 127) << 7 * place
            if byte < 128:
                need(byte or not place, self.rule, "a varint longer than necessary")
                need(value <= U64, self.rule, "a varint of more than 64 bits")
                return value
        raise Refused(self.rule, "a varint of more than 10 bytes")

    def zigzag(self):
        value = self.varint()
        return -(value + 1 >> 1) if value & 1 else value >> 1


def varint(value):
    """The bytes of a varint."""
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes(out) + bytes([value])


def unpack_frame(data, content_len, rule, most=0):
    """Unpack exactly one zstd frame of `content_len` bytes, or of at most `most` bytes if `content_len` is None."""
    need(data[:4] == b"\x28\xb5\x2f\xfd", rule, "no zstd frame")
    try:
        frame = zstandard.get_frame_parameters(data)
        if content_len is None:
            need(frame.content_size <= most, rule, f"content of {frame.content_size} bytes")
            content_len = frame.content_size
        need(frame.content_size == content_len, rule, f"content of {frame.content_size} bytes, not {content_len}")
        need(frame.dict_id == 0, rule, "a frame with a dictionary")
        decoder = zstandard.ZstdDecompressor().decompressobj()
        content = decoder.decompress(data)
    except zstandard.ZstdError as error:
        raise Refused(rule, str(error)) from None
    need(decoder.eof and not decoder.unused_data and len(content) == content_len, rule, "not exactly one frame")
    return content

"""16-bit grey PNG by the standard's own words, slow and obvious; shares no code with any library of images."""

import struct
import zlib

import numpy as np
from numpy.typing import NDArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PAIR = 2


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def encode(image: NDArray[np.uint16], *, depth: int = 16, colour: int = 0) -> bytes:
    """Encode (row, col) uint16 without filters."""
    rows, cols = image.shape
    raw = image.astype(">u2").view("u1").reshape(rows, _PAIR * cols)
    lines = b"".join(b"\x00" + line.tobytes() for line in raw)
    header = struct.pack(">IIBBBBB", cols, rows, depth, colour, 0, 0, 0)
    return SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(lines)) + _chunk(b"IEND", b"")


def decode(data: bytes) -> tuple[NDArray[np.uint16], dict[str, str]]:
    """Decode a grey PNG of 16 bits: (row, col) uint16, and its texts."""
    assert data.startswith(SIGNATURE)
    at, packed, texts, size = len(SIGNATURE), b"", {}, (0, 0)
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind, body = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", data, at + 8 + length)[0] == zlib.crc32(kind + body)
        if kind == b"IHDR":
            cols, rows, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", body)
            assert (depth, colour, interlaced) == (16, 0, 0)
            size = rows, cols
        elif kind == b"IDAT":
            packed += body
        elif kind == b"tEXt":
            key, _, text = body.partition(b"\x00")
            texts[key.decode("latin-1")] = text.decode("latin-1")
        at += length + 12
    return _unfiltered(zlib.decompress(packed), *size), texts


def _unfiltered(raw: bytes, rows: int, cols: int) -> NDArray[np.uint16]:
    width = _PAIR * cols
    above, lines = [0] * width, []
    for row in range(rows):
        start = row * (width + 1)
        kind, line = raw[start], list(raw[start + 1 : start + 1 + width])
        for i in range(width):
            left = line[i - _PAIR] if i >= _PAIR else 0
            corner = above[i - _PAIR] if i >= _PAIR else 0
            guess = left + above[i] - corner
            paeth = min((abs(guess - value), order, value) for order, value in enumerate((left, above[i], corner)))[2]
            line[i] = (line[i] + (0, left, above[i], (left + above[i]) // 2, paeth)[kind]) % 256
        above = line
        lines.append(bytes(line))
    return np.frombuffer(b"".join(lines), dtype=">u2").reshape(rows, cols).astype(np.uint16)

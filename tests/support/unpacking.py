"""Reads back what the page holds, slow and obvious; shares no code with the package or its script."""

import base64
import struct
import zlib
from typing import Any

UNKNOWN = -(2**31)


def unpack(window: dict[str, Any]) -> dict[str, list[float | None]]:
    """Arrays of one window by name; None where a value is not known."""
    content = zlib.decompress(base64.b64decode(window["data"]))
    arrays, at = {}, 0
    for spec in window["arrays"]:
        length = spec["length"]
        values: list[float | None] = []
        for k in range(length):
            whole = struct.unpack("<i", bytes(content[at + plane * length + k] for plane in range(4)))[0]
            values.append(None if whole == UNKNOWN else whole * spec["unit"])
        arrays[spec["name"]] = values
        at += 4 * length
    assert at == len(content)
    return arrays


def samples_of(window: dict[str, Any], pixel: int, pixels: int) -> list[float]:
    """Samples of a pixel, ascending."""
    held = window["samples"]
    gaps = zlib.decompress(base64.b64decode(held["data"]))
    high = held["ranks"] * pixels
    assert len(gaps) == 2 * high
    count = round(unpack(held["counts"])["counts"][pixel] or 0)
    values, steps = [], 0
    for rank in range(count):
        at = rank * pixels + pixel
        steps += gaps[at] + 256 * gaps[high + at]
        values.append(held["offset"] + held["step"] * steps)
    return values

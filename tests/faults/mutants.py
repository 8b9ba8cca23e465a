"""Damaged and hostile files, each made of a sound one and a seed: the same seed makes the same mutant."""

import random
import re
import shutil
from pathlib import Path

from faults.hostile import HOSTILE
from faults.originals import Original

_INTERESTING = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)
_VALUES = (
    "nan",
    "inf",
    "-inf",
    "-1",
    "0",
    "0.0",
    "1",
    "1e-300",
    "1e308",
    "1e999",
    "-1e9",
    "4294967296",
    "18446744073709551616",
    "9" * 400,
    "true",
    '""',
    '"text"',
    "[]",
    "[1.0]",
    "[[[[1.0]]]]",
    "{}",
    "1979-05-27",
    "0x10",
    "0.5",
    "1e6",
    "3",
    "1e4",
    '"../../etc/hostname"',
    '"map.npy"',
    '"sr3000"',
    '"\\u0000"',
)
_DEPTH = 20_000


def mutate(original: Original, seed: str, target: Path) -> tuple[Path, str]:
    """Write a mutant of an original.

    `original`: what is mutated; of several files, one.
    `seed`: which mutant.
    `target`: its path; a folder where the original is one.
    Returns Path, str: what a command is given, and what was done to it.
    """
    chance = random.Random(seed)  # noqa: S311  no secret
    chosen = chance.choice(original.files)
    path = target
    if chosen.parent.name.startswith("bag_"):
        shutil.copytree(chosen.parent, target)
        path = target / chosen.name
    else:
        shutil.copyfile(chosen, target)
    kinds = [_bytes]
    if original.format == "hdf5":
        kinds.append(_structure)
    elif original.format == "text" or chosen.suffix in (".yaml", ".toml"):
        kinds += [_text, _text]
    return target, chance.choice(kinds)(path, chance)


def _bytes(path: Path, chance: random.Random) -> str:
    """Flip, overwrite, cut, lengthen or move bytes."""
    data = bytearray(path.read_bytes())
    done = [chance.choice(_BYTE_CHANGES)(data, chance) for _ in range(chance.choice((1, 1, 1, 2, 8)))]
    path.write_bytes(data)
    return "bytes: " + ", ".join(done)


def _place(data: bytearray, chance: random.Random, width: int = 1) -> int:
    """Somewhere; headers stand in front more often than not."""
    end = max(1, len(data) - width + 1)
    return chance.randrange(end if chance.random() < 0.6 else min(end, 2048))


def _flip(data: bytearray, chance: random.Random) -> str:
    place, bit = _place(data, chance), chance.randrange(8)
    if data:
        data[place] ^= 1 << bit
    return f"bit {bit} of byte {place} flipped"


def _overwrite(data: bytearray, chance: random.Random) -> str:
    width = chance.choice((1, 1, 2, 4, 8, 64, 512))
    place = _place(data, chance, width)
    value = chance.choice(_INTERESTING)
    data[place : place + width] = chance.choice((bytes([value]) * width, chance.randbytes(width)))
    return f"{width} bytes from {place} on overwritten"


def _number(data: bytearray, chance: random.Random) -> str:
    width = chance.choice((2, 4, 8))
    place = _place(data, chance, width)
    value = chance.choice((0, 1, (1 << 8 * width) - 1, 1 << 8 * width - 1, (1 << 8 * width - 1) - 1, len(data)))
    data[place : place + width] = (value % (1 << 8 * width)).to_bytes(width, "little")
    return f"{value} in {width} bytes from {place} on"


def _cut(data: bytearray, chance: random.Random) -> str:
    length = chance.randrange(len(data) + 1)
    del data[length:]
    return f"cut to {length} bytes"


def _remove(data: bytearray, chance: random.Random) -> str:
    place = _place(data, chance)
    width = chance.randrange(1, 64)
    del data[place : place + width]
    return f"{width} bytes from {place} on removed"


def _insert(data: bytearray, chance: random.Random) -> str:
    place, width = _place(data, chance), chance.choice((1, 3, 8, 100, 5000))
    data[place:place] = chance.choice((bytes(width), chance.randbytes(width)))
    return f"{width} bytes put in at {place}"


def _copy(data: bytearray, chance: random.Random) -> str:
    width = chance.randrange(1, 256)
    here, there = _place(data, chance, width), _place(data, chance, width)
    data[there : there + width] = data[here : here + width]
    return f"{width} bytes from {here} copied to {there}"


_BYTE_CHANGES = (_flip, _flip, _overwrite, _number, _cut, _remove, _insert, _copy)


def _text(path: Path, chance: random.Random) -> str:
    """Change values, lines and nesting of a text of keys and values."""
    text = path.read_text()
    done = []
    for _ in range(chance.choice((1, 1, 2, 3))):
        change = chance.choice(_TEXT_CHANGES)
        text, what = change(text, chance)
        done.append(what)
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    return "text: " + ", ".join(done)


def _value(text: str, chance: random.Random) -> tuple[str, str]:
    found = list(re.finditer(r"(?<=[=:] )[^\n#]+", text))
    if not found:
        return text, "nothing"
    match, value = chance.choice(found), chance.choice(_VALUES)
    line = text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
    return text[: match.start()] + value + text[match.end() :], f"{line.strip()} {value[:30]}"


def _element(text: str, chance: random.Random) -> tuple[str, str]:
    found = list(re.finditer(r"-?\d+\.\d+(e-?\d+)?", text))
    if not found:
        return text, "nothing"
    match, value = chance.choice(found), chance.choice(_VALUES)
    return text[: match.start()] + value + text[match.end() :], f"number {match[0]} made {value[:30]}"


def _lines(text: str, chance: random.Random) -> tuple[str, str]:
    lines = text.split("\n")
    here, there = chance.randrange(len(lines)), chance.randrange(len(lines))
    what = chance.choice(("removed", "doubled", "moved"))
    line = lines[here] if what == "doubled" else lines.pop(here)
    if what != "removed":
        lines.insert(there, line)
    return "\n".join(lines), f"line {here} {what}"


def _nest(text: str, chance: random.Random) -> tuple[str, str]:
    opening, closing = chance.choice((("[", "]"), ("{a = ", "}"), ("{a: ", "}"), ("a.", "a = 1")))
    place = chance.choice([match.end() for match in re.finditer(r"\n|= ", text)] or [0])
    return text[:place] + opening * _DEPTH + "1" + closing * _DEPTH + text[place:], f"{opening} {_DEPTH} deep"


def _odd(text: str, chance: random.Random) -> tuple[str, str]:
    odd = chance.choice(
        ("\0", "\ud800", "\ufeff", "\r", "\x1b[2J", "\u202e", "#" * 1_000_000, "a" * 1_000_000 + " = 1\n")
    )
    place = chance.randrange(len(text) + 1)
    return text[:place] + odd + text[place:], f"{odd[:3]!r} at {place}"


_TEXT_CHANGES = (_value, _value, _value, _element, _lines, _nest, _odd)


def _structure(path: Path, chance: random.Random) -> str:
    """Change the contents of an HDF5 file through its library."""
    name = chance.choice(sorted(HOSTILE))
    try:
        return f"{name}: {HOSTILE[name](path, chance)}"
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:  # the library will not write all
        return f"{name}: not done ({' '.join(str(error).split())[:60]})"

"""Changes of an HDF5 file through the library itself: what a program could write by mistake or in bad faith.

Each takes the path of a sound file, changes it in place and says what it did.
"""

import random
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np

Chance: TypeAlias = random.Random
Change: TypeAlias = Callable[[Path, Chance], str]

HOSTILE: dict[str, Change] = {}
"""All of them, by their names."""

_BOMB_BYTES = 300_000_000
_MANY = 1 << 40


def _hostile(change: Callable[[h5py.File, Chance], str]) -> Callable[[h5py.File, Chance], str]:
    def on_path(path: Path, chance: Chance) -> str:
        with h5py.File(path, "r+") as root:
            return change(root, chance)

    HOSTILE[change.__name__.replace("_", " ")] = on_path
    return change


def _objects(root: h5py.File) -> dict[str, Any]:
    found: dict[str, Any] = {"/": root}
    root.visititems(found.__setitem__)
    return found


def _dataset(root: h5py.File, chance: Chance) -> h5py.Dataset:
    names = [name for name, item in _objects(root).items() if isinstance(item, h5py.Dataset)]
    likely = [name for name in names if name in ("range", "n_modes", "weight", "depth", "amplitude", "window_start")]
    return root[chance.choice(likely if likely and chance.random() < 0.6 else names)]


@contextmanager
def _replaced(dataset: h5py.Dataset) -> Iterator[tuple[h5py.Group, str, dict[str, Any], Any]]:
    """Take a dataset out; the block puts another one there, which then gets the old one's attributes."""
    parent, name, values = dataset.parent, dataset.name.split("/")[-1], dataset[...]
    scales = ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME")
    attributes = {key: value for key, value in dataset.attrs.items() if key not in scales}
    del parent[name]
    yield parent, name, attributes, values
    if isinstance(parent.get(name), h5py.Dataset):
        for key, value in attributes.items():
            parent[name].attrs[key] = value


def _odd_values(chance: Chance) -> tuple[Any, str]:
    values: tuple[Any, ...] = (
        float("nan"),
        float("inf"),
        -float("inf"),
        -1,
        0,
        1e308,
        1 << 63,
        -(1 << 62),
        "text",
        "",
        "mm",
        "m",
        "x" * 60_000,
        "\u00b5\U0001f600",
        b"\xff\xfe\x00",
        "[" * 5000,
        "null",
        "3.0",
        "1.0",
        "2",
        ["a", "b"],
        np.zeros(0),
        np.zeros((3, 3)),
        np.arange(5000.0),
        np.ones(1, "?")[0],
        np.complex128(1j),
        np.float16(2),
        np.longdouble(3),
        np.void(b"opaque"),
        h5py.Empty("f8"),
        h5py.Empty("S10"),
        np.array([1 << 63], "u8"),
        np.array([(1, 2.0)], dtype=[("a", "i4"), ("b", "f8")]),
        '{"window": "x", "stride": -1}',
        '{"unambiguous_range_mm": 1e999}',
        '{"stride": 1e400, "max_layers": "many"}',
        "tofmix-layers",
        "tofmix-recording",
    )
    value = chance.choice(values)
    return value, repr(value)[:30]


@_hostile
def attribute_changed(root: h5py.File, chance: Chance) -> str:
    item = chance.choice(list(_objects(root).values()))
    keys = list(item.attrs) or ["units"]
    key, (value, text) = chance.choice(keys), _odd_values(chance)
    item.attrs[key] = value
    return f"{item.name}@{key} = {text}"


@_hostile
def sensor_attribute_changed(root: h5py.File, chance: Chance) -> str:
    item = root.get("sensor", root)
    key, (value, text) = chance.choice(list(item.attrs) or ["range_min_mm"]), _odd_values(chance)
    if chance.random() < 0.5:
        value = chance.choice((np.nan, np.inf, -1.0, 0.0, 1e-308, 1e308, 1e5, 3.0))
        text = str(value)
    item.attrs[key] = value
    return f"{item.name}@{key} = {text}"


@_hostile
def root_attribute_changed(root: h5py.File, chance: Chance) -> str:
    key, (value, text) = chance.choice(list(root.attrs) or ["format"]), _odd_values(chance)
    root.attrs[key] = value
    return f"@{key} = {text}"


@_hostile
def attribute_removed(root: h5py.File, chance: Chance) -> str:
    item = chance.choice([item for item in _objects(root).values() if len(item.attrs)])
    key = chance.choice(list(item.attrs))
    del item.attrs[key]
    return f"{item.name}@{key}"


@_hostile
def fill_value_attribute(root: h5py.File, chance: Chance) -> str:
    dataset, (value, text) = _dataset(root, chance), _odd_values(chance)
    dataset.attrs["_FillValue"] = value
    return f"{dataset.name}: {text}"


@_hostile
def object_removed(root: h5py.File, chance: Chance) -> str:
    name = chance.choice([name for name in _objects(root) if name != "/"])
    del root[name]
    return name


@_hostile
def dataset_made_group(root: h5py.File, chance: Chance) -> str:
    dataset = _dataset(root, chance)
    name = dataset.name
    del root[name]
    root.create_group(name)
    return str(name)


@_hostile
def dataset_made_link(root: h5py.File, chance: Chance) -> str:
    name = str(_dataset(root, chance).name)
    del root[name]
    links = (
        h5py.SoftLink(name),
        h5py.SoftLink("/nowhere"),
        h5py.SoftLink("/"),
        h5py.ExternalLink("/etc/hostname", "/"),
        h5py.ExternalLink("/dev/zero", "/"),
        h5py.ExternalLink("recording.h5", name),
        h5py.ExternalLink("", ""),
    )
    link = chance.choice(links)
    root[name] = link
    return f"{name}: {type(link).__name__} to {getattr(link, 'filename', '')}{link.path}"


@_hostile
def group_made_link(root: h5py.File, chance: Chance) -> str:
    names = [name for name, item in _objects(root).items() if isinstance(item, h5py.Group) and name != "/"]
    name = chance.choice(names or ["sensor"])
    if name in root:
        del root[name]
    root[name] = chance.choice((h5py.SoftLink("/"), h5py.ExternalLink("recording.h5", "/sensor"), root["/"]))
    return name


@_hostile
def dataset_made_datatype(root: h5py.File, chance: Chance) -> str:
    name = str(_dataset(root, chance).name)
    del root[name]
    root[name] = np.dtype("f8")
    return name


@_hostile
def other_type(root: h5py.File, chance: Chance) -> str:
    types: tuple[Any, ...] = (
        "f2",
        ">f4",
        "f8",
        "g",
        "i1",
        ">i8",
        "u8",
        "?",
        "c8",
        "S5",
        h5py.string_dtype(),
        h5py.vlen_dtype("f8"),
        h5py.ref_dtype,
        h5py.enum_dtype({"a": 1, "b": 2}, basetype="u1"),
        h5py.opaque_dtype("M8[s]"),
        [("a", "f4"), ("b", "u2")],
        "(3,)f4",
        "u2",
        "f4",
    )
    dtype = chance.choice(types)
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        new = parent.create_dataset(name, shape=values.shape, dtype=dtype)
        with suppress(TypeError, ValueError, OSError):  # what cannot be converted stays its fill value
            new[...] = values
        return f"{name}: {dtype!s}"


@_hostile
def other_shape(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        shape = values.shape
        shapes: tuple[Any, ...] = ((0,), (1, 1, 1), (2, 2))
        if shape:
            first, *rest, last = shape if len(shape) > 1 else (*shape, 1)
            shapes = (
                (),
                (0,),
                (1,),
                shape[::-1],
                (*shape, 1),
                shape[:-1],
                (0, *rest, last),
                (first, *rest, 0),
                (1,) * 32,
                (first, *rest, 2 * last),
                (first + 1, *rest, last),
                (1 << 20, 1, 1),
                (1, 1, 300_000),
                (1, 3000, 1),
            )
        new = chance.choice(shapes)
        parent.create_dataset(name, data=np.resize(values, new))
        return f"{name}: {new}"


@_hostile
def null_dataspace(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        parent.create_dataset(name, data=h5py.Empty(values.dtype))
        return str(name)


@_hostile
def huge_declared_shape(root: h5py.File, chance: Chance) -> str:
    """Nothing is stored; reading all would give fill values without end."""
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        sides: tuple[Any, ...] = (
            (_MANY, 6, 8),
            (20, _MANY, 8),
            (20, 6, _MANY),
            (1 << 20, 1 << 20, 1 << 20),
            (_MANY,),
            (1 << 33, 144, 176),
            (50_000, 3000, 4000),
            (1 << 62, 1, 1),
            (2, 6, 8, 1 << 44),
        )
        shape = chance.choice(sides)
        chunks = chance.choice((True, tuple(min(n, 8) for n in shape), (1,) * len(shape)))
        parent.create_dataset(name, shape=shape, dtype=values.dtype, chunks=chunks, compression="gzip")
        return f"{name}: {shape} in chunks {chunks}"


@_hostile
def huge_contiguous_shape(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        shape = chance.choice(((100_000, 500, 500), (_MANY, 6, 8), (_MANY,)))
        space = h5py.h5s.create_simple(shape)
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_alloc_time(h5py.h5d.ALLOC_TIME_LATE)
        kind = h5py.h5t.py_create(values.dtype, logical=True)
        h5py.h5d.create(parent.id, name.encode(), kind, space, creation)
        return f"{name}: {shape}"


@cache
def _bomb() -> bytes:
    """Zeros that unpack to a thousand times their size."""
    packer = zlib.compressobj(1)
    return b"".join(packer.compress(bytes(1 << 20)) for _ in range(_BOMB_BYTES >> 20)) + packer.flush()


@_hostile
def bomb(root: h5py.File, chance: Chance) -> str:
    """One chunk of a modest shape that unpacks to hundreds of megabytes."""
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        shape = values.shape if chance.random() < 0.5 else (_BOMB_BYTES // values.dtype.itemsize // 48, 6, 8)
        new = parent.create_dataset(name, shape=shape, dtype=values.dtype, chunks=shape, compression="gzip")
        new.id.write_direct_chunk((0,) * len(shape), _bomb())
        return f"{name}: {_BOMB_BYTES} bytes in a chunk for {new.nbytes}"


@_hostile
def odd_chunks(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        most = tuple(None for _ in values.shape)
        if chance.random() < 0.3:  # a chunk of gigabytes is only locked
            chunks = (1, 20_000, 20_000, 1)[: values.ndim]
            parent.create_dataset(name, shape=values.shape, dtype=values.dtype, chunks=chunks, maxshape=most)
        else:
            chunks = chance.choice(((1,) * values.ndim, tuple(n + 3 for n in values.shape)))
            parent.create_dataset(name, data=values, chunks=chunks, maxshape=most, shuffle=chance.random() < 0.5)
        return f"{name}: {chunks}"


@_hostile
def filters(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        options: tuple[dict[str, Any], ...] = (
            {"compression": "lzf"},
            {"compression": "szip"},
            {"scaleoffset": 0},
            {"scaleoffset": 2},
            {"shuffle": True},
            {"fletcher32": True},
            {"compression": "gzip", "compression_opts": 9, "shuffle": True, "fletcher32": True},
        )
        chosen = chance.choice(options)
        parent.create_dataset(name, data=values, chunks=True, **chosen)
        return f"{name}: {chosen}"


@_hostile
def unknown_filter(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        creation = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        creation.set_chunk(tuple(max(1, n) for n in values.shape))
        number, flag = chance.choice((301, 32001, 32013, 65535)), chance.choice((0, h5py.h5z.FLAG_OPTIONAL))
        creation.set_filter(number, flag, (1, 2, 3))
        kind = h5py.h5t.py_create(values.dtype, logical=True)
        new = h5py.h5d.create(parent.id, name.encode(), kind, h5py.h5s.create_simple(values.shape), creation)
        new.write_direct_chunk((0,) * values.ndim, values.tobytes(), 0)
        return f"{name}: filter {number}, flag {flag}"


@_hostile
def damaged_chunk(root: h5py.File, chance: Chance) -> str:
    """A chunk whose packed bytes are rubbish, too few or too many."""
    datasets = [item for item in _objects(root).values() if isinstance(item, h5py.Dataset) and item.chunks]
    dataset = chance.choice(datasets)
    place = tuple(chance.randrange(-(-n // c)) * c for n, c in zip(dataset.shape, dataset.chunks, strict=True))
    _, data = dataset.id.read_direct_chunk(place)
    rubbish = chance.randbytes(len(data))
    made: bytes = chance.choice((rubbish, data[: len(data) // 2], data * 3, bytes(len(data)), b""))
    dataset.id.write_direct_chunk(place, made, chance.choice((0, 0, 1, 0xFF)))
    return f"{dataset.name} at {place}: {len(made)} bytes for {len(data)}"


@_hostile
def external_storage(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        file = chance.choice(("/etc/hostname", "/etc/passwd", "/dev/zero", "/dev/stdin", "recording.h5", "/nowhere"))
        parent.create_dataset(name, shape=values.shape, dtype=values.dtype, external=[(file, 0, h5py.h5f.UNLIMITED)])
        return f"{name} in {file}"


@_hostile
def virtual_dataset(root: h5py.File, chance: Chance) -> str:
    with _replaced(_dataset(root, chance)) as (parent, name, _, values):
        file, inside = chance.choice((("recording.h5", "range"), (".", name), ("/etc/hostname", "x"), ("%b", "range")))
        layout = h5py.VirtualLayout(shape=values.shape, dtype=values.dtype)
        layout[...] = h5py.VirtualSource(file, inside, shape=values.shape)
        parent.create_virtual_dataset(name, layout)
        return f"{name} from {file}"


@_hostile
def odd_values(root: h5py.File, chance: Chance) -> str:
    """Values that no camera and no estimate gives, in place of some or all."""
    dataset = _dataset(root, chance)
    values = np.asarray(dataset[...])
    if values.dtype.kind not in "uif":
        return f"{dataset.name}: {values.dtype}"
    odd: list[float] = [0, 1, 255, -1, 65535, 1e9]
    if values.dtype.kind == "f":
        odd += [np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45]
    value = np.float64(chance.choice(odd))
    mask = np.random.default_rng(chance.randrange(1 << 30)).random(values.shape) < chance.choice((0.01, 0.3, 1.1))
    with np.errstate(all="ignore"):
        values[mask] = value.astype(values.dtype)
    dataset[...] = values
    return f"{dataset.name}: {value} in {mask.sum()} of {mask.size}"


@_hostile
def shuffled_values(root: h5py.File, chance: Chance) -> str:
    dataset = _dataset(root, chance)
    values = np.asarray(dataset[...])
    dataset[...] = np.random.default_rng(chance.randrange(1 << 30)).permuted(values)
    return str(dataset.name)


@_hostile
def dataset_added(root: h5py.File, chance: Chance) -> str:
    """A dataset that readers know, of another kind than they expect."""
    names = (
        "time",
        "amplitude",
        "temperature",
        "truth",
        "sensor/noise_range",
        "sensor/noise_amplitude",
        "sensor/noise_shape_z",
        "sensor/noise_background",
        "sensor/range_step_mm",
        "frame",
        "status",
    )
    name, (value, text) = chance.choice(names), _odd_values(chance)
    if name in root:
        del root[name]
    root[name] = value
    return f"{name} = {text}"


@_hostile
def deep_groups(root: h5py.File, _: Chance) -> str:
    group = root
    for _level in range(2000):
        group = group.create_group("g")
    return "2000 groups deep"


@_hostile
def many_attributes(root: h5py.File, _: Chance) -> str:
    for number in range(3000):
        root.attrs[f"a{number}"] = number
    return "3000 attributes"

"""Small sound files of every kind that is read; the mutants are made of them."""

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
import scipy.io
import tifffile
from support.bags import AMPLITUDE, DEPTH, INFO, new_bag
from support.files import boards, write_recording

from faults.pool import Job, Pool

MODEL = """\
[sensor]
profile = "sr3000"
rows = 6
cols = 8
fov_horizontal_deg = 30.0
fov_vertical_deg = 20.0
range_min_mm = 650.0
range_max_mm = 7500.0
modulation_frequency_hz = 20.0e6
integration_time_ms = 1.2
outlier_probability = 1.0e-4

[sensor.noise]
range_mm = [500.0, 1000.0, 3000.0, 7500.0]
sigma_mm = [3.0, 6.0, 24.0, 150.0]
reference_integration_time_ms = 10.0
exponent = 0.5

[recording]
frames = 20
frame_rate_hz = 25.0
seed = 1

[[surface]]
name = "near board"
center_mm = [-900.0, 0.0, 1500.0]
size_mm = [1200.0, 1000.0]
yaw_deg = 0.0
pitch_deg = 0.0
reflectivity = 0.8

[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 4000.0]
size_mm = [3000.0, 3000.0]
reflectivity = 0.5

[[effect]]
kind = "wiggling"
amplitude_mm = 12.0
phase_rad = 0.3

[[effect]]
kind = "multipath"
surface = "wall"
share = 0.1
extra_path_mm = 700.0

[[effect]]
kind = "dropout"
probability = 0.05
threshold = 1.0
threshold_noise = 0.5
"""

MEMORY = '[[effect]]\nkind = "temporal_correlation"\ncoefficient = 0.7\n'
"""Contradicts the noise curve, so that `estimate` learns the noise, in windows of 20 frames."""

SENSOR = '[sensor]\nprofile = "sr3000"\nrows = 6\ncols = 8\nfov_horizontal_deg = 30.0\nfov_vertical_deg = 20.0\n'


@dataclass(frozen=True, slots=True)
class Original:
    """A kind of file."""

    files: tuple[Path, ...]
    """Those that are mutated, one at a time; the first is what commands are given."""
    format: str
    """"hdf5", "text" or "bytes": how it can be mutated beside byte by byte."""
    commands: tuple[str, ...]
    """What reads it. In an argument, @ is the mutant, %recording and %layers and the like are sound files."""
    own: bool = False
    """Whether every value in it has a checksum, so that what can be read must be right."""

    @property
    def given(self) -> Path:
        """What commands are given: the file, or the folder of a bag of several."""
        return self.files[0].parent if self.files[0].parent.name.startswith("bag_") else self.files[0]


_IMPORT = "import @ -o out.h5 --sensor %sensor"
_READ_RECORDING = (
    "estimate @ -o out.layers.h5 --window 10 --workers 1",
    "info @",
    "estimate @ -o out.layers.h5 --noise auto --outliers auto --workers 1 --memory 300MB",
    "report %layers --recording @ --html out.html",
    "info @ --json",
    "inspect %layers --pixel 1,2 --recording @ -o out.png",
    "map %layers --from averaged --recording @ -o out.yaml",
    "estimate @ -o out.layers.h5 --wrap --noise sr3000 --workers 1",
)
_READ_LAYERS = (
    "report @",
    "info @",
    "export @ -o out.csv",
    "compare @ %layers",
    "report @ --html out.html",
    "inspect @ --pixel 1,2",
    "export @ -o out.ply",
    "map @ -o out.yaml --voxels out.npz",
    "compare %layers @ --html out.html",
    "export @ -o out.tif --window 1",
    "export @ -o out.laz",
    "info @ --json",
    "export @ -o out.pcd",
    "inspect @ --pixel 1,2 --recording %recording -o out.svg",
    "export @ -o out.png --window 0",
)


def make(folder: Path, pool: Pool, *, learn: bool = False) -> dict[str, Original]:
    """Write the originals into a folder, those of our own formats by the program itself.

    With `learn`, which takes seconds, there are parts with learnt noise as well.
    """
    model, recording, layers = folder / "model.toml", folder / "recording.h5", folder / "layers.h5"
    model.write_text(MODEL)
    (folder / "sensor.toml").write_text(SENSOR)
    _run(folder, pool, "simulate", model, "-o", recording)
    _run(folder, pool, "estimate", recording, "--window", 10, "-o", layers)
    parts = (folder / "1.part", folder / "2.part")
    for number, part in enumerate(parts, 1):
        _run(folder, pool, "estimate", recording, "--window", 5, "--shard", f"{number}/2", "-o", part)
    return {
        "recording": Original((recording,), "hdf5", _with_verify(_READ_RECORDING), own=True),
        "foreign recording": Original((_foreign(folder / "foreign.h5"),), "hdf5", _with_verify(_READ_RECORDING)),
        "layers": Original((layers,), "hdf5", _with_verify(_READ_LAYERS), own=True),
        "model": Original(
            (model,), "text", ("simulate @ --explain", "simulate @ -o out.h5 --frames 3", "info @", "info @ --json")
        ),
        "sensor": Original((folder / "sensor.toml",), "text", ("import %array -o out.h5 --sensor @", "info @")),
        "part": Original(parts, "bytes", ("merge @ %part -o out.layers.h5",)),
        **(parts_with_learnt_noise(folder, pool) if learn else {}),
        **_arrays(folder),
        **{f"bag {kind}": _bag(folder, kind) for kind in ("ros1", "sqlite3", "mcap")},
    }


def parts_with_learnt_noise(folder: Path, pool: Pool) -> dict[str, Original]:
    """Write the parts of a run that learns its noise into a folder."""
    model, recording = folder / "memory.toml", folder / "memory.h5"
    model.write_text(MODEL + MEMORY)
    _run(folder, pool, "simulate", model, "-o", recording, "--frames", 40)
    parts = (folder / "learnt 1.part", folder / "learnt 2.part")
    for number, part in enumerate(parts, 1):
        _run(folder, pool, "estimate", recording, "--window", 20, "--shard", f"{number}/2", "-o", part)
        if not has_learnt_noise(part):
            raise RuntimeError(f"{part}: no learnt noise")
    return {"part with learnt noise": Original(parts, "bytes", ("merge @ %learnt -o out.layers.h5",))}


def _run(folder: Path, pool: Pool, *argv: object) -> None:
    """Run a command in the folder, which must succeed."""
    outcome = pool.run(Job(argv=tuple(map(str, argv)), cwd=str(folder)))
    if outcome.code:
        raise RuntimeError(outcome.err)


def has_learnt_noise(part: Path) -> bool:
    """Whether the header of a part of a sharded run holds learnt noise."""
    with closing(sqlite3.connect(f"{part.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
        ((header,),) = database.execute("SELECT value FROM about WHERE key = 'header'").fetchall()
    return b"noise_memory" in header


def _with_verify(commands: tuple[str, ...]) -> tuple[str, ...]:
    from tofmix.cli.main import main

    return ("verify @", *commands) if "verify" in main.commands else commands


def _foreign(path: Path) -> Path:
    """As other programs write them: the oldest HDF5 structures, no checksum anywhere."""
    write_recording(path, boards(20, 6, 8), fill=0, chunks=(5, 2, 3), compression="gzip")
    with h5py.File(path, "r+") as root:
        root.create_dataset("amplitude", data=np.full((20, 6, 8), 300, dtype="u2"))
        root.create_dataset("time", data=np.arange(20) / 25)
    return path


def _arrays(folder: Path) -> dict[str, Original]:
    samples = boards(20, 6, 8)
    np.save(folder / "a.npy", samples)
    np.savez_compressed(folder / "a.npz", depth=samples, amplitude=samples)
    scipy.io.savemat(folder / "a.mat", {"depth": samples.astype("f8")}, do_compression=True)
    with h5py.File(folder / "b.mat", "w", userblock_size=512) as root:
        root.create_dataset("depth", data=samples.astype("f8"), chunks=(5, 2, 3), compression="gzip")
        root["depth"].attrs["MATLAB_class"] = np.bytes_("double")
    with (folder / "b.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    tifffile.imwrite(folder / "a.tif", samples, compression="zlib", photometric="minisblack")
    options = {"npy": "", "npz": " --topic depth --amplitude amplitude", "mat": " --axes frame,row,col", "tif": ""}
    found = {name: Original((folder / f"a.{name}",), "bytes", (_IMPORT + more,)) for name, more in options.items()}
    return found | {"mat 7.3": Original((folder / "b.mat",), "hdf5", (f"{_IMPORT} --axes frame,row,col",))}


def _bag(folder: Path, kind: str) -> Original:
    with new_bag(folder, kind) as (bag, path):
        for index, frame in enumerate(boards(5, 6, 8)):
            stamp = 1_000_000_000 + index * 40_000_000
            bag.image(DEPTH, frame, stamp_ns=stamp)
            bag.image(AMPLITUDE, frame, stamp_ns=stamp)
        bag.info(INFO, (6, 8), (9.0, 9.0, 3.5, 2.5))
    files = tuple(sorted(file for file in path.iterdir())) if path.is_dir() else (path,)
    return Original(
        files, "bytes", (f"{_IMPORT} --topic {DEPTH}", f"{_IMPORT} --topic {DEPTH} --amplitude {AMPLITUDE}")
    )

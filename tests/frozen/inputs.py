"""The inputs: recordings, sources to import, models. Made without the package, the same on each call.

Surfaces are maps of ranges (row, col), mm. A recording of events draws one of two surfaces for each sample; recordings
of a lock-in camera are from the raw-tap simulator of `tests/blind`.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from blind.camera import Device, Mechanism, record
from blind.effects import Harmonics, StrayLight, WholeBeam
from blind.geometry import Surface
from blind.reference import NoiseTable
from blind.write import effect_tables, model_text, write_recording
from numpy.typing import NDArray
from support.bags import DEPTH, INFO, new_bag

Floats = NDArray[np.float64]

SAMPLES = Path(__file__).parents[2] / "sample_data"
CURVE: Mapping[str, Sequence[float]] = {
    "noise_range": (500.0, 2000.0, 6000.0),
    "noise_sigma": (8.0, 15.0, 40.0),
}
"""Sigma at some ranges, mm."""
CAMERA: Mapping[str, Any] = {
    "range_min_mm": 300.0,
    "range_max_mm": 7000.0,
    "fov_horizontal_deg": 20.0,
    "fov_vertical_deg": 16.0,
    "outlier_probability": 1e-3,
}
PINHOLE: Mapping[str, Any] = {
    "range_min_mm": 300.0,
    "range_max_mm": 7000.0,
    "projection": "pinhole",
    "fx": 40.0,
    "fy": 41.0,
    "cx": 9.8,
    "cy": 7.6,
    "distortion": (-0.1, 0.02, 0.001, -0.001, 0.0),
}
LOCK_IN = Device(
    name="lock-in", rows=24, cols=32, fov_horizontal_deg=8.5, fov_vertical_deg=6.5, frames=40, range_max_mm=7000.0
)
BOARDS = (
    Surface(name="board", center_mm=(-60.0, 0.0, 1700.0), size_mm=(130.0, 150.0), yaw_deg=12.0, reflectivity=0.5),
    Surface(name="panel", center_mm=(110.0, 30.0, 2400.0), size_mm=(160.0, 240.0), yaw_deg=-20.0, reflectivity=0.8),
    Surface(name="wall", center_mm=(0.0, 0.0, 3600.0), size_mm=(9000.0, 9000.0), yaw_deg=15.0),
)


def sigma_at(range_mm: Floats) -> Floats:
    """Sigma of the curve."""
    return np.interp(range_mm, CURVE["noise_range"], CURVE["noise_sigma"])


def slanted_share(rows: int, cols: int, lean: float = 0.3) -> Floats:
    """Share (row, col) of a near surface whose edge leans: 1 at the left, 0 at the right."""
    row, col = np.indices((rows, cols), dtype=np.float64)
    return np.clip(cols / 2 + lean * (row - rows / 2) - col, 0.0, 1.0)


def events(
    near_mm: Floats | float, far_mm: Floats | float, share: Floats, frames: int, seed: int, width: float = 1.0
) -> Floats:
    """Samples (frame, row, col) of the near surface with its share, else of the far one; noise `width` x the curve."""
    rng = np.random.default_rng(seed)
    is_near = rng.random((frames, *share.shape)) < share
    true = np.where(is_near, near_mm, far_mm)
    values = true + width * sigma_at(true) * rng.standard_normal(true.shape)
    wild = rng.random(true.shape) < 1e-3
    return np.where(wild, rng.uniform(300.0, 7000.0, true.shape), values)


def write(
    path: Path,
    samples: Floats,
    *,
    camera: Mapping[str, Any] = CAMERA,
    noise: Mapping[str, Any] = CURVE,
    dtype: str = "u2",
    **datasets: Any,  # noqa: ANN401  what h5py stores
) -> None:
    """Write a recording as a foreign program would."""
    whole = np.where(np.isnan(samples), 0.0, np.clip(np.rint(samples), 1, 65534)) if dtype == "u2" else samples
    with h5py.File(path, "w") as root:
        root["range"] = whole.astype(dtype)
        for name, values in datasets.items():
            root[name] = values
        sensor = root.create_group("sensor")
        sensor.attrs.update(camera)
        for name, values in noise.items():
            sensor[name] = values


def times(frames: int, rate_hz: float = 25.0) -> Floats:
    """Start of each frame, s."""
    return np.arange(frames) / rate_hz


def boards(folder: Path) -> None:
    """A board before a wall, in whole mm."""
    samples = events(1200.0, 3000.0, slanted_share(10, 14), 60, 1)
    write(folder / "boards.h5", samples, time=times(60), temperature=np.linspace(20, 30, 60).astype("f4"))


def small(folder: Path) -> None:
    """As boards, of few pixels."""
    write(folder / "small.h5", events(1200.0, 3000.0, slanted_share(4, 6), 40, 2), time=times(40))


def three_boards(folder: Path) -> None:
    """The recording of the README."""
    shutil.copy(SAMPLES / "three_boards.h5", folder)


def real(folder: Path) -> None:
    """The recording of a real sensor, whose noise is learnt."""
    shutil.copy(SAMPLES / "tmf8829_edge.h5", folder)


def unknown(folder: Path) -> None:
    """Neither curve nor working range; float, with NaN where samples are lost, and amplitudes."""
    samples = events(1200.0, 3000.0, slanted_share(12, 16), 60, 3)
    samples[np.random.default_rng(4).random(samples.shape) < 0.05] = np.nan
    amplitude = (1e9 / np.nan_to_num(samples, nan=3000.0) ** 2).astype("f4")
    write(folder / "unknown.h5", samples, camera={}, noise={}, dtype="f4", amplitude=amplitude)


def folded(folder: Path) -> None:
    """A wall at the fold of the ranges of 30 MHz."""
    circle = 299_792_458e3 / 60e6
    walls = events(1500.0, circle + 5.0, slanted_share(8, 10), 60, 5) % circle
    write(folder / "folded.h5", walls, camera={**CAMERA, "range_max_mm": circle, "modulation_frequency_hz": 30e6})


def open_space(folder: Path) -> None:
    """A board before nothing: samples around the end of the working range."""
    write(folder / "open_space.h5", events(1500.0, 7000.0, slanted_share(8, 10), 60, 6))


def by_amplitude(folder: Path) -> None:
    """Noise by amplitude."""
    bright = np.where(np.indices((8, 10))[0] % 2 == 0, 400.0, 60.0)
    rng = np.random.default_rng(7)
    factor = np.where(bright > 100.0, 1.0, 2.0)
    samples = 2000.0 + 15.0 * factor * rng.standard_normal((60, 8, 10))
    law = {
        **CURVE,
        "noise_reference_amplitude": (400.0, 400.0, 400.0),
        "noise_amplitude": (60.0, 400.0),
        "noise_amplitude_factor": (2.0, 1.0),
    }
    amplitude = (bright * rng.normal(1.0, 0.02, samples.shape)).astype("f4")
    write(folder / "by_amplitude.h5", samples, noise=law, amplitude=amplitude)


def shaped(folder: Path) -> None:
    """Errors with long tails, whose shape is to be learnt; pixels of unequal widths."""
    rng = np.random.default_rng(8)
    width = np.exp(0.3 * rng.standard_normal((16, 16)))
    far = rng.random((80, 16, 16)) < np.clip(np.arange(16) - 7.5, 0.0, 1.0)
    samples = np.where(far, 2600.0, 1500.0) + 10.0 * width * rng.standard_t(4, far.shape)
    write(folder / "shaped.h5", samples, dtype="f4", time=times(80))


def targets(folder: Path) -> None:
    """Up to three targets a zone, as an array to import."""
    rng = np.random.default_rng(9)
    values = np.zeros((60, 3, 6, 8))
    values[:, 0] = rng.normal(800.0, 6.0, values[:, 0].shape)
    values[:, 1, :, 4:] = rng.normal(2000.0, 6.0, values[:, 1, :, 4:].shape)
    values[rng.random(values.shape) < 0.1] = 0
    np.save(folder / "targets.npy", np.round(values).astype("u2"))


def coarse(folder: Path) -> None:
    """Ranges on a step of 16 mm; the camera keeps the strongest return."""
    samples = 16.0 * np.rint(events(1200.0, 3000.0, slanted_share(8, 10), 60, 10) / 16.0)
    camera = {**CAMERA, "range_step_mm": 16.0, "share_law": "strongest"}
    amplitude = (1e9 / samples**2).astype("f4")
    write(folder / "coarse.h5", samples, camera=camera, amplitude=amplitude)


def passing(folder: Path) -> None:
    """Something stands before the wall in the last third of the frames; a near return in nearly every pixel."""
    samples = events(2500.0, 3000.0, slanted_share(12, 14, lean=0.0), 90, 11)
    samples[60:, 3:8, 9:12] = events(1400.0, 1400.0, np.ones((5, 3)), 30, 12)
    rng = np.random.default_rng(13)
    samples[rng.random(samples.shape) < 0.06] = 350.0
    samples = np.where(samples == 350.0, rng.normal(350.0, 6.0, samples.shape), samples)
    write(folder / "passing.h5", samples, time=times(90))


def filtered(folder: Path) -> None:
    """A camera that filters its ranges in time: each sample is a mean of it and those before."""
    raw = events(1800.0, 1800.0, np.ones((12, 12)), 120, 14)
    samples = raw.copy()
    for frame in range(1, len(raw)):
        samples[frame] = 0.4 * raw[frame] + 0.6 * samples[frame - 1]
    write(folder / "filtered.h5", samples, noise={}, dtype="f4", time=times(120))


def pinhole(folder: Path) -> None:
    """A tilted board before a wall, seen through a lens."""
    row, col = np.indices((16, 20), dtype=np.float64)
    near = 1500.0 + 12.0 * (row - 8.0)
    far = 3000.0 + 4.0 * (col - 10.0) ** 2
    write(folder / "pinhole.h5", events(near, far, slanted_share(16, 20), 60, 15), camera=PINHOLE)


def ball(folder: Path) -> None:
    """A ball before a wall."""
    row, col = np.indices((20, 20), dtype=np.float64)
    azimuth, elevation = np.radians(col - 9.5), np.radians(0.8 * (row - 9.5))
    along = np.cos(azimuth) * np.cos(elevation) * 1500.0
    inside = along**2 - (1500.0**2 - 160.0**2)
    front = along - np.sqrt(np.maximum(inside, 0.0))
    wall = 2200.0 / (np.cos(azimuth) * np.cos(elevation))
    write(folder / "ball.h5", events(front, wall, (inside > 0).astype(float), 60, 16, width=0.3))


def lock_in(folder: Path) -> None:
    """A lock-in camera whose light adds up: boards in phasor sums; and with stray light."""
    for name, mechanisms, seed in (
        ("sums", [WholeBeam(probability=1.0)], 17),
        ("stray", [WholeBeam(probability=1.0), StrayLight(share=0.3)], 18),
    ):
        _lock_in(folder / f"{name}.h5", LOCK_IN, mechanisms, seed)


def _lock_in(path: Path, device: Device, mechanisms: Sequence[Mechanism], seed: int) -> NoiseTable:
    raw = record(device, list(BOARDS), list(mechanisms), seed=seed)
    range_mm = np.geomspace(300.0, 7000.0, 20)
    noise = NoiseTable(range_mm=range_mm, sigma_mm=device.design_sigma(range_mm))
    write_recording(path, raw, device, noise)
    return noise


def averaged(folder: Path) -> None:
    """Means over ten frames each, which contradict the curve."""
    samples = events(1200.0, 3000.0, slanted_share(6, 8), 400, 19).reshape(40, 10, 6, 8).mean(axis=1)
    write(folder / "averaged.h5", samples, dtype="f4", noise={"noise_range": (500.0,), "noise_sigma": (15.0,)})


def damaged(folder: Path) -> None:
    """A file, the half of it, and one that is no HDF5."""
    write(folder / "whole.h5", events(1200.0, 3000.0, slanted_share(6, 8), 40, 20))
    stored = (folder / "whole.h5").read_bytes()
    (folder / "cut.h5").write_bytes(stored[: len(stored) // 2])
    (folder / "no.h5").write_bytes(b"no HDF5")


def sources(folder: Path) -> None:
    """What `import` reads: CSV of two kinds, arrays, images, MATLAB, HDF5 of others, a bag."""
    import scipy.io
    import tifffile
    from PIL import Image

    depth = np.rint(events(1200.0, 2500.0, slanted_share(6, 8), 12, 21)).astype("u2")
    np.save(folder / "depth.npy", depth)
    np.savez(folder / "depth.npz", depth=depth, amplitude=depth // 2)
    tifffile.imwrite(folder / "depth.tif", depth)
    (folder / "images").mkdir()
    for number, frame in enumerate(depth):
        Image.fromarray(frame).save(folder / "images" / f"depth_{number:03d}.png")
    scipy.io.savemat(folder / "depth.mat", {"depth": np.moveaxis(depth, 0, 2)})
    with h5py.File(folder / "other.h5", "w") as root:
        root["entry/depth"] = depth / 1000.0
        root["entry/depth"].attrs["units"] = "m"
    np.savetxt(folder / "frames.csv", depth.reshape(12, -1), fmt="%d", delimiter=",")
    frame, row, col = np.indices(depth.shape)
    lines = np.stack([frame, row, col, depth, frame * 40, 5 + (depth % 7 == 0)], axis=-1).reshape(-1, 6)
    np.savetxt(folder / "log.csv", lines, fmt="%d", delimiter=",", header="n,y,x,mm,ms,code", comments="")
    with new_bag(folder, "mcap") as (bag, _):
        bag.info(INFO, depth.shape[1:], (20.0, 20.0, 3.5, 2.5))
        for number, image in enumerate(depth):
            bag.image(DEPTH, image, stamp_ns=1 + number * 40_000_000)


SCENE = """\
[sensor]
profile = "sr3000"
rows = 16
cols = 20
{sensor}
[recording]
frames = 40
seed = 3
[[surface]]
name = "board"
center_mm = [-300.0, 0.0, 1500.0]
size_mm = [500.0, 500.0]
roll_deg = 10.0
[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 3000.0]
size_mm = [9000.0, 9000.0]
yaw_deg = 20.0
"""
EFFECTS: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "plain": (),
    "biases": (
        {"kind": "wiggling", "amplitude_mm": 12.0, "phase_rad": 0.3},
        {"kind": "amplitude_walk", "scale_mm": 10.0, "reference_amplitude": 300.0, "exponent": 0.7},
        {"kind": "temperature_drift", "amplitude_mm": 8.0, "time_constant_s": 2.0},
        {"kind": "fixed_pattern", "pixel_sigma_mm": 6.0, "column_sigma_mm": 3.0, "row_sigma_mm": 2.0},
        {"kind": "surface_pose", "surface": "board", "shift_mm": 20.0, "yaw_deg": 3.0},
    ),
    "light": (
        {"kind": "scattering", "share": 0.05},
        {"kind": "multipath", "surface": "wall", "share": 0.1, "extra_path_mm": 900.0},
        {"kind": "vignetting", "corner_factor": 1.5},
        {"kind": "flying_pixels", "probability": 0.5},
        {"kind": "pixel_crosstalk", "share": 0.02},
        {"kind": "quantisation", "step_mm": 5.0},
    ),
    "losses": (
        {"kind": "outliers", "probability": 0.02},
        {"kind": "stuck_pixels", "share": 0.01, "value_mm": 4000.0},
        {"kind": "dropout", "probability": 0.05, "threshold": 0.0, "threshold_noise": 1.0},
        {"kind": "temporal_correlation", "coefficient": 0.5},
        {"kind": "interference", "probability": 0.3, "sigma_mm": 50.0},
        {"kind": "excess_noise", "factor": 1.3},
        {"kind": "motion", "surface": "board", "velocity_mm_s": 100.0},
        {"kind": "saturation", "full_well_amplitude": 5000.0},
    ),
}
"""Effects of the models, by the model's name."""


def models(folder: Path) -> None:
    """Models of one scene with all kinds of effects, and through a lens."""
    for name, effects in EFFECTS.items():
        text = SCENE.format(sensor="") + effect_tables([dict(effect) for effect in effects])
        (folder / f"{name}.toml").write_text(text)
    lens = 'projection = "pinhole"\nfx = 30.0\nfy = 30.0\ncx = 9.5\ncy = 7.5\ndistortion = [-0.1, 0.01, 0.0, 0.0, 0.0]'
    (folder / "lens.toml").write_text(SCENE.format(sensor=lens))


GAP_DEVICE = Device(name="sr3000", rows=16, cols=24, frames=60, fov_horizontal_deg=30.0, fov_vertical_deg=22.0)
GAP_SCENE = (
    Surface(name="panel", center_mm=(-500.0, 0.0, 2600.0), size_mm=(1200.0, 1400.0), yaw_deg=45.0, reflectivity=0.6),
    Surface(name="board", center_mm=(380.0, -150.0, 1500.0), size_mm=(420.0, 400.0), reflectivity=0.7),
    Surface(name="wall", center_mm=(0.0, 0.0, 4600.0), size_mm=(40000.0, 40000.0), yaw_deg=5.0, reflectivity=0.6),
)


def gaps(folder: Path) -> None:
    """A model, and recordings of its scene: one that wiggles, one with a pattern of its pixels, one that agrees."""
    range_mm = np.geomspace(240.0, 7000.0, 40)
    noise = NoiseTable(range_mm=range_mm, sigma_mm=GAP_DEVICE.design_sigma(range_mm))
    (folder / "gap.toml").write_text(model_text(GAP_DEVICE, list(GAP_SCENE), noise))
    hidden: Mapping[str, list[Mechanism]] = {
        "wiggles": [Harmonics(third=0.02, third_phase=0.5, fifth=0.004, fifth_phase=0.0)],
        "agrees": [],
    }
    for seed, (name, mechanisms) in enumerate(hidden.items()):
        raw = record(GAP_DEVICE, list(GAP_SCENE), mechanisms, seed=31 + seed)
        write_recording(folder / f"{name}.h5", raw, GAP_DEVICE, noise)
        if name == "agrees":
            raw.range_mm[...] += np.random.default_rng(33).normal(0.0, 40.0, raw.range_mm.shape[1:]).round()
            write_recording(folder / "pattern.h5", raw, GAP_DEVICE, noise)


INPUTS: Mapping[str, Callable[[Path], None]] = {
    make.__name__: make
    for make in (
        boards,
        small,
        three_boards,
        real,
        unknown,
        folded,
        open_space,
        by_amplitude,
        shaped,
        targets,
        coarse,
        passing,
        filtered,
        pinhole,
        ball,
        lock_in,
        averaged,
        damaged,
        sources,
        models,
        gaps,
    )
}
"""What writes the inputs into a folder, by name."""

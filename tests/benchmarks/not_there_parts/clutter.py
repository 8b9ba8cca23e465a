"""Fog, rain and uniform dark counts before a net and a wall: which layers are found, and which are not there.

Each pixel sees a net with a share of its own and a wall behind it. A frame of a direct ToF camera is a list of returns:
net or wall, and, in a part of the frames, one of the fog, of a drop or of the dark. The camera keeps the nearest return
("first"), the one of the largest amplitude ("strongest"), or the two nearest ("two"). Nothing here calls the package;
`main` runs the command `estimate` on the files.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, fields, replace
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

RANGE_MAX_MM = 12000.0
NEAREST_MM = 100.0
OVERLAP_MM = 600.0
"""Range from which the light falls fully into the detector's view: nearer, its part grows with the square of range."""

SAME_SIGMAS = 4.0
"""A layer within so many sigmas of a surface is this surface."""


@dataclass(frozen=True, kw_only=True)
class Weather:
    """What stands before the surfaces.

    `share` is the part of the frames with a return of `kind` (fog, rain, dark), `extinction_per_m` alpha of
    exp(-2 alpha r), and `keeps` says which returns of a frame are stored: first, strongest or two. `object_mm`, where
    above 0, is the range of a small thing inside the fog, seen in a tenth of the frames of a part of the pixels.
    """

    kind: str
    share: float
    keeps: str = "two"
    extinction_per_m: float = 0.3
    frames: int = 100
    rows: int = 24
    cols: int = 32
    sigma_mm: float = 12.0
    object_mm: float = 0.0
    with_curve: bool = False


@dataclass(frozen=True, kw_only=True)
class Seen:
    """A recording: `range_mm` (frame, target, row, col), NaN where there is none, and its truth (row, col), mm."""

    range_mm: FloatArray
    net_mm: FloatArray
    wall_mm: FloatArray
    object_mm: FloatArray


def density_of_fog(range_mm: FloatArray, extinction_per_m: float) -> FloatArray:
    """Density of fog's returns by range, not normalised: exp(-2 alpha r) / r^2 times the overlap of light and view."""
    overlap = np.minimum((range_mm / OVERLAP_MM) ** 2, 1.0)
    return np.asarray(np.exp(-2e-3 * extinction_per_m * range_mm) * overlap / range_mm**2)


def _returns(weather: Weather, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Ranges of clutter, mm, NaN in frames that have none."""
    at = np.linspace(NEAREST_MM, RANGE_MAX_MM, 20000)
    if weather.kind == "dark":
        drawn = rng.uniform(0.0, RANGE_MAX_MM, shape)
    elif weather.kind == "rain":
        near = np.exp(-0.5 * (np.log(at / 900.0) / 0.6) ** 2) / at  # drops: near ones return enough light
        drawn = np.interp(rng.random(shape), np.cumsum(near) / near.sum(), at)
    else:
        fog = density_of_fog(at, weather.extinction_per_m)
        drawn = np.interp(rng.random(shape), np.cumsum(fog) / fog.sum(), at)
    return np.where(rng.random(shape) < weather.share, drawn, np.nan)


def simulated(weather: Weather, seed: int) -> Seen:
    """Draw a recording: a net at 2 to 4 m of the share 0.2 to 0.4, and a wall at 5 to 9 m."""
    rng = np.random.default_rng([seed, 41])
    rows, cols = weather.rows, weather.cols
    tilt = np.linspace(-0.5, 0.5, cols)[None, :] + 0.3 * np.linspace(-0.5, 0.5, rows)[:, None]
    net = rng.uniform(2100.0, 3900.0) + 150.0 * tilt
    wall = rng.uniform(5300.0, 8700.0) + 500.0 * tilt
    shape = weather.frames, rows, cols
    surface = np.where(rng.random(shape) < rng.uniform(0.2, 0.4, (rows, cols)), net, wall)
    inside = np.full((rows, cols), np.nan)
    if weather.object_mm > 0.0:
        inside[rows // 3 : 2 * rows // 3, cols // 3 : 2 * cols // 3] = weather.object_mm
        surface = np.where((rng.random(shape) < 0.15) & np.isfinite(inside), weather.object_mm, surface)
    surface = surface + weather.sigma_mm * rng.standard_normal(shape)
    clutter = _returns(weather, shape, rng)
    both = np.stack([surface, clutter], axis=1)
    if weather.keeps == "two":
        kept = np.sort(both, axis=1)
    elif weather.keeps == "first":
        kept = np.nanmin(both, axis=1, keepdims=True)
    else:
        light = rng.exponential(0.6, shape) > 1.0
        kept = np.where(np.isfinite(clutter) & light, clutter, surface)[:, None]
    return Seen(range_mm=kept, net_mm=net, wall_mm=wall, object_mm=inside)


def write(path: Path, seen: Seen, weather: Weather) -> None:
    """Write a recording as the contract of formats has it."""
    stored = np.where(np.isfinite(seen.range_mm), np.clip(np.rint(np.nan_to_num(seen.range_mm)), 1, 65534), 0)
    stored = stored.astype(np.uint16)
    several = stored.shape[1] > 1
    with h5py.File(path, "w") as f:
        f.attrs["format"], f.attrs["format_version"] = "tofmix-recording", "1.0"
        data = f.create_dataset("range", data=stored if several else stored[:, 0])
        data.attrs["units"] = "mm"
        data.attrs["_FillValue"] = np.array([0], dtype=np.uint16)
        f["time"] = np.arange(len(stored)) / 25.0
        for axis, name in enumerate(("frame", "target", "row", "col") if several else ("frame", "row", "col")):
            f[name] = np.arange(data.shape[axis])
            f[name].make_scale(name)
            data.dims[axis].attach_scale(f[name])
        sensor = f.create_group("sensor")
        sensor.attrs["name"] = "simulated direct ToF"
        sensor.attrs["range_min_mm"], sensor.attrs["range_max_mm"] = 0.0, RANGE_MAX_MM
        sensor.attrs["fov_horizontal_deg"], sensor.attrs["fov_vertical_deg"] = 60.0, 45.0
        if weather.with_curve:
            sensor["noise_range"], sensor["noise_sigma"] = [500.0, 12000.0], [weather.sigma_mm] * 2


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a recording.

    `false` and `sure` are layers a pixel that no surface explains, all and those of p > 0.5; `net`, `wall` and `inside`
    the parts of the pixels where they are found; `share` the mean share of background.
    """

    false: float
    sure: float
    net: float
    wall: float
    inside: float
    share: float
    learnt: bool
    seconds: float


def judged(layers: Path, seen: Seen, weather: Weather) -> Outcome:
    """Compare a layers file with the truth."""
    with h5py.File(layers) as f:
        found, probability = f["range"][0].astype(float), f["probability"][0].astype(float)
        share, learnt = float(np.nanmean(f["weight_outlier"][0])), "noise_background_density" in f["sensor"]
    reach = SAME_SIGMAS * weather.sigma_mm
    false = np.isfinite(found)
    there = []
    for truth in (seen.net_mm, seen.wall_mm, seen.object_mm):
        near = np.abs(found - truth[..., None]) < reach
        false &= ~near
        there.append(float(near.any(axis=-1)[np.isfinite(truth)].mean()) if np.isfinite(truth).any() else np.nan)
    return Outcome(
        false=float(false.sum() / false[..., 0].size),
        sure=float((false & (probability > 0.5)).sum() / false[..., 0].size),
        net=there[0],
        wall=there[1],
        inside=there[2],
        share=share,
        learnt=learnt,
        seconds=0.0,
    )


def estimated(weather: Weather, seed: int, folder: Path, options: list[str]) -> Outcome:
    """Simulate, estimate by the command, and judge."""
    seen = simulated(weather, seed)
    recording, layers = folder / "clutter.h5", folder / "clutter.layers.h5"
    write(recording, seen, weather)
    start = time.perf_counter()
    command = [sys.executable, "-m", "tofmix", "estimate", recording, "-o", layers, "--overwrite", "-q", *options]
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise SystemExit(done.stdout + done.stderr)
    return replace(judged(layers, seen, weather), seconds=time.perf_counter() - start)


CASES = (
    Weather(kind="fog", share=0.3),
    Weather(kind="fog", share=0.7),
    Weather(kind="fog", share=0.3, keeps="first"),
    Weather(kind="fog", share=0.7, keeps="first", frames=200, rows=16, cols=16),
    Weather(kind="fog", share=0.7, keeps="strongest"),
    Weather(kind="fog", share=0.5, extinction_per_m=1.2, rows=32, cols=48),
    Weather(kind="fog", share=0.7, object_mm=900.0),
    Weather(kind="rain", share=0.1, keeps="first"),
    Weather(kind="rain", share=0.3),
    Weather(kind="dark", share=0.3),
    Weather(kind="dark", share=0.02, keeps="first"),
)


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="not_there.py clutter", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2], help="recordings of each case (1 2)")
    parser.add_argument("--cases", type=int, nargs="+", help="rows of the table, from 0 on (all)")
    parser.add_argument("--curve", action="store_true", help="the recordings have their noise curve")
    parser.add_argument("--options", nargs=argparse.REMAINDER, default=[], help="further options of `tofmix estimate`")
    chosen = parser.parse_args(arguments)
    print(
        "| clutter | in frames | kept | frames, pixels | false layers a pixel | of p > 0.5 | net | wall | inside fog"
        " | background share | density learnt | s |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
    )
    with tempfile.TemporaryDirectory() as folder:
        for number in chosen.cases or range(len(CASES)):
            case = replace(CASES[number], with_curve=chosen.curve)
            found = [estimated(case, seed, Path(folder), chosen.options) for seed in chosen.seeds]
            mean = {one.name: float(np.mean([getattr(seen, one.name) for seen in found])) for one in fields(Outcome)}
            inside = "" if np.isnan(mean["inside"]) else f"{100 * mean['inside']:.1f} %"
            print(
                f"| {case.kind} | {100 * case.share:.0f} % | {case.keeps} | {case.frames}, {case.rows} x {case.cols} |"
                f" {mean['false']:.4f} | {mean['sure']:.4f} | {100 * mean['net']:.1f} % | {100 * mean['wall']:.1f} % |"
                f" {inside} | {mean['share']:.3f} | {100 * mean['learnt']:.0f} % | {mean['seconds']:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1:])

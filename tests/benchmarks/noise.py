"""The measured noise curve against the true one, on recordings whose truth is known and on the real sample recording.

Usage: python tests/benchmarks/noise.py [--seeds 21 22 23]

Prints Markdown tables; docs/results/noise.md has them in short. Asserts nothing.
"""

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tofmix.arrays import BoolArray, FloatArray
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.noise.measurement import MeasuredNoise, disagreement, measure_noise
from tofmix.io.model_file import load_model
from tofmix.io.recording.recording_file import open_recording
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.render import recording_sensor, render_blocks

SAMPLE = Path(__file__).parents[2] / "sample_data" / "tmf8829_edge.h5"
ROWS, COLS = 100, 120
CELL_MM = 100.0

CURVES = {
    "like r^2": NoiseCurve(np.array([500.0, 1000, 2000, 3000, 5000, 7500]), np.array([7.0, 17, 38, 70, 190, 430])),
    "like r": NoiseCurve(np.array([200.0, 9000.0]), np.array([4.0, 180.0])),
    "5 mm": NoiseCurve(np.array([1000.0]), np.array([5.0])),
    "with kinks": NoiseCurve(np.array([500.0, 2000, 2500, 7000]), np.array([8.0, 10, 30, 35])),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """A recording: what share of its pixels sees two surfaces, how far apart in sigmas, and what else is wrong."""

    name: str
    multi: float = 0.4
    apart: tuple[float, float] = (0.5, 8.0)
    frames: int = 100
    drift_mm: float = 0.0
    pattern_mm: float = 0.0
    outliers: float = 0.0
    step_mm: float = 1.0
    memory: float = 0.0
    patches: bool = False


SETTINGS = (
    Setting(name="one surface everywhere", multi=0.0),
    Setting(name="20 % two surfaces", multi=0.2),
    Setting(name="40 % two surfaces"),
    Setting(name="40 %, 0.8 to 2 sigma apart", apart=(0.8, 2.0)),
    Setting(name="40 %, four boards", patches=True),
    Setting(name="40 %, warm-up by 30 mm", drift_mm=30.0),
    Setting(name="40 %, fixed pattern of 20 mm", pattern_mm=20.0),
    Setting(name="40 %, 1 % outliers", outliers=0.01),
    Setting(name="40 %, steps of 10 mm", step_mm=10.0),
    Setting(name="40 %, AR(1) of 0.5", memory=0.5),
    Setting(name="40 %, all of these", drift_mm=30.0, pattern_mm=20.0, outliers=0.01, memory=0.3),
    Setting(name="40 %, 26 frames", frames=26),
    Setting(name="40 %, 12 frames", frames=12),
)


def recorded(setting: Setting, curve: NoiseCurve, seed: int) -> tuple[ArrayRecording, FloatArray]:
    """A recording drawn pixel by pixel, and the range of each pixel's first surface."""
    rng = np.random.default_rng(seed)
    pixels = ROWS * COLS
    first = rng.uniform(700.0, 7000.0, pixels)
    if setting.patches:
        first = rng.choice([900.0, 1500.0, 2500.0, 4200.0], pixels) * (1.0 + 0.06 * rng.random(pixels))
    second = first + rng.uniform(*setting.apart, pixels) * curve.sigma(first)
    share = np.where(rng.random(pixels) < setting.multi, rng.uniform(0.1, 0.9, pixels), 1.0)
    true = np.where(rng.random((setting.frames, pixels)) < share, first, second)
    noise = rng.standard_normal(true.shape)
    for k in range(1, setting.frames):
        noise[k] = setting.memory * noise[k - 1] + np.sqrt(1.0 - setting.memory**2) * noise[k]
    warm_up = 1.0 - np.exp(-3.0 * np.arange(setting.frames) / setting.frames)
    samples = true + noise * curve.sigma(true) + setting.pattern_mm * rng.standard_normal(pixels)
    samples += setting.drift_mm * warm_up[:, None]
    wild = rng.random(true.shape) < setting.outliers
    samples[wild] = rng.uniform(300.0, 9000.0, int(wild.sum()))
    samples = np.rint(np.rint(samples / setting.step_mm) * setting.step_mm)
    sensor = Sensor(name="benchmark", range_min_mm=300.0, range_max_mm=9000.0, noise=curve)
    return ArrayRecording(samples.reshape(-1, ROWS, COLS), sensor), first


def ratios(measured: NoiseCurve, curve: NoiseCurve, seen_mm: FloatArray) -> FloatArray:
    """Measured over true sigma, at each 100 mm of range that 200 pixels or more see."""
    cell = np.floor(seen_mm / CELL_MM)
    values, counts = np.unique(cell, return_counts=True)
    middle = np.array([np.median(seen_mm[cell == value]) for value in values[counts >= 200]])
    return np.asarray(measured.sigma(middle) / curve.sigma(middle))


def naive(samples: NDArray[np.float32], seen_mm: FloatArray, curve: NoiseCurve) -> FloatArray:
    """The same for the median over a cell's pixels of each pixel's standard deviation."""
    spread = samples.std(axis=0, ddof=1).ravel()
    cell = np.floor(seen_mm / CELL_MM)
    values, counts = np.unique(cell, return_counts=True)
    wanted = values[counts >= 200]
    return np.array([np.median((spread / curve.sigma(seen_mm))[cell == value]) for value in wanted])


def drawn(seeds: list[int]) -> None:
    """Print one row a setting and curve, over all seeds."""
    columns = ("recording", "curve", "ranges", "median", "least", "most", "naive: median", "most", "p(c_r), true")
    print(f"| {' | '.join(columns)} | measured |")
    print("|---" * (len(columns) + 1) + "|")
    for setting in SETTINGS:
        for name, curve in CURVES.items():
            found, other, shares = [], [], []
            for seed in seeds:
                recording, first = recorded(setting, curve, seed)
                measured = measure_noise(recording)
                found.append(ratios(measured.curve, curve, first))
                other.append(naive(recording.read_range(slice(None), slice(None)), first, curve))
                shares.append(measured.outlier_probability)
            all_found, all_other = np.concatenate(found), np.concatenate(other)
            print(
                f"| {setting.name} | {name} | {all_found.size} | {np.median(all_found):.3f} | {all_found.min():.3f}"
                f" | {all_found.max():.3f} | {np.median(all_other):.2f} | {all_other.max():.2f}"
                f" | {setting.outliers:g} | {np.median(shares):.1e} |",
                flush=True,
            )


def reflective(exponent: float, frames: int, seed: int) -> tuple[ArrayRecording, FloatArray, FloatArray, BoolArray]:
    """A recording whose sigma is 20 mm (amplitude / 100)^-exponent.

    Reflectivity is a pattern of squares, amplitude goes as reflectivity / r^2 with 5 % of noise of its own. 40 % of the
    pixels see a second surface of another amplitude, up to 300 mm behind. Returns range and amplitude of each pixel's
    first surface, and whether it sees no other.
    """
    rng = np.random.default_rng(seed)
    shape = (ROWS, COLS)
    first = np.sort(rng.uniform(700.0, 4000.0, ROWS * COLS)).reshape(COLS, ROWS).T
    squares = (np.arange(ROWS)[:, None] // 5 + np.arange(COLS)[None, :] // 5) % 4
    light = 1000.0 * np.array([0.08, 0.2, 0.45, 0.9])[squares] * (1000.0 / first) ** 2
    second, dim = first + rng.uniform(20.0, 300.0, shape), light * rng.uniform(0.3, 3.0, shape)
    share = np.where(rng.random(shape) < 0.4, rng.uniform(0.1, 0.9, shape), 1.0)
    near = rng.random((frames, *shape)) < share
    amplitude = np.where(near, light, dim)
    samples = np.where(near, first, second) + 20.0 * (amplitude / 100.0) ** -exponent * rng.standard_normal(near.shape)
    recorded = amplitude * (1.0 + 0.05 * rng.standard_normal(near.shape))
    sensor = Sensor(name="benchmark", range_min_mm=300.0, range_max_mm=9000.0)
    return ArrayRecording(np.rint(np.maximum(samples, 1.0)), sensor, recorded), first, light, share == 1.0


def by_amplitude(seeds: list[int]) -> None:
    """Print one row a power and seed: measured over true sigma of every pixel, and one-surface pixels kept whole."""
    print("| true power | frames | seed | measured | median | least | most | by range alone: least | most |", end="")
    print(" one surface kept one | by range alone |")
    print("|---" * 11 + "|")
    for exponent in (0.0, 0.7, 0.85, 1.0):
        for frames in (100, 26):
            for seed in seeds:
                recording, first, light, one = reflective(exponent, frames, seed)
                bare = ArrayRecording(recording.read_range(slice(None), slice(None)), recording.sensor)
                true = 20.0 * (light / 100.0) ** -exponent
                measured, alone = measure_noise(recording).curve, measure_noise(bare).curve
                ratio, other = measured.sigma(first, light) / true, alone.sigma(first) / true
                kept = [
                    (estimate_layers(with_curve(source, curve), workers=2).n_modes[0][one] == 1).mean()
                    for source, curve in ((recording, measured), (bare, alone))
                ]
                law = "none" if measured.law is None else ", ".join(f"{p:.2f}" for p in measured.law.exponents())
                print(
                    f"| {exponent:g} | {frames} | {seed} | {law} | {np.median(ratio):.3f} | {ratio.min():.3f}"
                    f" | {ratio.max():.3f} | {other.min():.2f} | {other.max():.2f} | {kept[0]:.4f} | {kept[1]:.4f} |",
                    flush=True,
                )


def with_curve(recording: ArrayRecording, curve: NoiseCurve) -> ArrayRecording:
    """The recording of a camera with this noise curve."""
    everything = slice(None), slice(None)
    amplitude = recording.read_amplitude(*everything) if recording.has_amplitude else None
    return ArrayRecording(recording.read_range(*everything), replace(recording.sensor, noise=curve), amplitude)


def simulated(seeds: list[int]) -> None:
    """Print one row a built-in scene and seed, amplitudes given: only pixels of one surface count towards 200."""
    print("| scene | seed | ranges | median | least | most | p(c_r), true | measured | law of amplitude |")
    print("|---" * 9 + "|")
    for name in ("three-boards", "corridor"):
        model = load_model(name)
        truth, sensor = cast_scene(model), recording_sensor(model)
        assert sensor.noise is not None
        one = truth.n_modes == 1
        for seed in seeds:
            blocks = list(render_blocks(model, truth, n_frames=100, seed=seed))
            samples = np.concatenate([block.range_mm for block in blocks])
            amplitude = np.concatenate([block.amplitude for block in blocks])
            measured = measure_noise(ArrayRecording(samples, sensor, amplitude))
            ratio = ratios(measured.curve, sensor.noise, truth.range_true[one][:, 0].astype(np.float64))
            print(
                f"| {name} | {seed} | {ratio.size} | {np.median(ratio):.3f} | {ratio.min():.3f} | {ratio.max():.3f}"
                f" | {sensor.outlier_probability:g} | {measured.outlier_probability:.1e}"
                f" | {'none' if measured.curve.law is None else 'one'} |",
                flush=True,
            )


def real_recording() -> None:
    """Print the curve of the real sample recording."""
    with open_recording(SAMPLE) as recording:
        measured: MeasuredNoise = measure_noise(recording)
        curve = recording.sensor.noise
    assert curve is not None
    print("| range, mm | pixels | measured sigma, mm | at amplitude | the file's |")
    print("|---" * 5 + "|")
    for range_mm, sigma, pixels in zip(measured.curve.range_mm, measured.curve.sigma_mm, measured.pixels, strict=True):
        if pixels:
            light = "any"
            if measured.curve.law is not None:
                light = f"{np.interp(range_mm, measured.curve.range_mm, measured.curve.law.reference):.0f}"
            print(f"| {range_mm:.0f} | {pixels} | {sigma:.2f} | {light} | {curve.sigma(range_mm):.2f} |")
    range_mm, ratio = disagreement(measured, curve)
    print(f"\nlargest disagreement: the file's is {ratio:.2f} times the measured one at {range_mm:.0f} mm")
    law = measured.curve.law
    if law is not None:
        print(
            f"sigma by range and amplitude: factors {law.factor.round(2).tolist()} at amplitudes"
            f" {law.amplitude.round().tolist()}, powers {law.exponents().round(2).tolist()},"
            f" +{measured.law_gain:.0f} nat on pixels held out"
        )
    print(f"outliers: {measured.outlier_samples} samples, p(c_r) = {measured.outlier_probability:.1e}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[21, 22, 23])
    parser.add_argument(
        "--only", choices=["drawn", "by-amplitude", "simulated", "real"], help="One of the tables instead of all."
    )
    chosen = parser.parse_args()
    tables = {
        "drawn": lambda: drawn(chosen.seeds),
        "by-amplitude": lambda: by_amplitude(chosen.seeds),
        "simulated": lambda: simulated(chosen.seeds),
        "real": real_recording,
    }
    for name, table in tables.items():
        if chosen.only in (None, name):
            table()
            print()


if __name__ == "__main__":
    main()

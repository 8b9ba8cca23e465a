"""How many surfaces are counted where nobody tuned the noise: real sensors, spliced pixels, noise of any shape.

Usage: PYTHONPATH=tests:. python tests/benchmarks/real.py real|spliced|simulated|adversarial|speed [--json] [--seed N]

Every recording is estimated with default options, so that its noise is that of the file, where the file has a curve,
and of the samples, where it has none. Prints Markdown tables, or JSON with `--json`; asserts nothing.

- real: recordings of four sensors. `clusters.py` says which pixels see one surface and which see two, without calling
  the package; some columns leave out pixels beside a faint further cluster. `sigma` is the learnt sigma over half the
  width of the central 68 % of single pixels, drift removed: the median over them. A second table says where the further
  layers of single pixels stand (`further_layers.py`), and how double pixels fare whose clusters are as narrow as those
  of single ones. A TMF8829 recording is part of the project; the others are read from `--data`, and skipped with a line
  on stderr where they are not there.
- spliced: recordings of single real pixels, of which 15 % were joined from two at a known distance.
- simulated: one surface a pixel and noise that is skewed, long-tailed, of different widths, drifting or on background,
  `--pixels` a cell in images of 25,000; and three surfaces in every pixel.
- adversarial: what comes of recordings that no noise model fits, and what `tofmix estimate` says of them.
- speed: a full image of 100 frames with a learnt shape beside one of Gaussian noise, alternating in one run.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.clusters import Judged, Kind, half_width, half_width_without_drift
from benchmarks.further_layers import further_layers
from benchmarks.real_recordings import FOLDER, LOADERS, PROJECT, RealRecording, SinglePixels, real_recordings
from benchmarks.simulated_noise import (
    CAMERA,
    CURVE,
    FAR_MM,
    LOW_MM,
    NEAR_MM,
    NOISES,
    TOP_MM,
    Drawn,
    Noise,
    draw,
    draw_three,
    gaussian,
    skewed,
)

import tofmix
from tofmix.api.recordings import Recording
from tofmix.arrays import FloatArray, IntArray
from tofmix.errors import TofmixError
from tofmix.sensor import NoiseCurve

SEED = 83
DISTANCES = (2.0, 3.0, 4.0, 8.0)
SHARES = (0.2, 0.5)
MIXED = 0.15
"""Share of spliced pixels: enough others that noise can be learnt."""

FRAMES = (50, 100, 300)
IMAGE_COLS, IMAGE_PIXELS = 250, 25_000
"""Images that simulated cells are cut into: about those of a camera, and bounded memory."""

ENOUGH = 15
"""Samples that a surface must have for it to be found without fail."""

WIDEST = 0.99
"""Double pixels are narrow if no cluster is wider than this share of single pixels has it."""

THREE_FRAMES = (100, 300)
THREE_DISTANCES = (4.0, 12.0)
FULL_IMAGE = (144, 176)

Row = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What an estimate makes of a recording."""

    layers: IntArray | None = None
    """(pixel,) int64 or None. Layers of each pixel; None where the recording was refused."""
    range_mm: FloatArray | None = None
    weight: FloatArray | None = None
    """(pixel, layer) float64 or None. `range_mm`, `weight`: the layers, NaN past the last."""
    curve: NoiseCurve | None = None
    """The noise that was used."""
    said: list[str] = field(default_factory=list)
    """Warnings, or why the recording was refused."""


def estimated(recording: Recording, workers: int, noise: str | NoiseCurve | None = None) -> Outcome:
    """Estimate with default options."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            result = tofmix.estimate(recording, workers=workers, noise=noise)
        except TofmixError as error:
            return Outcome(said=[str(error)])
    said = [str(warning.message) for warning in caught]
    layers = result.n_modes.ravel().astype(np.int64)
    range_mm, weight = (x.reshape(layers.size, -1).astype(np.float64) for x in (result.range, result.weight))
    return Outcome(layers=layers, range_mm=range_mm, weight=weight, curve=result.sensor.noise, said=said)


def percent(part: IntArray | np.ndarray[Any, np.dtype[np.bool_]]) -> float | None:
    """Mean of a mask in %; None of nothing."""
    return None if part.size == 0 else 100.0 * float(part.mean())


def counts(layers: IntArray | None, pixels: IntArray) -> Row:
    """Shares of pixels with no, one, two and more layers, in %; empty where there are no layers or pixels."""
    if layers is None or pixels.size == 0:
        return {}
    of = layers[pixels]
    return {
        "none, %": percent(of == 0),
        "one, %": percent(of == 1),
        "two, %": percent(of == 2),
        "three or more, %": percent(of > 2),
    }


def centre_mm(judged: Judged, pixel: int) -> float:
    """Middle of the first cluster of a pixel, mm."""
    cluster = judged.clusters[pixel][0]
    return 0.5 * (cluster.low_mm + cluster.high_mm)


def sigma_ratio(real: RealRecording, judged: Judged, curve: NoiseCurve | None) -> float | None:
    """Learnt sigma over half the width of the central 68 % of single pixels, drift removed: the median."""
    single = judged.pixels(Kind.SINGLE)
    if curve is None or single.size == 0:
        return None
    samples, amplitude = real.samples(), real.recording.amplitude
    own = np.array([half_width_without_drift(samples, judged, pixel) for pixel in single])
    light = None if amplitude is None else np.nanmedian(amplitude.reshape(len(amplitude), -1), axis=0)[single]
    sigma = curve.sigma(np.array([centre_mm(judged, pixel) for pixel in single]), light)
    return float(np.median(sigma / np.maximum(own, 1e-9)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimated:
    """A real recording, what the rule says of its pixels, and what an estimate finds."""

    real: RealRecording
    judged: Judged
    noise: str | None
    found: Outcome


@cache
def real_estimates(folder: Path, names: tuple[str, ...], workers: int) -> list[Estimated]:
    """Estimate the real recordings, once for all tables: by default, and with learnt noise beside a file's curve."""
    out = []
    for real in real_recordings(folder, names, _skip):
        judged = real.judged()
        for noise in (None, "auto") if real.recording.sensor.noise is not None else (None,):
            found = estimated(real.recording, workers, noise)
            out.append(Estimated(real=real, judged=judged, noise=noise, found=found))
    return out


def run_real(chosen: argparse.Namespace) -> Iterator[Row]:
    """Rows of the table of real recordings."""
    for one in real_estimates(chosen.data, tuple(chosen.only or LOADERS), chosen.workers):
        real, judged, found, noise = one.real, one.judged, one.found, one.noise
        single, double = judged.pixels(Kind.SINGLE), judged.pixels(Kind.DOUBLE)
        row: Row = {
            "recording": real.name,
            "noise": noise or "default",
            "single": single.size,
            "double": double.size,
            "undecided": len(judged.kind) - single.size - double.size,
            "half-width, mm": judged.half_width_mm,
            "aim, at most": 100.0 * real.most_split,
            "aim, at least": 100.0 * (real.least_double or 0.0) or None,
            "sigma (aim 0.97 to 1.03)": sigma_ratio(real, judged, found.curve),
            "said": found.said,
        }
        if found.layers is not None:
            row["more than one, %"] = percent(found.layers[single] > 1)
            clear, pair = judged.clear(Kind.SINGLE), judged.clear(Kind.DOUBLE)
            row["single beside no faint cluster"], row["double beside no faint cluster"] = clear.size, pair.size
            row["of these more than one, %"] = percent(found.layers[clear] > 1)
            row["of these two, %"] = percent(found.layers[pair] == 2)
            row["no layer, %"] = percent(found.layers[single] == 0)
            row["two, %"] = percent(found.layers[double] == 2)
            row["one, %"] = percent(found.layers[double] == 1)
            row["other, %"] = percent((found.layers[double] == 0) | (found.layers[double] > 2))
        yield row


REAL = (
    "recording | noise | single | more than one, % | single beside no faint cluster | "
    "of these more than one, % | aim, at most | no layer, % | double | two, % | aim, at least | one, % | "
    "other, % | double beside no faint cluster | of these two, % | undecided | sigma (aim 0.97 to 1.03)"
)


def run_spliced(chosen: argparse.Namespace) -> Iterator[Row]:
    """Rows of the table of spliced pixels."""
    for real in real_recordings(chosen.data, tuple(chosen.only or ("vl53l0x", "mit_face")), _skip):
        pool, judged, samples = SinglePixels(real), real.judged(), real.samples()
        own = [half_width_without_drift(samples, judged, pixel) for pixel in judged.pixels(Kind.SINGLE)]
        sigma_mm = float(np.median(own))
        for number, (share, distance) in enumerate((s, d) for s in SHARES for d in DISTANCES):
            if distance not in chosen.apart or share not in chosen.share:
                continue
            rng = np.random.default_rng([chosen.seed, number])
            made = pool.splice(
                sigma_mm=sigma_mm, distance=distance, share=share, pixels=chosen.pixels, mixed=MIXED, rng=rng
            )
            found = estimated(made.recording, chosen.workers)
            row: Row = {
                "recording": real.name,
                "lesser share": share,
                "sigma apart": distance,
                "as made": made.distance,
                "spliced": made.spliced.size,
                "aim, at least": 95.0 if (share, distance) == (0.5, 3.0) else None,
                "said": found.said,
            }
            if found.layers is not None and found.curve is not None:
                row |= counts(found.layers, made.spliced)
                single = np.setdiff1d(np.arange(found.layers.size), made.spliced)
                row["single"], row["split, % (aim at most 1.5)"] = single.size, percent(found.layers[single] > 1)
                row["split beside no faint cluster, %"] = percent(found.layers[made.clear] > 1)
                row["no layer, %"] = percent(found.layers[single] == 0)
                row["sigma"] = float(found.curve.sigma(float(np.median(pool.centre_mm)))) / sigma_mm
            yield row


def run_further(chosen: argparse.Namespace) -> Iterator[Row]:
    """Rows of the table of further layers in single pixels, and of narrow double pixels."""
    for one in real_estimates(chosen.data, tuple(chosen.only or LOADERS), chosen.workers):
        judged, found, sensor = one.judged, one.found, one.real.recording.sensor
        if found.layers is None or found.range_mm is None or found.weight is None:
            continue
        samples = one.real.samples()
        low, high = float(np.nanmin(samples)), float(np.nanmax(samples))
        if sensor.range_min_mm is not None and sensor.range_max_mm is not None:
            low, high = sensor.range_min_mm, sensor.range_max_mm
        _, rows, cols = one.real.recording.range_mm.shape
        groups = further_layers(judged, (rows, cols), found.range_mm, found.weight, low_mm=low, high_mm=high)
        widest = np.quantile(widest_mm(judged, judged.pixels(Kind.SINGLE)), WIDEST)
        double = judged.pixels(Kind.DOUBLE)
        narrow = double[widest_mm(judged, double) <= widest]
        yield {
            "recording": one.real.name,
            "noise": one.noise or "default",
            "further layers of single pixels: beside the first": groups.beside,
            "at a surface of pixels around": groups.around,
            "by chance, %": 100.0 * groups.around_by_chance,
            "at another surface of the scene": groups.scene,
            "there by chance, %": 100.0 * groups.scene_by_chance,
            "elsewhere": groups.elsewhere,
            "single pixels with one elsewhere, %": 100.0 * groups.pixels_elsewhere,
            "double, clusters as narrow as of 99 % of the single": narrow.size,
            "of these two, %": percent(found.layers[narrow] == 2),
            "one, %": percent(found.layers[narrow] == 1),
            "double, wider": double.size - narrow.size,
            "two of these, %": percent(found.layers[np.setdiff1d(double, narrow)] == 2),
        }


def widest_mm(judged: Judged, pixels: IntArray) -> FloatArray:
    """Half-width of the widest cluster of each of these pixels, mm."""
    return np.array([max(cluster.half_width_mm for cluster in judged.clusters[pixel]) for pixel in pixels])


FURTHER = (
    "recording | noise | further layers of single pixels: beside the first | at a surface of pixels around | "
    "by chance, % | at another surface of the scene | there by chance, % | elsewhere | "
    "single pixels with one elsewhere, % | double, clusters as narrow as of 99 % of the single | "
    "of these two, % | one, % | double, wider | two of these, %"
)


SPLICED = (
    "recording | lesser share | sigma apart | as made | spliced | two, % | aim, at least | one, % | "
    "three or more, % | none, % | single | split, % (aim at most 1.5) | split beside no faint cluster, % | "
    "no layer, % | sigma"
)


def image(samples: FloatArray) -> FloatArray:
    """Samples (frame, pixel) as (frame, row, col)."""
    frames, pixels = samples.shape
    cols = IMAGE_COLS if pixels % IMAGE_COLS == 0 else pixels
    return samples.reshape(frames, pixels // cols, cols)


@dataclass(slots=True)
class Tally:
    """What the images of a cell add up to."""

    layers: list[IntArray] = field(default_factory=list)
    background: list[FloatArray] = field(default_factory=list)
    of_surface: list[IntArray] = field(default_factory=list)
    sigma: list[float] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    refused: int = 0

    def add(self, drawn: Drawn, found: Outcome, unit: float) -> None:
        """Count one image; `unit` is the half-width of the errors, in sigma of the curve they were drawn with."""
        self.said += [text for text in found.said if text not in self.said]
        if found.layers is None or found.curve is None:
            self.refused += drawn.range_mm.size
            return
        self.layers.append(found.layers)
        self.background.append(drawn.background)
        self.of_surface.append(drawn.of_surface)
        ratio = found.curve.sigma(drawn.range_mm) / (unit * CURVE.sigma(drawn.range_mm))
        self.sigma.append(float(np.median(ratio)))


def cell(
    draws: Callable[[int, np.random.Generator], Drawn], unit: float, key: list[int], chosen: argparse.Namespace
) -> Tally:
    """Draw and estimate a cell image by image."""
    tally = Tally()
    for number, first in enumerate(range(0, chosen.pixels, IMAGE_PIXELS)):
        rng = np.random.default_rng([chosen.seed, *key, number])
        drawn = draws(min(IMAGE_PIXELS, chosen.pixels - first), rng)
        noise = CURVE if chosen.with_curve else None
        recording = tofmix.from_array(image(drawn.samples), units="mm", sensor=CAMERA, noise=noise)
        tally.add(drawn, estimated(recording, chosen.workers), unit)
    return tally


def unit_of(noise: Noise) -> float:
    """Half the width of the central 68 % of the errors, in their standard deviation."""
    return half_width(noise.errors(np.random.default_rng(0), 100, 2000).ravel())


def run_simulated(chosen: argparse.Namespace) -> Iterator[Row]:
    """Rows of the table of noise that is not Gaussian."""
    names = [name for name in NOISES if not chosen.noise or any(text in name for text in chosen.noise)]
    for name in names:
        noise, unit = NOISES[name], unit_of(NOISES[name])
        for frames in chosen.frames:
            key = [list(NOISES).index(name), frames]
            tally = cell(lambda n, rng, noise=noise, frames=frames: draw(noise, frames, n, rng), unit, key, chosen)  # type: ignore[misc]
            row: Row = {"noise": name, "frames": frames, "said": tally.said, "refused": tally.refused}
            if tally.layers:
                layers, background = np.concatenate(tally.layers), np.concatenate(tally.background)
                enough = np.concatenate(tally.of_surface) >= ENOUGH
                row |= {
                    "pixels": layers.size,
                    "more than one, % (aim 0.05 to 0.2)": percent(layers > 1),
                    "no layer, %": percent(layers == 0),
                    "one, of those with 15 samples or more, % (aim 99.5)": percent(layers[enough] == 1),
                    "sigma": float(np.median(tally.sigma)),
                }
                third = np.minimum(3.0 * background / max(noise.most_background, 1e-9), 2.0).astype(np.int64)
                for k, part in enumerate(BACKGROUNDS if noise.most_background > 0 else ()):
                    row[part] = percent(layers[third == k] > 1)
            yield row


BACKGROUNDS = ("background < 0.3", "0.3 to 0.6", "> 0.6")
SIMULATED = (
    "noise | frames | pixels | more than one, % (aim 0.05 to 0.2) | background < 0.3 | 0.3 to 0.6 | > 0.6 | "
    "no layer, % | one, of those with 15 samples or more, % (aim 99.5) | sigma | refused"
)


def run_three(chosen: argparse.Namespace) -> Iterator[Row]:
    """Rows of the table of three surfaces in every pixel."""
    for frames in THREE_FRAMES:
        for distance in THREE_DISTANCES:
            key = [len(NOISES), frames, round(distance)]
            tally = cell(lambda n, rng, f=frames, d=distance: draw_three(f, n, d, rng), 1.0, key, chosen)  # type: ignore[misc]
            row: Row = {"frames": frames, "sigma apart": distance, "said": tally.said, "refused": tally.refused}
            if tally.layers:
                layers = np.concatenate(tally.layers)
                row |= counts(layers, np.arange(layers.size))
                row |= {
                    "pixels": layers.size,
                    "three, % (aim 99)": percent(layers == 3),
                    "sigma (aim 0.95 to 1.05)": float(np.median(tally.sigma)),
                }
            yield row


THREE = (
    "frames | sigma apart | pixels | three, % (aim 99) | one, % | two, % | none, % | sigma (aim 0.95 to 1.05) | refused"
)


def adversaries(rng: np.random.Generator) -> dict[str, FloatArray]:
    """Recordings (frame, row, col), mm, that no noise model fits."""
    frames, rows, cols = 100, 40, 60
    pixels = rows * cols
    plain = draw(Noise(), frames, pixels, rng).samples
    place = rng.uniform(NEAR_MM, FAR_MM, pixels)
    halves = np.where(np.arange(pixels) % cols < cols // 2, skewed(rng, frames, pixels), gaussian(rng, frames, pixels))
    made = {
        "background alone": rng.uniform(LOW_MM, TOP_MM, (frames, pixels)),
        "three samples a pixel": plain[:3],
        "a constant": np.full((frames, pixels), 1500.0),
        "steps of 40 mm": 40.0 * np.rint(plain / 40.0),
        "skewed on the left half, Gaussian on the right": place + CURVE.sigma(place) * halves,
    }
    return {name: samples.reshape(-1, rows, cols) for name, samples in made.items()}


def run_adversarial(chosen: argparse.Namespace) -> Iterator[Row]:
    """Rows of the table of hostile recordings, by the command."""
    for name, samples in adversaries(np.random.default_rng(chosen.seed)).items():
        with tempfile.TemporaryDirectory() as folder:
            source, output = Path(folder) / "recording.h5", Path(folder) / "out.layers.h5"
            tofmix.from_array(samples, units="mm", sensor=CAMERA).save(source)
            command = [sys.executable, "-m", "tofmix", "estimate", str(source), "-o", str(output)]
            ended = subprocess.run(
                [*command, "--workers", str(chosen.workers)],
                capture_output=True,
                text=True,
                check=False,
                cwd=PROJECT,
                env=os.environ | {"PYTHONPATH": str(PROJECT)},
            )
            said = [line.replace(f"{folder}/", "") for line in ended.stderr.splitlines() if line.strip()]
            row: Row = {"recording": name, "exit code": ended.returncode, "said": said}
            if output.exists():
                found = tofmix.open(output)
                assert not isinstance(found, Recording)
                layers = found.n_modes.astype(np.int64)[0]
                half = layers.shape[1] // 2
                row |= counts(layers.ravel(), np.arange(layers.size))
                row["left half, more than one"] = percent(layers[:, :half] > 1)
                row["right half"] = percent(layers[:, half:] > 1)
            yield row


ADVERSARIAL = (
    "recording | exit code | none, % | one, % | two, % | three or more, % | left half, more than one | right half"
)


def run_speed(chosen: argparse.Namespace) -> Iterator[Row]:
    """Seconds of a full image, alternating, best of the rounds."""
    rows, cols = FULL_IMAGE
    rng = np.random.default_rng(chosen.seed)
    recordings = {
        name: tofmix.from_array(
            draw(Noise(errors=errors), chosen.frames, rows * cols, rng).samples.reshape(-1, rows, cols),
            units="mm",
            sensor=CAMERA,
        )
        for name, errors in (("Gaussian", gaussian), ("skewness 1", skewed))
    }
    learnt = {name: estimated(recording, chosen.workers).curve for name, recording in recordings.items()}
    seconds: dict[tuple[str, str], float] = {}
    for _ in range(chosen.rounds):
        for name, recording in recordings.items():
            for way, noise in (("learning", None), ("learnt before", learnt[name])):
                start = time.perf_counter()
                estimated(recording, chosen.workers, noise)
                seconds[name, way] = min(seconds.get((name, way), np.inf), time.perf_counter() - start)
    plain = seconds["Gaussian", "learnt before"]
    for name, curve in learnt.items():
        given, whole = seconds[name, "learnt before"], seconds[name, "learning"]
        shape = None if curve is None else curve.shape
        yield {
            "noise": name,
            "shape": "refused" if curve is None else "Gaussian" if shape is None else "learnt",
            "estimate, s": given,
            "over Gaussian (aim at most 3)": given / plain,
            "learning, s": whole - given,
            "all over Gaussian": whole / plain,
        }


SPEED = "noise | shape | estimate, s | over Gaussian (aim at most 3) | learning, s | all over Gaussian"

PARTS: dict[str, list[tuple[str, Callable[[argparse.Namespace], Iterator[Row]], str]]] = {
    "real": [
        ("Real recordings: layers in pixels that visibly see one surface, and two", run_real, REAL),
        ("Further layers of single pixels, and double pixels by the width of their clusters", run_further, FURTHER),
    ],
    "spliced": [("Single real pixels, 15 % of them joined from two", run_spliced, SPLICED)],
    "simulated": [
        ("One surface a pixel", run_simulated, SIMULATED),
        ("Three surfaces in every pixel, shares 0.2 and more", run_three, THREE),
    ],
    "adversarial": [("What no noise model fits", run_adversarial, ADVERSARIAL)],
    "speed": [("144 x 176 pixels, best of the rounds", run_speed, SPEED)],
}


def _skip(text: str) -> None:
    print(text, file=sys.stderr)


def shown(value: object) -> str:
    """A cell of a table."""
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if value < 1.0 else f"{value:.4g}"
    return str(value)


def print_table(title: str, head: str, rows: Iterator[Row]) -> None:
    """Print rows, whose keys are the titles of columns, as they come, and below them what was said."""
    columns = head.split(" | ")
    print(f"{title}:\n\n| {head} |\n{'|---' * len(columns)}|", flush=True)
    notes: dict[str, None] = {}
    for row in rows:
        print(f"| {' | '.join(shown(row.get(key)) for key in columns)} |", flush=True)
        notes |= dict.fromkeys(f"- {row[columns[0]]}: {text}" for text in row.get("said", ()))
    print("\n" + "".join(f"{note}\n" for note in notes))


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="part", required=True)
    made = {name: commands.add_parser(name, help=parts[0][0].replace("%", "%%")) for name, parts in PARTS.items()}
    for one in made.values():
        one.add_argument("--json", action="store_true", help="print JSON instead of tables")
        one.add_argument("--seed", type=int, default=SEED)
        one.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="threads of an estimate")
    for name in ("real", "spliced"):
        made[name].add_argument("--data", type=Path, default=FOLDER, metavar="FOLDER", help="with the real recordings")
        made[name].add_argument("--only", choices=tuple(LOADERS), nargs="+", help="recordings, by the folder's name")
    made["spliced"].add_argument("--pixels", type=int, default=4000, help="of each recording")
    made["spliced"].add_argument("--apart", type=float, nargs="+", default=DISTANCES, help="distances, in sigma")
    made["spliced"].add_argument("--share", type=float, nargs="+", default=SHARES, help="shares of the second surface")
    made["simulated"].add_argument("--pixels", type=int, default=200_000, help="of each cell")
    made["simulated"].add_argument("--frames", type=int, nargs="+", default=FRAMES)
    made["simulated"].add_argument("--noise", nargs="+", metavar="TEXT", help="kinds whose name contains one of these")
    made["simulated"].add_argument(
        "--with-curve", action="store_true", help="recordings hold the sigma(r) that they were drawn with"
    )
    made["speed"].add_argument("--frames", type=int, default=100)
    made["speed"].add_argument("--rounds", type=int, default=5)
    return parser.parse_args()


def main() -> None:
    chosen = parsed()
    if chosen.json:
        tables = [{"title": title, "rows": list(run(chosen))} for title, run, _ in PARTS[chosen.part]]
        print(json.dumps({"part": chosen.part, "seed": chosen.seed, "tables": tables}, indent=1))
        return
    for title, run, head in PARTS[chosen.part]:
        print_table(title, head, run(chosen))


if __name__ == "__main__":
    main()

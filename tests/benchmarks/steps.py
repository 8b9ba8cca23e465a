"""Ranges that are stored on a step: sigma, false alarms and power beside the same samples without a step.

    python tests/benchmarks/steps.py [--steps 0.5,2] [--samples 30,100] [--forms common,jitter] [--pixels 1000]

Pixels of one surface, and of two surfaces `--apart` sigmas apart, are drawn with Gaussian noise of 6 mm at ranges of
1.5 to 4.5 m, and stored on a step of each number of sigmas: ``common`` multiples of one step; ``jitter``, the same
after a conversion in float32; ``range``, a step that grows with range; ``float``, floating-point numbers of few bits,
whose step is that number from about 2 to 4 m, and half and twice as much below and beyond; ``pixel``, the step of each
pixel; ``integer``, whole mm, with the noise made as small as the step asks. The noise is learnt, with all its parts.
Step 0 is the same samples as they were drawn.

`ratio` is the power of a likelihood-ratio test on the same stored values, which knows sigma and the step: two surfaces
of free places and shares against one, for the probability of the values in their cells, by direct maximisation. Its
threshold is the gain that as many pixels of one surface exceed as `estimate` takes for more, one of them at least. So
it is the most that any count can find; of each kind `--tested` pixels are tried.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import ndtr

import tofmix as tm
from tofmix.arrays import FloatArray

SIGMA_MM = 6.0
LOW_MM, HIGH_MM = 1500.0, 4500.0
FORMS = ("common", "jitter", "range", "float", "pixel", "integer")


def stored(range_mm: FloatArray, step_mm: float, form: str, rng: np.random.Generator) -> NDArray[np.float32]:
    """Ranges (frame, row, col), mm, as a camera stores them on a step that is `step_mm` in the middle of all ranges."""
    if step_mm == 0.0:
        return range_mm.astype(np.float32)
    if form == "range":  # multiples of a step in the logarithm
        part = step_mm / (0.5 * (LOW_MM + HIGH_MM))
        return np.exp(part * np.rint(np.log(range_mm) / part)).astype(np.float32)
    if form == "float":
        double = step_mm * 2.0 ** np.rint(np.log2(2048.0 / step_mm))  # a value of both steps, near 2 m
        own = step_mm * 2.0 ** np.floor(np.log2(range_mm / double))
        return np.asarray(own * np.rint(range_mm / own), np.float32)
    if form == "pixel":
        factor = 1.0 + 0.2 * rng.random(range_mm.shape[1:])
        return (factor * step_mm * np.rint(range_mm / (factor * step_mm))).astype(np.float32)
    values = (step_mm * np.rint(range_mm / step_mm)).astype(np.float32)
    if form == "jitter":
        turn = rng.uniform(0.5, 1.0, range_mm.shape).astype(np.float32)
        return values * turn / turn
    return values


def drawn(
    samples: int, pixels: int, sigma_mm: float, apart: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Ranges (frame, row, col), mm, of one surface, or of two `apart` sigmas apart in every fourth pixel; the truth."""
    rows = max(1, pixels // 40)
    place = rng.uniform(LOW_MM, HIGH_MM, (rows, 40))
    ranges = place + sigma_mm * rng.standard_normal((samples, rows, 40))
    if apart:
        ranges[:, :, ::4] += apart * sigma_mm * (rng.random((samples, rows, 10)) < 0.5)
    return ranges, place


def recorded(values: NDArray[np.float32], form: str, folder: Path) -> tm.Recording:
    """A recording of values (frame, row, col), mm; ``integer`` in a file of uint16."""
    camera = tm.Sensor(name="benchmark", range_min_mm=500.0, range_max_mm=8000.0)
    if form != "integer":
        return tm.from_array(values, units="mm", sensor=camera)
    path = folder / "whole.h5"
    with h5py.File(path, "w") as root:
        root.create_dataset("range", data=values.astype(np.uint16), chunks=values.shape).attrs["units"] = "mm"
        group = root.create_group("sensor")
        group.attrs.update(name="benchmark", range_min_mm=500.0, range_max_mm=8000.0)
    found = tm.open(path)
    assert isinstance(found, tm.Recording)
    return found


def ratio_gain(values: FloatArray, step: float) -> float:
    """Gain, nat, of two surfaces over one, for the values (n,) of a pixel in cells of `step`, all in sigmas."""
    level, times = np.unique(np.round(values - values.mean(), 6), return_counts=True)
    half = max(0.5 * step, 1e-3)

    def cell(place: float) -> FloatArray:
        return np.asarray(ndtr(level + half - place) - ndtr(level - half - place))

    def loss(fit: FloatArray) -> float:
        near = 1.0 / (1.0 + np.exp(-fit[2]))
        return -float(times @ np.log(near * cell(fit[0]) + (1.0 - near) * cell(fit[1]) + 1e-300))

    one = min(loss(np.array([place, place, 0.0])) for place in np.linspace(-0.6, 0.6, 121) * max(1.0, step))
    spread = max(float(values.std()), 0.3)
    starts = ([-spread, spread, 0.0], [-2.0 * spread, 0.5 * spread, -1.4], [-0.5 * spread, 2.0 * spread, 1.4])
    return one - min(one, *(minimize(loss, start, method="Nelder-Mead").fun for start in starts))


def ratio_power(values: FloatArray, two: NDArray[np.bool_], step: float, more: float, tested: int) -> float:
    """Share of pixels of two surfaces whose gain exceeds that of all but the share `more` of those of one.

    `values` (frame, row, col) and the step are in sigmas, `two` (row, col) says which pixels have two surfaces.
    """
    single, pair = ([ratio_gain(v, step) for v in values[:, chosen].T[:tested]] for chosen in (~two, two))
    threshold = np.quantile(single, 1.0 - max(more, 1.0 / len(single)))
    return float((np.array(pair) > threshold).mean())


def row(
    form: str,
    step: float,
    samples: int,
    pixels: int,
    apart: float,
    folder: Path,
    *,
    tested: int = 0,
    seed: int = 20080922,
) -> dict[str, float]:
    """Numbers of one line."""
    rng = np.random.default_rng([seed, samples])
    whole = form == "integer" and step > 0.0
    sigma_mm, step_mm = (1.0 / step, 1.0) if whole else (SIGMA_MM, step * SIGMA_MM)
    ranges, place = drawn(samples, pixels, sigma_mm, apart, rng)
    start = time.process_time()
    values = stored(ranges, step_mm, form, rng)
    found = tm.estimate(recorded(values, form, folder), noise="auto", workers=1)
    seconds = time.process_time() - start
    layers = found
    n, sigma = layers.n_modes[0], layers.sigma[0, ..., 0]
    two = np.zeros(n.shape, dtype=bool)
    if apart:
        two[:, ::4] = True
    error = (layers.range[0, ..., 0] - place)[~two & (n == 1)]
    stderr = layers.range_stderr[0, ..., 0][~two & (n == 1)]
    step_found = found.sensor.range_step_mm
    return {
        "sigma": float(np.nanmedian(sigma[~two]) / sigma_mm),
        "more": float((n[~two] > 1).mean()),
        "none": float((n[~two] == 0).mean()),
        "power": float((n[two] == 2).mean()) if apart else np.nan,
        "ratio": ratio_power(np.asarray(values / sigma_mm, np.float64), two, step, float((n[~two] > 1).mean()), tested)
        if tested
        else np.nan,
        "rms": float(np.sqrt(np.mean((error / stderr) ** 2))),
        "least": float(stderr.min() / sigma_mm),
        "found": 0.0 if step_found is None else float(np.median(step_found)) / sigma_mm,
        "seconds": seconds,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", default="0,0.1,0.3,1,2,5,10", help="steps, in sigmas")
    parser.add_argument("--samples", default="30,100,1000", help="samples of a pixel")
    parser.add_argument("--forms", default=",".join(FORMS), help=f"some of {', '.join(FORMS)}")
    parser.add_argument("--pixels", type=int, default=1000, help="pixels")
    parser.add_argument(
        "--apart", type=float, default=0.0, help="distance of two surfaces in every fourth pixel, sigmas"
    )
    parser.add_argument("--tested", type=int, default=0, help="pixels of each kind for the likelihood-ratio test")
    parser.add_argument("--seed", type=int, default=20080922, help="seed of the samples")
    chosen = parser.parse_args()
    print(
        "| samples | form | step, sigma | found | sigma / true | more than one, % | none, % | power | ratio |"
        " error / stderr | least stderr, sigma | s |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for samples in map(int, chosen.samples.split(",")):
            for step in map(float, chosen.steps.split(",")):
                for form in ("common",) if step == 0.0 else chosen.forms.split(","):
                    r = row(
                        form,
                        step,
                        samples,
                        chosen.pixels,
                        chosen.apart,
                        Path(folder),
                        tested=chosen.tested,
                        seed=chosen.seed,
                    )
                    print(
                        f"| {samples} | {form if step else '-'} | {step:g} | {r['found']:.3g} | {r['sigma']:.3f} |"
                        f" {100 * r['more']:.2f} | {100 * r['none']:.2f} | {r['power']:.3f} | {r['ratio']:.3f} |"
                        f" {r['rms']:.2f} | {r['least']:.3f} | {r['seconds']:.0f} |"
                    )
                    sys.stdout.flush()


if __name__ == "__main__":
    main()

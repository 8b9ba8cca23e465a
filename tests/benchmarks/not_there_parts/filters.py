"""A camera that filters its ranges over time or pixels, before a board and a wall; and memory that is no filter.

"Both" are the mixed pixels with two layers of p > 0.5 at the two surfaces, "more" those with more layers of p > 0.5.
"Unfiltered" is the rate of "both" without a filter: of medians from as many frames as there are samples; of others from
all frames, as the inverse of an average gives all samples again.
"""

import argparse
from collections.abc import Callable
from functools import partial

import numpy as np
from support.filtered import SENSOR, Scene, averaged, averaged_up_to, over_neighbours, over_windows, stored

import tofmix
from tofmix.arrays import Float32Array, FloatArray
from tofmix.temporal_filter import AveragedMedians, RunningMedian

SHAPE = (48, 64)  # pixels
NEAR_SIGMAS = 5.0  # a layer is at its surface within this


def _median_of_3(samples: FloatArray) -> FloatArray:
    return over_windows(samples, 3, median=True)


def _mean_of_medians(samples: FloatArray, window: int) -> FloatArray:
    return over_windows(_median_of_3(samples), window, median=False)


FILTERS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "none": np.asarray,
    **{f"exponential average, {a:g}": partial(averaged, share=a) for a in (0.7, 0.4, 0.2, 0.1)},
    **{f"median of {m}": partial(over_windows, window=m, median=True) for m in (3, 5)},
    **{f"mean of {m}": partial(over_windows, window=m, median=False) for m in (2, 3, 4, 5, 8)},
    **{
        f"exponential average, {a:g}, jumps over {d:g} mm at once": partial(averaged_up_to, share=a, jump_mm=d)
        for a, d in ((0.4, 20.0), (0.4, 60.0), (0.4, 100.0), (0.2, 60.0))
    },
    "median of 3, then exponential average, 0.4": lambda samples: averaged(_median_of_3(samples), 0.4),
    **{f"median of 3, then mean of {m}": partial(_mean_of_medians, window=m) for m in (2, 3, 4)},
    "median of 3 x 3 pixels": partial(over_neighbours, median=True),
    "mean of 3 x 3 pixels within 100 mm": partial(over_neighbours, median=False, jump_mm=100.0),
    "exponential average, 0.4, then median of 3 x 3 pixels": lambda samples: over_neighbours(
        averaged(samples, 0.4), median=True
    ),
}
MEMORIES: dict[str, Callable[[Scene, int], FloatArray]] = {
    "noise of memory 0.6": lambda scene, n: scene.draw(n, memory=0.6),
    "noise of memory 0.9": lambda scene, n: scene.draw(n, memory=0.9),
    "1/f noise": lambda scene, n: scene.draw(n, pink=True),
    "drift of 30 mm": lambda scene, n: _drifting(scene.draw(n), 30.0),
    "jitter of whole frames, 20 mm": lambda scene, n: _jittered(scene.draw(n), scene, 20.0),
}


def _drifting(samples: FloatArray, by_mm: float) -> FloatArray:
    return np.asarray(samples + by_mm * np.linspace(0.0, 1.0, len(samples))[:, None, None])


def _jittered(samples: FloatArray, scene: Scene, sd_mm: float) -> FloatArray:
    return np.asarray(samples + scene.rng.normal(0.0, sd_mm, len(samples))[:, None, None])


def estimated(ranges: Float32Array, workers: int) -> tofmix.Estimate:
    """Layers of all frames."""
    return tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), workers=workers)


def scored(scene: Scene, found: tofmix.Estimate) -> dict[str, float]:
    """Rates over the mixed pixels, false layers of the others, and errors in stated ones."""
    probability = found.probability[0]
    sure = (np.isfinite(found.range[0]) & (probability > 0.5)).sum(axis=-1)
    truth = np.stack([scene.near_mm, scene.far_mm], axis=-1)
    shares = np.stack([scene.share, 1.0 - scene.share], axis=-1)
    away = found.range[0][..., :2] - truth
    at = (np.abs(away) < NEAR_SIGMAS * SENSOR.noise.sigma(truth)).all(axis=-1)  # type: ignore[union-attr]
    both = (sure == 2) & at & scene.mixed
    undecided = 0.0 if found.mixing is None else float((found.mixing[0][scene.mixed] == 3).mean())
    range_z = (away / found.range_stderr[0][..., :2])[both]
    share_z = ((found.weight[0][..., :2] - shares) / found.weight_stderr[0][..., :2])[both]
    return {
        "both": float(both[scene.mixed].mean()),
        "more": float((sure > 2)[scene.mixed].mean()),
        "undecided": undecided,
        "false": float((sure > 1)[~scene.mixed].mean()),
        "range_z": _rms(range_z),
        "share_z": _rms(share_z),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


def row(name: str, seed: int, frames: int, workers: int) -> str:
    """One line of the table of filters."""
    scene = Scene(SHAPE, seed)
    found = estimated(stored(FILTERS[name](scene.draw(frames)), frames), workers)
    camera, said = found.sensor.temporal_filter, scored(scene, found)
    worth = camera.worth(frames) if isinstance(camera, (RunningMedian, AveragedMedians)) else frames
    plain = Scene(SHAPE, seed + 1000)
    rate = scored(plain, estimated(stored(plain.draw(worth), worth), workers))["both"]
    shared = "" if not found.sensor.filters_over_pixels else f"; pixels share {found.sensor.neighbour_correlation:.2f}"
    return (
        f"| {name} | {'-' if camera is None else camera.words()}{shared} | {said['both']:.3f} | {rate:.3f} ({worth}) |"
        f" {said['more']:.3f} | {said['undecided']:.3f} | {said['false']:.4f} | {said['range_z']:.2f} |"
        f" {said['share_z']:.2f} |"
    )


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="not_there.py filters", description=__doc__)
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", choices=[*FILTERS, *MEMORIES], help="one line of the tables")
    asked = parser.parse_args(arguments)
    print("| filter | found | both | unfiltered (frames) | more | undecided | false, one surface | range z | share z |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name in FILTERS:
        if asked.only in (None, name):
            print(row(name, asked.seed, asked.frames, asked.workers), flush=True)
    print("\n| memory that is no filter | found |\n|---|---|")
    from tofmix.estimation.filters import learn_filter
    from tofmix.recording import ArrayRecording

    for name, draw in MEMORIES.items():
        if asked.only in (None, name):
            found = learn_filter(
                ArrayRecording(stored(draw(Scene(SHAPE, asked.seed), asked.frames), asked.frames), SENSOR)
            )
            print(f"| {name} | {'none' if found is None else found.words()} |", flush=True)

"""Changes of known size in the second half of real recordings, against the first half as the scene.

The recordings are the real ones of `same`, and one of boards where a segment moves, with their frames in another order,
so that nothing else changes: the noise, the steps of the values and the edges are real, the change alone is computed.
The object before the TMF8829 recedes and turns: the course of its mean in each column is taken out first. Sizes are in
standard deviations of a sample, factors or shares. A change of what one wall shows has several names that no recording
of this wall tells apart: these are in `ALIKE`.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from benchmarks.measured_parts import same
from benchmarks.measured_parts.of_itself import VIEW_DEG, of_itself
from scipy.stats import median_abs_deviation
from users.score import alternatives

from tofmix.arrays import BoolArray, FloatArray
from tofmix.optics.equiangular import Equiangular
from tofmix.optics.projection import beam_directions_of

DRAWS = 20
"""Recordings of each change and size."""


class Injected(NamedTuple):
    """A recording's second half after a change, and the change's number."""

    samples: FloatArray
    """(frame, row, col), mm."""
    value: float
    """In the unit of the effect's number."""


Change = Callable[[FloatArray, FloatArray, float, np.random.Generator], Injected]
"""The second half from itself, the first half, the size and a generator."""


def _sigma(first: FloatArray) -> float:
    """The median of the pixels' standard deviations, mm, without random values."""
    return float(np.median(median_abs_deviation(first, axis=0, scale="normal")))


def _offset(second: FloatArray, first: FloatArray, size: float, rng: np.random.Generator) -> Injected:
    value = _sign(rng) * size * _sigma(first)
    return Injected(second + value, value)


def _drift(second: FloatArray, first: FloatArray, size: float, rng: np.random.Generator) -> Injected:
    """Along a line from the middle of the first half; `size` at the end."""
    value = _sign(rng) * size * _sigma(first)
    since = (np.arange(len(second)) + len(first) / 2) / (len(second) + len(first) / 2)
    return Injected(second + value * since[:, None, None], value)


def _motion(second: FloatArray, first: FloatArray, size: float, rng: np.random.Generator) -> Injected:
    """Of the nearest surface, along its normal; `size` is its way by the end, in standard deviations of its samples."""
    near = nearest(first)
    value = _sign(rng) * size * _sigma(first[:, near])
    since = (np.arange(len(second)) + len(first) / 2) / same.RATE_HZ
    velocity = value / float(since[-1])
    view = Equiangular(fov_horizontal_deg=VIEW_DEG, fov_vertical_deg=VIEW_DEG)
    beams = beam_directions_of(view, (near.shape[0], near.shape[1]))
    place = np.median(first, axis=0)[near]
    plane = np.linalg.lstsq(beams[near] * place[:, None], np.ones(place.size), rcond=None)[0]
    nearer = beams @ plane / np.linalg.norm(plane)  # a beam that meets it at an angle becomes longer by more
    way = velocity * since[:, None, None] / np.where(near, nearer, 1.0)
    return Injected(np.where(near, second + way, second), velocity)


def _biases(second: FloatArray, first: FloatArray, size: float, rng: np.random.Generator) -> Injected:
    value = size * _sigma(first)
    return Injected(second + rng.normal(0.0, value, second.shape[1:]), value)


def _noise(second: FloatArray, first: FloatArray, size: float, _: np.random.Generator) -> Injected:
    place, out = _about(second, first)
    return Injected(np.where(np.isnan(out), second, place + size * out), size)


def _outliers(second: FloatArray, _: FloatArray, size: float, rng: np.random.Generator) -> Injected:
    random = rng.uniform(0.0, 2 * second.max(), second.shape)
    return Injected(np.where(rng.random(second.shape) < size, random, second), size)


def _memory(second: FloatArray, first: FloatArray, size: float, _: np.random.Generator) -> Injected:
    """The noise of a frame is `size` times that of the frame before, and enough of its own to be as wide."""
    place, out = _about(second, first)
    noise, before = np.full(out.shape, np.nan), np.zeros(place.shape)
    for k, own in enumerate(out):
        fresh = np.where(np.isnan(own), before, own)  # under a random value the noise goes on unseen
        before = fresh if k == 0 else size * before + math.sqrt(1.0 - size**2) * fresh
        noise[k] = np.where(np.isnan(own), np.nan, before)
    return Injected(np.where(np.isnan(noise), second, place + noise), size)


def _about(second: FloatArray, first: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of each pixel (row, col), and samples less it, NaN for those of other surfaces and random values.

    Noise that is skewed and changes about its median would have another mean: an offset beside the change.
    """
    middle, far = np.median(np.concatenate([first, second]), axis=0), 5.0  # standard deviations
    wide = np.abs(second - middle) > far * median_abs_deviation(first, axis=0, scale="normal")
    own = np.where(wide, np.nan, second)
    place = np.where(wide.all(axis=0), middle, np.nanmean(np.where(wide.all(axis=0), middle, own), axis=0))
    return place, own - place


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice((-1.0, 1.0)))


def nearest(first: FloatArray) -> BoolArray:
    """The pixels (row, col) of the nearest surface of a scene; all of them if it has one surface."""
    mean, sigma = np.median(first, axis=0), _sigma(first)
    levels = np.sort(mean.ravel())
    steps = np.diff(levels)
    widest = int(np.argmax(steps))
    apart = 10.0  # standard deviations between surfaces
    return np.asarray(mean <= levels[widest] if steps[widest] > apart * sigma else np.ones_like(mean, dtype=bool))


NEAR_MM = 400.0
"""The receding object of the TMF8829's recording is nearer than this, all else is farther."""


def still(samples: FloatArray) -> FloatArray:
    """Samples (frame, row, col) of the TMF8829 in the order of time, as if its object neither receded nor turned."""
    near = samples < NEAR_MM
    whole = near.all(axis=0)
    mean = np.where(whole, samples, 0.0).sum(axis=1) / np.maximum(whole.sum(axis=0), 1)
    course = mean - mean.mean(axis=0)
    return np.where(near, samples - course[:, None, :], samples)


OF_SCENES = ("TMF8829", "VL53L8CX", "three boards")
"""Recordings whose pixels are those of one image; a segment of others is not connected."""

MEASURED = tuple(name for name in same.RECORDINGS if name != "three boards")
"""Recordings of real cameras. The noise of the boards is 50 to 200 mm: some times that is a bias of no camera."""

CHANGES: Mapping[str, tuple[Change, tuple[float, float, float]]] = {
    "range_offset": (_offset, (1.0, 2.0, 4.0)),
    "temperature_drift": (_drift, (1.0, 2.0, 4.0)),
    "motion": (_motion, (0.25, 0.5, 1.0)),  # its noise stays that of its first place
    "fixed_pattern": (_biases, (1.0, 2.0, 4.0)),
    "excess_noise": (_noise, (1.2, 1.5, 2.0)),
    "outliers": (_outliers, (0.01, 0.03, 0.1)),
    "temporal_correlation": (_memory, (0.2, 0.4, 0.6)),
}

ALIKE: Mapping[str, frozenset[str]] = {
    "range_offset": frozenset(
        {"surface_pose", "surface_offset", "smooth_pattern", "tap_mismatch", "wiggling", "amplitude_walk"}
    ),
    "temperature_drift": frozenset({"motion"}),
    "motion": frozenset({"temperature_drift"}),
    "fixed_pattern": frozenset(),
    "excess_noise": frozenset({"vignetting", "interference"}),
    "outliers": frozenset(),
    "temporal_correlation": frozenset(),
}
"""Other names of a change: without recorded amplitudes and at one range, a walk is an offset, and a second camera that
is always on is noise."""

NUMBERS = {
    "range_offset": "offset_mm",
    "motion": "velocity_mm_s",
    "excess_noise": "factor",
    "outliers": "probability",
    "temporal_correlation": "coefficient",
}
"""The number of an effect that is held against the injected one."""

MOST = 4
"""Alternatives that may be listed."""

CASES = len(CHANGES) * 3 * DRAWS


def judged(number: int, seed: int) -> dict[str, Any] | None:
    """The result of one case; None where its recording is missing."""
    kind = list(CHANGES)[number % len(CHANGES)]
    rest = number // len(CHANGES)
    change, sizes = CHANGES[kind]
    names = OF_SCENES if kind == "motion" else MEASURED
    name, size = names[rest % len(names)], sizes[(rest // len(names) + rest % len(names)) % len(sizes)]
    rng = np.random.default_rng([seed, number])
    try:
        samples = same.RECORDINGS[name](rng)[: same.MOST_FRAMES]
    except FileNotFoundError:
        return None
    samples = same.part_of(samples, rng)
    samples = same.in_group(still(samples) if name == "TMF8829" else samples, "permuted", rng)
    half = len(samples) // 2
    first = samples[:half]
    changed = changed_half(change, samples, half, size, rng)
    found = of_itself(np.concatenate([first, changed.samples]), half)
    result, errors = scored(kind, changed.value, found)
    case = {"number": number, "kind": kind, "size": size, "name": name, "value": round(changed.value, 4)}
    return {**case, "result": result, "errors": errors, **found}


def changed_half(change: Change, samples: FloatArray, half: int, size: float, rng: np.random.Generator) -> Injected:
    """The second half after a change. Of a camera that stores whole mm, samples change before they are rounded.

    The noise that is multiplied there is that of the camera, that of its rounding and that of the values between.
    """
    first, second = samples[:half], samples[half:].copy()
    if (samples != np.rint(samples)).any():
        return change(second, first, size, rng)
    step_variance = 1.0 / 12.0  # mm2: of rounding, and of what is added before the change
    changed = change(second + rng.uniform(-0.5, 0.5, second.shape), first, size, rng)
    if change is not _noise:
        return Injected(np.rint(changed.samples), changed.value)
    unrounded = max(_sigma(first) ** 2 - step_variance, step_variance)
    return Injected(np.rint(changed.samples), size * math.sqrt(1.0 + 2.0 * step_variance / unrounded))


def scored(kind: str, value: float, found: Mapping[str, Any]) -> tuple[str, float | None]:
    """Right, wrong or open, and by how many stated errors the number is off; None where none is held against it.

    As in docs/results/user-scenes.md: another name is right only if the change is among at most `MOST` alternatives, of
    which half are names of it.
    """
    named = frozenset(found["named"])
    if named - {kind} - ALIKE[kind]:
        return "wrong", None
    if named != {kind}:
        listed = alternatives(found)
        good = sum(one <= {kind} | ALIKE[kind] for one in listed)
        told = bool(named) and frozenset({kind}) in listed and len(listed) <= MOST and 2 * good >= len(listed)
        return "right" if told else "open", None
    (effect,) = found["effects"][:1]
    key = NUMBERS.get(kind, "")
    error = effect["stderr"].get(key)
    return "right", round(abs(effect["parameters"][key] - value) / error, 2) if error else None


def order(count: int) -> Sequence[int]:
    """The first cases: kinds take turns, then recordings and sizes together."""
    return range(count)


def table(done: Sequence[Any]) -> Iterator[str]:
    """Counts by kind and size."""
    yield "| change | small | middle | large | wrong | number within two errors | names that are wrong |"
    yield "|---|---|---|---|---|---|---|"
    for kind, (_, sizes) in CHANGES.items():
        own = [line for line in done if line["kind"] == kind]
        cells = []
        for size in sizes:
            of = [line for line in own if line["size"] == size]
            cells.append(f"{sum(line['result'] == 'right' for line in of)} of {len(of)}")
        wrong = [line for line in own if line["result"] == "wrong"]
        within = [line["errors"] <= 2.0 for line in own if line["errors"] is not None]
        names = "; ".join(sorted({" + ".join(line["named"]) for line in wrong}))
        yield f"| {kind} | {' | '.join(cells)} | {len(wrong)} | {sum(within)} of {len(within)} | {names} |"
    yield f"| longest run, s | {max((line['seconds'] for line in done), default=0)} | | | | | |"

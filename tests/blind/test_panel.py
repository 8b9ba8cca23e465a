"""Statistics of two recordings: each shows its own change, and noise alone changes none."""

from dataclasses import replace

import numpy as np
import pytest

from blind.camera import Device, Recording, record
from blind.geometry import Array
from blind.panel import compare, gap
from blind.scenes import draw_scene
from blind.two_samples import two_samples

DEVICE = Device(name="test camera", rows=32, cols=40, frames=120)
SCENE = draw_scene("boards", [2], DEVICE.view).surfaces


@pytest.fixture(scope="module")
def plain() -> tuple[Recording, Recording]:
    return record(DEVICE, SCENE, seed=1), record(DEVICE, SCENE, seed=2)


def _z(a: Recording, b: Recording) -> dict[tuple[str, str], float]:
    return {(s.statistic, s.axis): s.z for s in compare(a, b)}


def test_two_recordings_of_one_camera_differ_by_noise_alone(plain: tuple[Recording, Recording]) -> None:
    panels = [compare(*plain)]
    panels += [compare(record(DEVICE, SCENE, seed=10 + k), record(DEVICE, SCENE, seed=20 + k)) for k in range(2)]
    z = np.array([[s.z for s in panel] for panel in panels])
    assert z.max() < 4.0  # of 165
    assert abs(z[:, 9:].mean()) < 0.6
    assert 0.6 < z[:, 9:].std() < 1.3
    for panel in panels:
        assert 0.8 < gap(panel) < 1.25


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        ("shift", ("bias", "all")),
        ("stretch", ("spread", "all")),
        ("slope", ("trend", "frame")),
        ("jitter", ("common_mode", "frame")),
        ("coarse", ("discreteness", "all")),
        ("lost", ("invalid", "all")),
        ("wild", ("tails", "extremes")),
        ("memory", ("memory", "lag 1")),
        ("blur", ("neighbour_correlation", "col")),
        ("burst", ("bursts", "frame")),
    ],
)
def test_each_statistic_shows_its_own_change(
    plain: tuple[Recording, Recording], change: str, seen: tuple[str, str], rng: np.random.Generator
) -> None:
    one, two = plain
    r = one.range_mm.copy()
    middle = np.median(r, axis=0)
    frames = np.arange(len(r))[:, None, None]
    if change == "shift":
        r += 3
    elif change == "stretch":
        r = middle + 1.1 * (r - middle)
    elif change == "slope":
        r += 8 * frames / len(r)
    elif change == "jitter":
        r += 4 * rng.standard_normal((len(r), 1, 1))
    elif change == "coarse":
        r = np.rint(r / 7) * 7
    elif change == "lost":
        r[rng.random(r.shape) < 0.001] = np.nan
    elif change == "wild":
        hit = rng.random(r.shape) < 0.002
        r[hit] = rng.uniform(300, 7000, int(hit.sum()))
    elif change == "memory":
        off = r - middle
        off[1:] = 0.3 * off[:-1] + 0.95 * off[1:]
        r = middle + off
    elif change == "blur":
        off = r - middle
        off[:, :, 1:] += 0.3 * off[:, :, :-1]
        r = middle + off
    else:
        r = np.where(frames % 20 < 5, middle + 1.5 * (r - middle), r)
    assert _z(replace(one, range_mm=r.astype(np.float32)), two)[seen] > 6


SIGMA_MM = 12.0


def _noise(rng: np.random.Generator, shape: tuple[int, int, int], memory: float = 0.0) -> Array:
    """Standard normal noise, of an autoregression from frame to frame."""
    out: Array = rng.standard_normal(shape)
    for frame in range(1, len(out)):
        out[frame] = memory * out[frame - 1] + np.sqrt(1 - memory**2) * out[frame]
    return out


def _recording(samples: Array) -> Recording:
    samples = np.rint(samples).astype(np.float32)
    return Recording(
        range_mm=samples, amplitude=np.ones_like(samples), time_s=np.arange(len(samples)) / 25.0, temperature_c=None
    )


def _scene(rng: np.random.Generator, image: tuple[int, int]) -> Array:
    return np.asarray(rng.uniform(1500, 4000, image))


def _p_values(seeds: int, frames: int, memory: float = 0.0, common: float = 0.0) -> Array:
    """P-values (seed, test) of two recordings of one camera."""
    found = []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 5])
        base = _scene(rng, (8, 10))
        pair = []
        for _ in range(2):
            noise = _noise(rng, (frames, 8, 10), memory) + common * rng.standard_normal((frames, 1, 1))
            pair.append(_recording(base + SIGMA_MM * noise))
        found.append([t.p for t in two_samples(*pair, seed=seed, permutations=39)])
    return np.array(found)


def _assert_level(p: Array, level: float) -> None:
    """The share of p-values at or below a level is not above it by more than three standard errors."""
    highest = level + 3 * np.sqrt(level * (1 - level) / len(p))
    assert ((p <= level).mean(axis=0) <= highest).all(), (p <= level).mean(axis=0)


@pytest.mark.parametrize(("memory", "common"), [(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
def test_recordings_of_one_distribution_differ_no_more_often_than_the_level_says(memory: float, common: float) -> None:
    p = _p_values(40, 160 if memory else 64, memory, common)
    for level in (0.05, 0.2):
        _assert_level(p, level)


def _changed(change: str, base: Array, rng: np.random.Generator) -> Array:
    shape = (120, *base.shape)
    noise = _noise(rng, shape, 0.3 if change == "memory" else 0.0)
    if change == "jitter":
        noise = np.sqrt(0.96) * noise + 0.2 * rng.standard_normal((shape[0], 1, 1))
    if change == "neighbours":
        noise[:, :, 1:] = np.sqrt(0.91) * noise[:, :, 1:] + 0.3 * noise[:, :, :-1]
    out = base + SIGMA_MM * noise * (1.1 if change == "wider" else 1.0)
    if change == "shift":
        out += 0.3 * SIGMA_MM
    if change == "board":
        out[:, 4:8, 4:8] -= 0.6 * SIGMA_MM
    if change == "one pixel":
        out[:, 3, 5] = np.rint(base[3, 5]) + 3
    if change == "lost":
        out[rng.random(shape) < 0.01] = np.nan
    if change == "lost in one pixel":
        out[:, 3, 5] = np.where(rng.random(shape[0]) < 0.4, np.nan, out[:, 3, 5])
    return np.asarray(out)


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        ("shift", ("energy", "classifier")),
        ("wider", ("energy", "classifier")),
        ("board", ("energy",)),
        ("one pixel", ("energy_pixel",)),
        ("lost", ("classifier",)),
        ("lost in one pixel", ("energy_pixel",)),
        ("memory", ("classifier",)),
        ("jitter", ("classifier",)),
        ("neighbours", ("classifier",)),
    ],
)
def test_change_of_the_recording_is_detected(change: str, seen: tuple[str, ...], rng: np.random.Generator) -> None:
    base = _scene(rng, (16, 20))
    plain = _recording(base + SIGMA_MM * _noise(rng, (120, 16, 20)))
    tests = {t.name: t for t in two_samples(plain, _recording(_changed(change, base, rng)))}
    for name in seen:
        assert tests[name].differs, tests[name]


def test_energy_distance_is_that_of_its_definition(rng: np.random.Generator) -> None:
    """The quadratic form, summed over all blocks, is 2 E|X - Y| - E|X - X'| - E|Y - Y'| in units of the spread."""
    from blind.two_samples import _forms

    x, y = rng.normal(0, 5, 30), rng.normal(2, 6, 30)
    pooled = np.concatenate([x, y])

    def mean_distance(a: Array, b: Array) -> float:
        return float(np.abs(a[:, None] - b).mean())

    energy = 2 * mean_distance(x, y) - mean_distance(x, x) - mean_distance(y, y)
    form = _forms(pooled[None].astype(np.float32), np.arange(30) // 6, 5)[0]
    assert 2 * form.sum() / 30**2 == pytest.approx(energy / mean_distance(pooled, pooled), rel=1e-4)

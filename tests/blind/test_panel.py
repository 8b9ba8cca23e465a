from dataclasses import replace

import numpy as np
import pytest

from blind.camera import Device, Recording, record
from blind.panel import compare, gap
from blind.scenes import draw_scene

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


def test_statistics_are_the_same_in_either_order(plain: tuple[Recording, Recording]) -> None:
    there, back = _z(*plain), _z(plain[1], plain[0])
    for key in (("bias", "map"), ("tails", "extremes"), ("trend", "frame"), ("discreteness", "all")):
        assert there[key] == pytest.approx(back[key], abs=0.6)  # ties are broken at random


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

"""The rule by which tests/benchmarks/real.py says what real pixels see, on pixels that are made up."""

import argparse
from pathlib import Path

import numpy as np
import pytest
from benchmarks import real, real_recordings
from benchmarks.clusters import (
    Cluster,
    Judged,
    Kind,
    excess_mass,
    half_width,
    half_width_without_drift,
    is_one_mode,
    judge_recording,
)
from benchmarks.further_layers import FurtherLayers, further_layers
from benchmarks.simulated_noise import CAMERA, CURVE, NOISES, draw, draw_three

import tofmix
from tofmix.arrays import FloatArray

LOW, TOP = 300.0, 6000.0
pytestmark = pytest.mark.slow  # of the benchmarks alone

SIGMA = 15.0


def judged(samples: FloatArray) -> Judged:
    """Judge made-up pixels of a known working range."""
    return judge_recording(samples, range_min_mm=LOW, range_max_mm=TOP)


def share(found: Judged, kind: Kind) -> float:
    return found.pixels(kind).size / len(found.kind)


def surfaces(
    rng: np.random.Generator,
    *,
    pixels: int,
    frames: int = 100,
    apart: float = 0.0,
    lesser: float = 0.5,
    background: float = 0.0,
) -> FloatArray:
    """Samples (frame, pixel) of two surfaces `apart` sigma from each other, on uniform background."""
    second = rng.random((frames, pixels)) < lesser
    place = rng.uniform(1000.0, 5000.0, pixels) + apart * SIGMA * second
    samples = place + SIGMA * rng.standard_normal((frames, pixels))
    random = rng.random((frames, pixels)) < background
    return np.asarray(np.where(random, rng.uniform(LOW, TOP, (frames, pixels)), samples))


@pytest.mark.parametrize("name", [name for name in NOISES if "background" not in name])
def test_one_surface_of_any_shape_width_or_drift_is_single(name: str) -> None:
    samples = draw(NOISES[name], 60, 500, np.random.default_rng(1)).samples
    assert share(judged(samples), Kind.SINGLE) > 0.99


@pytest.mark.parametrize("background", [0.1, 0.5, 0.8])
def test_background_makes_no_cluster(background: float) -> None:
    found = judged(surfaces(np.random.default_rng(2), pixels=500, background=background))
    assert share(found, Kind.SINGLE) > 0.985
    assert found.half_width_mm == pytest.approx(SIGMA, rel=0.15)
    assert found.faint.mean() < 0.1


@pytest.mark.parametrize(("lesser", "background"), [(0.5, 0.0), (0.2, 0.0), (0.5, 0.4), (0.2, 0.4)])
def test_two_surfaces_far_apart_are_double(lesser: float, background: float) -> None:
    rng = np.random.default_rng(4)
    samples = np.hstack(
        [
            surfaces(rng, pixels=200, apart=40.0, lesser=lesser, background=background),
            surfaces(rng, pixels=200, background=background),
        ]
    )
    found = judged(samples)
    double = found.kind[:200] == list(Kind).index(Kind.DOUBLE)
    assert double.mean() > (0.9 if lesser * (1.0 - background) < 0.15 else 0.98)
    assert (double | found.faint[:200]).mean() > 0.97
    assert (found.kind[200:] == list(Kind).index(Kind.SINGLE)).mean() > 0.98


def test_two_close_surfaces_and_three_are_undecided() -> None:
    rng = np.random.default_rng(6)
    samples = np.hstack([surfaces(rng, pixels=100, apart=5.0), surfaces(rng, pixels=300)])
    found = judged(samples)
    assert (found.kind[:100] == list(Kind).index(Kind.UNDECIDED)).mean() > 0.85
    assert not (found.kind == list(Kind).index(Kind.DOUBLE)).any()
    rng = np.random.default_rng(7)
    samples = np.hstack([draw_three(100, 100, 20.0, rng).samples, surfaces(rng, pixels=200)])
    found = judged(samples)
    assert (found.kind[:100] == list(Kind).index(Kind.UNDECIDED)).mean() > 0.95


def test_one_sample_far_away_leaves_a_pixel_single_and_three_make_it_double() -> None:
    samples = surfaces(np.random.default_rng(8), pixels=300, frames=30)
    samples[0, :100] = 5800.0
    samples[:3, 100:200] = [[5800.0], [5806.0], [5795.0]]
    kinds = judged(samples).kind
    assert (kinds[:100] == list(Kind).index(Kind.SINGLE)).all()
    assert (kinds[100:200] == list(Kind).index(Kind.DOUBLE)).all()


@pytest.mark.parametrize(("further", "likely"), [(0, False), (4, True)])
def test_a_further_cluster_that_is_likely_but_not_sure_leaves_no_clear_single_pixel(further: int, likely: bool) -> None:
    rng = np.random.default_rng(7)
    samples = surfaces(rng, pixels=200, background=0.1)
    samples[:, 0] = 2000.0 + SIGMA * rng.standard_normal(100)
    samples[:13, 0] = np.linspace(600.0, 1800.0, 13)  # background
    samples[:further, 0] = 3000.0 + 20.0 * np.arange(further)
    found = judged(samples)
    assert 0 in found.pixels(Kind.SINGLE)
    assert (0 not in found.clear(Kind.SINGLE)) == likely
    assert found.clear(Kind.SINGLE).size > 0.9 * found.pixels(Kind.SINGLE).size


def test_whole_millimetres_are_no_modes() -> None:
    samples = np.rint(76.0 + 2.0 * np.random.default_rng(9).standard_normal((100, 500)))
    found = judge_recording(samples)
    assert found.step_mm == 1.0
    assert share(found, Kind.SINGLE) > 0.99


def test_step_in_the_middle_of_the_window_is_not_single() -> None:
    rng = np.random.default_rng(10)
    samples = surfaces(rng, pixels=300)
    samples[50:, :100] += 12.0 * SIGMA
    kinds = judged(samples).kind
    assert (kinds[:100] != list(Kind).index(Kind.SINGLE)).all()


def test_half_width_of_single_pixels_is_sigma_in_spite_of_drift_steps_and_background() -> None:
    rng = np.random.default_rng(11)
    samples = surfaces(rng, pixels=800, frames=40, background=0.3)
    samples += np.linspace(-1.5, 1.5, 40)[:, None] * SIGMA * rng.choice([-1.0, 1.0], 800)
    samples = np.rint(samples / 10.0) * 10.0
    found = judged(samples)
    own = [half_width_without_drift(samples, found, pixel) for pixel in found.pixels(Kind.SINGLE)]
    # Rounding is part of the samples' own scatter; 28 samples on background tell a half-width to 3 %.
    assert np.median(own) == pytest.approx(np.hypot(SIGMA, 10.0 / np.sqrt(12.0)), rel=0.035)


def naive_excess_mass(x: FloatArray, levels: FloatArray) -> float:
    """Over all pairs of intervals between samples."""
    n, best = len(x), 0.0
    ends = [(i, j) for i in range(n) for j in range(i, n)]
    for level in levels:
        gain = {(i, j): (j - i + 1) / n - level * (x[j] - x[i]) for i, j in ends}
        one = max(gain.values())
        two = max((gain[a] + gain[b] for a in ends for b in ends if b[0] > a[1]), default=0.0)
        best = max(best, two - one)
    return best


def test_excess_mass_is_that_of_a_search_over_all_intervals() -> None:
    from benchmarks.clusters import LEVELS

    rng = np.random.default_rng(14)
    for _ in range(3):
        x = np.sort(np.concatenate([rng.normal(0.0, 1.0, 6), rng.normal(5.0, 1.0, 5)]))
        levels = LEVELS[::6] / half_width(x)
        assert excess_mass(x[None])[0] >= naive_excess_mass(x, levels) - 1e-12
        padded = np.concatenate([x, [np.nan, np.nan]])
        np.testing.assert_array_equal(excess_mass(np.stack([padded, padded])), excess_mass(np.stack([x, x])))


def test_uniform_samples_have_one_mode_but_for_the_level_of_the_test() -> None:
    parts = [np.sort(row) for row in np.random.default_rng(15).random((2000, 50))]
    assert 0.98 < is_one_mode(parts).mean() < 0.998


def test_splice_has_the_requested_distance_share_and_number_of_pixels() -> None:
    rng = np.random.default_rng(17)
    recording = tofmix.from_array(np.rint(500.0 + 20.0 * rng.standard_normal((100, 20, 20))), units="mm", sensor=CAMERA)
    made = real_recordings.SinglePixels(
        real_recordings.RealRecording(name="made up", recording=recording, most_split=0.0)
    ).splice(sigma_mm=20.0, distance=10.0, share=0.2, pixels=200, mixed=0.15, rng=rng)
    assert made.spliced.size == 30
    assert made.distance == pytest.approx(10.0, rel=0.01)
    samples = made.recording.range_mm[:, 0, :]
    assert samples.shape == (100, 200)
    away = np.abs(samples[:, made.spliced] - np.median(samples[:, made.spliced], axis=0)) > 100.0
    np.testing.assert_allclose(away.mean(axis=0), 0.2, atol=0.001)
    rest = np.setdiff1d(np.arange(200), made.spliced)
    assert np.abs(samples[:, rest] - 500.0).max() < 100.0


def test_table_of_the_recording_of_the_project_has_its_pixels() -> None:
    chosen = argparse.Namespace(data=Path("/nowhere"), only=["vl53l8cx"], workers=1)
    assert list(real.run_real(chosen)) == []
    judged = real_recordings.tmf8829().judged()
    assert (judged.pixels(Kind.SINGLE).size, judged.pixels(Kind.DOUBLE).size) == (240, 15)


@pytest.mark.parametrize("name", ["Gaussian", "skewness 1", "Student t (5)", "Laplace", "AR(1) 0.5"])
def test_simulated_errors_have_mean_zero_and_deviation_one(name: str) -> None:
    errors = NOISES[name].errors(np.random.default_rng(18), 100, 3000)
    assert errors.mean() == pytest.approx(0.0, abs=0.01)
    assert errors.std() == pytest.approx(1.0, abs=0.015)
    after = (errors[1:] * errors[:-1]).mean()
    assert after == pytest.approx(0.5 if name.startswith("AR") else 0.0, abs=0.015)
    assert (errors**3).mean() == pytest.approx(1.0 if name.startswith("skew") else 0.0, abs=0.2)


def test_drawn_background_is_counted_and_sigma_is_the_curves() -> None:
    drawn = draw(NOISES["background 0 to 0.9"], 100, 2000, np.random.default_rng(19))
    far = np.abs(drawn.samples - drawn.range_mm) > 6.0 * CURVE.sigma(drawn.range_mm)
    near_by_chance = 1.0 - 12.0 * CURVE.sigma(drawn.range_mm).mean() / 5700.0
    assert far.sum() == pytest.approx(near_by_chance * (100 - drawn.of_surface).sum(), rel=0.02)
    assert drawn.background.max() < 0.9


ROWS, COLS = 10, 20
WALL, BOARD = Cluster(3990.0, 4010.0, 5.0), Cluster(1990.0, 2010.0, 5.0)
BESIDE_THE_BOARD, FAR_FROM_IT = 5 * COLS + 3, 5 * COLS + 15


def sorted_with(*further_mm: float, pixel: int = BESIDE_THE_BOARD) -> FurtherLayers:
    """A wall at 4000 mm, a board at 2000 mm in columns 5 to 9; one pixel of the wall has further layers."""
    clusters = [[BOARD] if 5 <= p % COLS < 10 else [WALL] for p in range(ROWS * COLS)]
    judged = Judged(
        kind=np.full(ROWS * COLS, list(Kind).index(Kind.SINGLE)),
        clusters=clusters,
        half_width_mm=5.0,
        step_mm=0.0,
        background=np.zeros(ROWS * COLS),
        faint=np.zeros(ROWS * COLS, dtype=bool),
    )
    range_mm = np.full((ROWS * COLS, 1 + len(further_mm)), np.nan)
    range_mm[:, 0] = [own[0].low_mm + 10.0 for own in clusters]
    range_mm[pixel, 1:] = further_mm
    weight = np.where(np.isfinite(range_mm), 0.1, np.nan)
    weight[:, 0] = 0.9
    return further_layers(judged, (ROWS, COLS), range_mm, weight, low_mm=0.0, high_mm=5000.0)


def test_further_layers_are_sorted_by_the_clusters_around_and_their_chance() -> None:
    found = sorted_with(4035.0)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (1, 0, 0, 0)
    found = sorted_with(2005.0)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 1, 0, 0)
    # Around it the clusters cover 20 mm of the wall and 20 mm of the board.
    assert found.around_by_chance == pytest.approx(40.0 / 5000.0, rel=0.1)
    found = sorted_with(2005.0, pixel=FAR_FROM_IT)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 0, 1, 0)
    assert found.around_by_chance == pytest.approx(20.0 / 5000.0, rel=0.1)
    assert found.scene_by_chance == pytest.approx(40.0 / 5000.0, rel=0.1)
    found = sorted_with(1000.0, 3000.0)
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 0, 0, 2)
    assert found.pixels_elsewhere == pytest.approx(1.0 / (ROWS * COLS))
    found = sorted_with()
    assert (found.beside, found.around, found.scene, found.elsewhere) == (0, 0, 0, 0)
    assert np.isnan(found.around_by_chance)

"""Samples of a block sorted and binned, and a camera's temporal filter found and undone."""

import json
import math
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks import binning
from click.testing import CliRunner
from support.filtered import SENSOR, Scene, averaged, averaged_up_to, over_neighbours, over_windows, stored
from support.sizes import sized

import tofmix
from tofmix.arrays import FloatArray
from tofmix.cli.main import main
from tofmix.compiled.vector import LANES
from tofmix.errors import DoubtWarning
from tofmix.estimation.filters import common_motion, find_repeats, learn_filter
from tofmix.estimation.samples import BIN, FARTHEST_MM, LONG_WINDOW, Readings, gather, padded, sort_samples
from tofmix.estimation.spatial_filters import neighbour_correlation
from tofmix.recording import ArrayRecording
from tofmix.temporal_filter import (
    AveragedMedians,
    ExponentialAverage,
    HeldValues,
    RunningMean,
    RunningMedian,
    TemporalFilter,
)


def test_valid_samples_come_first_and_ascend(rng: np.random.Generator) -> None:
    block = rng.normal(1000, 100, (50, 7)).astype(np.float32)
    block[rng.random(block.shape) < 0.2] = np.nan
    block[3, 2], block[4, 2] = np.inf, 10 * FARTHEST_MM
    ordered = sort_samples(block)
    for pixel in range(7):
        valid = block[np.isfinite(block[:, pixel]) & (block[:, pixel] < FARTHEST_MM), pixel]
        assert ordered.valid[pixel] == len(valid)
        np.testing.assert_array_equal(ordered.values[pixel, : len(valid)], np.sort(valid))


def _gathered(values: FloatArray, sigma_mm: float) -> Readings:
    scratch = np.empty(padded(len(values))), np.empty(padded(len(values)))
    return gather(values, len(values), np.array([1000.0]), np.array([sigma_mm]), *scratch)


@pytest.mark.slow
def test_last_group_is_padded_with_values_of_count_zero() -> None:
    data = _gathered(np.array([1.0, 2.0, 2.0, 5.0]), 10.0)
    assert data.value.tolist() == [1.0, 2.0] + [5.0] * (LANES - 2)
    assert data.times.tolist() == [1.0, 2.0, 1.0] + [0.0] * (LANES - 3)
    assert data.total == 4.0


def test_bins_keep_the_mean_and_lose_little_spread(rng: np.random.Generator) -> None:
    values = np.sort(rng.normal(1000.0, 20.0, LONG_WINDOW))
    data = _gathered(values, 20.0)
    assert data.times.sum() == LONG_WINDOW
    assert np.count_nonzero(data.times) < LONG_WINDOW / 5
    assert data.value @ data.times / LONG_WINDOW == pytest.approx(values.mean(), rel=1e-12)
    spread = data.value**2 @ data.times / LONG_WINDOW - values.mean() ** 2
    assert 0.0 < values.var() - spread < BIN**2 / 12.0 * 20.0**2 * 1.5


@pytest.mark.slow
@pytest.mark.parametrize(
    "samples", [1000, pytest.param(10_000, marks=pytest.mark.compiled("fits of 10,000 samples each"))]
)
def test_binning_moves_no_fit_by_a_hundredth_of_its_standard_error(samples: int, rng: np.random.Generator) -> None:
    for surfaces in (1, 2, 3):
        means, shares, left = binning.errors(samples, surfaces, sized(10, 2), rng)
        assert np.abs(means).max() < 0.01
        assert np.abs(shares).max() < 0.01
        assert left < 200
    assert np.abs(means).max() > 0.0  # it was binned


SHAPE = (24, 32)
FRAMES = 100


def _found(samples: FloatArray, frames: int = FRAMES) -> TemporalFilter | None:
    return learn_filter(ArrayRecording(stored(samples, frames), SENSOR))


@pytest.mark.parametrize(("share", "frames"), [(0.7, 100), (0.1, 100), (0.05, 100), (0.4, 30), (0.05, 30)])
def test_exponential_average_is_found_with_its_share(share: float, frames: int) -> None:
    found = _found(averaged(Scene(SHAPE, 1).draw(FRAMES), share), frames)
    assert isinstance(found, ExponentialAverage)
    assert found.parameter == pytest.approx(share, rel=0.01)


def test_exponential_average_and_no_other_is_found() -> None:
    scene = Scene((48, 64), 1)
    assert scene.mixed.sum() > 200
    found = _found(averaged(scene.draw(FRAMES), 0.2))
    assert isinstance(found, ExponentialAverage)
    assert found.parameter == pytest.approx(0.2, rel=0.004)
    samples = Scene(SHAPE, 6).draw(2 * FRAMES)
    assert isinstance(_found(np.repeat(samples, 2, axis=0), 2 * FRAMES), HeldValues)
    sway = 300.0 * np.sin(np.arange(len(samples)) / 9.0)[:, None, None] * (np.indices(SHAPE)[1] < 8)
    assert _found(samples + sway) is None
    scene = Scene(SHAPE, 7)
    scene.share = np.rint(scene.share)
    assert _found(averaged(scene.draw(FRAMES), 0.4)) is None


@pytest.mark.parametrize("window", [3, 5, 7])
def test_running_median_is_found_by_its_repeated_values(window: int) -> None:
    assert _found(over_windows(Scene(SHAPE, 2).draw(FRAMES), window, median=True)) == RunningMedian(float(window))


def held(samples: FloatArray, share: float, *, frames: bool = False) -> FloatArray:
    """The samples, each of which repeats the one before with some probability: by itself, or in whole frames."""
    out = samples.copy()
    drawn = np.random.default_rng(11).random((len(out), 1, 1) if frames else out.shape) < share
    for frame in range(1, len(out)):
        out[frame] = np.where(drawn[frame], out[frame - 1], out[frame])
    return out


@pytest.mark.parametrize(("share", "step_mm"), [(0.3, 1.0), (0.45, 0.0), (0.5, 1.0)])
def test_held_values_are_no_median(share: float, step_mm: float) -> None:
    samples = held(Scene(SHAPE, 2).draw(FRAMES), share)
    found = _found(np.round(samples / step_mm) * step_mm if step_mm else samples)
    assert isinstance(found, HeldValues)
    assert found.parameter == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("steps", [0.0, 0.5, 2.0])
def test_held_values_are_left_out_and_repeats_by_chance_are_not(steps: float) -> None:
    rng = np.random.default_rng(17)
    drawn = rng.normal(1500.0, 8.0, (300, 6, 50))
    drawn = np.round(drawn / (8.0 * steps)) * 8.0 * steps if steps else drawn
    samples = held(drawn, 0.4).astype(np.float32)
    own = HeldValues(0.4).independent(samples, 0)
    assert np.isfinite(own).mean() == pytest.approx(0.6, abs=0.012)
    assert np.nanstd(own) == pytest.approx(drawn.std(), rel=0.012)
    later = np.isfinite(HeldValues(0.4).independent(samples, 100))
    assert not later[0].any()  # what came before is not known


@pytest.mark.parametrize("noise", ["file", "auto"])
def test_values_that_pixels_hold_one_by_one_give_no_further_surface(noise: str) -> None:
    rng = np.random.default_rng(18)
    mixed = (np.arange(FRAMES * 16 * 30).reshape(FRAMES, 16, 30) % 30 == 0) & (rng.random((FRAMES, 16, 30)) < 0.5)
    samples = held(np.where(mixed, 1900.0, 1500.0) + rng.normal(0.0, 9.5, mixed.shape), 0.4)
    recording = tofmix.from_array(samples.astype(np.float32), units="mm", sensor=SENSOR)
    with pytest.warns(DoubtWarning, match="40 % of the samples repeat"):
        layers = tofmix.estimate(recording, noise=noise)
    assert (layers.n_modes[0][:, 1:] != 1).sum() <= 2
    assert (layers.n_modes[0][:, 0] == 2).all()
    alone = layers.range[0][:, 1:, 0]
    assert np.std((alone - 1500.0) / layers.range_stderr[0][:, 1:, 0]) == pytest.approx(1.0, abs=0.1)
    assert layers.n_samples.mean() == pytest.approx(0.6 * FRAMES, rel=0.03)


@pytest.mark.parametrize("frames", [False, True])
@pytest.mark.parametrize("step_mm", [0.0, 1.0])
def test_repeats_are_counted_beyond_chance(step_mm: float, frames: bool) -> None:
    samples = Scene(SHAPE, 2).draw(FRAMES)
    samples = np.round(samples / step_mm) * step_mm if step_mm else samples
    assert find_repeats(ArrayRecording(stored(samples, FRAMES), SENSOR)) is None
    repeated = stored(held(samples, 0.4, frames=frames), FRAMES)
    found = find_repeats(ArrayRecording(repeated, SENSOR))
    assert found is not None
    whole = np.mean((np.diff(repeated, axis=0) == 0.0).all(axis=(1, 2)))
    assert found.share == pytest.approx(whole if frames else 0.4, abs=0.02)
    assert found.frames == pytest.approx(whole)


@pytest.mark.parametrize("memory", [0.3, 0.9])
@pytest.mark.parametrize("step_mm", [1.0, 4.0])
def test_noise_with_a_memory_repeats_nothing(memory: float, step_mm: float) -> None:
    samples = np.round(Scene(SHAPE, 4).draw(FRAMES, memory=memory) / step_mm) * step_mm
    assert find_repeats(ArrayRecording(stored(samples, FRAMES), SENSOR)) is None


@pytest.mark.parametrize("median", [False, True])
def test_verify_finds_no_fault_in_layers_of_fewer_samples_than_frames(median: bool, tmp_path: Path) -> None:
    samples = np.random.default_rng(13).normal(1500.0, 8.0, (FRAMES, 4, 6))
    stored_mm = over_windows(samples, 3, median=True) if median else held(samples, 0.4)
    path = tofmix.from_array(stored_mm, units="mm", sensor=SENSOR).save(tmp_path / "few.h5")
    runner = CliRunner()
    assert runner.invoke(main, ["estimate", str(path), "--noise", "auto"]).exit_code == 0
    result = runner.invoke(main, ["verify", str(tmp_path / "few.layers.h5")])
    assert (result.exit_code, "no fault" in result.stdout) == (0, True)


def test_command_of_repeated_frames_leaves_them_out(tmp_path: Path) -> None:
    samples = np.random.default_rng(13).normal(1500.0, 8.0, (FRAMES, 4, 6))
    path = tofmix.from_array(held(samples, 0.4, frames=True), units="mm", sensor=SENSOR).save(tmp_path / "held.h5")
    result = CliRunner().invoke(main, ["estimate", str(path), "--noise", "file", "--json"])
    (said,) = (one for one in json.loads(result.stdout)["warnings"] if one["code"] == "repeated_samples")
    assert said["text"].startswith("4")
    assert "% of the samples repeat the one before" in result.stderr
    (command,) = said["commands"]
    subprocess.run([sys.executable, *shlex.split(command)[1:]], check=True)
    left = tofmix.open(tmp_path / "held.new.h5")
    assert isinstance(left, tofmix.Recording)
    assert (np.diff(left.range_mm, axis=0) != 0.0).any(axis=(1, 2)).all()
    assert f"100 such frames tell as much as {left.shape[0]}." in said["text"].replace("samples", "frames")


def test_sigma_of_held_values_is_that_of_the_samples() -> None:
    rng = np.random.default_rng(12)
    samples = held(1500.0 + 40.0 * np.arange(10.0) + rng.normal(0.0, 8.0, (FRAMES, 8, 10)), 0.3)
    with pytest.warns(DoubtWarning, match="% of the samples repeat the one before"):
        found = tofmix.estimate(tofmix.from_array(samples, units="mm"), workers=2)
    assert np.median(found.sigma[found.n_modes == 1][:, 0]) == pytest.approx(8.0, rel=0.05)
    one = found.n_modes[0] == 1
    z = ((found.range[0, ..., 0] - 1500.0 - 40.0 * np.arange(10.0)) / found.range_stderr[0, ..., 0])[one]
    assert one.mean() > 0.95
    assert 0.75 < z.std() < 1.25


@pytest.mark.parametrize(
    ("window", "frames"), [(2, 100), (5, 100), (3, 30), (8, 40), pytest.param(16, 100, marks=pytest.mark.slow)]
)
def test_running_mean_is_found_with_its_window(window: int, frames: int) -> None:
    means = over_windows(Scene(SHAPE, 3).draw(FRAMES), window, median=False)
    assert _found(means, frames) == RunningMean(float(window))


@pytest.mark.parametrize(("share", "jump_mm"), [(0.4, 25.0), (0.4, 100.0), (0.2, 60.0)])
def test_average_that_takes_jumps_at_once_is_found(share: float, jump_mm: float) -> None:
    found = _found(averaged_up_to(Scene(SHAPE, 14).draw(FRAMES), share, jump_mm))
    assert isinstance(found, ExponentialAverage)
    assert found.parameter == pytest.approx(share, rel=0.2)
    assert 0.7 * jump_mm < found.threshold_mm < 2500.0  # the surfaces are as far apart


def test_average_of_medians_is_found() -> None:
    medians = over_windows(Scene(SHAPE, 15).draw(FRAMES), 3, median=True)
    found = _found(averaged(medians, 0.35))
    assert isinstance(found, AveragedMedians)
    assert found.window == 3
    assert found.parameter == pytest.approx(0.35, rel=0.004)
    assert _found(over_windows(medians, 4, median=False)) == AveragedMedians(RunningMean(4.0), 3)


@pytest.mark.parametrize(("sep_mm", "sigma_mm"), [(60.0, 12.0), (40.0, 12.0), (25.0, 8.0)])
@pytest.mark.parametrize("median", [False, True])
def test_filter_is_found_where_surfaces_are_a_few_sigmas_apart(sep_mm: float, sigma_mm: float, median: bool) -> None:
    samples = _near_surfaces(sep_mm, sigma_mm)
    before = over_windows(samples, 3, median=True) if median else samples
    for means, average in ((averaged(before, 0.4), ExponentialAverage), (_mean_of_3(before), RunningMean)):
        found = _found(np.rint(means))
        if median:
            assert isinstance(found, AveragedMedians)
            assert found.window == 3
            found = found.average
        assert isinstance(found, average)
        assert found.parameter == pytest.approx(0.4 if average is ExponentialAverage else 3.0, rel=0.1)


@pytest.mark.parametrize("spread", [0.0, 0.4])
@pytest.mark.parametrize("sep_mm", [0.0, 40.0, 80.0])
def test_noise_with_a_memory_on_dark_things_and_near_surfaces_is_no_filter(sep_mm: float, spread: float) -> None:
    assert _found(_near_surfaces(sep_mm, 12.0, memory=0.6, spread=spread)) is None


def test_pairs_behind_an_average_are_those_of_near_surfaces() -> None:
    ranges = stored(averaged(_near_surfaces(60.0, 12.0), 0.4), FRAMES)
    near = pytest.warns(DoubtWarning, match="two layers within 5 sigma of each other")
    with near, pytest.warns(DoubtWarning, match="exponential average.*temporal filter off"):
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm"), noise="auto", workers=2)
    mixed = found.n_modes[0][:, ::12]
    assert (mixed == 2).mean() > 0.9
    np.testing.assert_allclose(np.nanmedian(np.diff(found.range[0][:, ::12, :2], axis=-1)), 60.0, atol=4.0)
    assert (found.n_modes[0] > 2).sum() <= 1


def _near_surfaces(sep_mm: float, sigma_mm: float, *, memory: float = 0.0, spread: float = 0.0) -> FloatArray:
    """Samples (frame, row, col) of a wall; every twelfth column sees a board before it too.

    Noise is AR(1) of a memory. `spread` is that of the logarithm of the pixels' sigma.
    """
    rng = np.random.default_rng([20261130, int(sep_mm)])
    shape = FRAMES + 60, 16, 36
    noise = rng.standard_normal(shape)
    for frame in range(1, len(noise)):
        noise[frame] = memory * noise[frame - 1] + np.sqrt(1.0 - memory**2) * noise[frame]
    nearer = (np.arange(shape[2]) % 12 == 0) & (rng.random(shape) < np.linspace(0.3, 0.7, shape[1])[:, None])
    wall = 2000.0 + 2.0 * np.arange(shape[2])
    return np.asarray(wall - sep_mm * nearer + sigma_mm * np.exp(spread * rng.standard_normal(shape[1:])) * noise)


def _mean_of_3(samples: FloatArray) -> FloatArray:
    return over_windows(samples, 3, median=False)


def _shared(samples: FloatArray) -> float | None:
    return neighbour_correlation(ArrayRecording(stored(samples, FRAMES), SENSOR))


def test_filters_over_pixels_are_found_by_the_noise_of_neighbours() -> None:
    samples = Scene(SHAPE, 18).draw(FRAMES)
    for filtered in (
        over_neighbours(samples, median=True),
        over_neighbours(samples, median=False, jump_mm=100.0),
        over_neighbours(averaged(samples, 0.4), median=True),
        averaged_up_to(over_neighbours(samples, median=True), 0.4, 60.0),
    ):
        shared = _shared(filtered)
        assert shared is not None
        assert 0.2 < shared < 0.8


def test_noise_of_rows_frames_blocks_and_motion_is_no_filter_over_pixels() -> None:
    scene = Scene(SHAPE, 19)
    samples, rng = scene.draw(FRAMES), scene.rng
    frames, (rows, cols) = len(samples), SHAPE
    assert _shared(samples) is None
    assert _shared(averaged(samples, 0.4)) is None
    assert _shared(samples + rng.normal(0.0, 30.0, (frames, rows, 1))) is None
    assert _shared(samples + rng.normal(0.0, 30.0, (frames, 1, 1))) is None
    assert _shared(samples + np.kron(rng.normal(0.0, 8.0, (frames, 2, 2)), np.ones((rows // 2, cols // 2)))) is None
    passing = (np.abs(np.arange(cols) - np.linspace(0, cols, frames)[:, None]) < 4.0)[:, None]
    assert _shared(np.where(passing, 1200.0 + rng.normal(0.0, 8.0, samples.shape), samples)) is None


@pytest.mark.parametrize("median", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_pixels_of_several_surfaces_behind_a_filter_over_pixels_are_undecided(median: bool, tmp_path: Path) -> None:
    scene = Scene(SHAPE, 20)
    ranges = stored(over_neighbours(scene.draw(FRAMES), median=median, jump_mm=100.0), FRAMES)
    recording = tofmix.from_array(ranges, units="mm", sensor=replace(SENSOR, noise=None))
    path, runner = recording.save(tmp_path / "over.h5"), CliRunner()
    result = runner.invoke(main, ["estimate", str(path), "--noise", "auto"])
    assert (result.exit_code, "undecided, not counted" in result.stdout) == (0, True)
    (said,) = (line for line in result.stderr.splitlines() if "filter" in line)
    for part in ("over neighbouring pixels", "undecided", "spatial filter off"):
        assert part in said
    found = tofmix.open(tmp_path / "over.layers.h5")
    assert isinstance(found, tofmix.Estimate)
    assert found.mixing is not None
    assert (found.n_modes > 1).any()
    assert (found.mixing[found.n_modes > 1] == 3).all()
    assert not (found.probability[found.n_modes > 1] > 0.5).any()
    result = runner.invoke(main, ["verify", str(tmp_path / "over.layers.h5")])
    assert (result.exit_code, "no fault" in result.stdout) == (0, True)


@pytest.mark.parametrize("memory", [0.0, 0.3, 0.6, pytest.param(0.9, marks=pytest.mark.slow)])
def test_noise_with_a_memory_is_no_filter(memory: float) -> None:
    assert _found(Scene(SHAPE, 4).draw(FRAMES, memory=memory)) is None


@pytest.mark.parametrize("frames", [100, 30])
def test_pink_noise_drift_and_jitter_of_frames_are_no_filter(frames: int) -> None:
    scene = Scene(SHAPE, 5)
    samples = scene.draw(frames)
    time = np.linspace(0.0, 1.0, len(samples))[:, None, None]
    assert _found(scene.draw(frames, pink=True), frames) is None
    assert _found(samples + 40.0 * time, frames) is None
    assert _found(samples + scene.rng.normal(0.0, 20.0, (len(samples), 1, 1)), frames) is None
    assert _found(samples + np.cumsum(scene.rng.normal(0.0, 5.0, (len(samples), 1, 1)), axis=0), frames) is None


@pytest.mark.parametrize(("share", "worth"), [(0.4, 25), pytest.param(0.1, 5, marks=pytest.mark.slow)])
def test_mixed_pixels_of_an_average_are_found_and_said_with_the_remedy(share: float, worth: int) -> None:
    scene = Scene(SHAPE, 8)
    ranges = stored(averaged(scene.draw(FRAMES), share), FRAMES)
    with pytest.warns(DoubtWarning, match=f"100 such frames tell as much as {worth} .*temporal filter off") as said:
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), noise="file", workers=2)
    assert sum("filter" in str(one.message) for one in said) == 1
    mixed, n = scene.mixed, found.n_modes[0]
    assert mixed.sum() > 50
    assert (n[mixed] == 2).mean() > 0.97
    assert (n[~mixed] > 1).mean() < 0.01
    assert found.n_samples.max() == FRAMES - 1
    np.testing.assert_allclose(np.median(found.range[0][mixed][:, 0] - scene.near_mm[mixed]), 0.0, atol=3.0)


@pytest.mark.parametrize(("share", "jump_mm"), [(0.4, 25.0), (0.4, 100.0)])
def test_mixed_pixels_of_an_average_that_takes_jumps_at_once_have_their_two_layers(
    share: float, jump_mm: float
) -> None:
    scene = Scene(SHAPE, 16)
    ranges = stored(averaged_up_to(scene.draw(FRAMES), share, jump_mm), FRAMES)
    with pytest.warns(DoubtWarning, match="jumps of more than .* temporal filter off") as said:
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), noise="file", workers=2)
    assert sum("filter" in str(one.message) for one in said) == 1
    mixed, n = scene.mixed, found.n_modes[0]
    assert (n[mixed] == 2).mean() > 0.97
    assert (n[~mixed] > 1).mean() < 0.01
    both = mixed & (n == 2)
    z = (found.range[0][both][:, 0] - scene.near_mm[both]) / found.range_stderr[0][both][:, 0]
    assert np.sqrt(np.mean(z**2)) < 1.3


@pytest.mark.parametrize("mean", [False, True])
def test_mixed_pixels_of_an_average_of_medians_have_their_two_layers(mean: bool) -> None:
    scene = Scene(SHAPE, 17)
    medians = over_windows(scene.draw(FRAMES), 3, median=True)
    ranges = stored(over_windows(medians, 3, median=False) if mean else averaged(medians, 0.4), FRAMES)
    with pytest.warns(DoubtWarning, match="median of 3, then .* tell as much as 33 .*temporal filter off") as said:
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), noise="file", workers=2)
    assert sum("filter" in str(one.message) for one in said) == 1
    mixed, n = scene.mixed, found.n_modes[0]
    assert (n[mixed] > 2).mean() <= 0.02
    assert (n[~mixed] > 1).mean() < 0.01
    both = mixed & (n == 2)
    assert both.sum() > 0.85 * mixed.sum()
    off = found.weight[0][both][:, 0] - scene.share[both]
    assert abs(np.polyfit(scene.share[both], off, 1)[0]) < 0.15  # uncorrected, the slope is 0.4
    z = (found.range[0][both][:, 0] - scene.near_mm[both]) / found.range_stderr[0][both][:, 0]
    assert np.sqrt(np.mean(z**2)) < 1.5


def test_shares_and_ranges_behind_a_median_are_those_of_the_samples() -> None:
    scene = Scene(SHAPE, 9)
    ranges = stored(over_windows(scene.draw(FRAMES), 3, median=True), FRAMES)
    with pytest.warns(DoubtWarning, match="median of 3"):
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), noise="file", workers=2)
    both = scene.mixed & (found.n_modes[0] == 2)
    assert both.sum() > 0.9 * scene.mixed.sum()
    assert (found.n_modes[0][scene.mixed] > 2).mean() <= 0.02
    off = found.weight[0][both][:, 0] - scene.share[both]
    assert abs(off.mean()) < 0.03
    assert abs(np.polyfit(scene.share[both], off, 1)[0]) < 0.15  # uncorrected, the slope is 0.4
    z = (found.range[0][both][:, 0] - scene.near_mm[both]) / found.range_stderr[0][both][:, 0]
    assert np.sqrt(np.mean(z**2)) < 1.5


@pytest.mark.parametrize("window", [3, pytest.param(8, marks=pytest.mark.slow)])
def test_mixed_pixels_of_a_running_mean_have_their_two_layers(window: int) -> None:
    scene = Scene(SHAPE, 10)
    ranges = stored(over_windows(scene.draw(FRAMES), window, median=False), FRAMES)
    with pytest.warns(DoubtWarning, match=f"mean of {window}.* tell as much as {FRAMES // window} ") as said:
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), noise="file", workers=2)
    assert sum("filter" in str(one.message) for one in said) == 1
    mixed, n = scene.mixed, found.n_modes[0]
    assert (n[mixed] == 2).mean() > 0.97
    assert (n[~mixed] > 1).mean() < 0.01
    assert found.n_samples.max() == FRAMES
    both = mixed & (n == 2)
    z = (found.range[0][both][:, 0] - scene.near_mm[both]) / found.range_stderr[0][both][:, 0]
    assert np.sqrt(np.mean(z**2)) < 1.3
    off = (found.weight[0][both][:, 0] - scene.share[both]) / found.weight_stderr[0][both][:, 0]
    assert np.sqrt(np.mean(off**2)) < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("median", [False, True])
def test_means_in_whole_mm_of_fine_noise_have_no_further_layers(median: bool) -> None:
    scene, sigma_mm = Scene(SHAPE, 21), 3.0
    place = np.where(scene.rng.random((FRAMES + 8, *SHAPE)) < scene.share, scene.near_mm, scene.near_mm + 200.0)
    samples = place + scene.rng.normal(0.0, sigma_mm, place.shape)
    ranges = stored(over_windows(over_windows(samples, 3, median=True) if median else samples, 3, median=False), FRAMES)
    with pytest.warns(DoubtWarning, match="median of 3, then mean of 3" if median else r"\(mean of 3\)"):
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm"), noise="auto", workers=2)
    mixed, sure = scene.mixed, (found.probability[0] > 0.5).sum(axis=-1)
    assert (sure[mixed] > 2).mean() <= 0.02
    assert (sure[mixed] == 2).mean() > 0.9
    assert (sure[~mixed] > 1).mean() <= 0.02
    assert np.nanmedian(found.sigma[0][~mixed][:, 0]) == pytest.approx(sigma_mm, rel=0.2 if median else 0.08)


@pytest.mark.slow
def test_mixed_pixels_of_few_windows_of_a_mean_have_no_layer() -> None:
    scene = Scene(SHAPE, 11)
    ranges = stored(over_windows(scene.draw(40), 8, median=False), 40)
    with pytest.warns(DoubtWarning) as said:
        found = tofmix.estimate(tofmix.from_array(ranges, units="mm", sensor=SENSOR), noise="file", workers=2)
    assert any("mean of 8" in str(one.message) for one in said)
    assert not any("too dark" in str(one.message) for one in said)
    np.testing.assert_array_equal(found.invalid_share, 0.0)
    assert (found.n_modes[0][scene.mixed] == 0).all()
    assert (found.n_modes[0][~scene.mixed] == 1).mean() > 0.95


@pytest.mark.parametrize("jitter_mm", [0.0, 20.0])
def test_frames_that_move_as_a_whole_are_said_with_a_command_that_takes_the_motion_out(
    jitter_mm: float, tmp_path: Path
) -> None:
    rng = np.random.default_rng(19)
    samples = rng.normal(1500.0, 9.0, (FRAMES, 8, 12)) + jitter_mm * rng.standard_normal((FRAMES, 1, 1))
    samples[rng.random(samples.shape) < 0.02] = np.nan
    path = tofmix.from_array(samples, units="mm", sensor=SENSOR).save(tmp_path / "moved.h5")
    result = CliRunner().invoke(main, ["estimate", str(path), "--noise", "auto", "--json"])
    said = [one for one in json.loads(result.stdout)["warnings"] if one["code"] == "frames_move"]
    assert len(said) == (jitter_mm > 0.0)
    if said:
        (command,) = said[0]["commands"]
        subprocess.run([sys.executable, *shlex.split(command)[1:]], check=True)
        left = tofmix.open(tmp_path / "moved.still.h5")
        assert isinstance(left, tofmix.Recording)
        assert np.nanstd(left.range_mm - 1500.0) == pytest.approx(9.0, rel=0.2)
        common, alone = common_motion(ArrayRecording(left.range_mm.astype(np.float32), SENSOR)) or (math.nan, 0.0)
        assert common < 0.3 * alone
        common, alone = common_motion(ArrayRecording(samples.astype(np.float32), SENSOR)) or (math.nan, 0.0)
        assert (common, alone) == pytest.approx((20.0, 9.0), rel=0.2)

"""Unmixing on raw-tap recordings: surfaces are found, and layers stay as they were where samples are of one surface."""

import math
from typing import Any

import numpy as np
import pytest
from blind.geometry import Surface
from support.lock_in import FAMILIES, SMALL, Scene, judge, made, random_boards, small, two_boards

from tofmix.arrays import Float32Array
from tofmix.bounds import declared
from tofmix.estimation.blocks.sequence import EstimatedWindows, estimate_windows, resolved_mixing
from tofmix.estimation.settings import EstimateOptions, MixingChoice
from tofmix.flags import Mixing, MixingLaw
from tofmix.invariants import layer_rules
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.unmixing.phasors import mean_phasors
from tofmix.unmixing.settings import LawSettings, UnmixSettings
from tofmix.unmixing.unmix import unmix

EVENTS = EstimateOptions(mixing=MixingChoice.EVENTS)


def first(found: EstimatedWindows) -> Layers:
    """Layers (row, col) of the first window."""
    return Layers(**{spec.name: getattr(found.layers, spec.name)[0] for spec in found.layers.fields})


@pytest.fixture(scope="module")
def sums() -> Scene:
    """Every sample is a phasor sum."""
    return small(1)


@pytest.fixture(scope="module")
def found(sums: Scene) -> EstimatedWindows:
    """What is estimated of it."""
    return estimate_windows(sums.recording)


def test_both_surfaces_of_mixed_pixels_are_found_in_phasor_sums(sums: Scene, found: EstimatedWindows) -> None:
    before = judge(sums, first(estimate_windows(sums.recording, EVENTS)))
    after = judge(sums, first(found))
    assert after.asked > 100
    assert before.found == 0
    assert before.false > 0.5 * before.mixed
    assert after.found >= 0.98 * after.asked
    assert after.false <= 0.02 * after.mixed
    assert after.share_rms < 0.01
    assert after.sure_false <= 0.01 * after.sure


def test_long_edges_of_each_half_of_an_image_have_their_own_share_of_sums(sums: Scene) -> None:
    single = small(1, q=0.0)
    half = sums.recording.shape[2] // 2
    parts = [
        np.concatenate(
            [
                getattr(one, read)(slice(None), slice(None))[..., columns]
                for one, columns in ((sums.recording, slice(None, half)), (single.recording, slice(half, None)))
            ],
            axis=2,
        )
        for read in ("read_range", "read_amplitude")
    ]
    both = ArrayRecording(parts[0], sums.sensor, amplitude=parts[1])
    found, summed, events = (
        first(estimate_windows(recording, options))
        for recording, options in ((both, None), (sums.recording, None), (single.recording, EVENTS))
    )
    near = 2  # columns beside the boundary, where neighbours are of the other half
    long = slice(4, 28)  # rows of an upright edge left of the middle, with five pixels that tell in each window
    assert summed.mixing is not None
    assert found.mixing is not None
    left, right = slice(half - 10, half - near), slice(half + near, None)
    mixed = summed.mixing[long, left] == int(Mixing.PHASOR)
    assert mixed.sum() > 20
    assert (found.mixing[long, left][mixed] == int(Mixing.PHASOR)).all()
    np.testing.assert_allclose(found.range[long, left][mixed], summed.range[long, left][mixed], rtol=1e-5)
    assert not (found.mixing[:, right] == int(Mixing.PHASOR)).any()
    np.testing.assert_array_equal(found.range[:, right], events.range[:, right])


def test_errors_of_shares_are_as_stated(sums: Scene, found: EstimatedWindows) -> None:
    after = judge(sums, first(found))
    assert 0.6 < np.sqrt(after.share_z_squares / after.found) < 1.4


def test_layers_of_unmixed_pixels_are_consistent(found: EstimatedWindows) -> None:
    layers = first(found)
    assert layers.mixing is not None
    unmixed = layers.mixing == int(Mixing.PHASOR)
    weights = np.nansum(layers.weight, axis=-1) + layers.weight_no_return + layers.weight_outlier
    np.testing.assert_allclose(weights[unmixed], 1.0, atol=1e-6)
    assert (np.isfinite(layers.range).sum(axis=-1)[unmixed] == layers.n_modes[unmixed]).all()
    assert (layers.range[unmixed, 1] > layers.range[unmixed, 0]).all()
    assert np.isfinite(layers.log_likelihood[unmixed]).all()
    assert (layers.sigma[unmixed, 0] > 0).all()
    undecided = layers.mixing == int(Mixing.UNDECIDED)
    assert np.nanmax(layers.probability[undecided], initial=0.0) <= 0.5


def test_pixels_of_one_surface_are_unchanged(sums: Scene, found: EstimatedWindows) -> None:
    layers, events = first(found), first(estimate_windows(sums.recording, EVENTS))
    assert layers.mixing is not None
    alone = layers.mixing <= int(Mixing.EVENTS)
    assert alone.mean() > 0.9
    for spec in events.fields:
        if spec.name != "probability":
            np.testing.assert_array_equal(
                getattr(layers, spec.name)[alone], getattr(events, spec.name)[alone], spec.name
            )


@pytest.mark.parametrize("seed", [2, 3])
def test_recording_of_events_leaves_every_array_unchanged(seed: int) -> None:
    one = small(seed, q=0.0)
    auto, events = estimate_windows(one.recording), estimate_windows(one.recording, EVENTS)
    for spec in events.layers.fields:
        assert getattr(auto.layers, spec.name).tobytes() == getattr(events.layers, spec.name).tobytes(), spec.name
    assert auto.phasor_share is not None
    assert abs(float(auto.phasor_share[0])) < 0.04
    assert auto.layers.mixing is not None
    several = (events.layers.n_modes > 1) | ((events.layers.n_modes == 1) & (events.layers.weight_no_return > 0))
    np.testing.assert_array_equal(auto.layers.mixing, np.where(several, int(Mixing.EVENTS), int(Mixing.ONE_SURFACE)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 8, 9])
def test_wrong_surfaces_at_corners_do_not_change_the_share_of_their_edge(seed: int) -> None:
    """Beside narrow boards some pairs have a wrong surface, as 1 in 100 may, and look like sums."""
    one = made(random_boards(np.random.default_rng([seed, 77])), seed, q=0.0)
    auto, events = estimate_windows(one.recording), estimate_windows(one.recording, EVENTS)
    for spec in events.layers.fields:
        assert getattr(auto.layers, spec.name).tobytes() == getattr(events.layers, spec.name).tobytes(), spec.name


@pytest.mark.parametrize("q", [0.35, 0.7])
def test_share_of_phasor_sums_is_measured_and_both_surfaces_found(q: float) -> None:
    one = small(4, q=q)
    part = estimate_windows(one.recording)
    assert part.phasor_share is not None
    assert float(part.phasor_share[0]) == pytest.approx(q, abs=0.05)
    after = judge(one, first(part))
    assert after.found >= 0.95 * after.asked


def test_share_of_a_surface_next_to_open_space_is_its_area() -> None:
    rng = np.random.default_rng(5)
    board = Surface(name="board", center_mm=(10.0, 5.0, 2000.0), size_mm=(300.0, 250.0), yaw_deg=10.0, reflectivity=0.6)
    one = made([board], int(rng.integers(100)), view=SMALL)
    layers = first(estimate_windows(one.recording)).reshaped((SMALL[0] * SMALL[1],))
    share = one.beams.share[0]
    some = (share > 0.15) & (share < 0.85) & (one.beams.nothing > 0)
    both = some & (layers.n_modes == 1) & (layers.weight_no_return > 0.05)
    assert both.sum() >= 0.95 * some.sum()
    np.testing.assert_allclose(layers.weight[both, 0], share[both], atol=0.06)


def test_wall_in_a_gap_narrower_than_a_pixel_is_found_by_its_plane_elsewhere() -> None:
    board = Surface(name="board", center_mm=(172.0, 0.0, 1800.0), size_mm=(155.4, 157.0), reflectivity=0.5)
    wall = Surface(name="wall", center_mm=(0.0, 0.0, 3000.0), size_mm=(9000.0, 9000.0), reflectivity=0.6)
    layers = first(estimate_windows(made([board, wall], 3, view=SMALL).recording))
    gap = (slice(17, 31), 59)  # the board ends in the last column
    assert layers.mixing is not None
    assert (layers.mixing[gap] == int(Mixing.PHASOR)).all()
    np.testing.assert_allclose(layers.range[gap][:, 0], 1818.0, atol=6.0)
    np.testing.assert_allclose(layers.range[gap][:, 1], 3030.0, atol=12.0)
    np.testing.assert_allclose(layers.weight[gap][:, 0], 0.617, atol=0.03)


def test_bright_sums_whose_phase_is_that_of_no_return_are_no_open_space() -> None:
    bright = Surface(name="board", center_mm=(-115.1, 0.0, 860.0), size_mm=(240.0, 400.0), reflectivity=0.9)
    wall = Surface(name="wall", center_mm=(0.0, 0.0, 5100.0), size_mm=(30000.0, 30000.0), reflectivity=0.2)
    one = made([bright, wall], 3, view=SMALL, frames=10)
    middle = np.nanmedian(one.recording.read_range(slice(None), slice(None)), axis=0)
    far_past = middle > np.float64(one.sensor.range_max_mm or np.inf)
    assert far_past.sum() > 3
    judged = judge(one, first(estimate_windows(one.recording)))
    assert judged.asked > 30
    assert judged.found == judged.asked
    assert judged.undecided == 0


@pytest.mark.slow
def test_pixels_of_creases_are_decided() -> None:
    one = made(FAMILIES["corner"](np.random.default_rng([2, 77])), 2, view=(72, 88, 47.0, 39.0))
    after = judge(one, first(estimate_windows(one.recording, EstimateOptions(mixing=MixingChoice.PHASOR))))
    assert after.mixed > 150
    assert after.undecided <= 0.05 * after.mixed
    assert after.false <= 0.01 * after.mixed


@pytest.mark.slow
def test_ranges_that_fold_are_unmixed_and_stay_on_the_circle() -> None:
    one = small(6, frequency_hz=45.0e6, wraps=True)  # the wall is a turn of 3331 mm away
    length = one.device.unambiguous_mm
    result = estimate_windows(one.recording, EstimateOptions(unambiguous_range_mm=length))
    after = judge(one, first(result), circle_mm=length)
    assert after.asked > 100
    assert after.found >= 0.95 * after.asked
    broken = [rule.text for rule in layer_rules(result.layers, np.array([50]), circle_mm=length) if rule.broken.any()]
    assert broken == []


@pytest.mark.slow
def test_wall_beyond_the_fold_is_a_plane_of_its_true_ranges() -> None:
    boards = two_boards(np.random.default_rng(6))[:2]
    for range_mm in (4980.0, 5150.0):  # across the fold of 4997 mm, and beyond it
        wall = Surface(
            name="wall", center_mm=(0.0, 0.0, range_mm), size_mm=(9000.0, 9000.0), yaw_deg=5.0, reflectivity=0.6
        )
        one = made([*boards, wall], 6, view=SMALL, frequency_hz=30.0e6, wraps=True)
        length = one.device.unambiguous_mm
        result = estimate_windows(one.recording, EstimateOptions(unambiguous_range_mm=length))
        after = judge(one, first(result), circle_mm=length)
        assert after.asked > 100
        assert after.found >= 0.97 * after.asked
        assert after.false <= 0.01 * after.mixed
        assert after.split <= 0.01 * after.single


def test_every_rule_of_a_result_holds_for_unmixed_layers(found: EstimatedWindows) -> None:
    broken = [rule.text for rule in layer_rules(found.layers, np.array([50])) if rule.broken.any()]
    assert broken == []


def test_mixing_phasor_unmixes_without_a_measured_share() -> None:
    one = small(7, q=0.0)
    insisted = first(estimate_windows(one.recording, EstimateOptions(mixing=MixingChoice.PHASOR)))
    assert insisted.mixing is not None
    assert (insisted.mixing == int(Mixing.PHASOR)).sum() > 100


def test_nothing_is_measured_without_amplitudes_or_a_frequency(sums: Scene) -> None:
    source = sums.recording
    plain = ArrayRecording(source.read_range(slice(0, 20), slice(None)), source.sensor)
    assert resolved_mixing(EstimateOptions(), plain).mixing is MixingChoice.EVENTS
    result = estimate_windows(plain)
    assert result.layers.mixing is None
    assert result.phasor_share is None
    with pytest.raises(ValueError, match="phasor sums need amplitudes"):
        estimate_windows(plain, EstimateOptions(mixing=MixingChoice.PHASOR))


def test_images_too_small_for_a_plane_are_unchanged(sums: Scene) -> None:
    source = sums.recording
    for rows, cols in ((1, 60), (2, 2), (48, 1)):
        part = ArrayRecording(
            source.read_range(slice(0, 20), slice(0, rows))[:, :, :cols],
            source.sensor,
            amplitude=source.read_amplitude(slice(0, 20), slice(0, rows))[:, :, :cols],
        )
        result, events = estimate_windows(part), estimate_windows(part, EVENTS)
        assert np.isnan(result.phasor_share).all()  # type: ignore[arg-type]  # measured
        np.testing.assert_array_equal(result.layers.n_modes, events.layers.n_modes)


@pytest.mark.parametrize(
    ("share", "pixels", "text"),
    [
        (1.0, 2016, "100 % of the samples at edges are phasor sums (2,016 pixels)"),
        (-0.004, 34, "0 % of the samples at edges are phasor sums (34 pixels)"),
        (float("nan"), 0, "no edge shows"),
    ],
)
def test_mixing_is_described_in_one_line(share: float, pixels: int, text: str) -> None:
    assert MixingLaw(phasor_share=share, pixels=pixels).words().startswith(text)


def test_settings_bound_the_share_of_sums_that_is_unmixed(sums: Scene) -> None:
    layers = first(estimate_windows(sums.recording, EVENTS))
    everything = slice(None), slice(None)
    means = mean_phasors(
        sums.recording.read_range(*everything), sums.recording.read_amplitude(*everything), sums.sensor
    )
    never = UnmixSettings(law=LawSettings(least_phasor_share=2.0))
    found, kept = unmix(layers, means, sums.sensor), unmix(layers, means, sums.sensor, settings=never)
    assert found.layers.mixing is not None
    assert kept.layers.mixing is not None
    assert (found.layers.mixing == int(Mixing.PHASOR)).sum() > 100
    assert not (kept.layers.mixing == int(Mixing.PHASOR)).any()
    assert kept.phasor_share == found.phasor_share


@pytest.mark.slow
@pytest.mark.compiled("unmixes 50 times")
def test_infinite_thresholds_and_loops_of_no_rounds_work(sums: Scene) -> None:
    """An infinite threshold does what a very large one does."""
    layers = first(estimate_windows(sums.recording, EVENTS))
    everything = slice(None), slice(None)
    means = mean_phasors(
        sums.recording.read_range(*everything), sums.recording.read_amplitude(*everything), sums.sensor
    )

    def ranges(part: str, **values: float) -> Float32Array:
        made: Any = type(getattr(UnmixSettings(), part))
        circle_mm = 7500.0 if part == "unfolding" else None
        settings = UnmixSettings(**{part: made(**values)})
        return unmix(layers, means, sums.sensor, circle_mm=circle_mm, settings=settings).layers.range

    tried = 0
    for part in ("image", "seeds", "neighbours", "planes", "hypotheses", "labels", "law", "unfolding"):
        settings: Any = type(getattr(UnmixSettings(), part))
        for name, field in declared(settings).items():
            if field.bounds is not None and field.bounds.infinite:
                np.testing.assert_array_equal(
                    ranges(part, **{name: math.inf}), ranges(part, **{name: 1e12}), err_msg=name
                )
                tried += 1
    assert tried > 15
    assert np.isfinite(ranges("labels", rounds=0)).any()
    assert np.isfinite(ranges("planes", tries=0)).any()

"""Unmixing on raw-tap recordings, also beside round things."""

import numpy as np
import pytest
from blind.geometry import Surface
from support.cameras import camera_of
from support.lock_in import FAMILIES, SMALL, Scene, judge, made, random_boards, small, two_boards
from support.round_things import OPEN_SCENES, SCENES, Thing, cylinder, joined, render, score, sphere, wall

import tofmix as tm
from tofmix.estimation.blocks.sequence import EstimatedWindows, estimate_windows, resolved_mixing
from tofmix.estimation.settings import EstimateOptions, MixingChoice
from tofmix.flags import Mixing
from tofmix.invariants import layer_rules
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.unmixing.chords import unseen_log_density
from tofmix.unmixing.curved_labels import _lesser_part, _seen_probability
from tofmix.unmixing.image import mean_phasors
from tofmix.unmixing.labels import mixed_probability
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


@pytest.mark.parametrize("sums", [True, False])
def test_behind_a_mesh_without_a_whole_window_of_one_surface_no_mixed_pixel_is_sure(sums: bool) -> None:
    shape, parts, frames = (24, 30), 8, 40
    y, x = (np.indices((shape[0] * parts, shape[1] * parts)) + 0.5) / parts
    wires = (np.abs((x + y) % 5.0 - 2.5) < 0.25) | (np.abs((x - y) % 5.0 - 2.5) < 0.25)
    share = wires.reshape(shape[0], parts, shape[1], parts).mean(axis=(1, 3))
    near, far = 2000.0, 3900.0 + 10.0 * np.indices(shape)[1]
    rng = np.random.default_rng(5)
    sensor = camera_of([1000.0, 6000.0], [20.0, 20.0], fov_deg=(30.0, 24.0), modulation_frequency_hz=20e6)
    turn = 2.0 * np.pi / (299_792_458e3 / 2.0 / 20e6)
    if sums:
        light = share * np.exp(1j * turn * near) + (1.0 - share) * 0.3 * np.exp(1j * turn * far)
        light = np.broadcast_to(light, (frames, *shape))
    else:
        hits = rng.random((frames, *shape)) < share
        light = np.where(hits, np.exp(1j * turn * near), 0.3 * np.exp(1j * turn * far))
    samples = np.angle(light) % (2.0 * np.pi) / turn + rng.normal(0.0, 20.0, light.shape)
    amplitude = 1000.0 * np.abs(light) * (1.0 + 0.02 * rng.standard_normal(light.shape))
    recording = ArrayRecording(samples.astype(np.float32), sensor, amplitude=amplitude.astype(np.float32))
    layers, events = first(estimate_windows(recording)), first(estimate_windows(recording, EVENTS))
    assert layers.mixing is not None
    mixed = (share > 0.05) & (share < 0.95)
    assert mixed.mean() > 0.5
    if sums:
        assert (layers.mixing[mixed] == int(Mixing.UNDECIDED)).mean() > 0.98
        assert (layers.mixing[share == 0.0] == int(Mixing.ONE_SURFACE)).mean() > 0.4
    else:
        np.testing.assert_array_equal(layers.range, events.range)
        assert (layers.n_modes[mixed] == 2).mean() > 0.9


@pytest.mark.parametrize("last", [True, False])
def test_two_halves_of_a_slat_at_the_border_of_the_image_are_no_surface_of_their_own(last: bool) -> None:
    rows, cols, frames = 30, 24, 40
    share = np.zeros((rows, cols))
    share[:2, 4:20] = 0.62  # a slat of 1.24 pixels on the border of two rows
    share[12:20, 4:20], share[11, 4:20], share[20, 4:20] = 1.0, 0.3, 0.6  # a board, whose edges tell the law
    row = np.indices(share.shape)[0]
    near, far = 2300.0 + 4.0 * row, 3900.0 + 10.0 * row
    share, near, far = (part[::-1] if last else part for part in (share, near, far))
    rng = np.random.default_rng(6)
    sensor = camera_of([1000.0, 6000.0], [20.0, 20.0], fov_deg=(30.0, 24.0), modulation_frequency_hz=20e6)
    turn = 2.0 * np.pi / (299_792_458e3 / 2.0 / 20e6)
    light = share * np.exp(1j * turn * near) + (1.0 - share) * 0.35 * np.exp(1j * turn * far)
    noise = rng.standard_normal((2, frames, *share.shape))
    light = 1000.0 * (light + 0.01 * (noise[0] + 1j * noise[1]))
    samples = (np.angle(light) % (2.0 * np.pi) / turn).astype(np.float32)
    layers = first(estimate_windows(ArrayRecording(samples, sensor, amplitude=np.abs(light).astype(np.float32))))
    away = np.minimum(np.abs(layers.range - near[..., np.newaxis]), np.abs(layers.range - far[..., np.newaxis]))
    assert ((layers.probability > 0.5) & (away > 100.0)).sum() == 0
    assert (layers.n_modes[share == 1.0] == 1).all()


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


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_both_surfaces_are_found_at_the_limbs_of_a_sphere_and_nothing_flies() -> None:
    one = render([wall(2800), sphere((40, -30, 1500), 180)], [0.5, 0.8], noise_mm=15.0, frames=60, seed=4)
    found = tm.estimate(one.recording)
    result = score(one, found.window(0))
    assert result.mixed > 40
    assert result.both >= 0.9 * result.mixed
    assert result.ranges_within >= 0.85 * result.ranges
    assert result.shares_within >= 0.85 * result.both
    assert (result.split, result.flying) == (0, 0)
    assert found.mixing_law is not None
    assert found.mixing_law.phasor_share == pytest.approx(1.0, abs=0.03)


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
@pytest.mark.parametrize(
    "thing", [cylinder(150, 3600, 200), sphere((-100, 60, 2100), 120)], ids=["column far away", "sphere of 9 pixels"]
)
def test_things_of_eight_pixels_get_both_surfaces_and_nothing_flies(thing: Thing) -> None:
    one = render([wall(5200), thing], [0.5, 0.7], noise_mm=20.0, frames=60, seed=3)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.both >= 0.9 * result.mixed
    assert (result.split, result.flying) == (0, 0)


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["two columns", "person"])
def test_scenes_of_curved_edges_alone_are_unmixed(name: str) -> None:
    things, reflectivity = SCENES[name]
    one = render(things, reflectivity, noise_mm=20.0, frames=60, seed=2)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.both >= 0.85 * result.mixed
    assert result.flying <= 1  # a layer of 0.3 % of the light, 0.1 m off its surface
    assert result.split <= 0.002 * result.single


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_pixels_of_a_wire_are_undecided_where_no_pixel_sees_it_alone() -> None:
    one = render([wall(3500), cylinder(-200, 2000, 6)], [0.5, 0.5], noise_mm=15.0, frames=60)
    found = tm.estimate(one.recording, noise=one.noise).window(0)
    assert score(one, found).flying == 0
    assert found.mixing is not None
    wire = one.share[1] > 0.1
    assert (found.mixing[wire] == int(Mixing.UNDECIDED)).mean() > 0.9
    law = tm.estimate(one.recording, noise=one.noise).mixing_law
    assert law is not None
    assert law.pixels == 0
    assert "a lock-in camera sums" in law.words()


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_round_things_before_open_space_have_one_surface_with_the_share_that_returns() -> None:
    one = render(*OPEN_SCENES["sphere and cylinder"], noise_mm=20.0, frames=60, threshold=3.0, seed=2)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.both >= 0.9 * result.mixed
    assert result.ranges_within >= 0.9 * result.ranges
    assert result.shares_within >= 0.9 * result.both
    assert np.sqrt(result.share_square / result.both) < 0.025
    assert result.flying == 0  # pixels whose few samples are noise have no layer


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_nothing_flies_where_two_walls_meet_behind_a_sphere() -> None:
    one = render(*SCENES["creased wall and sphere"], noise_mm=20.0, frames=60, seed=2)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.both >= 0.9 * result.mixed
    assert (result.split, result.flying) == (0, 0)


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_a_floor_at_80_degrees_of_incidence_before_a_wall_gets_no_second_layer_for_a_sphere_on_it() -> None:
    floor = wall(7.2e7, (0.0, 1.0, 1e-5))  # 720 mm below the camera
    things = [joined(wall(4000), floor), sphere((100.0, 400.0, 2200.0), 250.0)]
    one = render(things, [0.5, 0.8], noise_mm=5.0, power=0.7)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.both >= 0.9 * result.mixed
    few = 5  # at the sphere's limb; each row of the floor a surface of its own gave 55 pixels and 22 layers
    assert result.split <= few
    assert result.flying <= few


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_a_column_of_three_pixels_bends_at_noise_that_hides_each_pixel_s_own_bend() -> None:
    one = render(*SCENES["two columns"], noise_mm=40.0, frames=100, seed=1)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.both >= 0.9 * result.mixed
    assert result.flying <= 2


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_second_modes_by_chance_leave_pixels_of_one_surface_decided() -> None:
    one = render(*SCENES["sphere and cylinder"], noise_mm=20.0, seed=1)
    found = tm.estimate(one.recording, noise=one.noise).window(0)
    assert found.mixing is not None
    alone = one.share.max(axis=0) > 0.999
    assert (found.mixing[alone] == int(Mixing.UNDECIDED)).sum() <= 1
    assert (found.n_modes[alone] == 1).mean() > 0.999


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
@pytest.mark.slow
def test_poles_of_four_pixels_get_no_wrong_layer_and_most_mixed_pixels_both_surfaces() -> None:
    things = [wall(3500), cylinder(-300, 2000, 55), cylinder(200, 2300, 45)]
    one = render(things, [0.5, 0.7, 0.6], noise_mm=20.0)
    result = score(one, tm.estimate(one.recording, noise=one.noise).window(0))
    assert result.mixed > 80
    assert result.both >= 0.8 * result.mixed
    assert result.ranges_within >= 0.9 * result.ranges
    assert (result.split, result.flying) == (0, 0)


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_surface_with_a_small_area_and_much_light_is_no_small_part() -> None:
    bright, dark, open_behind = [0.02, 3.0, 0.0, 0.01, 0.0], [0.02, 0.01, 0.0, 3.0, 0.0], [0.99, 3.0, 0.0, 0.0, 0.0]
    part = _lesser_part(np.array([bright, dark, open_behind]))
    light = 0.02 * np.exp(3.0)
    np.testing.assert_allclose(part, [light / (light + 0.98 * np.exp(0.01)), 0.02, 0.01])


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_share_within_its_error_of_nothing_is_hardly_a_second_surface() -> None:
    mean = np.array([[0.98, 0.0, 0.0, 0.0, 0.0], [0.98, 0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0]])
    mean[:, 3] = 1e-9  # the same light; 0 is open space
    covariance = np.zeros((3, 5, 5))
    covariance[:, 0, 0] = [0.02**2, 0.001**2, 0.02**2]
    np.testing.assert_allclose(_seen_probability(mean, covariance, 0.0), [0.841345, 1.0, 1.0], rtol=1e-5)
    np.testing.assert_allclose(_seen_probability(mean, covariance, 0.02), [0.5, 0.5, 1.0], atol=1e-5)


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_unseen_surface_is_uniform_in_share_and_in_the_disc_of_phasors() -> None:
    rng = np.random.default_rng(4)
    count, largest, seen = 2_000_000, 3.0, 1.0 + 0.5j
    share, turn = rng.random(count), rng.random(count) * 2.0 * np.pi
    drawn = (1.0 - share) * seen + share * largest * np.sqrt(rng.random(count)) * np.exp(1j * turn)
    at = np.array([1.2 + 0.6j, 0.5 - 0.5j, -1.0 + 1.0j])
    radius = 0.05
    found = np.array([(np.abs(drawn - z) < radius).mean() for z in at]) / (np.pi * radius**2)
    expected = np.exp(unseen_log_density(at, np.full(3, seen), np.zeros(3), largest))
    np.testing.assert_allclose(found, expected, rtol=0.05)


@pytest.mark.compiled("it estimates 3,072 pixels")
@pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning")
def test_probability_adds_up_where_planes_and_bent_surfaces_agree() -> None:
    bends, planes, bent = np.array([0.25, 0.25, 0.75]), np.array([0.8, 0.8, 0.8]), np.array([0.4, 0.4, 0.4])
    found = mixed_probability(bends, planes, bent, np.array([True, False, False]))
    np.testing.assert_allclose(found, [0.7, 0.6, 0.3])

"""Mixed pixels beside round things: both surfaces are found, nothing flies, and planes stay as they were."""

import numpy as np
import pytest
from support.round_things import OPEN_SCENES, SCENES, Thing, cylinder, render, score, sphere, wall

import tofmix as tm
from tofmix.flags import Mixing
from tofmix.unmixing.chords import unseen_log_density
from tofmix.unmixing.curved_labels import _lesser_part, _seen_probability
from tofmix.unmixing.labels import mixed_probability
from tofmix.unmixing.phasors import mean_phasors
from tofmix.unmixing.settings import CurvedSettings, UnmixSettings
from tofmix.unmixing.unmix import unmix

pytestmark = [
    pytest.mark.compiled("it estimates 3,072 pixels"),
    pytest.mark.filterwarnings("ignore::tofmix.errors.DoubtWarning"),
]


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


@pytest.mark.slow
@pytest.mark.parametrize(
    "thing", [cylinder(150, 3600, 200), sphere((-100, 60, 2100), 120)], ids=["column far away", "sphere of 9 pixels"]
)
def test_things_of_eight_pixels_get_both_surfaces_and_nothing_flies(thing: Thing) -> None:
    one = render([wall(5200), thing], [0.5, 0.7], noise_mm=20.0, frames=60, seed=3)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.both >= 0.9 * result.mixed
    assert (result.split, result.flying) == (0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two columns", "person"])
def test_scenes_of_curved_edges_alone_are_unmixed(name: str) -> None:
    things, reflectivity = SCENES[name]
    one = render(things, reflectivity, noise_mm=20.0, frames=60, seed=2)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.both >= 0.85 * result.mixed
    assert result.flying <= 1  # a layer of 0.3 % of the light, 0.1 m off its surface
    assert result.split <= 0.002 * result.single


@pytest.mark.slow
def test_planes_are_unmixed_as_if_there_were_no_smooth_surfaces() -> None:
    one = render([wall(3000), wall(1800, (0.3, 0.0, 0.95), 150.0)], [0.5, 0.8], noise_mm=15.0, frames=40)
    estimate = tm.estimate(one.recording, mixing="events")
    assert one.recording.amplitude is not None
    phasors = mean_phasors(one.recording.range_mm, one.recording.amplitude, one.recording.sensor)
    whole, planes = (
        unmix(
            estimate.window(0), phasors, estimate.sensor, settings=UnmixSettings(curved=CurvedSettings(rounds=rounds))
        )
        for rounds in (8, 0)
    )
    assert np.any(whole.layers.mixing == int(Mixing.PHASOR))
    for spec in whole.layers.fields:
        np.testing.assert_array_equal(getattr(whole.layers, spec.name), getattr(planes.layers, spec.name))


@pytest.mark.slow
def test_pixels_of_a_wire_are_undecided_where_no_pixel_sees_it_alone() -> None:
    one = render([wall(3500), cylinder(-200, 2000, 6)], [0.5, 0.5], noise_mm=15.0, frames=60)
    found = tm.estimate(one.recording).window(0)
    assert score(one, found).flying == 0
    assert found.mixing is not None
    wire = one.share[1] > 0.1
    assert (found.mixing[wire] == int(Mixing.UNDECIDED)).mean() > 0.9
    law = tm.estimate(one.recording).mixing_law
    assert law is not None
    assert law.pixels == 0
    assert "a lock-in camera sums" in law.words()


@pytest.mark.slow
def test_samples_of_one_surface_each_contradict_sums_where_no_edge_tells() -> None:
    one = render([wall(3500), cylinder(-200, 2000, 6)], [0.5, 0.5], noise_mm=15.0, frames=60)
    draw = np.random.default_rng(3)
    far = render([wall(3500)], [0.5], noise_mm=15.0, frames=60).recording
    assert far.amplitude is not None
    near = draw.random(far.range_mm.shape) < one.share[1]
    ranges = np.where(near, draw.normal(2000.0, 15.0, near.shape), far.range_mm)
    events = tm.from_array(ranges, units="mm", sensor=far.sensor, amplitude=np.where(near, 200.0, far.amplitude))
    law = tm.estimate(events).mixing_law
    assert law is not None
    assert not law.phasor_share > 0.05


@pytest.mark.slow
def test_round_things_before_open_space_have_one_surface_with_the_share_that_returns() -> None:
    one = render(*OPEN_SCENES["sphere and cylinder"], noise_mm=20.0, frames=60, threshold=3.0, seed=2)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.both >= 0.9 * result.mixed
    assert result.ranges_within >= 0.9 * result.ranges
    assert result.shares_within >= 0.9 * result.both
    assert np.sqrt(result.share_square / result.both) < 0.025
    assert result.flying == 0  # pixels whose few samples are noise have no layer


@pytest.mark.slow
def test_both_surfaces_are_found_beside_an_ellipsoid_with_ranges_as_far_off_as_stated() -> None:
    one = render(*SCENES["ellipsoid"], noise_mm=20.0, seed=1)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.both >= 0.9 * result.mixed
    assert result.ranges_within >= 0.85 * result.ranges


@pytest.mark.slow
def test_nothing_flies_where_two_walls_meet_behind_a_sphere() -> None:
    one = render(*SCENES["creased wall and sphere"], noise_mm=20.0, frames=60, seed=2)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.both >= 0.9 * result.mixed
    assert (result.split, result.flying) == (0, 0)


@pytest.mark.slow
def test_a_column_of_three_pixels_bends_at_noise_that_hides_each_pixel_s_own_bend() -> None:
    one = render(*SCENES["two columns"], noise_mm=40.0, frames=100, seed=1)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.both >= 0.9 * result.mixed
    assert result.flying <= 2


@pytest.mark.slow
def test_second_modes_by_chance_leave_pixels_of_one_surface_decided() -> None:
    one = render(*SCENES["sphere and cylinder"], noise_mm=20.0, seed=1)
    found = tm.estimate(one.recording).window(0)
    assert found.mixing is not None
    alone = one.share.max(axis=0) > 0.999
    assert (found.mixing[alone] == int(Mixing.UNDECIDED)).sum() <= 1
    assert (found.n_modes[alone] == 1).mean() > 0.999


@pytest.mark.slow
def test_poles_of_four_pixels_get_no_wrong_layer_and_most_mixed_pixels_both_surfaces() -> None:
    things = [wall(3500), cylinder(-300, 2000, 55), cylinder(200, 2300, 45)]
    one = render(things, [0.5, 0.7, 0.6], noise_mm=20.0)
    result = score(one, tm.estimate(one.recording).window(0))
    assert result.mixed > 80
    assert result.both >= 0.8 * result.mixed
    assert result.ranges_within >= 0.9 * result.ranges
    assert (result.split, result.flying) == (0, 0)


def test_surface_with_a_small_area_and_much_light_is_no_small_part() -> None:
    bright, dark, open_behind = [0.02, 3.0, 0.0, 0.01, 0.0], [0.02, 0.01, 0.0, 3.0, 0.0], [0.99, 3.0, 0.0, 0.0, 0.0]
    part = _lesser_part(np.array([bright, dark, open_behind]))
    light = 0.02 * np.exp(3.0)
    np.testing.assert_allclose(part, [light / (light + 0.98 * np.exp(0.01)), 0.02, 0.01])


def test_share_within_its_error_of_nothing_is_hardly_a_second_surface() -> None:
    mean = np.array([[0.98, 0.0, 0.0, 0.0, 0.0], [0.98, 0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0, 0.0]])
    mean[:, 3] = 1e-9  # the same light; 0 is open space
    covariance = np.zeros((3, 5, 5))
    covariance[:, 0, 0] = [0.02**2, 0.001**2, 0.02**2]
    np.testing.assert_allclose(_seen_probability(mean, covariance, 0.0), [0.841345, 1.0, 1.0], rtol=1e-5)
    np.testing.assert_allclose(_seen_probability(mean, covariance, 0.02), [0.5, 0.5, 1.0], atol=1e-5)


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


def test_probability_adds_up_where_planes_and_bent_surfaces_agree() -> None:
    bends, planes, bent = np.array([0.25, 0.25, 0.75]), np.array([0.8, 0.8, 0.8]), np.array([0.4, 0.4, 0.4])
    found = mixed_probability(bends, planes, bent, np.array([True, False, False]))
    np.testing.assert_allclose(found, [0.7, 0.6, 0.3])

"""Errors of a measured scene in the score: the closed forms against numerical integrals, and whole searches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import beta, betabinom, binom, multivariate_normal, norm
from support.recordings import recorded

from tofmix.errors import BadInputError
from tofmix.layers import Layers, layer_fields
from tofmix.reconciliation.evidence import Evidence
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.reference_errors import ReferenceErrors
from tofmix.reconciliation.likelihood.unsteady_way import UnsteadyWay
from tofmix.reconciliation.one.recordings import SearchTask
from tofmix.reconciliation.one.scene_errors import SceneErrors
from tofmix.reconciliation.one.search import search
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.workflow import reconcile
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.motion import Motion
from tofmix.simulation.effects.outliers import Outliers
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation
from tofmix.simulation.measured_scene import measured_scene
from tofmix.simulation.model import Model

KINDS = ("surface_pose", "motion", "range_offset", "excess_noise", "dropout", "fixed_pattern")
FRAMES = 12
"""Of the reference: its means have large errors."""


def _errors(pixels: int, *, lost_frames: float = 0.0, frame_noise_mm: float = 0.0) -> SceneErrors:
    none = SceneErrors.none(pixels)
    return replace(none, lost_frames=np.full(pixels, lost_frames), frame_noise_mm=frame_noise_mm)


def test_lost_samples_have_the_probability_of_an_integral_over_the_share() -> None:
    share, worth, lost, frames = 0.1, 15.0, 4, 20
    prior = beta(worth * share, worth * (1 - share))
    # the integrand has a pole of power 0.5 at 0, which a square takes away
    whole, _ = quad(lambda u: 2 * u * binom.pmf(lost, frames, u * u) * prior.pdf(u * u), 0, 1)
    more = _errors(1, lost_frames=worth).by_lost(np.array([lost]), frames, np.array([share]))
    assert more == pytest.approx(np.log(whole) - binom.logpmf(lost, frames, share), abs=1e-6)


def test_the_share_of_all_pixels_is_integrated_out_beside_those_of_single_ones() -> None:
    share, worth, frames, error = 0.02, 5000.0, 60, 0.5
    lost = np.array([0, 3, 1, 0])
    errors = replace(_errors(4, lost_frames=worth), lost_share=np.full(4, share), common_lost=error)
    log_factor = norm(-0.5 * error**2, error)  # its exponential has the mean 1

    def of(log: float) -> float:
        now = share * np.exp(log)
        return float(np.prod(betabinom.pmf(lost, frames, worth * now, worth * (1 - now))) * log_factor.pdf(log))

    whole, _ = quad(of, -4, 3)
    known = float(binom.logpmf(lost, frames, share).sum())
    assert errors.by_lost(lost, frames, np.full(4, share)) == pytest.approx(np.log(whole) - known, abs=0.01)


def test_a_given_share_of_lost_samples_has_no_error() -> None:
    assert SceneErrors.none(2).by_lost(np.array([0, 5]), 20, np.array([0.0, 0.5])) == 0.0


def test_a_bias_of_each_frame_is_integrated_out() -> None:
    slope, information, sigma_mm = np.array([2.0, -2.0]), np.array([3.0, 3.0]), 0.7
    found = _errors(1, frame_noise_mm=sigma_mm).by_frames(slope, information)

    def of(s: float, i: float) -> float:
        density = lambda x: np.exp(s * x - 0.5 * i * x * x - 0.5 * (x / sigma_mm) ** 2)  # noqa: E731
        return float(np.log(quad(density, -10, 10)[0] / (sigma_mm * np.sqrt(2 * np.pi))))

    assert found == pytest.approx([of(2.0, 3.0), of(-2.0, 3.0)], abs=1e-6)


def test_a_walk_of_all_means_has_the_probability_of_its_covariance() -> None:
    """Samples of one pixel, about their mean: contrasts of them are Gaussian, with the walk and without."""
    blocks, each, sigma_mm = 10, 3, 2.0
    frames = blocks * each
    rng = np.random.default_rng(5)
    y = np.repeat(0.9 * np.cumsum(rng.normal(size=blocks)), each) + sigma_mm * rng.normal(size=frames)
    scene = replace(SceneErrors.none(1), typical_mm=sigma_mm)
    found = scene.by_course(y / sigma_mm**2, np.full(frames, sigma_mm**-2.0))

    block = np.arange(frames) // each
    walk = np.minimum.outer(block, block) * sigma_mm**2 / (blocks - 1)
    contrasts = np.linalg.svd(np.ones((1, frames)))[2][1:]

    def density(size: float) -> float:
        noise = sigma_mm**2 * np.eye(frames) + size**2 * walk
        return float(multivariate_normal(cov=contrasts @ noise @ contrasts.T).pdf(contrasts @ y))

    sizes = (0.05, 0.1, 0.2, 0.4, 0.8)
    wanted = 0.5 + 0.5 * np.mean([density(size) for size in sizes]) / density(0.0)
    assert found == pytest.approx(np.log(wanted), abs=1e-6)


def test_means_share_the_noise_of_frames_of_both_recordings(wall: Model) -> None:
    task = SearchTask(joint_likelihood([(wall, recorded(wall))]), Settings(kinds=KINDS))
    pixels = task.lit.shape[1]
    known = ReferenceErrors(
        sigma_mm=np.full(pixels, 5.0),
        variance_mm2=np.full(pixels, 2.0),
        log_width=np.full(pixels, 0.1),
        lent_log_width=np.zeros(pixels),
        shares=np.zeros(pixels),
        lost=np.full(pixels, 0.0),
        lost_share=np.zeros(pixels),
        lost_worth=0.0,
        common_lost=0.0,
        common=0.02,
        common_log_width=0.01,
        frame_noise=0.5,
    )
    found = SceneErrors.of(known, task.mixture, 50, 0.0)
    assert found.columns_mm == pytest.approx(np.full((1, pixels), 5.0 * np.sqrt(0.02 + 0.25 / 50)))
    assert found.frame_noise_mm == pytest.approx(2.5)
    assert task.own_variance_mm2.max() == 0  # rectangles are given


def _measured(wall: Model, *effects: Effect) -> tuple[Model, Evidence]:
    """A scene as a recording of `FRAMES` frames saw the wall, and a recording with effects."""
    samples = recorded(replace(wall, recording=replace(wall.recording, frames=FRAMES, seed=91))).samples
    range_mm = samples.reshape(FRAMES, wall.sensor.rows, wall.sensor.cols).astype(np.float64)
    sensor = wall.sensor.sensor()
    layers = Layers.empty(range_mm.shape[1:], 1, layer_fields(sensor))
    layers.n_modes[:] = 1
    layers.range[..., 0] = range_mm.mean(axis=0)
    layers.sigma[..., 0] = range_mm.std(axis=0, ddof=1)
    layers.range_stderr[..., 0] = layers.sigma[..., 0] / np.sqrt(FRAMES)
    layers.weight[..., 0], layers.weight_no_return[:], layers.weight_outlier[:] = 1.0, 0.0, 0.0
    layers.n_samples[:] = FRAMES
    if layers.invalid_share is not None:
        layers.invalid_share[:] = 0.0
    numbers = np.zeros((*range_mm.shape[1:], 1), dtype=np.int64)
    camera, scene = measured_scene(layers, sensor, numbers, frames=FRAMES)
    model = Model(sensor=camera, surfaces=scene.surfaces, recording=wall.recording, scene=scene)
    return model, recorded(wall, *effects)


def test_a_static_scene_with_few_frames_has_no_effect(wall: Model) -> None:
    found = search(joint_likelihood([_measured(wall)]), Settings(kinds=KINDS))
    assert found.best.names == set()


def test_a_wide_surface_whose_widths_few_frames_draw_to_the_curve_has_no_excess_noise(wall: Model) -> None:
    """Each pixel keeps a part of its log width, as of a prior about the curve; what it lacks is the same in all."""
    model, evidence = _measured(wall)
    assert model.scene is not None
    wider, spread = 0.6, 0.2  # of the logarithm
    kept = 2 * FRAMES / (2 * FRAMES + spread**-2)
    drawn = np.full_like(model.scene.width, np.exp(kept * wider))
    scene = replace(model.scene, width=drawn, width_spread=spread)
    np.testing.assert_allclose(scene.lent_log_width(), (1.0 - kept) * wider, rtol=1e-6)
    samples = evidence.samples.astype(np.float64)
    mean = samples.mean(axis=0)
    wide = replace(evidence, samples=np.rint(mean + np.exp(wider) * (samples - mean)).astype(np.uint16))
    kinds = ("excess_noise", "range_offset")
    found = search(joint_likelihood([(replace(model, scene=scene), wide)]), Settings(kinds=kinds))
    assert found.best.names == set()


def test_an_offset_beside_a_walk_is_named_alone(wall: Model) -> None:
    """Ranges of real cameras wander within minutes; no drift of two terms stands for that."""
    model, evidence = _measured(wall, RangeOffset(offset_mm=6.0))
    course = np.repeat([0, 1, 3, 4, 4, 3, 1, 1, 0, -1], len(evidence.samples) // 10)
    moved = replace(evidence, samples=(evidence.samples + course[:, None]).astype(np.uint16))
    kinds = ("range_offset", "temperature_drift")
    found = search(joint_likelihood([(model, moved)]), Settings(kinds=kinds))
    assert found.best.names == {("range_offset", "")}


def _round(wall: Model) -> tuple[Model, Evidence]:
    """The measured wall, bulged by up to 400 mm; its recording begins 0.4 s after the middle of the reference."""
    model, evidence = _measured(wall)
    assert model.scene is not None
    bulge_mm = 400.0 * np.cos(np.linspace(-1.4, 1.4, wall.sensor.cols))[:, None]
    scene = replace(model.scene, range_mm=model.scene.range_mm - bulge_mm)
    return replace(model, scene=scene), replace(evidence, time_s=evidence.time_s + 0.4)


def test_rates_of_a_round_measured_thing_are_those_of_its_cast(wall: Model) -> None:
    """Times of one prediction follow each other without a jump."""
    likelihood = joint_likelihood([_round(wall)])
    mixture = likelihood.scene.mixture((Motion(surface="surface 0", velocity_mm_s=120.0),))
    apart_s = float(likelihood.evidence.time_s[-1]) / len(mixture.mean)
    lit = mixture.lit[0]
    assert len(mixture.mean) > 1
    np.testing.assert_allclose(np.diff(mixture.mean, axis=0)[:, lit] / apart_s, mixture.rate[:-1, lit], rtol=1e-3)


def test_means_and_noise_on_a_path_do_not_depend_on_the_speed_beside_it(wall: Model) -> None:
    """Else a speed would be chosen by the shape of a thing, or by its noise, that thousands of pixels tell better."""
    likelihood = joint_likelihood([_round(wall)])
    assert likelihood.scene.has_way
    time_s = likelihood.evidence.time_s
    path_mm = 110.0 * time_s + np.random.default_rng(2).normal(0.0, 4.0, time_s.size)
    way = UnsteadyWay(np.zeros(time_s.size), rest=0.8, path_mm=path_mm)
    slow, fast = (
        likelihood.predicted(
            replace(likelihood.start(), effects=(Motion(surface="surface 0", velocity_mm_s=speed),), way=way)
        )
        for speed in (80.0, 140.0)
    )
    pixels = np.flatnonzero(slow.of_main(slow.lit))
    np.testing.assert_allclose(slow.main_means(pixels), fast.main_means(pixels), atol=0.02)
    noise = [m.sigma[m.key[:, None], m.main[pixels], pixels] for m in (slow, fast)]
    np.testing.assert_allclose(noise[0], noise[1], rtol=0.01)  # of times that are not the same; 0.19 by steady ways


def test_lost_samples_on_a_path_do_not_depend_on_the_speed_beside_it(wall: Model) -> None:
    """Pixels in which what moves leaves the known ranges have unknown shares, and a density that thousands share."""
    likelihood = joint_likelihood([_round(wall)])
    time_s, known = likelihood.evidence.time_s, likelihood.scene.model.sensor.noise.range_mm
    first = likelihood.scene.mixture()
    away_mm = 1.05 * float(known[-1]) - float(np.median(first.main_means(np.arange(first.lit.shape[2]))))
    path_mm = away_mm * time_s / time_s[-1]  # beyond in some pixels, and not in others
    way = UnsteadyWay(np.zeros(time_s.size), rest=0.8, path_mm=path_mm)
    found = []
    for speed in (300.0, 600.0, 1500.0):
        effects = (Motion(surface="surface 0", velocity_mm_s=speed),)
        mixture = likelihood.predicted(replace(likelihood.start(), effects=effects, way=way))
        there = likelihood.beyond(mixture)
        found.append((there, [(part.frames, part.nats) for part in likelihood.lost_in_parts(mixture, there)]))
    moving = mixture.of_main(mixture.rate) != 0
    assert 0 < found[0][0].sum() < moving.sum()
    for there, parts in found[1:]:
        np.testing.assert_array_equal(there, found[0][0])
        np.testing.assert_allclose(parts, found[0][1])


def test_pixels_that_are_left_out_say_nothing_of_lost_samples_where_a_thing_goes(wall: Model) -> None:
    """They have no sample: else each other pixel would have a part of their losses where no share is known."""
    model, evidence = _round(wall)
    assert model.scene is not None
    lost = model.scene.lost.copy()
    lost[:, ::2] = 1.0
    some = replace(model, scene=replace(model.scene, lost=lost))
    samples = np.where(lost.ravel() < 1.0, evidence.samples, 0).astype(np.uint16)
    likelihood = joint_likelihood([(some, replace(evidence, samples=samples))])
    time_s, speed = likelihood.evidence.time_s, 2000.0
    way = UnsteadyWay(np.zeros(time_s.size), rest=0.8)
    effects = (Motion(surface="surface 0", velocity_mm_s=speed),)
    mixture = likelihood.predicted(replace(likelihood.start(), effects=effects, way=way))
    there = likelihood.beyond(mixture)
    assert there.any()
    assert not there[lost.ravel() == 1.0].any()
    assert mixture.invalid[:, there].mean() < 0.01


def test_pixels_that_are_left_out_say_nothing_of_random_values(wall: Model) -> None:
    """They have no sample, and no effect predicts one there: else the share would be that of all pixels."""
    model, evidence = _measured(wall, Outliers(probability=0.06))
    assert model.scene is not None
    lost = model.scene.lost.copy()
    lost[:, ::2] = 1.0
    some = replace(model, scene=replace(model.scene, lost=lost))
    samples = np.where(lost.ravel() < 1.0, evidence.samples, 0).astype(np.uint16)
    kinds = ("outliers", "near_return")
    found = search(joint_likelihood([(some, replace(evidence, samples=samples))]), Settings(kinds=kinds))
    assert found.best.names == {("outliers", "")}
    share = found.best.members()[0].numbers()["probability"]
    assert abs(share - 0.06) < 3 * np.sqrt(0.06 / (len(samples) * (lost < 1.0).sum()))


def test_a_reference_of_random_values_with_a_memory_is_refused_with_a_remedy(wall: Model) -> None:
    model, evidence = _measured(wall)
    noise = replace(model.sensor.noise, background=np.array(0.1))
    effects = (TemporalCorrelation(coefficient=0.5),)
    both = replace(model, sensor=replace(model.sensor, noise=noise), effects=effects)
    with pytest.raises(BadInputError, match=r"reference: .* background of 10 % .* give a model of the scene"):
        reconcile(both, evidence, Settings(kinds=KINDS))


@pytest.mark.slow
def test_motion_since_the_reference_is_named_with_its_speed(wall: Model) -> None:
    """To 10 %: the means of the reference, of 12 frames of 80 pixels, are wrong by 0.03 sigma together."""
    found = search(
        joint_likelihood([_measured(wall, Motion(surface="wall", velocity_mm_s=8.0))]), Settings(kinds=KINDS)
    )
    assert found.best.names == {("motion", "surface 0")}
    assert abs(found.best.members()[0].numbers()["velocity_mm_s"]) == pytest.approx(8.0, rel=0.1)

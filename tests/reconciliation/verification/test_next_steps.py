"""What to do after a verdict."""

import tomllib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.measured_parts.walls import FRAMES, RATE_HZ, draw
from support.recordings import MAKE, reconciled, recorded

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.likelihood.hidden_fits import fit_pattern
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.likelihood.pixel_pattern import spreads_of
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.verification.considered import separate_by
from tofmix.reconciliation.verification.next_steps import fold, other_axes, remedies, worse
from tofmix.reconciliation.workflow import reconcile
from tofmix.sensors import load_profile
from tofmix.simulation.effects.phase_wrapping import PhaseWrapping
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface


@pytest.mark.slow
def test_every_verdict_ends_with_a_step(small: Model) -> None:
    kinds = ("range_offset", "surface_pose")
    agree = reconciled(small, kinds=kinds)
    explained = reconciled(small, MAKE["range_offset"](offset_mm=9.0), kinds=kinds)
    unexplained = reconciled(small, MAKE["excess_noise"](factor=2.0), kinds=kinds)
    verdicts = [r.verified.verdict for r in (agree, explained, unexplained)]
    assert verdicts == ["agree", "explained", "unexplained"]
    assert all(
        r.next_steps and r.as_dict()["next_steps"] == list(r.next_steps) for r in (agree, explained, unexplained)
    )
    assert "sigma of all samples would have been seen" in agree.next_steps[-1]
    assert any("--noise auto" in step for step in unexplained.next_steps)


@pytest.mark.slow
def test_a_surface_elsewhere_comes_first_with_the_table_that_moves_it_there(small: Model) -> None:
    """No tried effect moves a surface, so only the step names the other position."""
    moved = replace(
        small,
        surfaces=(
            SurfacePose(surface=small.surfaces[0].name, shift_mm=40.0, yaw_deg=2.0).place(small.surfaces[0], 0.0),
            *small.surfaces[1:],
        ),
    )
    result = reconcile(small, recorded(moved), Settings(kinds=("range_offset", "scattering")))
    first = result.next_steps[0]
    assert result.verified.verdict == "unexplained"
    assert first.startswith(f'"{small.surfaces[0].name}" is ')
    table = "\n".join(part.strip() for part in first[first.index("[[effect]]") + 10 :].split(";"))
    (effect,) = tomllib.loads("[[effect]]\n" + table)["effect"]
    assert effect["kind"] == "surface_pose"
    assert effect["shift_mm"] == pytest.approx(40.0, abs=1.0)
    assert effect["yaw_deg"] == pytest.approx(2.0, abs=0.2)
    ((recording, pose),) = result.suggested
    assert (recording, pose.kind) == (0, "surface_pose")
    assert "suggested_model.toml has this: reconcile it with the same recording." in result.next_steps
    advised = replace(small, effects=(pose,))
    assert reconcile(advised, recorded(moved), Settings(kinds=("range_offset",))).verified.verdict == "agree"


@pytest.mark.slow
def test_common_offset_of_all_surfaces_is_advised_instead_of_a_list_of_poses(small: Model) -> None:
    hidden = MAKE["range_offset"](offset_mm=12.0)
    result = reconciled(small, hidden, kinds=("temperature_drift",), split="frames")
    assert result.verified.verdict == "unexplained"
    assert any(step.startswith("All surfaces are off by one value") for step in result.next_steps)
    assert not any("along its normal" in step for step in result.next_steps)
    ((_, offset),) = result.suggested
    assert offset.kind == "range_offset"
    assert offset.offset_mm == pytest.approx(12.0, abs=1.0)  # type: ignore[attr-defined]
    advised = replace(small, effects=(offset,))
    assert reconcile(advised, recorded(small, hidden), Settings(kinds=())).verified.verdict == "agree"


@pytest.mark.slow
def test_bias_that_is_smooth_over_the_image_leads_to_the_lens_and_to_no_pose(small: Model) -> None:
    evidence = recorded(small)
    rows, cols = small.sensor.shape
    across = np.linspace(-1, 1, cols)
    samples = evidence.samples.reshape(-1, rows, cols) + np.rint(40 * (across**2 - 1 / 3))
    shown = make_evidence(small, samples.astype(np.float32), time_s=evidence.time_s)
    result = reconcile(small, shown, Settings(kinds=("range_offset", "surface_pose")))
    assert (result.verified.verdict, result.verified.law) == ("unexplained", "place in the image")
    assert any("suspect the lens" in step for step in result.next_steps)
    assert not any("along its normal" in step for step in result.next_steps)
    assert not result.suggested


def along_another_axis(model: Model, power: int) -> Evidence:
    """Ranges times this power of the cosine of each beam with z, in whole mm."""
    evidence = recorded(model)
    cosine = joint_likelihood([(model, evidence)]).scene.members[0].beams[:, 2]
    samples = np.rint(evidence.samples * cosine**power).reshape(-1, *model.sensor.shape)
    return make_evidence(model, samples.astype(np.float32), time_s=evidence.time_s)


@pytest.mark.parametrize(("power", "axes"), [(1, [(0, "z")]), (-1, [(0, "ray")]), (0, [])])
def test_axis_of_the_depths_is_told_by_the_biases(small: Model, power: int, axes: list[tuple[int, str]]) -> None:
    likelihood = joint_likelihood([(small, along_another_axis(small, power))])
    assert list(other_axes(likelihood, Settings(kinds=()))) == axes


@pytest.mark.parametrize("offset_mm", [-40.0, 40.0])
def test_an_offset_is_no_other_axis(small: Model, offset_mm: float) -> None:
    likelihood = joint_likelihood([(small, recorded(small, MAKE["range_offset"](offset_mm=offset_mm)))])
    assert not list(other_axes(likelihood, Settings(kinds=())))


@pytest.mark.slow
def test_depths_along_z_lead_to_the_import_and_to_no_pose(small: Model) -> None:
    result = reconcile(small, along_another_axis(small, 1), Settings(kinds=("range_offset",)))
    step = "The ranges fit the model if they are depths along z: import the source again with --depth-axis z."
    assert step in result.next_steps
    assert not any("along its normal" in step for step in result.next_steps)
    assert not result.suggested


def test_statistic_that_is_worse_with_the_effects_has_a_sentence(small: Model) -> None:
    result = reconciled(small, MAKE["range_offset"](offset_mm=9.0), kinds=("range_offset",))
    verified = result.verified
    assert verified.verdict == "explained"
    assert not list(worse(verified))
    skew = next(c for c in verified.after.curves if (c.statistic, c.axis) == ("skew", "range"))
    far = replace(skew, value=skew.value + 60 * np.sqrt(skew.variance))
    rest = tuple(far if c is skew else c for c in verified.after.curves)
    (step,) = worse(replace(verified, after=replace(verified.after, curves=rest)))
    assert step.startswith("skew over range is farther from noise than without the effects (")


ROOM = (
    Surface(name="back wall", center_mm=(0, 0, 4000), size_mm=(3200, 2600), reflectivity=0.7),
    Surface(name="left wall", center_mm=(-1300, 0, 2150), size_mm=(3700, 2600), yaw_deg=90, reflectivity=0.6),
    Surface(name="floor", center_mm=(0, 1200, 2150), size_mm=(3200, 3700), pitch_deg=90, reflectivity=0.5),
    Surface(name="table", center_mm=(500, 250, 1900), size_mm=(800, 600), pitch_deg=20, reflectivity=0.8),
)


@pytest.mark.slow
@pytest.mark.long
def test_advice_leads_from_a_room_with_four_faults_to_all_of_them() -> None:
    """A table 12 mm off, a side wall turned by 0.8 degrees, and two effects: one more than are searched for."""
    sensor = replace(load_profile("sr4000"), rows=28, cols=52)
    settings = Settings(kinds=("excess_noise", "wiggling", "surface_pose", "range_offset", "vignetting"))
    given = Model(sensor=sensor, surfaces=ROOM, recording=RecordingSettings(frames=80, frame_rate_hz=25.0))
    hidden = (
        MAKE["surface_pose"](surface="table", shift_mm=12.0),
        MAKE["surface_pose"](surface="left wall", shift_mm=0.0, yaw_deg=0.8),
        MAKE["wiggling"](amplitude_mm=12.0, phase_rad=0.7),
        MAKE["excess_noise"](factor=1.4),
    )
    evidence = recorded(given, *hidden, seed=9)
    first = reconcile(given, evidence, settings)
    assert first.verified.verdict == "unexplained"
    assert not first.suggested
    (step,) = [s for s in first.next_steps if "--max-effects" in s]
    assert "--max-effects 4 tries one more" in step
    second = reconcile(given, evidence, replace(settings, max_effects=4))
    assert second.verified.verdict == "explained"
    assert sorted((n.effect.kind, getattr(n.effect, "surface", "")) for n in second.named) == [
        ("excess_noise", ""),
        ("surface_pose", "left wall"),
        ("surface_pose", "table"),
        ("wiggling", ""),
    ]
    poses = {getattr(n.effect, "surface", ""): n for n in second.named if n.effect.kind == "surface_pose"}
    for surface, true in (("left wall", {"shift_mm": 0.0, "yaw_deg": 0.8}), ("table", {"shift_mm": 12.0})):
        found = poses[surface]  # only four columns see the wall: its shift and its tilt have joint errors
        for name, value in true.items():
            assert getattr(found.effect, name) == pytest.approx(value, abs=3 * found.stderr[name])


def test_few_samples_are_reported_with_the_sufficient_number_of_frames(small: Model) -> None:
    one = replace(small, sensor=replace(small.sensor, rows=1, cols=1))
    result = reconcile(one, recorded(one), Settings(kinds=("range_offset",)))
    assert result.verified.verdict == "unexplained"
    assert result.next_steps[0].startswith("Too few samples: 40 were held out")
    assert "Record " in result.next_steps[0]


def test_repeated_frames_are_left_out_and_counted(small: Model) -> None:
    samples = recorded(small).samples.reshape(-1, *small.sensor.shape).astype(np.float32)
    samples[4::5] = samples[3::5]
    evidence = make_evidence(small, np.where(samples > 0, samples, np.nan), time_s=np.arange(80) / 10.0)
    assert evidence.shape[0] == 64
    result = reconcile(small, evidence, Settings(kinds=("temporal_correlation", "range_offset")))
    assert result.verified.verdict == "agree"
    assert result.next_steps[0].startswith("16 frames of 80 repeated the frame before")


def test_named_near_return_comes_with_its_remedy_and_an_offset_has_none(small: Model) -> None:
    remedy = MAKE["near_return"](share=0.06, range_mm=25.0, sigma_mm=5.0).remedy
    kinds = ("near_return", "range_offset")
    near = reconciled(small, MAKE["near_return"](share=0.06, range_mm=25.0, sigma_mm=5.0), kinds=kinds)
    offset = reconciled(small, MAKE["range_offset"](offset_mm=9.0), kinds=kinds)
    assert [n.effect.kind for n in (*near.named, *offset.named)] == ["near_return", "range_offset"]
    assert remedy in near.next_steps
    assert remedies(offset.verified) == []


def test_reflection_and_its_rivals_are_separated_by_brightness_and_distance() -> None:
    for rival in ("range_offset", "surface_pose", "wiggling", "amplitude_walk", "scattering", "multipath"):
        assert "dark and a bright board" in separate_by(["internal_reflection"], [rival])


def test_aliases_name_the_recording_that_separates_them(small: Model) -> None:
    board = replace(small, surfaces=(Surface(name="board", center_mm=(0, 0, 1500), size_mm=(9000, 9000)),))
    hidden = MAKE["range_offset"](offset_mm=3.0)
    result = reconcile(board, recorded(board, hidden), Settings(kinds=("range_offset", "surface_pose")))
    assert any("cannot separate" in step and "record a second surface" in step for step in result.next_steps)


def test_advice_that_another_advice_contains_is_left_out() -> None:
    both = separate_by(["wiggling"], ["multipath", "surface_pose"])
    assert both == "the same surface at a second distance, without others around it"
    assert separate_by(["range_offset"], ["surface_pose", "wiggling"]).count("; and ") == 1


@pytest.mark.slow
def test_offset_beside_noise_of_one_part_of_the_image_is_named_and_no_pose_is_advised(small: Model) -> None:
    """More noise everywhere gains little beyond the offset and does not remove the spread, so it is taken back."""
    evidence = recorded(small, MAKE["range_offset"](offset_mm=60.0))
    middle = np.nanmedian(evidence.samples, axis=0)
    noisier = np.where(np.arange(middle.size) % small.sensor.cols < small.sensor.cols // 3, 1.3, 1.0)
    samples = np.rint(middle + noisier * (evidence.samples - middle))
    shown = make_evidence(small, samples.reshape(-1, small.sensor.rows, small.sensor.cols), time_s=evidence.time_s)
    result = reconcile(small, shown, Settings(kinds=("range_offset", "excess_noise")))
    assert result.verified.verdict == "partly_explained"
    assert [n.effect.kind for n in result.named] == ["range_offset"]
    assert abs(result.named[0].effect.offset_mm - 60.0) < 0.6  # type: ignore[attr-defined]
    assert not any("surface_pose" in step for step in result.next_steps)
    assert any("--noise auto" in step for step in result.next_steps)


SEED = 20261128
KINDS = ("range_offset", "surface_pose", "multipath", "phase_wrapping", "fixed_pattern", "excess_noise")


def case(number: int, *, wraps: bool) -> tuple[Model, Evidence]:
    """A case of the benchmark whose model wraps, or does not."""
    drawn = draw(SEED, number)
    turn = drawn.model.sensor.turn_mm("test")
    effects = (PhaseWrapping(unambiguous_range_mm=turn),) if wraps else ()
    model = replace(drawn.model, effects=effects)
    return model, make_evidence(model, drawn.range_mm, time_s=np.arange(FRAMES) / RATE_HZ)


def everything(evidence: Evidence) -> Any:  # noqa: ANN401
    frames, pixels = evidence.shape
    return np.arange(frames), np.arange(pixels)


@pytest.mark.parametrize("number", [1, 2, 5, 38])
def test_fold_is_found_whatever_the_biases_and_not_where_the_model_wraps(number: int) -> None:
    """Case 5 has a sigma of 2 mm under biases of 10: the fold alone is no better than random values."""
    for wraps in (False, True):
        likelihood = joint_likelihood([case(number, wraps=wraps)])
        found = fold(likelihood, likelihood.start(), everything(likelihood.evidence))
        assert (found is None) == wraps


def test_wall_that_stands_metres_nearer_than_the_model_before_the_turn_has_no_fold() -> None:
    model, evidence = case(2, wraps=False)
    turn = model.sensor.turn_mm("test")
    near = tuple(replace(s, center_mm=(0.0, 0.0, 0.8 * turn)) for s in model.surfaces)
    likelihood = joint_likelihood([(replace(model, surfaces=near), evidence)])
    assert fold(likelihood, likelihood.start(), everything(evidence)) is None


@pytest.mark.parametrize("wraps", [False, True])
def test_surfaces_whose_samples_lie_on_both_sides_of_the_fold_have_one_bias(wraps: bool) -> None:
    """The wall stands at the turn itself: an offset puts half of the samples at the other end of the axis."""
    model, _ = case(2, wraps=wraps)
    turn = model.sensor.turn_mm("test")
    at = tuple(replace(s, center_mm=(0.0, 0.0, turn)) for s in model.surfaces)
    rng = np.random.default_rng(3)
    there = replace(model, surfaces=at)
    mean = joint_likelihood([(there, case(2, wraps=wraps)[1])]).scene.mixture()
    true = (mean.of_main(mean.true_range) - 15.0 + rng.normal(0, 12.0, (FRAMES, 34))) % turn
    evidence = make_evidence(there, np.maximum(np.rint(true), 1).reshape(FRAMES, 1, 34).astype(np.float32))
    found = reconcile(there, evidence, Settings(kinds=KINDS)).as_dict()
    assert found["verdict"] == "explained"
    kinds = {e["kind"] for e in found["effects"]} - {"phase_wrapping"}
    assert kinds <= {"range_offset", "surface_pose"}
    (size,) = (abs(v) for e in found["effects"] for n, v in e["parameters"].items() if n in ("offset_mm", "shift_mm"))
    assert size == pytest.approx(15.0, abs=2.0)


@pytest.mark.parametrize("image", [(1, 8), (8, 1), (4, 4), (1, 24)])
def test_spread_of_biases_is_found_in_images_of_few_pixels(image: tuple[int, int]) -> None:
    model, _ = case(2, wraps=False)
    small = replace(model, sensor=replace(model.sensor, rows=image[0], cols=image[1]))
    rng = np.random.default_rng(7)
    pattern = rng.normal(0, 40.0, image)
    mixture = joint_likelihood([(small, make_evidence(small, np.full((FRAMES, *image), 9000.0)))]).scene.mixture()
    mean = mixture.of_main(mixture.mean).reshape(image)
    evidence = make_evidence(small, mean + pattern + rng.normal(0, 12.0, (FRAMES, *image)))
    likelihood = joint_likelihood([(small, evidence)])
    found = fit_pattern(likelihood, likelihood.mixture(likelihood.start()), likelihood.start(), everything(evidence))
    assert found is not None
    effect = found[0]
    whole = np.hypot(np.hypot(effect.pixel_sigma_mm, effect.column_sigma_mm), effect.row_sigma_mm)
    assert whole == pytest.approx(np.sqrt((pattern**2).mean()), rel=0.3)
    assert spreads_of(image) == (3 if min(image) > 1 else 1)
    if min(image) == 1:
        assert effect.column_sigma_mm == effect.row_sigma_mm == 0.0


@pytest.mark.parametrize("number", [1, 2, 3])
def test_offset_beside_biases_of_one_row_is_named_with_the_error_of_their_mean(number: int) -> None:
    """The bias of the only row is an offset, and the bias of a column is that of its pixel: no further numbers."""
    model, evidence = case(number, wraps=True)
    found = reconcile(model, evidence, Settings(kinds=KINDS)).as_dict()
    assert found["verdict"] == "explained"
    errors = {e["kind"]: e["stderr"] for e in found["effects"]}
    assert set(errors["fixed_pattern"]) == {"pixel_sigma_mm"}
    pixels = evidence.shape[1]
    assert errors["fixed_pattern"]["pixel_sigma_mm"] == pytest.approx(10.0 / np.sqrt(2 * pixels), rel=0.5)
    (error,) = (
        e.get("offset_mm", e.get("shift_mm")) for k, e in errors.items() if k in ("range_offset", "surface_pose")
    )
    assert error == pytest.approx(10.0 / np.sqrt(pixels), rel=0.5)

"""A kind is a file of its own and a line of the registry: two more are simulated, found, refitted, drawn and told.

One is a bias by the square of the range. The other has a hidden state of each pixel.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest
from support.effects.noisy_pixels import NoisyPixels
from support.effects.range_square import RangeSquare
from support.reconcile_errors import scene

from tofmix.reconciliation.evidence import Evidence, make_evidence
from tofmix.reconciliation.likelihood.likelihood import Likelihood
from tofmix.reconciliation.likelihood.mixture import Scene
from tofmix.reconciliation.settings import Settings
from tofmix.reconciliation.words import effect_tables, headline, in_words, summary_lines
from tofmix.reconciliation.workflow import Reconciliation, reconcile
from tofmix.report.gap import render_gap
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import EFFECTS, Effect
from tofmix.simulation.exposure import drawn_truth, predict
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import explain, parse_model
from tofmix.simulation.render import render_blocks

MODEL = """
[sensor]
profile = "sr3000"
rows = 14
cols = 18
fov_horizontal_deg = 50.0
fov_vertical_deg = 40.0

[recording]
frames = 80
frame_rate_hz = 10.0

[[surface]]
name = "near"
center_mm = [-500.0, 0.0, 1300.0]
size_mm = [700.0, 700.0]
reflectivity = 0.9

[[surface]]
name = "wall"
center_mm = [0.0, 0.0, 4000.0]
size_mm = [20000.0, 20000.0]
yaw_deg = 30.0
reflectivity = 0.6
"""
SQUARE = '\n[[effect]]\nkind = "range_square"\nbias_mm = 6.0\n'
NOISY = '\n[[effect]]\nkind = "noisy_pixels"\nshare = 0.15\nfactor = 2.5\n'
SEED = 5


@pytest.fixture(autouse=True)
def registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a line for each of the two."""
    monkeypatch.setitem(EFFECTS, "range_square", RangeSquare)
    monkeypatch.setitem(EFFECTS, "noisy_pixels", NoisyPixels)


def parsed(text: str) -> Model:
    return parse_model(text, source="model.toml")


def recorded(given: Model, true: Model) -> Evidence:
    """A recording of one model, held against another."""
    frames = true.recording.frames
    (block,) = render_blocks(true, cast_scene(true), n_frames=frames, seed=SEED, block_frames=frames)
    range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
    return make_evidence(given, range_mm, time_s=block.time_s)


def found(given: str, true: str) -> Reconciliation:
    """The outcome among all kinds of the registry."""
    model = parsed(given)
    return reconcile(model, recorded(model, parsed(true)), Settings(kinds=tuple(EFFECTS)))


@pytest.mark.slow
def test_effects_are_named_with_their_errors_refitted_drawn_and_told() -> None:
    hidden = SQUARE + NOISY
    result = found(MODEL, MODEL + hidden)
    assert result.verified.verdict == "explained", headline(result)
    assert sorted(n.effect.kind for n in result.named) == ["noisy_pixels", "range_square"]
    true = {effect.kind: effect for effect in parsed(MODEL + hidden).effects}
    for named in result.named:
        assert set(named.stderr) == set(named.effect.parameters())
        for name, error in named.stderr.items():
            assert getattr(named.effect, name) == pytest.approx(getattr(true[named.effect.kind], name), abs=4 * error)
            assert 0 < error < 0.5 * getattr(named.effect, name)
        assert named.effect.remedy in result.next_steps

    page, lines = render_gap(result, source="recording.h5"), "\n".join(summary_lines(result))
    for named in result.named:
        number = re.escape(next(iter(named.stderr)))
        assert re.search(rf"{named.effect.kind} \({number} [\d.]+ \+- [\d.]+", lines)
        assert in_words(named.effect) in page
    assert page.count("<img") + page.count("<svg") > 2

    again = found(MODEL + effect_tables(result), MODEL + hidden)
    assert again.verified.verdict == "agree", headline(again)


@pytest.mark.parametrize("hidden", [SQUARE, NOISY], ids=["square", "noisy"])
def test_effects_are_simulated_as_predicted_and_explained(hidden: str) -> None:
    model = parsed(MODEL + hidden)
    (effect,) = model.effects
    assert effect.explain() in explain(model)
    samples = recorded(model, model).samples.astype(np.float64)
    within = np.random.default_rng(1).uniform(-0.5, 0.5, samples.shape)  # of a whole mm
    chances = predict(model, cast_scene(model), seed=SEED).cdf(samples + within)
    assert kstest(chances.ravel(), "uniform").pvalue > 1e-3
    bare = predict(parsed(MODEL)).cdf(samples + within)
    assert kstest(bare.ravel(), "uniform").pvalue < 1e-6
    assert [t.name for t in drawn_truth(model, seed=SEED, n_frames=5)] == ["noisy_pixels"] * (hidden == NOISY)


def test_log_likelihood_of_pixels_is_that_of_a_mixture_of_both_states() -> None:
    """Sums over pixels of log((1 - share) L + share L'), each with all samples of the pixel."""
    model, effect = scene(rows=4, cols=6, frames=20), NoisyPixels(share=0.3, factor=2.0)
    evidence = recorded(model, replace(model, effects=(effect,)))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    part = np.arange(20), np.arange(24)

    def of_pixels(*effects: Effect) -> np.ndarray:
        state = replace(likelihood.start(), effects=effects)
        return likelihood.sums(likelihood.mixture(state), state, part).by_pixel

    quiet, noisy, either = of_pixels(), of_pixels(effect.in_affected()), of_pixels(effect)
    wanted = np.logaddexp(np.log(0.7) + quiet[:, 0], np.log(0.3) + noisy[:, 0])
    np.testing.assert_allclose(either[:, 0], wanted, rtol=1e-9)
    chance = 0.3 * np.exp(noisy[:, 0] - wanted)
    np.testing.assert_allclose(either[:, 1], quiet[:, 1] + chance * (noisy[:, 1] - quiet[:, 1]), rtol=1e-6, atol=1e-9)
    state = replace(likelihood.start(), effects=(effect,))
    by_frame = likelihood.sums(likelihood.mixture(state), state, part).by_frame
    likely = np.where(chance > 0.5, noisy[:, 0], quiet[:, 0])
    assert by_frame[:, 0].sum() == pytest.approx(likely.sum(), rel=1e-9)


def test_slope_of_pixels_of_two_states_is_that_of_their_log_likelihood() -> None:
    model, effect = scene(rows=4, cols=6, frames=20), NoisyPixels(share=0.3, factor=2.0)
    evidence = recorded(model, replace(model, effects=(effect,)))
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    state, part = replace(likelihood.start(), effects=(effect,)), (np.arange(20), np.arange(24))
    mixture, step = likelihood.mixture(state), 0.01
    below, here, above = (
        likelihood.sums(mixture, state, part, bias=np.full(24, bias)).by_pixel for bias in (-step, 0.0, step)
    )
    np.testing.assert_allclose(here[:, 1], (above[:, 0] - below[:, 0]) / (2 * step), rtol=1e-3, atol=1e-4)


def test_scores_of_affected_pixels_are_standard_normal() -> None:
    model, effect = scene(rows=14, cols=18, frames=80), NoisyPixels(share=0.2, factor=3.0)
    true = replace(model, effects=(effect,))
    evidence = recorded(model, true)
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    part = np.arange(80), np.arange(252)
    z = likelihood.scores(replace(likelihood.start(), effects=(effect,)), part, 1)
    bare = likelihood.scores(likelihood.start(), part, 1)
    (truth,) = drawn_truth(true, seed=SEED, n_frames=80)
    noisy = truth.values.ravel().astype(bool)
    assert np.std(bare[:, noisy]) > 2
    for pixels in (noisy, ~noisy):
        assert np.std(z[:, pixels]) == pytest.approx(1.0, abs=4 / np.sqrt(2 * z[:, pixels].size))

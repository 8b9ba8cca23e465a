"""Light of another camera in bursts, with a beat, or always: one kind, each form with its own identity and price."""

import numpy as np
import pytest
from support.recordings import recorded
from support.search_tasks import MakeTask

from tofmix.reconciliation.likelihood.beats import FrameNoise, of_unknown_phase
from tofmix.reconciliation.likelihood.joint import joint_likelihood
from tofmix.reconciliation.one.coordinates import key_of_state
from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.search import search
from tofmix.reconciliation.settings import Settings
from tofmix.simulation.effects import Effect
from tofmix.simulation.effects.interference import Interference
from tofmix.simulation.model import Model

BURSTS = Interference(probability=0.3, sigma_mm=40.0, burst_frames=4.0)
BEAT = Interference(probability=0.7, sigma_mm=40.0, period_frames=20.0)
ALWAYS = Interference(probability=1.0, sigma_mm=40.0)


def _named(wall: Model, effect: Effect) -> Interference:
    found = search(joint_likelihood([(wall, recorded(wall, effect))]), Settings(kinds=("interference",))).best
    assert found.names == {("interference", "")}
    (named,) = (*found.members(), *found.linked)
    assert isinstance(named, Interference)
    return named


def test_forms_have_keys_of_their_own(make_task: MakeTask) -> None:
    always = [law.key for law in make_task(("interference",)).laws if law.named]
    assert [*map(key_of_state, (BURSTS, BEAT)), *always] == [("interference", "", k) for k in (0, 1, 2, 3)]


def test_a_kind_with_several_forms_counts_once_and_all_prices_share_alpha(make_task: MakeTask) -> None:
    task = make_task(("excess_noise", "interference"))
    key_of = {law.name: law.key for law in task.laws}
    noise, other = (task.price_nats([key_of[kind, ""]]) for kind in ("excess_noise", "interference"))
    assert sum(np.exp(-task.price_nats([key])) for key in key_of.values()) == pytest.approx(task.settings.alpha)
    assert noise < other  # every model has an error of its noise


def test_phase_of_a_beat_is_integrated_out(make_task: MakeTask) -> None:
    task = make_task(("interference",), BEAT)
    empty = FittedSet.without_effects(task).fit()
    state = empty.with_errors
    noise = FrameNoise(task.likelihood, task.likelihood.mixture(state), state, task.part)
    chain = BEAT.hidden.chain(BEAT)  # type: ignore[union-attr]
    values = np.array([noise.of_beat(chain, phase) for phase in np.linspace(0, 1, 4000, endpoint=False)])
    integral = values.max() + np.log(np.exp(values - values.max()).mean())
    found, square = of_unknown_phase(noise, chain)
    assert found == pytest.approx(integral, abs=0.5)
    assert square.shape == (60,)
    assert square.max() <= 1


@pytest.mark.slow
def test_a_beat_is_named_with_its_period(wall: Model) -> None:
    named = _named(wall, BEAT)
    assert named.period_frames == pytest.approx(20.0, rel=0.1)
    assert named.sigma_mm == pytest.approx(40.0, rel=0.25)


@pytest.mark.slow
def test_light_in_all_frames_is_named_without_a_hidden_state(wall: Model) -> None:
    named = _named(wall, ALWAYS)
    assert not named.hides
    assert named.sigma_mm == pytest.approx(40.0, rel=0.1)


@pytest.mark.slow
def test_bursts_are_no_beat(wall: Model) -> None:
    named = _named(wall, BURSTS)
    assert named.hides
    assert named.period_frames is None

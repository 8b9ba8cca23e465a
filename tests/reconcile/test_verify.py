"""The verdict is of the models as they are: no trace of poses that were tried, none of pixels that see nothing."""

from recordings import MAKE, Record

from tofmix.reconcile.add import Added, Settings, held_out
from tofmix.reconcile.compare import compare
from tofmix.reconcile.likelihood import Likelihood
from tofmix.reconcile.mixture import Scene
from tofmix.reconcile.name import KINDS
from tofmix.reconcile.verify import verify
from tofmix.simulation.model import Model

SETTINGS = Settings(kinds=KINDS)


def test_a_pose_that_was_tried_leaves_no_trace_in_the_gaps(model: Model, record: Record) -> None:
    evidence = record()
    likelihood = Likelihood(evidence, Scene(model, evidence.time_s))
    start = likelihood.start()
    panel = compare(likelihood, start, held_out(likelihood, SETTINGS), seed=SETTINGS.seed)
    added = Added(state=start, chosen=(), first=(), aliases=(), tolerated=start, panel=panel)
    straight = verify(likelihood, added, SETTINGS)
    likelihood.scene.anchor((MAKE["surface_pose"](surface="near", shift_mm=200.0),))
    after_a_trial = verify(likelihood, added, SETTINGS)
    assert after_a_trial.before.gap == straight.before.gap
    assert after_a_trial.floor.gap == straight.floor.gap

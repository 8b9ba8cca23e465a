"""The order of effects within a level."""

from dataclasses import replace

import numpy as np
from support.recordings import MAKE
from support.search_tasks import MakeTask

from tofmix.reconciliation.one.fitted_set import FittedSet
from tofmix.reconciliation.one.proposals import About, Columns
from tofmix.reconciliation.one.search import in_best_order


def test_effects_of_one_level_get_the_order_in_which_they_act(make_task: MakeTask) -> None:
    """A lens dims what is reflected before it, and not what is reflected behind it."""
    reflected = MAKE["internal_reflection"](amplitude=40.0, range_mm=100.0)
    dimmed = MAKE["vignetting"](corner_factor=3.0)
    for hidden in ((reflected, dimmed), (dimmed, reflected)):
        task = make_task(("internal_reflection", "vignetting"), *hidden)
        laws = [next(law for law in task.laws if law.kind is type(e)) for e in hidden]
        null = FittedSet.without_effects(task).fit()
        for order in ((0, 1), (1, 0)):
            x = np.concatenate([laws[k].vector_of(hidden[k]) for k in order])
            begun = replace(null, laws=tuple(laws[k] for k in order), x=x, hessian=None, started=None)
            best = in_best_order(begun)
            assert [law.kind for law in best.laws] == [type(e) for e in hidden]
            np.testing.assert_allclose(
                best.x, np.concatenate([law.vector_of(e) for law, e in zip(laws, hidden, strict=True)])
            )


def test_effects_that_predict_the_same_in_any_order_stay_as_they_are(make_task: MakeTask) -> None:
    task = make_task(("range_offset", "temperature_drift"), MAKE["range_offset"](offset_mm=5.0))
    about = About(Columns.of(task), FittedSet.without_effects(task).fit())
    built = next(iter(about.sets(2))).build()
    assert in_best_order(built) is built

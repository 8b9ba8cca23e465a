"""Biases of the pixels that see one surface, recording by recording."""

from collections.abc import Iterator
from dataclasses import dataclass

from tofmix.arrays import BoolArray, FloatArray
from tofmix.reconciliation.likelihood.joint import RecordingView, views
from tofmix.reconciliation.likelihood.likelihood import Likelihood, ModelState, Part
from tofmix.reconciliation.likelihood.memory import sees_one_surface
from tofmix.reconciliation.likelihood.pixel_pattern import pixel_biases


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordingBiases:
    """The biases of one recording. Arrays are (pixel,).

    Parameters
    ----------
    view : RecordingView
        The recording, and the prediction of the model.
    used : pixels that see one surface and have data; the others have no information.
    bias_mm : bias of the mean against the prediction, mm.
    information : its information, 1/mm2.
    """

    view: RecordingView
    used: BoolArray
    bias_mm: FloatArray
    information: FloatArray

    @property
    def surfaces(self) -> Iterator[tuple[str, BoolArray]]:
        """Each surface's name, and the pixels (pixel,) with data that see it."""
        m = self.view.mixture
        seen = m.of_main(m.surface)
        for number, name in enumerate(self.view.scene.names):
            own = self.used & (seen == number)
            if own.any():
                yield name, own


def biases_of_recordings(likelihood: Likelihood, state: ModelState, part: Part) -> list[RecordingBiases]:
    """The biases that a part of each recording has, relative to a state."""
    mixture = likelihood.mixture(state)
    out = []
    for view in views(likelihood, mixture, part):
        found, m = pixel_biases(likelihood, mixture, state, view.part_of_all), view.mixture
        used = sees_one_surface(m) & m.of_main(m.lit).astype(bool) & (found.information > 0)
        out.append(RecordingBiases(view=view, used=used, bias_mm=found.bias, information=found.information))
    return out

"""The last steps of a window, when the layers of its whole image are there: unmixing, and what lost samples say.

Files and memory take them here, so that both have the same values.
"""

from dataclasses import replace
from typing import NamedTuple

from tofmix.arrays import Float32Array
from tofmix.layers import Layers
from tofmix.lost_samples import learn_losses
from tofmix.sensor import Sensor
from tofmix.unmixing.unmix import unmix


class FinishedWindow(NamedTuple):
    """Layers (row, col) of a window, the share of phasor sums and the pixels that tell it; None: not measured."""

    layers: Layers
    phasor_share: float | None = None
    phasor_pixels: int | None = None


def finish_window(
    layers: Layers,
    phasors: Float32Array | None,
    sensor: Sensor,
    *,
    frames: int,
    insist: bool = False,
    circle_mm: float | None = None,
) -> FinishedWindow:
    """Finish the layers of a window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), pixel by pixel.
    phasors : (row, col, 7) float32 or None
        Mean phasors of the pixels (`tofmix.unmixing.phasors`); None: nothing is unmixed.
    sensor : Sensor
        The camera.
    frames : int
        Frames of the window.
    insist : bool
        Whether all samples at edges are taken as phasor sums.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    """
    done = FinishedWindow(layers)
    if phasors is not None:
        found = unmix(layers, phasors, sensor, insist=insist, circle_mm=circle_mm)
        done = FinishedWindow(found.layers, found.phasor_share, found.informative_pixels)
    lost = done.layers.invalid_share
    if lost is None:
        return done
    probability = learn_losses(lost, frames).weighed(done.layers.probability, lost)
    return done._replace(layers=replace(done.layers, probability=probability))

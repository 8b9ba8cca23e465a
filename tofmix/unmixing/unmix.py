"""Unmix one window: the entry for everything that has layers and mean phasors of a whole image."""

import math
from dataclasses import replace

import numpy as np

from tofmix.arrays import BoolArray, Float32Array, FloatArray
from tofmix.flags import Status
from tofmix.layers import Layers
from tofmix.optics.pinhole import Pinhole
from tofmix.optics.projection import beam_directions_of
from tofmix.sensor import Sensor
from tofmix.unmixing.curved_labels import label_curved
from tofmix.unmixing.image import make_image
from tofmix.unmixing.labels import label
from tofmix.unmixing.law import measure_law
from tofmix.unmixing.phasors import phase_scale_mm
from tofmix.unmixing.rewriting import Rewritten, rewrite
from tofmix.unmixing.settings import DEFAULT_SETTINGS, UnmixSettings
from tofmix.unmixing.unfolding import unfolded


def unmix(
    layers: Layers,
    phasors: Float32Array,
    sensor: Sensor,
    *,
    insist: bool = False,
    circle_mm: float | None = None,
    settings: UnmixSettings = DEFAULT_SETTINGS,
) -> Rewritten:
    """Find the surfaces in the mixed pixels of one window.

    Parameters
    ----------
    layers : Layers
        Of the leading shape (row, col), as samples of one surface each give them. They are not changed.
    phasors : (row, col, 7) float32
        From `tofmix.unmixing.phasors.mean_phasors`, of the same window.
    sensor : Sensor
        Its modulation frequency must be known; its optics and noise curve are used if known.
    insist : bool
        Whether all samples at edges are taken as phasor sums, for any scatter.
    circle_mm : float, optional
        Length of the circle that ranges are on, mm.
    settings : UnmixSettings
        Thresholds.

    Returns
    -------
    Rewritten
        Layers with `mixing`, and the law that was found. Where samples are of one surface each (equation (1)), all
        layers are as they were.

    Raises
    ------
    ValueError
        If the modulation frequency is not known.
    """
    if sensor.modulation_frequency_hz is None:
        raise ValueError("unmixing needs the modulation frequency")
    rows, cols = layers.shape
    directions = _directions(sensor, (rows, cols), settings.unknown_pitch)
    scale_mm = phase_scale_mm(sensor.modulation_frequency_hz)
    open_space = _sees_nothing(layers, phasors, settings)
    image = make_image(phasors, directions, scale_mm=scale_mm, open_space=open_space, settings=settings.image)
    if circle_mm is not None:
        image = replace(image, range_mm=unfolded(image, circle_mm, settings.unfolding))
    labels = label_curved(image, label(image, settings), settings)
    law = measure_law(image, labels, settings.law)
    return rewrite(layers, image, labels, law, sensor, insist=insist, circle_mm=circle_mm, settings=settings)


def _directions(sensor: Sensor, shape: tuple[int, int], unknown_pitch: float) -> FloatArray:
    """Unit vectors (row, col, 3) along the beams."""
    optics = sensor.optics
    if optics is None:
        focal = 1.0 / unknown_pitch
        optics = Pinhole(fx=focal, fy=focal, cx=(shape[1] - 1) / 2, cy=(shape[0] - 1) / 2)
    return beam_directions_of(optics, shape)


def _sees_nothing(layers: Layers, phasors: Float32Array, settings: UnmixSettings) -> BoolArray:
    """Pixels (row, col) without any surface: c_0 explains their samples, or too few samples are valid.

    A sum of the phasors of two surfaces may have a phase outside of the working range, as c_0 has. But it has more
    light than the dimmest surfaces, and open space has not.
    """
    amplitude, seen = np.hypot(phasors[..., 0], phasors[..., 1]), layers.n_modes > 0
    dim = float(np.quantile(amplitude[seen], settings.dimmest)) if seen.any() else math.inf
    empty = (layers.n_modes == 0) & (np.nan_to_num(layers.weight_no_return) > settings.open_share) & (amplitude <= dim)
    lost = layers.status == int(Status.TOO_FEW_SAMPLES)
    return np.asarray(empty | lost)

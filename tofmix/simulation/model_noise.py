"""A model with another noise than its file has, and its text with this noise.

Use `with_noise` for a noise that was measured: the model and its text then say the same.
"""

import re
from dataclasses import replace

import numpy as np

from tofmix.errors import BadInputError
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensors.camera_toml import noise_toml
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.model import Model
from tofmix.toml_table import parse_toml

BACKGROUND_MAP = "noise_background.npy"
"""Path of the map of background shares beside the written model."""

_TABLE = re.compile(r"^\[sensor\.noise\][^\n]*\n(?:(?!\[)[^\n]*(?:\n|\Z))*", re.MULTILINE)
_WHOLE_MM = 1.0  # the step of the stored type, which every model has


def with_noise(model: Model, curve: NoiseCurve, *, step_mm: float | None = None) -> Model:
    """The model with this noise at its integration time.

    Parameters
    ----------
    model : Model
        The model; its file has the noise in a table ``[sensor.noise]``, or in its profile.
    curve : NoiseCurve
        The noise. A background that is not uniform over the range becomes uniform.
    step_mm : float, optional
        Step on which the ranges lie. One above 1 mm becomes the effect `quantisation`, if the model has none.

    Raises
    ------
    BadInputError
        If the file has the noise in another form than a table of its own.
    """
    sensor = model.sensor
    curve = _explicit(replace(curve, background_density=None), sensor.noise)
    path = BACKGROUND_MAP if curve.background is not None and curve.background.ndim else None
    stepped = step_mm is not None and step_mm > _WHOLE_MM
    added = () if not stepped or any(isinstance(e, Quantisation) for e in model.effects) else (_step(step_mm),)
    text = model.text
    if text:
        table = noise_toml(
            curve, integration_time_ms=sensor.integration_time_ms, exponent=sensor.exponent, background=path
        )
        bare = _TABLE.sub("", text)
        if "noise" in parse_toml(bare, source="model").table("sensor").values:
            raise BadInputError("[sensor]: noise: give it as a table [sensor.noise], so that another can replace it")
        text = f"{bare.rstrip()}\n\n{table}" + "".join(
            f'\n[[effect]]\nkind = "{Quantisation.kind}"\nstep_mm = {e.step_mm!r}\n' for e in added
        )
    changed = replace(sensor, noise=curve, reference_integration_time_ms=sensor.integration_time_ms)
    return replace(model, sensor=changed, effects=(*model.effects, *added), text=text)


def _step(step_mm: float | None) -> Quantisation:
    return Quantisation(step_mm=float(step_mm or 0.0))


def _explicit(curve: NoiseCurve, given: NoiseCurve) -> NoiseCurve:
    """The curve with every part that a table would otherwise inherit from the model's profile."""
    if curve.law is None and given.law is not None:
        ones = np.ones(curve.range_mm.size)
        curve = replace(curve, law=AmplitudeLaw(reference=ones, amplitude=np.ones(1), factor=np.ones(1)))
    if curve.background is None and given.background is not None:
        curve = replace(curve, background=np.zeros(()))
    return curve

"""The effects of real cameras: one file an effect, one registry.

An effect is declared once: its parameters with units and bounds, its level, its action on samples, and its action on
the predicted distribution of a pixel. `simulate`, ``--explain``, docs/reference/effects.md and the fits of `reconcile`
all use this declaration.
"""

from tofmix.simulation.effects.base import Effect, EffectTruth, Level
from tofmix.simulation.effects.parameter import Parameter, PixelMap
from tofmix.simulation.effects.registry import EFFECTS

__all__ = ["EFFECTS", "Effect", "EffectTruth", "Level", "Parameter", "PixelMap"]

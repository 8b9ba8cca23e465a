"""The effects of real cameras: one file an effect, one registry.

An effect is declared once: its parameters with units and bounds, the level at
which it acts, what it does to samples, and what it does to a pixel's predictive
distribution. `simulate` runs it, ``--explain`` and docs/reference/effects.md describe it,
and a fit searches its parameters, all from that declaration.
"""

from tofmix.simulation.effects.base import Effect, EffectTruth, Level
from tofmix.simulation.effects.parameter import Parameter, PixelMap
from tofmix.simulation.effects.registry import EFFECTS

__all__ = ["EFFECTS", "Effect", "EffectTruth", "Level", "Parameter", "PixelMap"]

"""The effects of real cameras: one file an effect, one registry.

An effect is declared once: its parameters with units and bounds, its level, its action on samples, and its action on
the predicted distribution of a pixel. `simulate`, ``--explain``, docs/reference/effects.md and the fits of `reconcile`
all use this declaration.
"""

from tofmix.simulation.effects.amplitude_walk import AmplitudeWalk
from tofmix.simulation.effects.base import Basic, Effect, EffectTruth, Level
from tofmix.simulation.effects.dropout import Dropout
from tofmix.simulation.effects.excess_noise import ExcessNoise
from tofmix.simulation.effects.fixed_pattern import FixedPattern
from tofmix.simulation.effects.flying_pixels import FlyingPixels
from tofmix.simulation.effects.interference import Interference
from tofmix.simulation.effects.internal_reflection import InternalReflection
from tofmix.simulation.effects.motion import Motion
from tofmix.simulation.effects.multipath import Multipath
from tofmix.simulation.effects.near_return import NearReturn
from tofmix.simulation.effects.outliers import Outliers
from tofmix.simulation.effects.parameter import Parameter, PixelMap
from tofmix.simulation.effects.phase_wrapping import PhaseWrapping
from tofmix.simulation.effects.pixel_crosstalk import PixelCrosstalk
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.effects.range_offset import RangeOffset
from tofmix.simulation.effects.saturation import Saturation
from tofmix.simulation.effects.scattering import Scattering
from tofmix.simulation.effects.smooth_pattern import SmoothPattern
from tofmix.simulation.effects.stuck_pixels import StuckPixels
from tofmix.simulation.effects.surface_offset import SurfaceOffset
from tofmix.simulation.effects.surface_pose import SurfacePose
from tofmix.simulation.effects.tap_mismatch import TapMismatch
from tofmix.simulation.effects.temperature_drift import TemperatureDrift
from tofmix.simulation.effects.temporal_correlation import TemporalCorrelation
from tofmix.simulation.effects.vignetting import Vignetting
from tofmix.simulation.effects.wiggling import Wiggling

EFFECTS: dict[str, type[Effect]] = {
    "surface_pose": SurfacePose,
    "motion": Motion,
    "multipath": Multipath,
    "scattering": Scattering,
    "internal_reflection": InternalReflection,
    "pixel_crosstalk": PixelCrosstalk,
    "flying_pixels": FlyingPixels,
    "vignetting": Vignetting,
    "wiggling": Wiggling,
    "tap_mismatch": TapMismatch,
    "temporal_correlation": TemporalCorrelation,
    "interference": Interference,
    "saturation": Saturation,
    "phase_wrapping": PhaseWrapping,
    "range_offset": RangeOffset,
    "surface_offset": SurfaceOffset,
    "temperature_drift": TemperatureDrift,
    "smooth_pattern": SmoothPattern,
    "fixed_pattern": FixedPattern,
    "amplitude_walk": AmplitudeWalk,
    "excess_noise": ExcessNoise,
    "near_return": NearReturn,
    "outliers": Outliers,
    "quantisation": Quantisation,
    "dropout": Dropout,
    "stuck_pixels": StuckPixels,
}


def basic_kind(error: Basic) -> type[Effect]:
    """The kind that describes an error of every model."""
    return next(kind for kind in EFFECTS.values() if kind.basic is error)


__all__ = ["EFFECTS", "Effect", "EffectTruth", "Level", "Parameter", "PixelMap", "basic_kind"]

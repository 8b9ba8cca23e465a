"""tofmix: the surfaces in a time-of-flight pixel.

A pixel of a time-of-flight camera is a cone. tofmix treats the samples of each pixel of a recorded sequence as a
Gaussian mixture and recovers all surfaces in it: their number, ranges, shares of the beam, and errors.

The data's path through the package:

recording -> `tofmix.estimation` (density -> modes -> mixture -> layers) -> layers file -> `tofmix.report`
layers -> `tofmix.unmixing` (mixed pixels of phasor sums) -> layers
layers -> `tofmix.surfaces` (planes, edges below a pixel), `tofmix.mapping` (occupancy)
scene -> `tofmix.simulation` (scene -> sensor -> cast -> events -> effects -> render) -> recording
recording and scene -> `tofmix.reconciliation` (the effects that the model lacks)

What travels stands here: `recording`, `sensor`, `layers`, `points`. `tofmix.optics` is where pixels look,
`tofmix.compiled` how kernels are compiled. `tofmix.io` reads and writes the files, `tofmix.pipeline` runs an estimate,
`tofmix.cli` is the command line, `tofmix.api` the functions below.
In Python:

>>> import tofmix as tm
>>> layers = tm.estimate(tm.open("recording.h5"))  # doctest: +SKIP

`open`, `from_array`, `estimate`, `scene`, `simulate`, `reconcile` and `plot` are loaded from `tofmix.api` when they are
first used. No large library is imported here, so ``tofmix --help`` answers at once.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from tofmix.version import __version__

if TYPE_CHECKING:
    from tofmix.api.estimates import Estimate, estimate
    from tofmix.api.estimates import open_file as open  # noqa: A004  tofmix.open reads well, as gzip.open does
    from tofmix.api.plots import plot
    from tofmix.api.recordings import Recording, from_array
    from tofmix.api.simulations import reconcile, scene, simulate
    from tofmix.sensor import NoiseCurve, Sensor

_LAZY = {
    "Estimate": ("tofmix.api.estimates", "Estimate"),
    "NoiseCurve": ("tofmix.sensor", "NoiseCurve"),
    "Recording": ("tofmix.api.recordings", "Recording"),
    "Sensor": ("tofmix.sensor", "Sensor"),
    "estimate": ("tofmix.api.estimates", "estimate"),
    "from_array": ("tofmix.api.recordings", "from_array"),
    "open": ("tofmix.api.estimates", "open_file"),
    "plot": ("tofmix.api.plots", "plot"),
    "reconcile": ("tofmix.api.simulations", "reconcile"),
    "scene": ("tofmix.api.simulations", "scene"),
    "simulate": ("tofmix.api.simulations", "simulate"),
}
"""Names of `import tofmix`: the module of each, and its name there."""

__all__ = [
    "Estimate",
    "NoiseCurve",
    "Recording",
    "Sensor",
    "__version__",
    "estimate",
    "from_array",
    "open",
    "plot",
    "reconcile",
    "scene",
    "simulate",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401  as the import system has it
    """Load a public name when it is first used."""
    if name not in _LAZY:
        raise AttributeError(f"module 'tofmix' has no attribute {name!r}")
    module, attribute = _LAZY[name]
    value = getattr(import_module(module), attribute)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)

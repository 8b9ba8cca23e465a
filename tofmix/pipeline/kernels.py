"""Compile every kernel ahead, by using each once: for container images and read-only installations."""

from itertools import product

import numpy as np

from tofmix.estimation.counters import COUNTERS
from tofmix.estimation.layering import warm_up
from tofmix.estimation.noise import measure_noise
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.io.model_file import load_model
from tofmix.recording import ArrayRecording
from tofmix.sensor import Sensor
from tofmix.simulation.cast import cast_scene

_RANGE_MM = 1000.0


def compile_all() -> None:
    """Compile the kernels of all commands and options, or load them from their cache."""
    for sigma, refine, counter in product(SigmaMode, Refine, COUNTERS.values()):
        warm_up(EstimateOptions(sigma=sigma, refine=refine, counter=counter()))
    made_up = np.random.default_rng(1).normal(_RANGE_MM, 10.0, (20, 6, 6))
    measure_noise(ArrayRecording(made_up, Sensor(name="warm-up", range_max_mm=2.0 * _RANGE_MM)))
    cast_scene(load_model("three-boards"))

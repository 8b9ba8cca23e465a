"""Compile every kernel ahead, by using each once: for container images and read-only installations."""

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tofmix.estimation.layering import layer_pixels, warm_up
from tofmix.estimation.learnt import warm_up as learnt
from tofmix.estimation.noise.measurement import measure_noise
from tofmix.estimation.peaks.counters import COUNTERS
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.io.model_file import load_model
from tofmix.mapping.beams import beams_from_layers
from tofmix.mapping.grid import plan_grid as grid_of_map
from tofmix.mapping.occupancy import count_light
from tofmix.mapping.pose import Pose
from tofmix.recording import ArrayRecording
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor
from tofmix.simulation.casting.cast import cast_scene
from tofmix.surfaces.reconstruct import reconstruct

_RANGE_MM = 1000.0  # of the made-up samples


def compile_all() -> None:
    """Compile the kernels of all commands and options, or load them from their cache."""
    compile_options()
    compile_noise()
    learnt.warm_up()


def compile_options() -> None:
    """Compile the kernels that estimate layers, with all options, and those of maps and scenes, or load them."""
    for sigma, refine, counter in product(SigmaMode, Refine, COUNTERS.values()):
        warm_up(EstimateOptions(sigma=sigma, refine=refine, counter=counter()))
    warm_up(EstimateOptions(unambiguous_range_mm=2.0 * _RANGE_MM))
    warm_up(EstimateOptions(paper=True))
    range_mm, sensor, amplitude = _made_up()
    law = AmplitudeLaw(np.array([100.0]), np.array([50.0, 200.0]), np.array([2.0, 0.5]))
    by_amplitude = replace(sensor, noise=NoiseCurve(np.array([_RANGE_MM]), np.array([10.0]), law))
    layers = layer_pixels(range_mm, by_amplitude, amplitude=amplitude)
    beams = beams_from_layers(layers, by_amplitude)
    count_light(beams, Pose(), grid_of_map(beams, Pose(), cell_mm=200.0))
    reconstruct(layers.reshaped(range_mm.shape[1:]), by_amplitude, factor=2)
    cast_scene(load_model("three-boards"))


def compile_noise() -> None:
    """Compile the kernels that measure noise, or load them from their cache."""
    measure_noise(ArrayRecording(*_made_up()))


def _made_up() -> tuple[NDArray[np.float64], Sensor, NDArray[np.float64]]:
    """Samples of one surface in 6 x 6 pixels, their camera and their amplitudes."""
    range_mm = np.random.default_rng(1).normal(_RANGE_MM, 10.0, (20, 6, 6))
    sensor = Sensor(name="warm-up", range_max_mm=2.0 * _RANGE_MM, fov_horizontal_deg=10.0, fov_vertical_deg=10.0)
    return range_mm, sensor, np.full(range_mm.shape, 100.0)

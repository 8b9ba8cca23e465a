"""Compile every kernel ahead, by using each once: for container images and read-only installations."""

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tofmix.estimation.beam import beam_of, is_uniform
from tofmix.estimation.blocks.finishing import layer_amplitudes
from tofmix.estimation.layering import MADE_UP_MM, layer_pixels, warm_up
from tofmix.estimation.learnt.recordings import warm_up as warm_up_learnt
from tofmix.estimation.mixture.em import fit_mixture
from tofmix.estimation.noise.measurement import measure_noise
from tofmix.estimation.peaks.counters import COUNTERS
from tofmix.estimation.peaks.incremental import IncrementalDensity
from tofmix.estimation.peaks.modes import density, find_modes
from tofmix.estimation.settings import EstimateOptions, Refine, SigmaMode
from tofmix.flags import Mixing
from tofmix.io.model_file import load_model
from tofmix.mapping.beams import beams_from_layers
from tofmix.mapping.grid import Pose
from tofmix.mapping.grid import plan_grid as grid_of_map
from tofmix.mapping.occupancy import count_light
from tofmix.optics.pinhole import Pinhole
from tofmix.recording import ArrayRecording
from tofmix.sensor import AmplitudeLaw, NoiseCurve, Sensor
from tofmix.simulation.casting.cast import MovingCaster
from tofmix.simulation.effects import EFFECTS
from tofmix.surfaces.reconstruct import reconstruct
from tofmix.suspicion.evidence import warm_up as warm_up_evidence
from tofmix.unmixing import unmix as unmixing

_NOISE = NoiseCurve(np.array([MADE_UP_MM]), np.array([10.0]))
_EDGE_SIDE = 12  # pixels of the made-up images with edges, along each side
_PINHOLE = Pinhole(fx=20.0, fy=20.0, cx=5.5, cy=5.5)
"""A lens that sees the made-up scenes."""


def compile_all() -> None:
    """Compile the kernels of all commands and options, or load them from their cache."""
    compile_options()
    warm_up_evidence(EstimateOptions().max_layers)
    compile_images()
    compile_scenes()
    compile_noise()
    warm_up_learnt()


def compile_options() -> None:
    """Compile the kernels that estimate layers, with all options, or load them from their cache."""
    for sigma, refine, counter in product(SigmaMode, Refine, COUNTERS.values()):
        warm_up(EstimateOptions(sigma=sigma, refine=refine, counter=counter()))
    warm_up(EstimateOptions(unambiguous_range_mm=2.0 * MADE_UP_MM))
    warm_up(EstimateOptions(paper=True))
    range_mm, sensor, amplitude = _made_up()
    law = AmplitudeLaw(np.array([100.0]), np.array([50.0, 200.0]), np.array([2.0, 0.5]))
    layers = layer_pixels(range_mm, _with_sigma(sensor, law), amplitude=amplitude)
    layer_amplitudes(range_mm, amplitude, layers)


def compile_images() -> None:
    """Compile the kernels of unmixing and surfaces, or load them from their cache."""
    _compile_edges(_made_up()[1])
    unmixing.warm_up()
    unmixing.warm_up_curved()


def compile_scenes() -> None:
    """Compile the kernels of maps, scenes and the steps of one pixel, or load them from their cache."""
    range_mm, sensor, _ = _made_up()
    camera = _with_sigma(sensor)
    layers = layer_pixels(range_mm, camera)
    for optics in (None, _PINHOLE):
        beams = beams_from_layers(layers, replace(camera, projection=optics))
        count_light(beams, Pose(), grid_of_map(beams, Pose(), cell_mm=200.0))
    is_uniform(beam_of(camera))
    live = IncrementalDensity(camera, 1)
    live.add(range_mm[:1, 0, :1])
    live.modes()
    find_modes(range_mm[:, 0, 0], _NOISE)
    density(range_mm[:, 0, 0], [MADE_UP_MM], _NOISE)
    fit_mixture(range_mm[:, 0, 0], [MADE_UP_MM], camera)
    _compile_casts()


def _compile_edges(sensor: Sensor) -> None:
    """Find the edge between two surfaces that share the pixels of a diagonal, by counts and by unmixed shares."""
    rows, cols = np.indices((_EDGE_SIDE, _EDGE_SIDE))
    far = np.random.default_rng(1).random((50, _EDGE_SIDE, _EDGE_SIDE)) < 0.5 + 0.5 * np.sign(rows - cols)
    near_mm, far_mm = np.random.default_rng(2).normal([[[[MADE_UP_MM]]], [[[1.5 * MADE_UP_MM]]]], 10.0, (2, *far.shape))
    layers = layer_pixels(np.where(far, far_mm, near_mm), _with_sigma(sensor)).reshaped(rows.shape)
    reconstruct(layers, sensor, factor=2)
    reconstruct(replace(layers, mixing=np.full(rows.shape, int(Mixing.PHASOR), np.uint8)), sensor, factor=2)


def _compile_casts() -> None:
    """Cast a scene with a surface that moves, on both kinds of grids."""
    model = load_model("three-boards")
    motion = EFFECTS["motion"](surface=model.surfaces[0].name, velocity_mm_s=1.0)  # type: ignore[call-arg]
    for projection in (None, _PINHOLE):
        sensor = replace(model.sensor, rows=_EDGE_SIDE, cols=_EDGE_SIDE, projection=projection)
        MovingCaster(replace(model, sensor=sensor, effects=(motion,))).cast(0.0)


def compile_noise() -> None:
    """Compile the kernels that measure noise, or load them from their cache."""
    measure_noise(ArrayRecording(*_made_up()))


def _with_sigma(sensor: Sensor, law: AmplitudeLaw | None = None) -> Sensor:
    return replace(sensor, noise=replace(_NOISE, law=law))


def _made_up() -> tuple[NDArray[np.float64], Sensor, NDArray[np.float64]]:
    """Samples of one surface in 6 x 6 pixels, their camera and their amplitudes."""
    range_mm = np.random.default_rng(1).normal(MADE_UP_MM, 10.0, (20, 6, 6))
    sensor = Sensor(name="warm-up", range_max_mm=2.0 * MADE_UP_MM, fov_horizontal_deg=10.0, fov_vertical_deg=10.0)
    return range_mm, sensor, np.full(range_mm.shape, 100.0)

"""A small scene of three boards, and recordings of it with and without effects, made by the simulator."""

from dataclasses import replace

import numpy as np
import pytest
from recordings import Record

from tofmix.reconcile.evidence import Evidence, make_evidence
from tofmix.sensor import NoiseCurve
from tofmix.sensors.registry import load_profile
from tofmix.simulation.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model, RecordingSettings, Surface
from tofmix.simulation.render import render_blocks


@pytest.fixture(scope="session")
def model() -> Model:
    """Two boards and a slanted wall before a camera of 20 x 24 pixels."""
    ranges = np.linspace(500.0, 6000.0, 12)
    sensor = replace(
        load_profile("sr3000"), rows=20, cols=24, fov_horizontal_deg=50.0, fov_vertical_deg=40.0, range_min_mm=300.0,
        range_max_mm=7000.0, noise=NoiseCurve(ranges, 3.0 + (ranges / 1000) ** 2), reference_integration_time_ms=1.0,
        integration_time_ms=1.0, modulation_frequency_hz=20e6,
    )  # fmt: skip
    surfaces = (
        Surface(name="near", center_mm=(-500.0, 0.0, 1300.0), size_mm=(700.0, 700.0), reflectivity=0.9),
        Surface(name="middle", center_mm=(600.0, 100.0, 2300.0), size_mm=(900.0, 900.0), reflectivity=0.3),
        Surface(name="wall", center_mm=(0.0, 0.0, 4000.0), size_mm=(20000.0, 20000.0), yaw_deg=30.0, reflectivity=0.6),
    )
    return Model(sensor=sensor, surfaces=surfaces, recording=RecordingSettings(frames=120, frame_rate_hz=10.0))


@pytest.fixture(scope="session")
def record(model: Model) -> Record:
    """Simulate the model with effects that it does not say it has."""

    def make(*effects: Effect, seed: int = 5) -> Evidence:
        real = replace(model, effects=effects)
        (block,) = render_blocks(real, cast_scene(real), n_frames=120, seed=seed, block_frames=120)
        range_mm = np.where(block.range_mm > 0, block.range_mm, np.nan).astype(np.float32)
        return make_evidence(model, range_mm, time_s=block.time_s)

    return make

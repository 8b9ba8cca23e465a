"""Small models, and a slow twin of the caster: plain NumPy, one array a surface, nothing clever."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tofmix.sensors import CompleteCamera, load_profile
from tofmix.simulation import builtin_text
from tofmix.simulation.casting import cast, cast_cells, cast_kernel
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.events import Truth
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.surface import Surface

Floats = NDArray[np.float64]
MakeModel = Callable[..., Model]
CastTwin = Callable[..., tuple[Floats, Floats]]


@pytest.fixture
def kernel_casts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel itself, also where its twin, which is less precise, has taken its place elsewhere."""
    monkeypatch.setattr(cast, "cast_row", cast_kernel.cast_row)
    monkeypatch.setattr(cast, "cast_cells", cast_cells.cast_cells)


@pytest.fixture
def sensor() -> CompleteCamera:
    """9 x 11 pixels of the SR-3000's size at 1.2 ms."""
    return replace(
        load_profile("sr3000"),
        rows=9,
        cols=11,
        fov_vertical_deg=39.0 * 9 / 144,
        fov_horizontal_deg=47.0 * 11 / 176,
        integration_time_ms=1.2,
    )


@pytest.fixture
def make_model(sensor: CompleteCamera) -> MakeModel:
    """Build a model of surfaces before the small sensor; keywords change the sensor."""

    def make(*surfaces: Surface, **changes: float | None) -> Model:
        settings: dict[str, Any] = dict(changes)
        return Model(sensor=replace(sensor, **settings), surfaces=surfaces)

    return make


@pytest.fixture(scope="session")
def three_boards() -> tuple[Model, Truth]:
    """The built-in scene, cast once."""
    model = parse_model(builtin_text("three-boards"), source="three-boards")
    return model, cast_scene(model)


def _twin(model: Model, row: int, col: int, *, side: int = 1000) -> tuple[Floats, Floats]:
    """Shares (S + 1,), the last that of no return, and mean ranges (S,) of one pixel from side x side beams."""
    s = model.sensor
    assert s.fov_horizontal_deg is not None
    assert s.fov_vertical_deg is not None
    part = (np.arange(side) + 0.5) / side - 0.5
    az = np.radians((col - (s.cols - 1) / 2 + part) * s.fov_horizontal_deg / s.cols)[np.newaxis, :]
    el = np.radians((row - (s.rows - 1) / 2 + part) * s.fov_vertical_deg / s.rows)[:, np.newaxis]
    beam = np.stack(np.broadcast_arrays(np.sin(az) * np.cos(el), np.sin(el), np.cos(az) * np.cos(el)), axis=-1)
    ranges = [np.full((side, side), np.inf)]
    for surface in model.surfaces:
        yaw, pitch = np.radians(surface.yaw_deg), np.radians(surface.pitch_deg)
        about_y = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
        about_x = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
        u, v, n = (about_x @ about_y).T
        center = np.array(surface.center_mm)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (center @ n) / (beam @ n)
            point = beam * t[..., np.newaxis] - center
            hit = (abs(point @ u) <= surface.size_mm[0] / 2) & (abs(point @ v) <= surface.size_mm[1] / 2)
        ranges.append(np.where(hit & (t > 0) & (t <= s.range_max_mm), t, np.inf))
    first = np.argmin(ranges, axis=0) - 1
    nearest = np.min(ranges, axis=0)
    share = np.array([np.mean(first == k) for k in range(len(model.surfaces))] + [np.mean(np.isinf(nearest))])
    mean = [nearest[first == k].mean() if (first == k).any() else np.nan for k in range(len(model.surfaces))]
    return share, np.array(mean)


@pytest.fixture
def cast_twin() -> CastTwin:
    """Cast one pixel the slow way."""
    return _twin

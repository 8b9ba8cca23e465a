"""Pixels of a measured scene that see something else: parts that have changed are told, biases of cameras are not."""

import numpy as np
import pytest
from support.cameras import camera_of

from tofmix.arrays import FloatArray
from tofmix.layers import Layers, layer_fields
from tofmix.optics.projection import beam_directions_of
from tofmix.reconciliation.evidence import ChangedPart, Evidence, make_evidence
from tofmix.reconciliation.left_out import places, without_changes, without_others
from tofmix.reconciliation.words import change_text
from tofmix.simulation.measured_scene import measured_scene
from tofmix.simulation.model import Model, RecordingSettings

ROWS, COLS, FRAMES, SIGMA_MM = 12, 16, 40, 5.0
WALL_MM, BOX_MM = 2000.0, 1500.0
SENSOR = camera_of([1000.0], [SIGMA_MM], reach_mm=(0.0, 4000.0), fov_deg=(40.0, 30.0), integration_time_ms=1.0)
BOX = np.zeros((ROWS, COLS), dtype=np.bool_)
BOX[3:7, 5:10] = True


def _ranges(*, box: bool, box_mm: float = BOX_MM) -> FloatArray:
    assert SENSOR.optics is not None
    ahead_mm = np.where(BOX & box, box_mm, WALL_MM)
    return np.asarray(ahead_mm / beam_directions_of(SENSOR.optics, (ROWS, COLS))[..., 2])


def _scene(*, box: bool) -> Model:
    """A wall, before it a box or none, as a recording saw them."""
    layers = Layers.empty((ROWS, COLS), 1, layer_fields(SENSOR))
    layers.n_modes[:] = 1
    layers.range[..., 0] = _ranges(box=box)
    layers.sigma[..., 0], layers.range_stderr[..., 0] = SIGMA_MM, SIGMA_MM / np.sqrt(FRAMES)
    layers.weight[..., 0], layers.weight_no_return[:], layers.weight_outlier[:] = 1.0, 0.0, 0.0
    layers.n_samples[:] = FRAMES
    if layers.invalid_share is not None:
        layers.invalid_share[:] = 0.0
    numbers = np.where(BOX & box, 1, 0)[..., np.newaxis]
    camera, scene = measured_scene(layers, SENSOR, numbers, frames=FRAMES)
    return Model(sensor=camera, surfaces=scene.surfaces, recording=RecordingSettings(frames=FRAMES), scene=scene)


def _evidence(model: Model, mean_mm: FloatArray) -> Evidence:
    noise = np.random.default_rng(3).normal(0.0, SIGMA_MM, (FRAMES, ROWS, COLS))
    return make_evidence(model, (mean_mm + noise).astype(np.float32))


def test_something_new_is_told_with_its_place_and_left_out_with_its_edge() -> None:
    model = _scene(box=False)
    left, evidence = without_changes(model, _evidence(model, _ranges(box=True)))
    (part,) = evidence.changed
    assert (part.is_new, part.surfaces, part.rows, part.cols, part.pixels) == (True, ("surface 0",), (3, 6), (5, 9), 20)
    assert part.moved_mm == pytest.approx(BOX_MM - WALL_MM, rel=0.1)
    out = (evidence.samples == 0).all(axis=0).reshape(ROWS, COLS)
    wider = np.zeros_like(BOX)
    wider[2:8, 4:11] = True
    assert np.array_equal(out, wider)
    assert left.scene is not None
    assert np.array_equal(left.scene.lost == 1.0, wider)


def test_what_has_gone_is_told_by_the_surface_behind_it() -> None:
    model = _scene(box=True)
    _, evidence = without_changes(model, _evidence(model, _ranges(box=False)))
    (part,) = evidence.changed
    assert (part.is_new, part.surfaces, part.rows, part.cols, part.pixels) == (
        False,
        ("surface 1",),
        (3, 6),
        (5, 9),
        20,
    )
    assert part.moved_mm == pytest.approx(WALL_MM - BOX_MM, rel=0.1)


def test_an_offset_of_all_ranges_and_biases_of_single_pixels_change_no_part() -> None:
    model = _scene(box=True)
    biases = np.random.default_rng(8).normal(0.0, 4 * SIGMA_MM, (ROWS, COLS))
    for bias in (0.0, 30 * SIGMA_MM, biases):
        given = _evidence(model, _ranges(box=True) + bias)
        assert without_changes(model, given)[1] is given


def test_a_surface_that_moved_at_once_keeps_its_pixels_and_one_that_moves_leaves_those_that_do_not_follow() -> None:
    model = _scene(box=True)
    moved = without_changes(model, _evidence(model, _ranges(box=True, box_mm=BOX_MM + 20 * SIGMA_MM)))
    assert without_others(*moved)[1].others is None
    time_s = np.arange(FRAMES) / model.recording.frame_rate_hz
    way = 40 * SIGMA_MM * (time_s / time_s[-1])[:, None, None] * BOX
    hidden = np.zeros_like(BOX)
    hidden[3, 5:8] = True  # these see something at 1000 mm from the middle on
    mean = _ranges(box=True) + way
    mean[FRAMES // 2 :, hidden] = 1000.0
    others = without_others(model, _evidence(model, mean))[1].others
    assert others is not None
    assert np.array_equal(others.reshape(ROWS, COLS), hidden)


def test_words_and_places_of_changes() -> None:
    new = ChangedPart(
        is_new=True, surfaces=("surface 0",), rows=(1, 4), cols=(2, 3), pixels=8, range_mm=1500.0, before_mm=2000.0
    )
    assert (
        change_text(new) == 'something new stands 500 mm before "surface 0" in rows 1 to 4, columns 2 to 3 (8 pixels)'
    )
    row, col = places([new])
    assert (row.axis, row.interval, col.axis, col.interval) == ("row", (1.0, 4.0), "col", (2.0, 3.0))
    assert (row.statistic, row.size, row.unit) == ("bias", -500.0, "mm")

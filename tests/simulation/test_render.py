"""Blocks: the same frames however they are made, in bounded memory."""

import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import special, stats

from tofmix.simulation.builtin import builtin_text
from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import FrameBlock, recording_sensor, render_blocks
from tofmix.simulation.surface import Surface
from tofmix.simulation.truth import Truth

Floats = NDArray[np.float64]
MakeModel = Callable[..., Model]
BOARDS = (
    Surface(name="near", center_mm=(-500, 0, 2400), size_mm=(1000, 1000)),
    Surface(name="far", center_mm=(0, 0, 3000), size_mm=(3000, 3000)),
)


def frames(model: Model, n_frames: int, **options: int) -> tuple[NDArray[np.generic], ...]:
    """All frames of a rendering in one."""
    settings: dict[str, Any] = {"seed": 3} | options
    blocks = list(render_blocks(model, cast_scene(model), n_frames=n_frames, **settings))
    return tuple(np.concatenate([getattr(b, name) for b in blocks]) for name in ("range_mm", "amplitude", "time_s"))


@pytest.mark.parametrize("averaged", [False, True])
@pytest.mark.parametrize("options", [{"block_frames": 1}, {"block_frames": 7}, {"block_frames": 1000}, {"threads": 3}])
def test_blocks_and_threads_do_not_matter(make_model: MakeModel, averaged: bool, options: dict[str, int]) -> None:
    model = make_model(*BOARDS)
    for one, other in zip(
        frames(model, 30, averaged=averaged), frames(model, 30, averaged=averaged, **options), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_first_frames_are_the_same_however_many_follow(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    for few, many in zip(frames(model, 5), frames(model, 40), strict=True):
        np.testing.assert_array_equal(few, many[:5])


def _equation_1(model: Model, truth: Truth, r: Floats) -> Floats:
    """Cumulative distribution (frame, pixel) at r (frame, pixel): the contract's equation (1), integrated."""
    s = model.sensor
    sigma = s.noise.scaled((10.0 / 1.2) ** 0.5).sigma
    total = s.outlier_probability * np.clip((r - s.range_min_mm) / (s.range_max_mm - s.range_min_mm), 0.0, 1.0)
    total += truth.weight_no_return.ravel() * special.ndtr((r - s.range_max_mm) / sigma(s.range_max_mm))
    for layer in range(truth.range_true.shape[2]):
        seen = layer < truth.n_modes.ravel()
        mu = truth.range_true[..., layer].ravel()[seen].astype(np.float64)
        total[:, seen] += truth.weight_true[..., layer].ravel()[seen] * special.ndtr((r[:, seen] - mu) / sigma(mu))
    return total


@pytest.mark.slow
def test_p_values_of_2000_pixels_against_equation_1_are_uniform() -> None:
    """The scene of the paper in pixels of one degree, so that one in eight is mixed; +-0.5 mm undoes the rounding."""
    scene = parse_model(builtin_text("three-boards"), source="three-boards")
    model = replace(scene, sensor=replace(scene.sensor, rows=40, cols=50, outlier_probability=0.02))
    truth = cast_scene(model)
    assert ((truth.n_modes + (truth.weight_no_return > 0)) > 1).sum() > 250
    stored = frames(model, 1000)[0].reshape(1000, -1).astype(np.float64)
    p_uniform = np.sort(
        _equation_1(model, truth, stored + np.random.default_rng(0).uniform(-0.5, 0.5, stored.shape)), 0
    )
    rank = np.arange(1000)[:, np.newaxis] / 1000
    distance = np.maximum(p_uniform - rank, rank + 1e-3 - p_uniform).max(axis=0)
    p = stats.kstwo.sf(distance, 1000)
    assert p.size == 2000
    assert stats.kstest(p, "uniform").pvalue > 1e-3
    assert p.min() > 1e-3 / p.size


def test_another_seed_gives_other_frames(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    assert (frames(model, 5)[0] != frames(model, 5, seed=4)[0]).mean() > 0.9


def test_a_frame_is_never_repeated(make_model: MakeModel) -> None:
    ranges = frames(make_model(*BOARDS), 50)[0]
    assert len({frame.tobytes() for frame in ranges}) == 50


def test_blocks_follow_each_other(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    blocks = list(render_blocks(model, cast_scene(model), n_frames=25, seed=1, block_frames=10))
    assert [(block.start, block.stop) for block in blocks] == [(0, 10), (10, 20), (20, 25)]
    np.testing.assert_allclose(np.concatenate([block.time_s for block in blocks]), np.arange(25) / 25.0)
    for block in blocks:
        assert block.range_mm.shape == block.amplitude.shape == (block.stop - block.start, 9, 11)
        assert [str(a.dtype) for a in (block.range_mm, block.amplitude, block.time_s)] == [
            "uint16",
            "float32",
            "float64",
        ]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_number_of_frames(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    truth = cast_scene(model)

    def peak(n_frames: int) -> int:
        tracemalloc.start()
        for _ in render_blocks(model, truth, n_frames=n_frames, seed=1, block_frames=50):
            pass
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(50)
    assert peak(2000) < 1.5 * peak(100)


@pytest.mark.parametrize("option", ["n_frames", "block_frames", "threads", "seed"])
def test_numbers_below_their_least_are_refused_at_once(make_model: MakeModel, option: str) -> None:
    model = make_model(*BOARDS)
    options: dict[str, Any] = {"n_frames": 1, "seed": 1} | {option: -1}
    with pytest.raises(ValueError, match=f"^{option}: -1 is not at least"):
        render_blocks(model, cast_scene(model), **options)


def test_an_error_in_a_thread_is_raised(make_model: MakeModel, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise MemoryError

    model = make_model(*BOARDS)
    blocks = render_blocks(model, cast_scene(model), n_frames=4, seed=1, threads=2)
    monkeypatch.setattr("tofmix.simulation.render.stored_range", broken)
    with pytest.raises(MemoryError):
        next(blocks)


def test_sensor_is_the_models(make_model: MakeModel) -> None:
    model = make_model(*BOARDS)
    sensor = recording_sensor(model)
    assert (sensor.name, sensor.range_max_mm, sensor.outlier_probability) == ("SR-3000", 7500.0, 1e-4)
    assert sensor.noise is not None
    np.testing.assert_allclose(sensor.noise.sigma(2000.0), 13 * (10 / 1.2) ** 0.5)


def test_frame_block_counts_its_frames() -> None:
    block = FrameBlock(
        start=7,
        range_mm=np.ones((2, 1, 1), np.uint16),
        amplitude=np.ones((2, 1, 1), np.float32),
        time_s=np.zeros(2),
    )
    assert block.stop == 9

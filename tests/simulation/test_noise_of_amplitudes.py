"""Amplitudes have the noise of the phasor along it: A sigma 2 pi / d_u, whatever gave A and sigma."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.effect_bench import Bench, Floats, effect, light_alone

from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.effects import Effect
from tofmix.simulation.model import Model
from tofmix.simulation.render import render_blocks

TURN = 299_792_458_000.0 / 20.0e6 / 2.0
FRAMES = 400


@pytest.fixture(scope="module")
def bench() -> Bench:
    """The two scenes."""
    return Bench()


def frames(model: Model, *, block_frames: int = FRAMES, averaged: bool = False, threads: int = 1) -> tuple[Floats, ...]:
    """Ranges and amplitudes (frame, pixel)."""
    blocks = list(
        render_blocks(
            model,
            cast_scene(model),
            n_frames=FRAMES,
            seed=3,
            block_frames=block_frames,
            averaged=averaged,
            threads=threads,
        )
    )
    ranges, amplitudes = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("range_mm", "amplitude"))
    return ranges.reshape(FRAMES, -1).astype(np.float64), amplitudes.reshape(FRAMES, -1).astype(np.float64)


@pytest.mark.parametrize(
    ("effects", "light", "noise"),
    [
        ((), 1.0, 1.0),
        ((effect("excess_noise", factor=1.5),), 1.0, 1.5),
        ((effect("multipath", surface="wall", share=0.5, extra_path_mm=2 * TURN),), 1.5, 1.0),
        ((effect("range_offset", offset_mm=500.0),), 1.0, 1.0),
    ],
    ids=["no effect", "excess noise", "more light", "bias"],
)
def test_noise_has_the_standard_deviation_of_the_phasor(
    bench: Bench, effects: tuple[Effect, ...], light: float, noise: float
) -> None:
    recorded = bench.wall(*effects, frames=1)
    expected = recorded.true_amplitude * light
    sigma = recorded.true_amplitude * recorded.sigma(recorded.true_mm) * noise * 2 * math.pi / TURN
    ranges, amplitude = frames(recorded.model)
    z = (amplitude - expected) / sigma
    assert abs(z.mean()) < 4 / z.size**0.5
    assert (z**2).mean() == pytest.approx(1, abs=4 * (2 / z.size) ** 0.5)
    of_range = ranges - ranges.mean(axis=0)
    assert abs(np.corrcoef(z.ravel(), (of_range / of_range.std(axis=0)).ravel())[0, 1]) < 4 / z.size**0.5


@pytest.mark.parametrize("averaged", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("effects", [(), (effect("flying_pixels", probability=0.5), effect("dropout", threshold=30.0))])
def test_ranges_are_those_without_noise_in_amplitudes(
    bench: Bench, effects: tuple[Effect, ...], averaged: bool
) -> None:
    base = bench.boards(*effects, frames=1).model
    model = replace(base, sensor=replace(base.sensor, default_integration_time_ms=10.0))
    ranges, amplitude = frames(model, averaged=averaged)
    with light_alone():
        plain, light = frames(model, averaged=averaged)
    np.testing.assert_array_equal(ranges, plain)
    np.testing.assert_array_equal(amplitude[light == 0], 0)
    assert (amplitude != light)[light > 0].mean() > 0.99


def test_blocks_and_threads_change_no_amplitude(bench: Bench) -> None:
    for effects in ((), (effect("temporal_correlation", coefficient=0.5),)):
        model = bench.boards(*effects, frames=1).model
        one, other = frames(model), frames(model, block_frames=7, threads=3)
        np.testing.assert_array_equal(one[1], other[1])


def test_without_a_frequency_amplitudes_have_no_noise(bench: Bench) -> None:
    for effects in ((), (effect("excess_noise", factor=2.0),)):
        recorded = bench.wall(*effects, frames=1, modulation_frequency_hz=None)
        _, amplitude = frames(recorded.model)
        np.testing.assert_array_equal(amplitude, np.broadcast_to(recorded.true_amplitude, amplitude.shape))


def test_negative_amplitudes_are_stored_as_0(bench: Bench) -> None:
    """Noise of two thirds of the amplitude: 7 % would be below 0."""
    recorded = bench.wall(effect("excess_noise", factor=20.0), frames=1)
    _, amplitude = frames(recorded.model)
    assert amplitude.min() == 0


def test_noise_of_amplitudes_has_the_memory_of_the_range(bench: Bench) -> None:
    recorded = bench.wall(effect("temporal_correlation", coefficient=0.6), frames=1)
    _, amplitude = frames(recorded.model)
    z = (amplitude - recorded.true_amplitude) / recorded.true_amplitude
    assert np.mean(z[1:] * z[:-1]) / np.mean(z**2) == pytest.approx(0.6, abs=0.02)


def test_a_mean_has_the_noise_of_its_exposures(bench: Bench) -> None:
    """Of the whole time: with the exponent 0.5, sigma falls with the root of it."""
    base = bench.wall(frames=1)
    sensor = replace(base.model.sensor, default_integration_time_ms=10.0, exponent=0.5)
    model = replace(base.model, sensor=sensor)
    _, amplitude = frames(model, averaged=True)
    with light_alone():
        _, light = frames(model, averaged=True)
    whole = base.true_amplitude * 10.0 / 1.2
    z = (amplitude - light) / (whole * base.sigma(base.true_mm) * (1.2 / 10.0) ** 0.5 * 2 * math.pi / TURN)
    assert (z**2).mean() == pytest.approx(1, abs=4 * (2 / z.size) ** 0.5)

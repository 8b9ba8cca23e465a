from collections.abc import Callable

import numpy as np
from support.unpacking import samples_of

from tofmix.recording import ArrayRecording
from tofmix.report.explorer.packing import PackedSamples, PageLimits, pack_numbers, pack_samples
from tofmix.sensor import NoiseCurve, Sensor

CURVE = NoiseCurve(np.array([500.0, 7500.0]), np.array([9.0, 430.0]))


def unpacked(packed: PackedSamples | None, pixel: int, pixels: int) -> list[float]:
    assert packed is not None
    specs, data = pack_numbers({"counts": (packed.counts, 1.0)})
    counts = {"arrays": specs, "data": data}
    held = {"data": packed.text, "ranks": packed.ranks, "step": packed.step_mm, "offset": packed.offset_mm}
    return samples_of({"samples": held | {"counts": counts}}, pixel, pixels)


def test_whole_millimetres_come_back_exactly() -> None:
    rng = np.random.default_rng(3)
    samples = rng.normal(4000, 900, (40, 3, 4)).round()
    samples[rng.random(samples.shape) < 0.2] = np.nan
    samples[:, 0, 1] = np.nan
    packed = pack_samples(ArrayRecording(samples, Sensor(name="x")), start=5, stop=35, noise=CURVE, characters=10**6)
    assert packed is not None
    assert (packed.step_mm, packed.frames_kept, packed.frames) == (1.0, 30, 30)
    for pixel in range(12):
        expected = samples[5:35].reshape(30, 12)[:, pixel]
        assert unpacked(packed, pixel, 12) == sorted(expected[np.isfinite(expected)].tolist())


def test_fractions_and_negative_values_are_rounded_far_below_sigma() -> None:
    samples = np.random.default_rng(4).normal(10, 30, (50, 2, 2))
    packed = pack_samples(ArrayRecording(samples, Sensor(name="x")), start=0, stop=50, noise=CURVE, characters=10**6)
    assert packed is not None
    assert packed.step_mm == 0.1
    for pixel in range(4):
        expected = np.sort(samples.reshape(50, 4)[:, pixel])
        np.testing.assert_allclose(unpacked(packed, pixel, 4), expected, rtol=0, atol=0.0501)


def test_very_long_ranges_are_rounded_more_roughly() -> None:
    samples = np.array([10.0, 400_000.0]).repeat(8).reshape(16, 1, 1)
    packed = pack_samples(ArrayRecording(samples, Sensor(name="x")), start=0, stop=16, noise=None, characters=10**6)
    assert packed is not None
    assert packed.step_mm == 8.0
    np.testing.assert_allclose(unpacked(packed, 0, 1), np.sort(samples.ravel()), atol=4.0)


def test_packed_samples_stay_below_the_limit_of_characters() -> None:
    samples = np.random.default_rng(5).normal(4000, 400, (60, 5, 6)).round()
    recording = ArrayRecording(samples, Sensor(name="x"))
    whole = pack_samples(recording, start=0, stop=60, noise=CURVE, characters=10**6)
    assert whole is not None
    room = len(whole.text) // 2
    packed = pack_samples(recording, start=0, stop=60, noise=CURVE, characters=room)
    assert packed is not None
    assert packed.step_mm > 1
    assert len(packed.text) <= room + 3  # base64 fills up to fours
    expected = np.sort(samples.reshape(60, 30)[:, 7])
    np.testing.assert_allclose(unpacked(packed, 7, 30), expected, rtol=0, atol=packed.step_mm / 2)


def test_frames_of_long_windows_are_thinned_evenly(make_recording: Callable[..., ArrayRecording]) -> None:
    samples = np.arange(100.0)[:, None, None] + np.ones((100, 2, 3))
    for block in (1 << 21, 7):
        packed = pack_samples(
            ArrayRecording(samples, Sensor(name="x")),
            start=0,
            stop=100,
            noise=None,
            characters=10**6,
            limits=PageLimits(samples=20 * 6),
            block_samples=block,
        )
        assert packed is not None
        assert (packed.frames_kept, packed.frames) == (20, 100)
        found = unpacked(packed, 4, 6)
        assert (found[0], found[-1]) == (1.0, 100.0)
        assert set(np.diff(found)) == {5.0, 6.0}
    large = make_recording((50, 9, 11))
    assert (
        pack_samples(large, start=0, stop=50, noise=None, characters=10**6, limits=PageLimits(samples=20 * 6)) is None
    )


def test_packing_without_room_ends() -> None:
    samples = np.random.default_rng(6).normal(4000, 400, (20, 2, 2)).round()
    packed = pack_samples(ArrayRecording(samples, Sensor(name="x")), start=0, stop=20, noise=None, characters=1)
    assert packed is not None
    assert packed.step_mm > 2000

"""The explorer's page and the arrays that it unpacks."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from support.alike import MakeLayers, MakeRecording, MakeSource
from support.learnt_noises import ALL, Parts, camera
from support.unpacking import samples_of, unpack

from tofmix.layers import LayersSource
from tofmix.recording import ArrayRecording, SampleSource
from tofmix.report.averaging import average_layers
from tofmix.report.explorer import (
    DEFAULT_LIMITS,
    Explorer,
    PackedSamples,
    PageLimits,
    make_explorer,
    pack_numbers,
    pack_samples,
    windows_around,
)
from tofmix.sensor import NoiseCurve, Sensor


def made(
    source: LayersSource, recording: SampleSource | None = None, window: int = 0, limits: PageLimits = DEFAULT_LIMITS
) -> Explorer | None:
    layers = source.read_window(window)
    return make_explorer(
        source,
        recording=recording,
        window=window,
        layers=layers,
        averaged=average_layers(layers),
        scale=(700, 7000),
        limits=limits,
    )


def content(found: Explorer | None) -> dict[str, Any]:
    assert found is not None
    settings: dict[str, Any] = json.loads(found.text)
    return settings


def test_every_number_of_a_window_comes_back(make_layers: MakeLayers, make_source: MakeSource) -> None:
    layers = make_layers()
    (window,) = content(made(make_source(layers)))["windows"]
    arrays = unpack(window)
    for name, unit in (("n_modes", 1), ("n_peaks", 1), ("status", 1), ("n_samples", 1), ("weight_no_return", 1e-4)):
        found = np.array([np.nan if v is None else v for v in arrays[name]])
        np.testing.assert_allclose(found, getattr(layers, name).ravel(), atol=0.5001 * unit)
    present = np.arange(layers.max_layers) < layers.n_modes[..., None]
    for name, unit in (("range", 0.01), ("range_stderr", 0.01), ("weight", 1e-4), ("sigma", 0.01)):
        np.testing.assert_allclose(
            np.array(arrays[name], dtype=float), getattr(layers, name)[present], rtol=1e-7, atol=0.5001 * unit
        )
    assert set(arrays["probability"]) == {None}  # these layers do not know it
    assert window["samples"] is None


def test_all_windows_are_in_a_small_page(
    make_layers: MakeLayers, make_source: MakeSource, make_recording: MakeRecording
) -> None:
    source = make_source(*(make_layers(seed=k) for k in range(3)))
    recording = make_recording((150, 9, 11))
    found = made(source, recording, window=1)
    settings = content(found)
    assert found is not None
    assert found.note == "All 3 windows are in this page. Samples are rounded to 0.1 mm."
    assert settings["shown"] == 1
    assert [window["window"] for window in settings["windows"]] == [0, 1, 2]
    samples = np.asarray(recording.read_range(slice(100, 150), slice(0, 9))).reshape(50, 99)
    for pixel in (0, 1, 57):
        expected = np.sort(samples[np.isfinite(samples[:, pixel]), pixel])
        np.testing.assert_allclose(samples_of(settings["windows"][2], pixel, 99), expected, atol=0.051)


def test_large_pages_hold_the_windows_around_the_chosen_one(make_layers: MakeLayers, make_source: MakeSource) -> None:
    source = make_source(*(make_layers() for _ in range(9)))
    three = 3 * 99 + 50
    chosen = [list(windows_around(source, k, with_samples=False, limits=PageLimits(pixels=three))) for k in (0, 4, 8)]
    assert chosen == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    found = made(source, window=4, limits=PageLimits(pixels=three))
    assert found is not None
    assert found.note.startswith("This page holds windows 3 to 5 of 0 to 8; --window chooses others.")
    assert list(windows_around(source, 5, with_samples=False, limits=PageLimits(pixels=1))) == [5]
    many = make_source(*[make_layers()] * 80)
    assert list(windows_around(many, 5, with_samples=False, limits=PageLimits(pixels=10_000))) == list(range(50))
    assert list(windows_around(source, 5, with_samples=True, limits=PageLimits(samples=2 * 50 * 99))) == [4, 5]


def test_names_cannot_end_the_script_and_omitted_samples_are_stated(
    make_layers: MakeLayers, make_source: MakeSource, make_recording: MakeRecording
) -> None:
    source, recording = make_source(make_layers()), make_recording()
    for most, expected in ((30 * 99, "Of the 50 frames of a window, 30 are shown."), (99, "too large for samples")):
        found = made(source, recording, limits=PageLimits(samples=most))
        assert found is not None
        assert expected in found.note
    assert made(source, recording, limits=PageLimits(image_pixels=98)) is None
    found = made(make_source(make_layers()))
    assert found is not None
    assert "<" not in found.text


def test_components_have_the_learnt_shape_and_a_gaussian_has_no_note(
    make_layers: MakeLayers, make_source: MakeSource
) -> None:
    layers = make_layers()
    assert not {"shape", "background"} & set(content(made(make_source(layers))))
    first, step, densities = content(made(make_source(layers, sensor=camera(ALL, (9, 11)))))["shape"]
    assert ALL.shape is not None
    z = first + step * np.arange(len(densities))
    np.testing.assert_allclose(densities, ALL.shape.pdf(z), atol=1e-5)
    assert step * sum(densities) == pytest.approx(1.0, abs=0.01)
    background = content(made(make_source(layers, sensor=camera(Parts(background=0.2), (9, 11)))))
    assert background["background"] is True
    assert "shape" not in background


CURVE = NoiseCurve(np.array([500.0, 7500.0]), np.array([9.0, 430.0]))


def unpacked(packed: PackedSamples | None, pixel: int, pixels: int) -> list[float]:
    assert packed is not None
    specs, data = pack_numbers({"counts": (packed.counts, 1.0)})
    counts = {"arrays": specs, "data": data}
    held = {"data": packed.text, "ranks": packed.ranks, "step": packed.step_mm, "offset": packed.offset_mm}
    return samples_of({"samples": held | {"counts": counts}}, pixel, pixels)


def test_samples_come_back_exactly_and_stay_below_the_limit() -> None:
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

"""What is said of a result: few frames, flying pixels, lost samples, averages."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.alike import MakeLayers, MakeSource

from tofmix.circle import unambiguous_range_mm
from tofmix.flags import MixingLaw, Status
from tofmix.layers import Layers
from tofmix.recording import ArrayRecording
from tofmix.report.averaging import Averaging, average_layers, average_samples
from tofmix.report.summary.findings import (
    AMPLITUDES,
    DEFAULT_THRESHOLDS,
    FREQUENCY,
    PHASOR_SUMS,
    SINGLE_SAMPLES,
    AskedFrames,
    Remedy,
    Thresholds,
    count_findings,
    frame_findings,
    lacking,
    light_findings,
    sample_findings,
    sigma_findings,
)
from tofmix.report.summary.lost import UNKNOWN_CAUSE, LostTally, cause_of_loss
from tofmix.report.summary.summary import summarise
from tofmix.sensor import Sensor
from tofmix.sensor_schema import Measurement

REMEDY = Remedy(recording="a b.h5", window_frames=40, windows=2)


@pytest.mark.parametrize(
    ("median", "codes"), [(1.0, []), (1.09, []), (1.2, ["sigma_off_curve"]), (0.8, ["sigma_off_curve"]), (None, [])]
)
def test_sigma_off_the_curve_is_reported(median: float | None, codes: list[str]) -> None:
    assert [f.code for f in sigma_findings(count=1000, median=median, has_curve=True, remedy=REMEDY)] == codes


def test_counts_have_a_finding_each_and_sound_layers_none() -> None:
    by_status = {"ok": 70, "too_few_samples": 10, "not_converged": 10, "degenerate": 10}
    found = count_findings(pixels=100, by_status=by_status, by_surfaces=[0, 50, 50], max_layers=2, remedy=REMEDY)
    assert [f.code for f in found] == ["too_few_samples", "not_converged", "degenerate", "all_layers_used"]
    assert "10.0 %" in found[0].text
    assert found[-1].commands == ("tofmix estimate 'a b.h5' --max-layers 4 --overwrite",)
    assert found[0].line.endswith("Try: tofmix estimate 'a b.h5' --window 80 --overwrite")
    assert count_findings(pixels=100, by_status={"ok": 100}, by_surfaces=[0, 96, 4], max_layers=2, remedy=REMEDY) == []
    found = count_findings(pixels=10, by_status={}, by_surfaces=[10, 0], max_layers=1, remedy=REMEDY)
    assert [f.code for f in found] == ["no_surface_anywhere"]


def test_close_layers_name_the_remedies_that_were_not_tried() -> None:
    def commands(remedy: Remedy) -> tuple[str, ...]:
        found = count_findings(pixels=10, by_status={}, by_surfaces=[0, 9, 1], max_layers=4, close=1, remedy=remedy)
        return found[0].commands

    assert [c.split()[-3:-1] for c in commands(REMEDY)] == [["--window", "13"], ["--noise", "auto"]]
    slanted = count_findings(pixels=10, by_status={}, by_surfaces=[0, 9, 1], max_layers=4, close=1, remedy=REMEDY)
    assert "slanted or rough within a pixel" in slanted[0].text
    measured = Remedy(recording="a.h5", noise="auto", window_frames=40)
    assert [c.split()[-3:-1] for c in commands(measured)] == [["--window", "13"]]
    paper = Remedy(recording="a.h5", window_frames=40, paper=True)
    found = count_findings(pixels=10, by_status={}, by_surfaces=[0, 9, 1], max_layers=4, close=1, remedy=paper)
    assert found[0].commands == ("tofmix estimate a.h5 --overwrite",)
    assert "--paper causes them too" in found[0].text
    assert paper.shorter() == "tofmix estimate a.h5 --paper --window 13 --overwrite"


@pytest.mark.parametrize(
    ("scatter", "drift", "codes"),
    [
        (None, None, []),
        (0.51, 0.9 * DEFAULT_THRESHOLDS.drift_sigmas, []),
        (1.9, None, []),
        (0.49, None, ["scatter_off_curve"]),
        (2.1, 1.1 * DEFAULT_THRESHOLDS.drift_sigmas, ["scatter_off_curve", "drift"]),
    ],
)
def test_contradiction_of_the_curve_is_reported(scatter: float | None, drift: float | None, codes: list[str]) -> None:
    found = sample_findings(scatter_over_curve=scatter, drift_sigmas=drift, remedy=REMEDY)
    assert [f.code for f in found] == codes
    assert all(f.commands for f in found)


def test_thresholds_set_when_close_layers_are_a_finding() -> None:
    def codes(thresholds: Thresholds) -> list[str]:
        found = count_findings(
            pixels=100,
            by_status={},
            by_surfaces=[0, 90, 10],
            max_layers=6,
            close=10,
            remedy=Remedy(recording="a.h5"),
            thresholds=thresholds,
        )
        return [finding.code for finding in found]

    assert codes(Thresholds()) == ["close_layers"]
    assert codes(Thresholds(close_share=0.1)) == []


ROOT = Path(__file__).parents[3]


def column(page: str, head: str) -> dict[int, float]:
    """A column of the table of a page's section "By number of frames": figures by frames."""
    section = (ROOT / page.partition("#")[0]).read_text(encoding="utf-8").partition("### By number of frames")[2]
    lines = re.findall(r"^\|.*\|$", section, re.MULTILINE)
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    place = table[0].index(head)
    rows = table[2:]
    last = next((k for k, row in enumerate(rows) if not row[0].isdigit()), len(rows))
    return {int(row[0]): float(row[place]) for row in rows[:last]}


@pytest.mark.parametrize(
    ("asked", "head"), [(SINGLE_SAMPLES, "0.2, 4 sigma"), (PHASOR_SUMS, "exactly both")], ids=["samples", "sums"]
)
def test_figures_are_those_of_the_table_up_to_the_frames_asked_for(asked: AskedFrames, head: str) -> None:
    table = column(asked.page, head)
    assert len(table) > len(asked.found) >= 4
    assert dict(asked.found) == {frames: figure for frames, figure in table.items() if frames <= asked.frames}
    assert max(asked.found) == asked.frames
    assert list(asked.found.values()) == sorted(asked.found.values())


@pytest.mark.parametrize(("sums", "least"), [(False, 25), (True, 10)])
def test_a_note_is_made_below_the_frames_asked_for_alone(sums: bool, least: int) -> None:
    def made(frames: int) -> list[str]:
        remedy = Remedy(recording="a.h5", window_frames=frames)
        return [finding.code for finding in frame_findings(sums=sums, total=frames, remedy=remedy)]

    assert made(least) == made(4000) == []
    assert made(least - 1) == made(1) == ["few_frames"]


@pytest.mark.parametrize(
    ("frames", "said"),
    [
        (7, "33 % are found with 7 frames"),
        (11, "less than 73 % are found with 11 frames"),
        (1, "before another, 0 % are found with 1 frame,"),
    ],
)
def test_the_figure_is_that_of_the_row_or_below_the_next_one(frames: int, said: str) -> None:
    (finding,) = frame_findings(sums=False, total=frames, remedy=Remedy(recording="a.h5", window_frames=frames))
    assert said in finding.text
    assert f"{frames} frame{'s' * (frames > 1)} a window; tofmix asks for 25 or more." in finding.text
    assert "and 93 % with 25 (docs/results/limits.md#by-number-of-frames)" in finding.text
    assert finding.is_note


@pytest.mark.parametrize(("total", "window"), [(18, "18"), (25, "25"), (900, "25")])
def test_a_longer_window_is_advised_where_the_recording_has_frames(total: int, window: str) -> None:
    (finding,) = frame_findings(sums=False, total=total, remedy=Remedy(recording="a.h5", window_frames=9))
    assert finding.commands == (f"tofmix estimate a.h5 --window {window} --overwrite",)
    assert "Record more" not in finding.text


@pytest.mark.parametrize(
    ("options", "share", "asked"),
    [
        ({"mixing": "auto"}, 0.05, 10),
        ({"mixing": "auto"}, 0.04, 25),
        ({"mixing": "auto"}, math.nan, 25),
        ({"mixing": "phasor"}, math.nan, 10),
    ],
)
def test_the_law_of_mixing_or_the_option_settles_which_frames_are_asked_for(
    make_layers: MakeLayers, make_source: MakeSource, options: dict[str, str], share: float, asked: int
) -> None:
    source = replace(
        make_source(make_layers(), options={"window": 9} | options),
        frames=9,
        law=MixingLaw(phasor_share=share, pixels=70),
    )  # type: ignore[type-var]
    (note,) = summarise(source).notes
    assert f"9 frames a window; tofmix asks for {asked} or more." in note.text


LOCK_IN = Sensor(name="a", measurement=Measurement.LOCK_IN)
ONE_FREQUENCY = Sensor(name="b", modulation_frequency_hz=31.0e6)
UNKNOWN = Sensor(name="Kinect v2")
"""A name is no declaration."""


def codes(sensor: Sensor, *, targets: int = 0, has_amplitude: bool | None = None, unmix: bool = True) -> list[str]:
    remedy = Remedy(recording="x.h5", has_amplitude=has_amplitude, unmix=unmix)
    return [one.code for one in light_findings(sensor, targets=targets, remedy=remedy)]


@pytest.mark.parametrize("has_amplitude", [True, False, None])
def test_a_lock_in_camera_without_frequency_is_warned_of(has_amplitude: bool | None) -> None:
    remedy = Remedy(recording="x.h5", has_amplitude=has_amplitude)
    (found,) = light_findings(LOCK_IN, targets=0, remedy=remedy)
    assert (found.code, found.is_note) == ("flying_pixels_counted", False)
    assert "no modulation frequency" in found.text
    assert ("no amplitudes" in found.text) is (has_amplitude is False)
    assert "are counted as surfaces" in found.text
    command = "tofmix import SOURCE -o x.h5 --amplitude AMPLITUDES --modulation-frequency HZ --overwrite"
    assert found.commands == (command,)


def test_missing_amplitudes_are_named_as_far_as_they_are_known() -> None:
    (found,) = light_findings(ONE_FREQUENCY, targets=0, remedy=Remedy(recording="x.h5", has_amplitude=False))
    assert "has no amplitudes:" in found.text
    assert found.commands == ("tofmix import SOURCE -o x.h5 --amplitude AMPLITUDES --overwrite",)
    (found,) = light_findings(ONE_FREQUENCY, targets=0, remedy=Remedy(recording="x.h5"))
    assert "has no amplitudes, or --mixing events was chosen" in found.text
    assert lacking(UNKNOWN, has_amplitude=False) == (AMPLITUDES, FREQUENCY)
    assert lacking(UNKNOWN, has_amplitude=None) == (FREQUENCY,)
    assert lacking(ONE_FREQUENCY, has_amplitude=True) == ()


def test_flying_pixels_are_a_note_for_unknown_cameras_and_nothing_where_all_is_known() -> None:
    (found,) = light_findings(UNKNOWN, targets=0, remedy=Remedy(recording="x.h5", has_amplitude=False))
    assert (found.code, found.is_note) == ("mixing_not_measured", True)
    assert "has no amplitudes and no modulation frequency. If this is a lock-in camera, flying pixels" in found.text
    assert codes(UNKNOWN, targets=2, has_amplitude=False) == []
    assert codes(ONE_FREQUENCY, has_amplitude=True) == []
    assert codes(LOCK_IN, has_amplitude=False, unmix=False) == []


@pytest.mark.parametrize("measurement", [Measurement.PULSES, Measurement.STEREO])
def test_other_cameras_are_never_called_lock_in(measurement: Measurement) -> None:
    sensor = Sensor(name="a", measurement=measurement)
    assert [codes(sensor, has_amplitude=has) for has in (True, False, None)] == [[], [], []]


SHAPE = (20, 30)
BOX = (slice(4, 16), slice(10, 19))  # 108 pixels


def tally_of(in_box: float) -> LostTally:
    lost = np.zeros(SHAPE, np.float32)
    lost[BOX] = in_box
    status = np.where(lost > 0.97, int(Status.TOO_FEW_SAMPLES), int(Status.OK)).astype(np.uint8)
    tally = LostTally()
    tally.add(lost, status, 100)
    return tally


def test_pixels_without_a_valid_sample_are_counted_placed_and_explained() -> None:
    tally = tally_of(1.0)
    (finding,) = tally.findings()
    assert finding.code == "no_valid_sample"
    assert "No sample of 108 pixels is valid (within rows 4 to 15, columns 10 to 18)" in finding.text
    assert UNKNOWN_CAUSE in finding.text
    assert not finding.is_note
    assert tally.too_few == 108
    (told,) = tally.findings(lambda pixels: f"{pixels.sum()} dark")
    assert ": 108 dark." in told.text


def test_pixels_that_lose_most_samples_are_named_and_no_loss_is_not() -> None:
    (finding,) = tally_of(0.95).findings()
    assert finding.code == "lost_samples"
    assert "108 pixels lose 95 % of the samples" in finding.text
    nothing = tally_of(0.0)
    assert nothing.findings() == []
    assert nothing.numbers() is None
    numbers = tally_of(0.95).numbers()
    assert numbers is not None
    assert (numbers.pixels_without_sample, numbers.pixels_at_limit) == (0, 108)
    assert numbers.mean_share == pytest.approx(0.95 * 108 / 600)


def test_layers_of_old_versions_have_no_numbers() -> None:
    tally = LostTally()
    tally.add(None, np.zeros(SHAPE, np.uint8), 100)
    assert tally.numbers() is None
    assert tally.findings() == []


@pytest.mark.parametrize(
    ("of_lost", "cause"), [(3.0, "too dark"), (4000.0, "saturated"), (200.0, UNKNOWN_CAUSE), (0.0, UNKNOWN_CAUSE)]
)
def test_amplitudes_of_lost_samples_tell_the_cause(of_lost: float, cause: str) -> None:
    rng = np.random.default_rng(4)
    pixels = np.zeros(SHAPE, bool)
    pixels[BOX] = True
    samples = np.where(pixels, np.nan, 1000.0 + np.zeros((20, *SHAPE)))
    light = np.where(pixels, of_lost, rng.uniform(100.0, 300.0, samples.shape))
    recording = ArrayRecording(samples, Sensor(name="a"), light)
    assert cause_of_loss(recording, pixels).startswith(cause)
    assert cause_of_loss(ArrayRecording(samples, Sensor(name="a")), pixels) == UNKNOWN_CAUSE


PERIOD = unambiguous_range_mm(20.0e6)


def test_the_mean_keeps_to_the_turn_of_the_samples() -> None:
    class WithAmplitude(ArrayRecording):
        has_amplitude = True

        def read_amplitude(self, frames: slice, rows: slice) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
            return np.ones_like(self.read_range(frames, rows))

    sensor = Sensor(name="far", modulation_frequency_hz=20.0e6)
    recording = WithAmplitude(np.full((4, 1, 1), 2.4 * PERIOD), sensor)
    assert average_samples(recording, start=0, stop=4).range_mm[0, 0] == pytest.approx(2.4 * PERIOD, rel=1e-6)


def test_averages_are_by_direction_of_light(make_recording: Callable[..., object]) -> None:
    recording = make_recording((40, 1, 2))
    recording.range_mm[::2], recording.range_mm[1::2] = 2400, 3600  # type: ignore[attr-defined]
    image = average_samples(recording, start=0, stop=40)  # type: ignore[arg-type]
    assert ((image.range_mm > 2500) & (image.range_mm < 3500)).all()
    recording = make_recording((30, 3, 4))
    recording.amplitude[...] = 0  # type: ignore[attr-defined]
    image = average_samples(recording, start=0, stop=30)  # type: ignore[arg-type]
    expected = np.nanmean(recording.range_mm[:, 1:], axis=0)  # type: ignore[attr-defined]
    np.testing.assert_allclose(image.range_mm[1:], expected, rtol=1e-6)
    assert np.isnan(image.range_mm[0, 0])


def test_without_amplitude_or_frequency_the_plain_mean(make_recording: Callable[..., object]) -> None:
    recording = make_recording((30, 3, 4))
    samples = recording.range_mm.astype(np.float64)  # type: ignore[attr-defined]
    expected = np.full((3, 4), np.nan)
    known = np.isfinite(samples).any(axis=0)
    expected[known] = np.nanmean(samples[:, known], axis=0)
    bare = replace(recording, sensor=Sensor(name="no frequency"))  # type: ignore[type-var]
    dim = replace(recording, has_amplitude=False)  # type: ignore[type-var]
    plain = ArrayRecording(samples, Sensor(name="plain", modulation_frequency_hz=20.0e6))
    for case in (bare, dim, plain):
        image = average_samples(case, start=0, stop=30)  # type: ignore[arg-type]
        assert image.averaging is Averaging.PLAIN
        np.testing.assert_allclose(image.range_mm, expected, rtol=1e-6)


def test_layers_average_by_their_shares(make_layers: MakeLayers) -> None:
    layers = make_layers((6, 5))
    image = average_layers(layers)
    assert image.averaging is Averaging.LAYERS
    for pixel in np.ndindex(6, 5):
        n = int(layers.n_modes[pixel])
        weight, range_mm = layers.weight[pixel][:n].astype(float), layers.range[pixel][:n].astype(float)
        expected = float((weight * range_mm).sum() / weight.sum()) if n else math.nan
        assert image.range_mm[pixel] == pytest.approx(expected, nan_ok=True)


def test_means_and_layers_on_a_circle_are_averaged_by_direction() -> None:
    samples = np.where(np.arange(40) % 2, 30.0, 5980.0)[:, np.newaxis, np.newaxis]
    recording = ArrayRecording(np.concatenate([samples, np.full((40, 1, 1), np.nan)], axis=2), Sensor(name="x"))
    image = average_samples(recording, start=0, stop=40, unambiguous_range_mm=6000.0)
    assert image.averaging is Averaging.CIRCULAR
    assert image.range_mm[0, 0] == pytest.approx(5.0, abs=1e-3)
    assert np.isnan(image.range_mm[0, 1])
    layers = Layers.empty((1, 2), 2)
    layers.range[0, 0], layers.weight[0, 0] = (30.0, 5980.0), (0.5, 0.5)
    image = average_layers(layers, unambiguous_range_mm=6000.0)
    assert image.range_mm[0, 0] == pytest.approx(5.0, abs=1e-3)
    assert np.isnan(image.range_mm[0, 1])

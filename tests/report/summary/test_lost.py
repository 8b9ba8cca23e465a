"""Lost samples in words."""

import numpy as np
import pytest

from tofmix.flags import Status
from tofmix.recording import ArrayRecording
from tofmix.report.summary.lost import UNKNOWN_CAUSE, LostTally, cause_of_loss
from tofmix.sensor import Sensor

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

"""What is said of flying pixels that are not unmixed, by the kind of camera and by what is missing."""

import pytest

from tofmix.measurement import Measurement
from tofmix.report.summary.findings import AMPLITUDES, FREQUENCY, Remedy, lacking, light_findings
from tofmix.sensor import Sensor

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


def test_missing_amplitudes_alone_are_named_and_asked_for_alone() -> None:
    (found,) = light_findings(ONE_FREQUENCY, targets=0, remedy=Remedy(recording="x.h5", has_amplitude=False))
    assert "has no amplitudes:" in found.text
    assert found.commands == ("tofmix import SOURCE -o x.h5 --amplitude AMPLITUDES --overwrite",)


def test_a_layers_file_alone_does_not_tell_missing_amplitudes_from_the_option() -> None:
    (found,) = light_findings(ONE_FREQUENCY, targets=0, remedy=Remedy(recording="x.h5"))
    assert "has no amplitudes, or --mixing events was chosen" in found.text


def test_an_unknown_camera_gets_a_note_under_the_condition_that_it_is_lock_in() -> None:
    (found,) = light_findings(UNKNOWN, targets=0, remedy=Remedy(recording="x.h5", has_amplitude=False))
    assert (found.code, found.is_note) == ("mixing_not_measured", True)
    assert "has no amplitudes and no modulation frequency. If this is a lock-in camera, flying pixels" in found.text


@pytest.mark.parametrize("measurement", [Measurement.PULSES, Measurement.STEREO])
def test_other_cameras_are_never_called_lock_in(measurement: Measurement) -> None:
    sensor = Sensor(name="a", measurement=measurement)
    assert [codes(sensor, has_amplitude=has) for has in (True, False, None)] == [[], [], []]


def test_nothing_is_said_of_several_targets_of_what_is_complete_or_of_a_choice() -> None:
    assert codes(UNKNOWN, targets=2, has_amplitude=False) == []
    assert codes(ONE_FREQUENCY, has_amplitude=True) == []
    assert codes(LOCK_IN, has_amplitude=False, unmix=False) == []


def test_lacking_names_amplitudes_only_where_they_are_known_to_be_missing() -> None:
    assert lacking(UNKNOWN, has_amplitude=False) == (AMPLITUDES, FREQUENCY)
    assert lacking(UNKNOWN, has_amplitude=None) == (FREQUENCY,)
    assert lacking(ONE_FREQUENCY, has_amplitude=True) == ()

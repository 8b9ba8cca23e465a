"""Which frames an estimate can use: averages are no samples of one surface, and phasors need amplitudes."""

from typing import TYPE_CHECKING

from tofmix.cli.estimate.request import Request
from tofmix.errors import BadInputError

if TYPE_CHECKING:
    from tofmix.io.recording.recording_file import RecordingFile


def check_frames(source: "RecordingFile", request: Request) -> None:
    """Refuse frames that the law of mixing cannot use, before noise is learnt from them.

    Raises
    ------
    BadInputError
        If phasors are wanted, and the recording has no amplitudes, no modulation frequency or several targets a frame,
        or its camera measures no phase; or if samples are wanted, and its root attribute `averaged` is a number other
        than 0.
    """
    if request.options.mixing == "phasor":
        _check_phasors(source)
    elif not request.force:
        _check_not_averaged(source)


def _check_not_averaged(recording: "RecordingFile") -> None:
    """Refuse a recording whose frames are marked as averages."""
    if recording.attributes().get("averaged", 0) in (0, "0", ""):
        return
    raise BadInputError(
        f"{recording.path}: marked as averaged: a mean does not separate surfaces;"
        " unmix them with --mixing phasor, record at an integration time that the camera does not average,"
        " or use the means as samples with --force"
    )


def _check_phasors(recording: "RecordingFile") -> None:
    """Refuse a recording whose samples are no phasors."""
    from tofmix.report.summary.light import OPTIONS, lacking

    if recording.targets:
        raise BadInputError(f"{recording.path}: several targets a frame, and --mixing phasor needs one sample a frame")
    sensor = recording.sensor
    if sensor.is_lock_in is False:
        raise BadInputError(
            f"{recording.path}: {sensor.name} is no lock-in camera (measurement: {sensor.measurement}), and --mixing"
            " phasor needs one"
        )
    if missing := lacking(sensor, has_amplitude=recording.has_amplitude):
        raise BadInputError(
            f"{recording.path}: no {' and no '.join(missing)}, which --mixing phasor needs; import the recording with"
            f" {' and '.join(OPTIONS[name][0] for name in missing)}"
        )

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
        If phasors are wanted, and the recording has no amplitudes, no modulation frequency, or several targets a
        frame; or if samples are wanted, and its root attribute `averaged` is a number other than 0.
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
    if recording.targets:
        raise BadInputError(f"{recording.path}: several targets a frame, and --mixing phasor needs one sample a frame")
    lacking = {
        "amplitudes": ("--amplitude", recording.has_amplitude),
        "modulation frequency": ("--sensor", recording.sensor.modulation_frequency_hz is not None),
    }
    wanted = {name: option for name, (option, is_there) in lacking.items() if not is_there}
    if wanted:
        raise BadInputError(
            f"{recording.path}: no {' and no '.join(wanted)}, which --mixing phasor needs; import the recording with"
            f" {' and '.join(wanted.values())}"
        )

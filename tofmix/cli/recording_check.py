"""Opening recordings, and whether one goes with a layers file; shared by the commands that read recordings."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from tofmix.io.layers_file import LayersFile
    from tofmix.io.recording_file import RecordingFile


@contextmanager
def opened_recording(path: Path) -> Iterator["RecordingFile"]:
    """Open a recording, and say on stderr what is doubtful about it.

    Raises
    ------
    BadInputError
        As `tofmix.io.recording_file.open_recording`.
    """
    from tofmix.io.recording_file import open_recording

    with open_recording(path) as recording:
        for line in recording.remarks:
            click.echo(f"tofmix: {line}", err=True)
        yield recording


def check_recording(file: "LayersFile", source: "RecordingFile") -> None:
    """Refuse a recording of another size; say so where it is merely another one.

    Raises
    ------
    BadInputError
        If its image or its frames are not those of the layers.
    """
    from tofmix.errors import BadInputError
    from tofmix.io.recording_file import file_sha256

    if source.shape[1:] != file.shape[1:] or source.shape[0] < int(file.window_stop[-1]):
        raise BadInputError(
            f"{source.path}: range: shape {source.shape} does not go with {file.path}, which has"
            f" {file.shape[1]} x {file.shape[2]} pixels and windows up to frame {int(file.window_stop[-1])}"
        )
    if file_sha256(source.path) != file.provenance.source_sha256:
        click.echo(f"tofmix: {source.path} is not the recording that {file.path} was made from", err=True)

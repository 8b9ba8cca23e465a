"""Whether a recording goes with a layers file; shared by the commands that take both."""

from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from tofmix.io.layers_file import LayersFile
    from tofmix.io.recording_file import RecordingFile


def check_recording(file: "LayersFile", source: "RecordingFile") -> None:
    """Refuse a recording of another size; say so where it is merely another one.

    Raises
    ------
    BadInputError
        If its image or its frames are not those of the layers.
    """
    from tofmix.errors import BadInputError
    from tofmix.io.recording_file import file_sha256

    if source.shape[1:] != file.shape[1:] or source.frames < int(file.window_stop[-1]):
        raise BadInputError(
            f"{source.path}: range: shape {source.shape} does not go with {file.path}, which has"
            f" {file.shape[1]} x {file.shape[2]} pixels and windows up to frame {int(file.window_stop[-1])}"
        )
    if file_sha256(source.path) != file.provenance.source_sha256:
        click.echo(f"tofmix: {source.path} is not the recording that {file.path} was made from", err=True)

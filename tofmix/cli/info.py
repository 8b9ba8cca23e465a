"""``tofmix info``: what a file is."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tofmix.cli.options import PATH, examples, json_option

if TYPE_CHECKING:
    from tofmix.report.descriptions import Description

_TOML = ".toml"


@examples(
    """
tofmix info sample_data/three_boards.h5
tofmix info boards.layers.h5 --json
tofmix info my_scene.toml
tofmix info corridor
"""
)
@click.command(short_help="Say what a file is: sizes, units, options, warnings.")
@click.argument("file", type=PATH)
@json_option
def info(file: Path, as_json: bool) -> None:
    """Say what FILE is: a recording, a layers file, or a TOML file of a model or a sensor.

    Prints its sizes, units, options, camera and what to be wary of. FILE may also be
    the name of a built-in model. It takes no time: of samples at most a few blocks are
    read, to check their unit. What was found in a layers file is told by tofmix report.
    """
    from tofmix.report.descriptions import format_description
    from tofmix.simulation.builtin import BUILTIN_MODELS

    is_text = file.suffix == _TOML or (str(file) in BUILTIN_MODELS and not file.exists())
    description = _of_text(str(file)) if is_text else _of_hdf5(file)
    if as_json:
        click.echo(json.dumps(description.as_dict(), indent=2, allow_nan=False))
    else:
        click.echo(format_description(description))


def _of_text(name: str) -> "Description":
    from tofmix.io.model_file import load_model, load_model_text
    from tofmix.report.descriptions import describe_model, describe_sensor
    from tofmix.sensors.profile_toml import parse_profile
    from tofmix.toml_table import parse_toml

    text = load_model_text(name)
    if "about" in parse_toml(text, source=name):
        return describe_sensor(parse_profile(text, source=name), name=name)
    return describe_model(load_model(name), name=name)


def _of_hdf5(path: Path) -> "Description":
    from tofmix.io import layers_file
    from tofmix.io.file_kind import format_of
    from tofmix.io.layers_file import open_layers
    from tofmix.io.range_check import look, unit_doubt, zeros_doubt
    from tofmix.io.recording_file import open_recording
    from tofmix.report.descriptions import describe_layers, describe_recording

    kind, size = format_of(path), path.stat().st_size
    if kind == layers_file.FORMAT:
        with open_layers(path) as layers:
            return describe_layers(layers, name=str(path), file_bytes=size)
    with open_recording(path, check_units=False) as recording:
        found = look(recording)
        doubts = {"range_units": unit_doubt(recording, found), "range_zeros": zeros_doubt(recording, found)}
        return describe_recording(recording, name=str(path), file_bytes=size, doubts=doubts)

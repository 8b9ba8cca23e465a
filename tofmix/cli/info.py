"""``tofmix info``: describe a file; ``tofmix verify``: whether files are whole and keep their contract.

``tofmix sensors``: the built-in cameras.
"""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import PATH, examples, json_option, note
from tofmix.errors import BadInputError, ExitCode, UsageError
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.io.verify import Findings
    from tofmix.optics.projection import Projection
    from tofmix.report.description import Description
    from tofmix.sensors import Camera


_TOML = ".toml"


@examples(
    """
tofmix info sample_data/three_boards.h5
tofmix info boards.layers.h5 --json
tofmix info boards.surfaces.h5
tofmix info my_scene.toml
tofmix info corridor
tofmix info vl53l5cx
tofmix info depth.npy
tofmix info gap
"""
)
@click.command(short_help="Describe a file: sizes, units, options, warnings.")
@click.argument("file", type=PATH)
@json_option
def info(file: Path, as_json: bool) -> None:
    """Describe FILE: a recording, a layers or surfaces file, or a TOML file of a model or a sensor.

    Prints sizes, units, options, camera and warnings. FILE may also be the name of a built-in model or sensor, a folder
    that tofmix reconcile wrote, or any source of tofmix import: a bag, images, an array, CSV, other HDF5. It reads at
    most a few blocks of samples, to check their unit. tofmix report summarises a layers file.
    """
    from tofmix.report.description import format_description

    description = _describe(file)
    if as_json:
        click.echo(json.dumps(description.as_dict(), indent=2, allow_nan=False))
    else:
        click.echo(format_description(description))


def _describe(file: Path) -> "Description":
    from tofmix.io.reconciliation import is_gap_folder, read_gap
    from tofmix.report.description import describe_gap
    from tofmix.sensors import PROFILES
    from tofmix.simulation import BUILTIN_MODELS

    name = str(file)
    if is_gap_folder(file):
        return describe_gap(read_gap(file), name=name)
    if file.suffix == _TOML or (name in BUILTIN_MODELS and not file.exists()):
        return _of_text(name)
    if name in PROFILES and not file.exists():
        from tofmix.report.description import describe_sensor
        from tofmix.sensors import load_camera

        return describe_sensor(load_camera(name), name=name)
    return _of_source(file) if _is_foreign(file) else _of_hdf5(file)


def _is_foreign(path: Path) -> bool:
    """Whether it is for `tofmix import`: a folder, a kind of file that is no HDF5, or HDF5 without ``range``."""
    from tofmix.io.guard import guard
    from tofmix.io.hdf5 import is_foreign_hdf5
    from tofmix.io.importers import is_importable

    if path.is_dir():
        return True
    if path.is_file() and guard.is_hdf5(path):
        return is_foreign_hdf5(path)
    return is_importable(path)


def _of_source(path: Path) -> "Description":
    from tofmix.io.importers import open_source
    from tofmix.io.importers.base import SourceRequest
    from tofmix.io.next_command import import_command
    from tofmix.report.description import describe_source

    with open_source(path, SourceRequest()) as source:
        return describe_source(source, name=str(path), command=import_command(path))


def _of_text(name: str) -> "Description":
    from tofmix.io.model_file import load_model, load_model_text
    from tofmix.report.description import describe_model, describe_sensor
    from tofmix.sensors import parse_profile
    from tofmix.toml_table import parse_toml

    text = load_model_text(name)
    if "about" in parse_toml(text, source=name):
        return describe_sensor(parse_profile(text, source=name), name=name)
    return describe_model(load_model(name), name=name)


def _of_hdf5(path: Path) -> "Description":
    from tofmix.io.hdf5 import format_of
    from tofmix.io.layers import layers_file
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.io.recording.range_check import distance_doubt, fills_doubt, look, unit_doubt, zeros_doubt
    from tofmix.io.recording.recording_file import open_recording
    from tofmix.io.surfaces_file import FORMAT as SURFACES_FORMAT
    from tofmix.io.surfaces_file import open_surfaces
    from tofmix.report.description import describe_layers, describe_recording, describe_surfaces

    kind, size = format_of(path), path.stat().st_size
    if kind == layers_file.FORMAT:
        with open_layers(path) as layers:
            return describe_layers(layers, name=str(path), file_bytes=size)
    if kind == SURFACES_FORMAT:
        with open_surfaces(path) as surfaces:
            return describe_surfaces(surfaces, name=str(path), file_bytes=size)
    with open_recording(path, check_units=False) as recording:
        found = look(recording)
        doubts = {
            "range_units": unit_doubt(recording, found),
            "range_zeros": zeros_doubt(recording, found),
            "range_fills": fills_doubt(recording, found),
            "range_distance": distance_doubt(recording, found),
        }
        return describe_recording(recording, name=str(path), file_bytes=size, doubts=doubts)


@examples(
    """
tofmix verify boards.h5 boards.layers.h5 boards.surfaces.h5
tofmix verify layers/*.layers.h5 --json
tofmix verify gap
"""
)
@click.command(short_help="Check that files are whole and consistent.")
@click.argument("files", type=PATH, nargs=-1, required=True)
@json_option
def verify(files: tuple[Path, ...], as_json: bool) -> ExitCode:
    """Check FILES: recordings, layers, surfaces, models, or folders that tofmix reconcile wrote.

    Reads every value and compares every checksum. Checks dimensions, types, units and the rules of every result: shares
    sum to 1, ranges ascend, values after the first n_modes are NaN, statuses agree with the layers, and surfaces have
    the stated number of layers. Prints one line for each fault. Exit code 0: no fault; 3: a fault; 5: a fault in some
    of several files.
    """
    from tofmix.io.verify import verify as verify_file

    found = {}
    for path in files:
        found[path] = verify_file(path)
        if not as_json:
            _show(path, found[path])
    if as_json:
        listed = [{"file": str(path), **findings.as_dict()} for path, findings in found.items()]
        click.echo(json.dumps({"ok": all(f.ok for f in found.values()), "files": listed}, indent=2))
    wrong = sum(not findings.ok for findings in found.values())
    if not wrong:
        return ExitCode.DONE
    return ExitCode.BAD_INPUT if wrong == len(found) else ExitCode.SOME_FAILED


def _show(path: Path, findings: "Findings") -> None:
    for line in findings.lines():
        click.echo(f"{path}: {_printable(line)}")
    for text in findings.notes:
        note(f"{path}: {_printable(text)}")
    if findings.ok:
        read = f", {counted(findings.checked, 'dataset')} read" if findings.checked else ""
        click.echo(f"{path}: {findings.kind}{read}; no fault")


def _printable(text: str) -> str:
    """One line without control characters: names in a file are not ours."""
    return "".join(c if c.isprintable() else "?" for c in text)


@examples(
    """
tofmix sensors
tofmix sensors vl53l5cx
tofmix sensors azure-kinect-nfov --toml > camera.toml
tofmix sensors --json
"""
)
@click.command(short_help="List the built-in cameras, or print one.")
@click.argument("name", required=False)
@click.option(
    "--toml",
    "as_toml",
    is_flag=True,
    help="Print the file of the camera, as a start for your own --sensor file.",
    allow_from_autoenv=False,
)
@json_option
def sensors(name: str | None, as_toml: bool, as_json: bool) -> None:
    """List the built-in cameras, or print the data of the camera NAME with the source of each number.

    tofmix import --sensor and the profile of a model take these names. Unknown
    numbers of a camera are left out. --noise NAME, and a model with a profile
    only, need a camera with a noise curve.
    """
    from tofmix.sensors import PROFILES, load_camera

    if name is None:
        if as_toml:
            raise UsageError("--toml prints one camera; give its NAME")
        cameras = {key: load_camera(key) for key in PROFILES}
        click.echo("\n".join(json.dumps(_as_dict(*item)) for item in cameras.items()) if as_json else _table(cameras))
        return
    if as_toml and as_json:
        raise UsageError("--toml and --json exclude each other")
    try:
        camera = load_camera(name)
    except BadInputError as error:  # unlike --sensor, it may be no file
        raise UsageError(str(error)) from error
    if as_toml:
        from tofmix.sensors import profile_text

        click.echo(profile_text(name), nl=False)
    elif as_json:
        click.echo(json.dumps(_as_dict(name, camera)))
    else:
        from tofmix.report.description import describe_sensor, format_description

        click.echo(format_description(describe_sensor(camera, name=name)))


def _as_dict(name: str, camera: "Camera") -> dict[str, Any]:
    """Properties of a camera for JSON; None if not known."""
    from tofmix.sensor_schema import LAW_NUMBERS, NUMBERS, RARE_SENSOR_NUMBERS, VIEW_NUMBERS

    noise = camera.noise
    view = ("rows", "cols", *VIEW_NUMBERS)
    apart = {*view, *LAW_NUMBERS, *RARE_SENSOR_NUMBERS, "default_integration_time_ms"}

    def numbers(keys: Iterable[str]) -> dict[str, float | None]:
        return {key: getattr(camera, key) for key in keys}

    return {
        "profile": name,
        "name": camera.name,
        "measurement": camera.measurement,
        **numbers(view),
        "projection": None if camera.projection is None else _optics(camera.projection),
        **numbers(key for key in NUMBERS if key not in apart),
        "noise_range_mm": None if noise is None else noise.range_mm.tolist(),
        "noise_sigma_mm": None if noise is None else noise.sigma_mm.tolist(),
        **numbers(LAW_NUMBERS),
        "valid_status": camera.valid_status,
        "confirmed": camera.confirmed,
        "sources": list(camera.sources),
    }


def _optics(projection: "Projection") -> dict[str, Any]:
    from tofmix.optics.projection import projection_values

    return {"name": projection.name, **projection_values(projection)}


def _view(camera: "Camera") -> str:
    """Angles that the image spans, and of which projection where it is not equal angles."""
    if camera.projection is not None and camera.rows is not None and camera.cols is not None:
        return camera.projection.words((camera.rows, camera.cols)).replace(" degrees of a", "")
    return "-" if camera.fov_horizontal_deg is None else f"{camera.fov_horizontal_deg:g} x {camera.fov_vertical_deg:g}"


def _table(cameras: "dict[str, Camera]") -> str:
    lines = [f"{'profile':<26}{'measures':<10}{'rows x cols':<13}{'view, degrees':<21}{'range':<16}{'noise':<7}camera"]
    for name, camera in cameras.items():
        size = "-" if camera.rows is None else f"{camera.rows} x {camera.cols}"
        view = _view(camera)
        ends = [None if end is None else f"{end / 1000:g}" for end in (camera.range_min_mm, camera.range_max_mm)]
        reach = "-" if ends == [None, None] else f"{ends[0] or '?'} to {ends[1] or '?'} m"
        noise = "-" if camera.noise is None else "yes"
        lines.append(f"{name:<26}{camera.measurement or '-':<10}{size:<13}{view:<21}{reach:<16}{noise:<7}{camera.name}")
    return "\n".join(lines)

"""``tofmix sensors``: the built-in cameras."""

import json
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import examples, json_option
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.optics.projection import Projection
    from tofmix.sensors import CameraSheet


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
    from tofmix.sensors import PROFILES, load_sheet

    if name is None:
        if as_toml:
            raise UsageError("--toml prints one camera; give its NAME")
        sheets = {key: load_sheet(key) for key in PROFILES}
        click.echo("\n".join(json.dumps(_as_dict(*item)) for item in sheets.items()) if as_json else _table(sheets))
        return
    if as_toml and as_json:
        raise UsageError("--toml and --json exclude each other")
    try:
        sheet = load_sheet(name)
    except BadInputError as error:  # unlike --sensor, it may be no file
        raise UsageError(str(error)) from error
    if as_toml:
        from tofmix.sensors import profile_text

        click.echo(profile_text(name), nl=False)
    elif as_json:
        click.echo(json.dumps(_as_dict(name, sheet)))
    else:
        from tofmix.report.descriptions.camera import describe_sensor
        from tofmix.report.descriptions.description import format_description

        click.echo(format_description(describe_sensor(sheet, name=name)))


def _as_dict(name: str, sheet: "CameraSheet") -> dict[str, Any]:
    """Properties of a camera for JSON; None if not known."""
    noise = sheet.noise
    return {
        "profile": name,
        "name": sheet.name,
        "measurement": sheet.measurement,
        "rows": sheet.rows,
        "cols": sheet.cols,
        "fov_horizontal_deg": sheet.fov_horizontal_deg,
        "fov_vertical_deg": sheet.fov_vertical_deg,
        "projection": None if sheet.projection is None else _optics(sheet.projection),
        "range_min_mm": sheet.range_min_mm,
        "range_max_mm": sheet.range_max_mm,
        "modulation_frequency_hz": sheet.modulation_frequency_hz,
        "integration_time_ms": sheet.integration_time_ms,
        "outlier_probability": sheet.outlier_probability,
        "noise_range_mm": None if noise is None else noise.range_mm.tolist(),
        "noise_sigma_mm": None if noise is None else noise.sigma_mm.tolist(),
        "reference_integration_time_ms": sheet.reference_integration_time_ms,
        "exponent": sheet.exponent,
        "valid_status": sheet.valid_status,
        "confirmed": sheet.confirmed,
        "sources": list(sheet.sources),
    }


def _optics(projection: "Projection") -> dict[str, Any]:
    from tofmix.optics.projection import projection_values

    return {"name": projection.name, **projection_values(projection)}


def _view(sheet: "CameraSheet") -> str:
    """Angles that the image spans, and of which projection where it is not equal angles."""
    if sheet.projection is not None and sheet.rows is not None and sheet.cols is not None:
        return sheet.projection.words((sheet.rows, sheet.cols)).replace(" degrees of a", "")
    return "-" if sheet.fov_horizontal_deg is None else f"{sheet.fov_horizontal_deg:g} x {sheet.fov_vertical_deg:g}"


def _table(sheets: "dict[str, CameraSheet]") -> str:
    lines = [f"{'profile':<26}{'measures':<10}{'rows x cols':<13}{'view, degrees':<21}{'range':<16}{'noise':<7}camera"]
    for name, sheet in sheets.items():
        size = "-" if sheet.rows is None else f"{sheet.rows} x {sheet.cols}"
        view = _view(sheet)
        ends = [None if end is None else f"{end / 1000:g}" for end in (sheet.range_min_mm, sheet.range_max_mm)]
        reach = "-" if ends == [None, None] else f"{ends[0] or '?'} to {ends[1] or '?'} m"
        noise = "-" if sheet.noise is None else "yes"
        lines.append(f"{name:<26}{sheet.measurement or '-':<10}{size:<13}{view:<21}{reach:<16}{noise:<7}{sheet.name}")
    return "\n".join(lines)

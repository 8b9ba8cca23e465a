"""``tofmix sensors``: the built-in cameras."""

import json
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import examples, json_option
from tofmix.errors import BadInputError, UsageError

if TYPE_CHECKING:
    from tofmix.optics.projection import Projection
    from tofmix.sensors import Camera


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

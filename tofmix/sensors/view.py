"""A camera with the directions of its pixels, from a lens or a field of view."""

from dataclasses import replace

from tofmix.optics.pinhole import Pinhole
from tofmix.optics.view import PINHOLE, ideal_pinhole
from tofmix.sensor import Sensor


def with_lens(sensor: Sensor, lens: Pinhole) -> Sensor:
    """The camera with the directions of its pixels by a lens."""
    return replace(sensor, projection=lens, fov_horizontal_deg=None, fov_vertical_deg=None)


def with_view(sensor: Sensor, view_deg: tuple[float, float], projection: str, shape: tuple[int, int]) -> Sensor:
    """The camera with the directions of an image's pixels by a field of view.

    Parameters
    ----------
    sensor : Sensor
        The camera.
    view_deg : (float, float)
        Full field of view, horizontal and vertical, degrees.
    projection : {"equiangular", "pinhole"}
        Equal angles between pixels, or an ideal pinhole.
    shape : (int, int)
        Rows and columns of the image.

    Raises
    ------
    ValueError
        If no pinhole sees that much.
    """
    if projection == PINHOLE:
        return with_lens(sensor, ideal_pinhole(view_deg, shape))
    return replace(sensor, projection=None, fov_horizontal_deg=view_deg[0], fov_vertical_deg=view_deg[1])

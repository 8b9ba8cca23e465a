"""A camera with the directions of its pixels, from a lens, a field of view, or a profile of images of one size."""

from dataclasses import replace

from tofmix.optics.pinhole import Pinhole
from tofmix.optics.view import PINHOLE, ideal_pinhole
from tofmix.sensor import Sensor
from tofmix.sensors.sheet import CameraSheet


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


def sensor_of(camera: CameraSheet, shape: tuple[int, int]) -> Sensor:
    """The camera as a recording of an image (rows, cols) describes it.

    A projection is of an image of one size alone: where pixels of another look stays unknown.
    """
    sensor = camera.sensor()
    if sensor.projection is None or (camera.rows or shape[0], camera.cols or shape[1]) == tuple(shape):
        return sensor
    return replace(sensor, projection=None)


def size_doubt(camera: CameraSheet, shape: tuple[int, int]) -> str:
    """Doubt about an image (rows, cols) of another size than the camera's; empty without one."""
    if camera.rows is None or camera.cols is None or shape == (camera.rows, camera.cols):
        return ""
    view = "field of view is used" if camera.projection is None else "projection is not used"
    return f"{shape[0]} x {shape[1]} pixels, {camera.name} has {camera.rows} x {camera.cols}; its {view} for this image"


def turned(shape: tuple[int, int], camera: CameraSheet) -> str:
    """Reason to refuse an image whose rows and columns are those of the camera, swapped; empty without one."""
    if shape[0] == shape[1] or shape != (camera.cols, camera.rows):
        return ""
    return (
        f"images of {shape[0]} x {shape[1]} pixels, {camera.name} has {camera.rows} x {camera.cols}: rows and columns"
        " are swapped"
    )

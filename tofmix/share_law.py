"""How a camera's samples share out among the surfaces of a pixel. It decides how shares of samples become areas.

A profile or a user declares it (``share_law`` of ``[sensor]``, or ``--shares``), and a recording carries it on
(`tofmix.sensor.Sensor.share_law`). Samples alone do not tell it.
"""

from enum import StrEnum


class ShareLaw(StrEnum):
    """The chance of a surface to be the one of a sample.

    ``area``: the part of the pixel that it covers, as in the paper; ``detections``: that part times its brightness, as
    where single photons are detected; ``strongest``: the camera keeps the brightest return alone.
    """

    AREA = "area"
    DETECTIONS = "detections"
    STRONGEST = "strongest"


def share_law_of(text: str) -> ShareLaw:
    """The law of this name.

    Raises
    ------
    ValueError
        If there is none.
    """
    if text not in tuple(ShareLaw):
        raise ValueError(f'share_law: "{text}" is not one of {", ".join(ShareLaw)}')
    return ShareLaw(text)

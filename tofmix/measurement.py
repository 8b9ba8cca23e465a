"""What a camera measures, and how its samples share out: it declares both, and a `Sensor` carries them on.

The measurement decides whether the light of several surfaces in a pixel adds up in one sample. A camera's profile
declares it (``measurement`` of ``[sensor]``), and a recording carries it on (`tofmix.sensor.Sensor.measurement`).
Nothing guesses it from the name of a camera.

The law of shares decides how shares of samples become areas. A profile or a user declares it (``share_law`` of
``[sensor]``, or ``--shares``), and a recording carries it on (`tofmix.sensor.Sensor.share_law`). Samples alone do not
tell it.
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


class Measurement(StrEnum):
    """What a sample is taken from.

    ``lock-in``: the phase of modulated light, to which all surfaces in a pixel add; ``pulses``: the time of flight of
    single pulses or photons, each of one surface; ``stereo``: the parallax of two images.
    """

    LOCK_IN = "lock-in"
    PULSES = "pulses"
    STEREO = "stereo"


def measurement_of(text: str) -> Measurement:
    """The measurement of this name.

    Raises
    ------
    ValueError
        If there is none.
    """
    if text not in tuple(Measurement):
        raise ValueError(f'measurement: "{text}" is not one of {", ".join(Measurement)}')
    return Measurement(text)

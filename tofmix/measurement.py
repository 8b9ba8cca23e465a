"""What a camera measures. It decides whether the light of several surfaces in a pixel adds up in one sample.

A camera's profile declares it (``measurement`` of ``[sensor]``), and a recording carries it on
(`tofmix.sensor.Sensor.measurement`). Nothing guesses it from the name of a camera.
"""

from enum import StrEnum


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

"""Notes on the law of mixing: what a lock-in camera's recording lacks for unmixing, and what follows."""

from tofmix.report.summary.findings import Finding, Remedy
from tofmix.sensor import Sensor

AMPLITUDES, FREQUENCY = "amplitudes", "modulation frequency"
"""What makes phasors of samples, in words."""

OPTIONS = {AMPLITUDES: ("--amplitude", "AMPLITUDES"), FREQUENCY: ("--modulation-frequency", "HZ")}
"""Options of ``tofmix import`` that add each, with a placeholder."""


def lacking(sensor: Sensor, *, has_amplitude: bool | None) -> tuple[str, ...]:
    """What a recording of one sample a frame lacks to be unmixed.

    Amplitudes of which nothing is known (`has_amplitude` is None) are not named.
    """
    amplitudes = (AMPLITUDES,) if has_amplitude is False else ()
    return (*amplitudes, *((FREQUENCY,) if sensor.modulation_frequency_hz is None else ()))


def light_findings(sensor: Sensor, *, targets: int, remedy: Remedy) -> list[Finding]:
    """Say that flying pixels are counted as surfaces, where layers are not unmixed though light may add up.

    A warning for a camera that is known as a lock-in camera, a note where the kind of camera is not known. Nothing for
    other cameras, such as those that return several `targets` a frame, which measure no phase, and where nobody wanted
    unmixing.
    """
    if sensor.is_lock_in is False or targets or not remedy.unmix:
        return []
    missing = lacking(sensor, has_amplitude=remedy.has_amplitude)
    if remedy.has_amplitude and not missing:
        return []  # --mixing events was chosen, or --paper
    without = f"has no {' and no '.join(missing)}" if missing else "has no amplitudes, or --mixing events was chosen"
    needs = "Unmixing needs ranges and amplitudes of one modulation frequency."
    # Amplitudes that the recording may have already are imported again with the ranges.
    options = [part for name in (AMPLITUDES, FREQUENCY) if name in (AMPLITUDES, *missing) for part in OPTIONS[name]]
    commands = (remedy.import_command(*options),)
    if sensor.is_lock_in:
        text = (
            f"The recording {without}: a lock-in camera's flying pixels, in which the light of several surfaces adds"
            f" up, are counted as surfaces. {needs}"
        )
        return [Finding(code="flying_pixels_counted", text=text, commands=commands)]
    text = (
        f"Mixing is not measured, because the recording {without}. If this is a lock-in camera, flying pixels are"
        f" counted as surfaces. {needs}"
    )
    return [Finding(code="mixing_not_measured", text=text, commands=commands, is_note=True)]

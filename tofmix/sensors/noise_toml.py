"""A noise curve as the table ``[sensor.noise]`` of a model file, with all its numbers.

Use `noise_toml` where a curve is printed to be pasted, or written into a model. `tofmix.sensors.profile_toml` reads it.
"""

from collections.abc import Iterable

from tofmix.sensor import NoiseCurve

_DIGITS = ".6g"  # a millionth of a sigma is below what any recording shows


def noise_toml(
    curve: NoiseCurve, *, integration_time_ms: float | None, exponent: float = 0.5, background: str | None = None
) -> str:
    """The table, each list on one line, ending in a newline.

    Parameters
    ----------
    curve : NoiseCurve
        Sigma (mm) at some ranges (mm), and its further parts.
    integration_time_ms : float or None
        The integration time of one sample at which the curve holds, ms; None if it is not known: the table then leaves
        it out.
    exponent : float
        That of the law of the integration time.
    background : str, optional
        Path of the .npy file with the map of background shares, relative to the model's folder. Without it one share
        is written for all pixels, the mean of a map.
    """
    lines = ["[sensor.noise]", f"range_mm = {_list(curve.range_mm)}", f"sigma_mm = {_list(curve.sigma_mm)}"]
    if integration_time_ms is not None:
        lines += [f"reference_integration_time_ms = {integration_time_ms!r}", f"exponent = {exponent!r}"]
    if curve.law is not None:
        lines += [
            f"reference_amplitude = {_list(curve.law.reference)}",
            f"amplitude = {_list(curve.law.amplitude)}",
            f"amplitude_factor = {_list(curve.law.factor)}",
        ]
    if curve.shape is not None:
        lines += [f"shape_z = {_list(curve.shape.z)}", f"shape_density = {_list(curve.shape.density)}"]
    lines.append(f"width_spread = {_number(curve.width_spread)}")
    if background is not None:
        lines.append(f'background = "{background}"')
    elif curve.background is not None:
        lines.append(f"background = {_number(float(curve.background.mean()))}")
    return "\n".join(lines) + "\n"


def _list(values: Iterable[float]) -> str:
    return f"[{', '.join(_number(v) for v in values)}]"


def _number(value: float) -> str:
    return repr(float(format(float(value), _DIGITS)))

"""Phase and range of an amplitude-modulated continuous-wave camera."""

SPEED_OF_LIGHT_MM_S = 299_792_458_000.0  # in vacuum, mm/s; exact by the definition of the metre


def unambiguous_range_mm(modulation_frequency_hz: float) -> float:
    """Range at which the phase has turned once, d_u = c / (2 f).

    Parameters
    ----------
    modulation_frequency_hz : float
        Modulation frequency, above 0.

    Returns
    -------
    float
        d_u in mm; 7494.8 at 20 MHz.

    Raises
    ------
    ValueError
        If the frequency is not above 0.

    References
    ----------
    Lange and Seitz, IEEE J. Quantum Electronics 37(3), 2001, doi:10.1109/3.910448.
    """
    if not modulation_frequency_hz > 0:
        raise ValueError(f"modulation_frequency_hz: {modulation_frequency_hz} is not above 0")
    return SPEED_OF_LIGHT_MM_S / (2.0 * modulation_frequency_hz)

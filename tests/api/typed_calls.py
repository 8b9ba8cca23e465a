"""Calls of `tofmix.estimate` for `mypy`, which runs over tests: it takes the first, and refuses each of the others.

A comment that ignores nothing is an error of `mypy --strict`.
"""

import tofmix as tm


def call() -> None:
    """Never run."""
    recording = tm.from_array([[[1.0]]], units="m")
    tm.estimate(recording, sigma="tied", refine="likelihood", mixing="auto", noise_shape="gaussian", noise_widths="own")
    tm.estimate(recording, sigma="tide")  # type: ignore[arg-type]
    tm.estimate(recording, refine="none ")  # type: ignore[arg-type]
    tm.estimate(recording, mixing="phasors")  # type: ignore[arg-type]
    tm.estimate(recording, noise_shape="gauss")  # type: ignore[arg-type]
    tm.estimate(recording, noise_widths="both")  # type: ignore[arg-type]

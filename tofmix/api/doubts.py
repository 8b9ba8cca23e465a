"""What a job says, as warnings of Python; its notes are none."""

import inspect
import warnings
from typing import TYPE_CHECKING

from tofmix.errors import DoubtWarning
from tofmix.jobs.reporter import Reporter

if TYPE_CHECKING:
    from tofmix.report.summary.findings import Finding

_REMEDIES = {
    "scatter_off_curve": "noise='auto' measures it.",
    "sigma_off_curve": "noise='auto' measures it.",
    "drift": "Take a shorter window.",
    "close_layers": "Take a shorter window, or noise='auto'.",
    "all_layers_used": "A larger max_layers shows them.",
    "not_converged": "Take a larger max_iter.",
    "too_few_samples": "Take a longer window.",
    "flying_pixels_counted": "from_array takes amplitude=..., with_sensor modulation_frequency_hz=...",
}
"""Remedies of findings, as parameters of `estimate`."""


class PythonReporter(Reporter):
    """Warns of doubts, at the line that called the package."""

    def warn(self, text: str) -> None:
        """Warn of a doubt."""
        frame, level = inspect.currentframe(), 1
        while frame is not None and frame.f_globals["__name__"].startswith(("tofmix.", "contextlib")):
            frame, level = frame.f_back, level + 1
        warnings.warn(text, DoubtWarning, stacklevel=level)

    def finding(self, about: object, finding: "Finding") -> None:  # noqa: ARG002  the text does without it
        """Warn of it with its remedy in Python."""
        if not finding.is_note:
            self.warn(f"{finding.text} {_REMEDIES.get(finding.code, '')}".strip())

"""Status codes beside the ranges: which of them mark a valid sample."""

import re

from tofmix.io.importers.base import SourceRequest
from tofmix.io.importers.streams import set_of

_NAMES = set_of("status confidence quality valid validity flag flags error errors")


def is_status_name(name: str) -> bool:
    """Whether a column, dataset or array holds codes or grades of samples, by a word of its name."""
    words = re.split(r"[^a-z0-9]+", name.lower())
    return any(word.rstrip("0123456789") in _NAMES for word in words)


def codes_of(name: str, request: SourceRequest) -> tuple[int, ...] | None:
    """Codes of valid samples in a column, dataset or array of a name or path; None where nothing tells them.

    `valid_status` of the request is used first, then the camera's codes for whatever is called ``status``.
    """
    last = name.rpartition("/")[2].lower()
    if request.valid_status is not None:
        wanted, codes = request.valid_status
        return codes if wanted.strip("/").lower() in (name.strip("/").lower(), last) else None
    of_camera = "status" in re.split(r"[^a-z0-9]+", last)
    return request.status_codes if of_camera and request.status_codes else None

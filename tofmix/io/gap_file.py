"""`gap.json` of a reconciliation, read back."""

import json
from pathlib import Path
from typing import Any

from tofmix.errors import BadInputError
from tofmix.io.atomic.storage import read_text

GAP = "gap.json"
_NEEDED = {"verdict": str, "effects": list, "gap": dict}


def is_gap_folder(path: Path) -> bool:
    """Whether a folder is an output of `tofmix reconcile`."""
    try:
        return (path / GAP).is_file()
    except OSError:
        return False


def read_gap(folder: Path) -> dict[str, Any]:
    """Read `gap.json` of a folder.

    Raises
    ------
    BadInputError
        If it is missing, no JSON, or lacks the verdict, the effects or the gap.
    """
    path = folder / GAP
    try:
        gap = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise BadInputError(f"{path}: not JSON: {' '.join(str(error).split())}") from error
    for key, kind in _NEEDED.items():
        if not isinstance(gap, dict) or not isinstance(gap.get(key), kind):
            raise BadInputError(f"{path}: no {key}; expected a gap.json of tofmix reconcile")
    return dict(gap)

"""The values of a few small cases, as text in the repository: `stored.json`."""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from frozen.cases import CASES
from frozen.outcome import Outcome, run_case, write_inputs

PATH = Path(__file__).with_suffix(".json")
DIGITS = 9


def run(name: str, folder: Path) -> Outcome:
    """The outcome of a case in an empty folder, without what differs from version to version."""
    write_inputs(CASES[name].inputs, folder)
    return {key: value for key, value in run_case(CASES[name], folder).items() if not key.endswith(":attributes")}


def read() -> dict[str, Outcome]:
    """The stored outcomes, by case."""
    return {
        case: {key: value["lines"] if "lines" in value else _array(value) for key, value in outcome.items()}
        for case, outcome in json.loads(PATH.read_text()).items()
    }


def write() -> None:
    """Store the outcomes of this process's package."""
    kept = {}
    for name, case in CASES.items():
        if case.is_stored:
            with tempfile.TemporaryDirectory() as folder:
                outcome = run(name, Path(folder))
            kept[name] = {key: _packed(value) for key, value in outcome.items()}
    text = json.dumps(kept, indent=1, sort_keys=True)
    PATH.write_text(text + "\n")


def _packed(value: Any) -> dict[str, Any]:  # noqa: ANN401  an array, or lines
    if isinstance(value, list):
        return {"lines": value}
    numbers = " ".join(f"{number:.{DIGITS}g}" for number in np.ravel(value).tolist())
    return {"dtype": str(value.dtype), "shape": list(value.shape), "values": numbers}


def _array(packed: dict[str, Any]) -> Any:  # noqa: ANN401
    numbers = np.array([float(number) for number in packed["values"].split()])
    return numbers.reshape(packed["shape"]).astype(packed["dtype"])

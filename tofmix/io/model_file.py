"""Models (`*.toml`), from a file or built in."""

from pathlib import Path

from tofmix.errors import BadInputError
from tofmix.io.storage import read_text
from tofmix.simulation.builtin import BUILTIN_MODELS, builtin_text
from tofmix.simulation.model import Model
from tofmix.simulation.model_toml import parse_model


def load_model_text(name: str) -> str:
    """Text of the model file `name`, or of the built-in model of that name; a file of that name wins.

    Raises
    ------
    BadInputError
        If there is neither, or the file cannot be read.
    """
    if name in BUILTIN_MODELS and not Path(name).is_file():
        return builtin_text(name)
    if not Path(name).exists():
        known = ", ".join(BUILTIN_MODELS)
        raise BadInputError(f"{name}: no such model file, and not a built-in model ({known})")
    return read_text(Path(name))


def load_model(name: str) -> Model:
    """Read the model `name`; see `load_model_text`.

    Raises
    ------
    BadInputError
        If there is none, or it is not TOML or no model; the text names the line or the key.
    """
    return parse_model(load_model_text(name), source=name)

"""Synthetic recordings: scene (model, cast) -> sensor (events, averaging) -> recording (render).

Use it to make samples whose truth is known. Nothing here estimates, and nothing here reads or writes files, but for the
built-in models: one file in `scenes/` and one line in `BUILTIN_MODELS` each.
"""

from importlib.resources import files

from tofmix.errors import BadInputError
from tofmix.toml_table import nearest

BUILTIN_MODELS: dict[str, str] = {
    "three-boards": "three-boards.toml",
    "corridor": "corridor.toml",
    "slanted-wall": "slanted-wall.toml",
    "near-far": "near-far.toml",
    "corner": "corner.toml",
}


def builtin_text(name: str) -> str:
    """The model file of a built-in model, ready for `parse_model`.

    Parameters
    ----------
    name : str
        A key of `BUILTIN_MODELS`.

    Raises
    ------
    BadInputError
        If there is no model of this name.
    """
    if name not in BUILTIN_MODELS:
        raise BadInputError(f'"{" ".join(name.split())}" is not a built-in model{nearest(name, BUILTIN_MODELS)}')
    return (files("tofmix.simulation") / "scenes" / BUILTIN_MODELS[name]).read_text(encoding="utf-8")


def builtin_description(name: str) -> str:
    """Description of a built-in model in one line: the first comment of its file.

    Raises
    ------
    BadInputError
        If there is no model of this name.
    """
    return builtin_text(name).splitlines()[0].removeprefix("#").strip()

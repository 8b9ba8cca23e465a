"""Libraries that only some formats need: an optional extra of the package each."""

from importlib import import_module
from typing import Any

from tofmix.errors import UsageError


def need(module: str, *, extra: str, what: str) -> Any:  # noqa: ANN401  a module
    """Import a library, or raise an error with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        name = module.split(".", maxsplit=1)[0]
        raise UsageError(f"{what} needs {name}: pip install 'tofmix[{extra}]'") from error

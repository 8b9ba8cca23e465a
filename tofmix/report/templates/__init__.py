"""The templates, style sheets and scripts of the pages; all pages share one style sheet and a few macros."""

from functools import partial
from importlib import import_module, resources
from typing import TYPE_CHECKING

from tofmix.errors import UsageError
from tofmix.wording import number, percent_of

if TYPE_CHECKING:
    from jinja2 import Template


_MISSING_NUMBER = "\N{EN DASH}"
_MISSING_EXTRA = "the page needs matplotlib and jinja2: pip install 'tofmix[report]'"


def check_extra() -> None:
    """Refuse to make pages without what the extra ``report`` installs, before time is spent on their numbers."""
    try:
        import_module("matplotlib")
        import_module("jinja2")
    except ImportError as error:
        raise UsageError(_MISSING_EXTRA) from error


def load_template(name: str) -> "Template":
    """Load a template of this folder."""
    check_extra()
    jinja2 = import_module("jinja2")
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(read_part),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    colours = import_module("tofmix.report.figures.picture").style_colours()
    environment.globals.update(colours, number=partial(number, missing=_MISSING_NUMBER), percent_of=percent_of)
    template: Template = environment.get_template(name)
    return template


def read_part(name: str) -> str:
    """Return a template, style sheet or script of `tofmix.report.templates` as text."""
    return resources.files("tofmix.report.templates").joinpath(name).read_text(encoding="utf-8")

"""A reconciliation as one HTML page that needs nothing else, in the style of the layers' report."""

from importlib import import_module, resources
from typing import TYPE_CHECKING

from tofmix.errors import UsageError
from tofmix.reconcile.words import effect_tables, effect_text, headline, p_text, where_text
from tofmix.reconcile.workflow import Reconciliation

if TYPE_CHECKING:
    from jinja2 import Template

_MISSING_EXTRA = "the page needs matplotlib and jinja2: pip install 'tofmix[report]'"


def render_gap(result: Reconciliation, *, source: str) -> str:
    """Render the page of a reconciliation.

    Parameters
    ----------
    result : Reconciliation
        From `tofmix.reconcile.workflow.reconcile`.
    source : str
        Name of the recording.

    Returns
    -------
    str
        HTML. The same input gives the same text.

    Raises
    ------
    UsageError
        If matplotlib or jinja2 is missing.
    """
    template = _template()
    pictures = import_module("tofmix.report.gap_pictures")
    said = result.as_dict()
    return template.render(
        source=source,
        headline=headline(result),
        verdict=said["verdict"].replace("_", " "),
        gap=said["gap"],
        effects=[(effect_text(n), n.effect.explain(), n.heldout_gain_nats) for n in result.named],
        where=[(where_text(p, result), p_text(p)) for p in result.where[:6]],
        left=[(where_text(p, result), p_text(p)) for p in result.left[:6]] if result.named else [],
        candidates=said["candidates"],
        aliases=said["aliases"],
        added=effect_tables(result),
        panel=said["panel"],
        curves=pictures.curve_pictures(result),
        maps=pictures.map_pictures(result),
    )


def _template() -> "Template":
    try:
        import_module("matplotlib")
        jinja2 = import_module("jinja2")
    except ImportError as error:
        raise UsageError(_MISSING_EXTRA) from error
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    folder = resources.files("tofmix.report")
    style = folder.joinpath("page.html").read_text(encoding="utf-8").split("<style>")[1].split("</style>")[0]
    text = folder.joinpath("gap.html").read_text(encoding="utf-8").replace("/* style */", style)
    template: Template = environment.from_string(text)
    return template

"""A reconciliation as one HTML page that needs nothing else, in the style of the layers' report."""

from importlib import import_module

from tofmix.reconciliation.found import TriedEffect, set_text
from tofmix.reconciliation.words import closed_text, effect_tables, effect_text, headline, in_words, p_text, where_text
from tofmix.reconciliation.workflow import NamedEffect, Reconciliation
from tofmix.report.templates import load_template
from tofmix.wording import number


def render_gap(result: Reconciliation, *, source: str) -> str:
    """Render the page of a reconciliation of recordings named `source` as HTML; the same input gives the same text."""
    template = load_template("gap.html")
    pictures = import_module("tofmix.report.figures.gap_pictures")
    said = result.as_dict()
    return template.render(
        source=source,
        headline=headline(result),
        verdict=said["verdict"].replace("_", " "),
        gap=said["gap"],
        effects=[(effect_text(n, result), in_words(n.effect), n.heldout_gain_nats) for n in result.named],
        where=[(where_text(p, result), p_text(p)) for p in result.where[:6]],
        left=[(where_text(p, result), p_text(p)) for p in result.left[:6]] if result.named else [],
        candidates=[(c.kind, _fitted(c, result), number(c.gain, ",.0f"), c.parameters) for c in result.candidates],
        aliases=said["aliases"],
        considered=_considered(result),
        complete=result.is_complete,
        added=_added(result),
        next_steps=result.next_steps,
        panel=said["panel"],
        curves=pictures.curve_pictures(result),
        maps=pictures.map_pictures(result),
        closed_text=closed_text,
    )


def _considered(result: Reconciliation) -> list[tuple[str, str, str]]:
    """The weighed sets, their evidence, and why they are not the answer; the answer itself has no reason."""
    answer = "the answer" if result.named else "no effect is named"
    return [
        (set_text(w.names), number(w.evidence_nats, ",.1f"), answer if w.why_not is None else w.why_not)
        for w in result.considered
    ]


def _fitted(candidate: TriedEffect, result: Reconciliation) -> str:
    """The parameters of a candidate in words; nothing is known of their errors."""
    everywhere = tuple(range(len(result.models)))
    alone = NamedEffect(effect=candidate.effect, stderr={}, heldout_gain_nats=candidate.gain, recordings=everywhere)
    return effect_text(alone, result).removeprefix(candidate.kind).strip("( )")


def _added(result: Reconciliation) -> list[tuple[str, str]]:
    """The added effects, by model."""
    tables = [effect_tables(result, number) for number in range(len(result.models))]
    if len(set(tables)) == 1:
        return [("the model" if len(tables) == 1 else "every model", tables[0])] if tables[0] else []
    return [(f"the model of recording {number}", table) for number, table in enumerate(tables, 1) if table]

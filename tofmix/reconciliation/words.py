"""The result as text: the headline, lines for the terminal, and the tables for the model file."""

import json
import math
from dataclasses import replace
from typing import Any

from tofmix.reconciliation.comparison.compare import Place
from tofmix.reconciliation.evidence import ChangedPart
from tofmix.reconciliation.workflow import NamedEffect, Reconciliation
from tofmix.simulation.effects.base import Effect
from tofmix.simulation.model_toml import surface_table
from tofmix.wording import counted, number, rounded

_TITLES = {
    "agree": "Simulation and measurement agree",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unexplained": "unexplained: none of the known effects explains it",
}
_AXES = {
    "row": "in rows",
    "col": "in columns",
    "surfaces_in_pixel": "in pixels with",
    "neighbour_contrast": "where neighbours differ by",
}
"""Words before an interval; other axes have their names."""

_WIDER = 1.3  # least ratio of gaps that is mentioned
_UNITS = {"range": "mm", "time": "s", "radius": "pixels", "neighbour_contrast": "mm", "surfaces_in_pixel": "surfaces"}


def headline(result: Reconciliation) -> str:
    """The place of the disagreement, its explanation, and the fall of the gap."""
    if not result.changed:
        return _of_effects(result)
    most, v = 3, result.verified
    parts = "; ".join(change_text(part) for part in result.changed[:most])
    more = len(result.changed) - most
    parts += f"; and {counted(more, 'other place')}" if more > 0 else ""
    if v.verdict == "unexplained" and not (v.findings.chosen or v.findings.open or v.findings.few):
        rest = f"All else agrees: the gap is {v.after.gap:.2f}, noise alone gives {v.floor.gap:.2f}."
    else:
        rest = _of_effects(result)
        rest = f"Apart from this, {rest[0].lower()}{rest[1:]}"
    return f"The scene has changed: {parts}. {rest}"


def change_text(part: ChangedPart) -> str:
    """A part of a measured scene that has changed, in words."""
    (top, bottom), (first, last) = part.rows, part.cols
    place = f"in rows {top} to {bottom}, columns {first} to {last} ({counted(part.pixels, 'pixel')})"
    names = " and ".join(f'"{name}"' for name in part.surfaces) or "a layer of no surface"
    if part.moved_mm is None:
        return f"something new is seen at {part.range_mm:.0f} mm {place}, where nothing was seen"
    away = f"{abs(part.moved_mm):.0f} mm"
    if not part.is_new:
        return f"{names} has gone {place}, and a surface {away} behind it is seen"
    if part.moved_mm > 0:
        return f"a part of {names} has gone {place}, and ranges are {away} longer"
    return f"something new stands {away} before {names} {place}"


def _of_effects(result: Reconciliation) -> str:
    v = result.verified
    if v.verdict == "agree":
        gap = f"the gap is {v.before.gap:.2f}, noise alone gives {v.floor.gap:.2f}"
        within = "; the rest is within --tolerance" if v.before.gap > _WIDER * v.floor.gap else ""
        noise = ", with measured noise in place of that of the model" if result.measured_noise else ""
        return f"{_TITLES['agree']}{noise}: no disagreement beyond noise and tolerance; {gap}{within}."
    where = [place for place in result.where if place not in result.places_of_changes]
    if not where and v.verdict == "unexplained":
        if v.findings.few:
            return "There are too few independent samples to tell whether simulation and measurement disagree."
        return (
            "No statistic stands out beyond noise and tolerance, but effects fit the samples better than the model"
            " alone. None of them explains the difference."
        )
    place = where_text(where[0], result) if where else "where no single statistic shows it"
    if v.verdict == "unexplained":
        stays = where[0].statistic in ("bias", "pattern")  # a smooth law of place or range has no change in time
        law = f"; a smooth function of {v.law} fits better than any of them" if v.law and stays else ""
        if v.own is not None:
            own = f"the model's own effect fits with other numbers: {in_words(v.own)}"
            return f"Simulation and measurement disagree most {place}. No other effect explains it; {own}."
        return f"Simulation and measurement disagree most {place}. None of the known effects explains it{law}."
    effects = " and ".join(effect_text(n, result) for n in result.named)
    verb = "explain" if len(result.named) > 1 else "explains"
    whole = v.verdict == "explained" or (result.changed and not v.findings.open)
    part = "it" if whole else "a part of it"
    fall = f"the gap falls from {v.before.gap:.1f} to {v.after.gap:.1f}, noise alone gives {v.floor.gap:.1f}"
    wider = v.verdict == "explained" and not result.left and v.after.gap > _WIDER * max(v.floor.gap, 1.0)
    within = "; the rest is within --tolerance, which the errors exclude" if wider else ""
    return f"Simulation and measurement disagree most {place}. {effects} {verb} {part}; {fall}{within}."


def in_words(effect: Effect) -> str:
    """The sentence of an effect, its numbers with four digits."""
    numbers = {name: getattr(effect, name) for name in effect.parameters()}
    short = {name: rounded(value, 4) for name, value in numbers.items() if isinstance(value, float)}
    return replace(effect, **short).explain()


def where_text(place: Place, result: Reconciliation) -> str:
    """A place in words, such as ``at range 2000 to 2450 mm: bias of -10.9 mm``."""
    low, high = place.interval
    unit = _UNITS.get(place.axis, "")
    axis = _AXES.get(place.axis, f"at {place.axis}")
    within = f" in recording {place.recording + 1}" if len(result.models) > 1 else ""
    size = f"{place.statistic.replace('_', ' ')} of {number(place.size, '+.3g')}{' mm' if place.unit == 'mm' else ''}"
    if place.statistic == "trend":
        change = f"ranges {'grow' if place.size > 0 else 'shrink'} by {number(abs(place.size), '.3g')} mm"
        return f"{axis} {number(low, '.4g')} to {number(high, '.4g')} {unit}{within} ({change})"
    if place.statistic == "memory":
        frames = f"{low:g} to {high:g} frames" if high > low else counted(int(low), "frame")
        return f"between samples {frames} apart{within} ({size})"
    if place.statistic == "bridging":
        return f"between two surfaces of one pixel{within} ({number(place.size, '+.3g')} of its samples)"
    if place.axis == "all":
        return f"everywhere{within} ({size})"
    if place.axis == "surface":
        names = [s.name for s in result.models[place.recording].surfaces]
        numbers = range(max(math.floor(low), 0), math.ceil(high))
        named = " and ".join(f'"{names[n]}"' for n in numbers if n < len(names)) or "no return"
        return f"on {named}{within} ({size})"
    return f"{axis} {number(low, '.4g')} to {number(high, '.4g')}{' ' if unit else ''}{unit}{within} ({size})"


def p_text(place: Place) -> str:
    """The corrected p-value as text; very small values as a bound."""
    no_doubt = 1.0e-99  # smaller p-values are not printed
    return f"p = {place.p_value:.1g}" if place.p_value > no_doubt else f"p < {no_doubt:g}"


def effect_text(named: NamedEffect, result: Reconciliation) -> str:
    """An effect and its numbers with their errors, such as ``wiggling (amplitude_mm 11.8 +- 0.2)``."""
    some = len(named.recordings) < len(result.models)
    within = f" in recording {', '.join(str(k + 1) for k in named.recordings)}" if some else ""
    shown = [
        _text(name, value) if isinstance(value, str) else _with_error(name, value, named.stderr.get(name))
        for name, value in named.parameters.items()
        if isinstance(value, str) or (not isinstance(value, list) and (value or named.stderr.get(name)))
    ]  # zeros are left out
    within_lists = named.effect.numbers().keys() - named.effect.parameters().keys()
    shown += [
        _with_error(name, value, named.stderr.get(name))
        for name, value in named.effect.numbers().items()
        if name in within_lists
    ]
    size = named.effect.size_of_map()  # which the name of its file does not show
    shown += [size] if size else []
    return f"{named.effect.kind} ({', '.join(shown)}){within}" if shown else named.effect.kind


def _text(key: str, value: str) -> str:
    """A text in quotes; only what is no surface of the effect, and no map, needs its key."""
    return f'"{value}"' if key in ("surface", "map") else f'{key} "{value}"'


def _with_error(name: str, value: float, error: float | None) -> str:
    if not error:
        return f"{name} {number(value, '.4g')}"
    digits = max(0, 1 - math.floor(math.log10(error)))
    return f"{name} {number(value, f'.{min(digits, 8)}f')} +- {error:.{min(digits, 8)}f}"


def summary_lines(result: Reconciliation) -> list[str]:
    """About ten lines for the terminal."""
    v = result.verified
    so_far = "" if result.is_complete else " so far: the search was interrupted"
    lines = [headline(result), "", f"verdict      {v.verdict}{so_far}"]
    lines += [
        f"effect       {effect_text(n, result)}, held-out gain {number(n.heldout_gain_nats, '.0f')} nats"
        for n in result.named
    ]
    lines += [f"where        {where_text(p, result)}, {p_text(p)}" for p in result.where[:2]]
    if result.named and result.left:
        lines.append(f"left         {where_text(result.left[0], result)}, {p_text(result.left[0])}")
    ranking = ", ".join(f"{c.kind} {number(c.gain, '.0f')}" for c in result.candidates[:4])
    lines += [f"candidates   each alone: {ranking}"] if ranking else []
    closed = "" if v.closed is None else f", closed {closed_text(v.closed)}"
    lines.append(f"gap          before {v.before.gap:.2f}, after {v.after.gap:.2f}, floor {v.floor.gap:.2f}{closed}")
    lines += [f"next         {step}" for step in result.next_steps]
    return lines


def closed_text(closed: float) -> str:
    """The closed share of a gap, to a percent: its errors are larger, and they may put it above the whole gap."""
    return f"{number(100 * min(closed, 1.0), '.0f')} %"


def effect_tables(result: Reconciliation, recording: int = 0) -> str:
    """The [[effect]] tables that are appended to a recording's model file; empty if there are none."""
    return "\n".join(_table(n) for n in result.acting(recording))


def suggested_tables(result: Reconciliation, recording: int = 0) -> str:
    """The tables of the suggested model, appended to a recording's model file."""
    surfaces = [surface_table(surface) for number, surface in result.suggested_surfaces if number == recording]
    return "\n".join([*surfaces, *(_table(n) for n in result.advised(recording))])


def _table(named: NamedEffect) -> str:
    lines = ["[[effect]]", f'kind = "{named.effect.kind}"']
    lines += [f"{name} = {_value(value)}" for name, value in named.parameters.items()]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:  # noqa: ANN401  a string, a number, or lists of them
    return json.dumps(value) if isinstance(value, str | list) else repr(float(value) + 0.0)

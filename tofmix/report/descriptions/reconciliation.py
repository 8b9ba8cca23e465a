"""Description of the folder of a reconciliation, from its `gap.json`."""

from typing import Any

from tofmix.report.descriptions.description import Description, Section, Value
from tofmix.wording import finite_or_none


def describe_gap(gap: dict[str, Any], *, name: str, most_shown: int = 20) -> Description:
    """Describe the result of `tofmix reconcile`, from its `gap.json`.

    Of effects and of places `most_shown` each are listed.
    """
    effects: list[dict[str, Any]] = [
        {"kind": effect.get("kind"), **_flat(effect.get("parameters"))} for effect in _dicts(gap["effects"])
    ]
    places: list[dict[str, Any]] = [
        {key: place[key] for key in ("statistic", "axis", "interval", "size", "unit") if key in place}
        for place in _dicts(gap.get("where"))
    ]
    sections: dict[str, Section] = {
        "found": {"verdict": str(gap["verdict"]), "effects": effects[:most_shown], "where": places[:most_shown]},
        "gap": {key: _plain(gap["gap"].get(key)) for key in ("before", "after", "floor", "closed")},
    }
    steps = gap.get("next_steps")
    if isinstance(steps, list) and steps:
        sections["next_steps"] = {str(number): str(step) for number, step in enumerate(steps[:most_shown], 1)}
    return Description(kind="reconciliation", name=name, sections=sections, warnings=())


def _dicts(value: object) -> list[dict[str, Any]]:
    return [item for item in value if isinstance(item, dict)] if isinstance(value, list) else []


def _flat(value: object) -> dict[str, Any]:
    return {str(key): _plain(item) for key, item in value.items()} if isinstance(value, dict) else {}


def _plain(value: object) -> Value:
    known = finite_or_none(value)
    return known if isinstance(known, str | int | float | None) else str(known)

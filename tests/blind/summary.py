"""Results of the bench as Markdown tables: names, verdicts, gaps, parameters, times, z-scores, ceilings."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from blind.cases import SETTINGS
from blind.strength import KINDS

Result = dict[str, Any]


def summary(results: list[Result]) -> str:
    """All tables that the results allow."""
    good = [r for r in results if "broken" not in r]
    parts = [f"{len(results)} cases, {len(results) - len(good)} broken."]
    parts += [f"broken: {r['case']}: {r['broken']}" for r in results if "broken" in r]
    parts += [z_table(good), ceiling_table(good)]
    parts += [two_sample_table(good)]
    for half in ("open", "sealed"):
        for setting in ("ordinary", *SETTINGS):
            said = [
                r for r in good if r["half"] == half and _setting(r) == setting and ("verdict" in r or "failed" in r)
            ]
            if said:
                title = f"## {half} half" + (f", {setting}" if setting != "ordinary" else "")
                parts += [title, score_table(said), kind_table(said), confusion(said), stranger_table(said)]
    return "\n\n".join(part for part in parts if part)


def table(head: list[str], rows: Iterable[list[Any]]) -> str:
    """A Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def _share(items: list[Result], test: Callable[[Result], bool]) -> str:
    if not items:
        return "-"
    hits = sum(bool(test(r)) for r in items)
    return f"{hits}/{len(items)} ({100 * hits / len(items):.0f} %)"


def _median(values: list[float]) -> str:
    return f"{np.median(values):.3f}" if values else "-"


def _setting(result: Result) -> str:
    return str(result.get("setting", "ordinary"))


def strongest(result: Result) -> tuple[float, str]:
    """Largest z of a case's panel before, and where."""
    z, name = max((line[3], f"{line[0]}/{line[1]}") for line in result["panel"])
    return float(z), name


def z_table(results: list[Result]) -> str:
    """How far the cases stand outside chance before anything is reconciled."""
    rows = []
    for level in ("faint", "clear"):
        for kind in KINDS:
            of = [r for r in results if r["sort"] == "single" and r["level"] == level and r["truth"]["kinds"] == [kind]]
            if of:
                rows.append([kind, level, *_outside(of)])
    for sort in ("none", "nearly", "pair", "stranger"):
        of = [r for r in results if r["sort"] == sort]
        if of:
            rows.append([f"({sort})", "", *_outside(of)])
    note = _chance([r for r in results if r["sort"] == "none"])
    head = ["kind", "level", "cases", "smallest of the largest z", "median", "where, most often", "gap before"]
    return "### Largest z of the panel, by case\n\n" + table(head, rows) + "\n\n" + note


def _outside(of: list[Result]) -> list[Any]:
    top = [strongest(r) for r in of]
    common = Counter(name for _, name in top).most_common(1)[0][0]
    z = [value for value, _ in top]
    return [len(of), f"{min(z):.1f}", f"{np.median(z):.1f}", common, f"{np.median([r['before'] for r in of]):.1f}"]


def _chance(none: list[Result]) -> str:
    if not none:
        return ""
    z = np.array([line[3] for r in none for line in r["panel"] if line[0] != "invalid" or line[3] != 0])
    expected = float(np.sqrt(2 * np.log(z.size)))
    return (
        f"Without an effect: largest z {z.max():.2f} of {z.size} (chance: about {expected:.1f}); mean {z.mean():.2f}, "
        f"standard deviation {z.std():.2f}; gap {min(r['before'] for r in none):.2f} to "
        f"{max(r['before'] for r in none):.2f}."
    )


TESTS = ("energy", "energy_pixel", "classifier")


def two_sample_table(results: list[Result]) -> str:
    """How many cases the two-sample tests tell from their simulation at 1 %, before and after, and by how much."""
    rows = []
    groups: dict[tuple[str, ...], list[Result]] = defaultdict(list)
    for r in results:
        if "two_samples" in r:
            groups[_setting(r), r["sort"], r["level"], str(r.get("verdict", "-"))].append(r)
    for key, of in sorted(groups.items()):
        row: list[Any] = [*key, len(of)]
        for when in ("before", "after"):
            tests = [r["two_samples"][when] for r in of if when in r["two_samples"]]
            for name in TESTS:
                values = [t[name] for t in tests]
                differ = sum(value > limit for value, limit, _ in values)
                row.append(f"{differ}/{len(values)} ({np.median([v[0] for v in values]):.3g})" if values else "-")
        rows.append(row)
    head = ["setting", "sort", "level", "verdict", "cases", *(f"{name} before" for name in TESTS), *TESTS]
    note = (
        "Cases that differ from a fresh simulation at the level of 1 %, and the median statistic; by chance energy is 0"
    )
    return f"### Two-sample tests\n\n{note} and the classifier's area 0.5.\n\n" + table(head, rows) if rows else ""


def ceiling_table(results: list[Result]) -> str:
    """What the true effect, simulated by the package, closes."""
    rows = []
    for kind in KINDS:
        row: list[Any] = [kind]
        rest: Counter[str] = Counter()
        for level in ("faint", "clear"):
            of = [r for r in results if r["sort"] == "single" and r["level"] == level and r["truth"]["kinds"] == [kind]]
            closed = [r["ceiling"] for r in of if r.get("ceiling") is not None]
            row += [len(closed), _median(closed), f"{min(closed):.3f}" if closed else "-"]
            rest.update(f"{r['ceiling_rest'][0][0]}/{r['ceiling_rest'][0][1]}" for r in of if "ceiling_rest" in r)
        if rest:
            rows.append([*row, rest.most_common(1)[0][0]])
    head = ["kind", "faint", "median", "least", "clear", "median", "least", "what is left, most often"]
    return "### Ceiling: gap closed by the true effect in `tofmix simulate`\n\n" + table(head, rows) if rows else ""


def score_table(said: list[Result]) -> str:
    """The criteria."""
    single = [r for r in said if r["sort"] == "single"]
    pairs = [r for r in said if r["sort"] == "pair"]
    strangers = [r for r in said if r["sort"] == "stranger"]
    right = [r for r in single if r.get("right")]
    closed = [r["closed"] for r in right if r.get("closed") is not None]
    again = [r["second_scene"]["closed"] for r in right if (r.get("second_scene") or {}).get("closed") is not None]
    parameters = [p for r in right for p in r["parameters"].values()]
    seconds = [r["seconds"] for r in said]
    rows = [
        [f"{level}: named first", _share([r for r in single if r["level"] == level], lambda r: r.get("first", False))]
        for level in ("clear", "faint")
    ]
    rows += [
        [
            f"{level}: named, and nothing else",
            _share([r for r in single if r["level"] == level], lambda r: r.get("right", False)),
        ]
        for level in ("clear", "faint")
    ]
    rows += [
        ["none: agree", _share(_of(said, "none"), lambda r: r.get("verdict") == "agree")],
        ["none: a name", _share(_of(said, "none"), lambda r: bool(r.get("named")))],
        ["nearly right: no name of a sensor effect", _share(_of(said, "nearly"), _no_sensor_name)],
        ["strangers: unexplained or partly, at the right axis", _share(strangers, _stranger_right)],
        ["strangers: explained", _share(strangers, lambda r: r.get("verdict") == "explained")],
        ["strangers: any name", _share(strangers, lambda r: bool(r.get("named")))],
        ["pairs: both", _share(pairs, lambda r: len(r.get("found", [])) == 2)],
        ["pairs: at least one", _share(pairs, lambda r: bool(r.get("found")))],
        ["gap closed, median over the rightly named", _median(closed)],
        ["gap closed on the second scene, median", _median(again)],
        ["parameters right", f"{sum(p['right'] for p in parameters)}/{len(parameters)}"],
        ["seconds, median and largest", f"{_median(seconds)}, {max(seconds):.0f}"],
        ["failed", _share(said, lambda r: "failed" in r)],
    ]
    return table(["criterion", "result"], rows)


def _of(results: list[Result], sort: str) -> list[Result]:
    return [r for r in results if r["sort"] == sort]


def _no_sensor_name(result: Result) -> bool:
    return "failed" not in result and not set(result.get("named", [])) - {"surface_pose"}


def _stranger_right(result: Result) -> bool:
    return result.get("verdict") in ("unexplained", "partly_explained") and bool(result.get("axis_right"))


def kind_table(said: list[Result]) -> str:
    """Names, parameters and gaps by kind."""
    rows = []
    for kind in KINDS:
        of = [r for r in said if r["sort"] == "single" and r["truth"]["kinds"] == [kind]]
        if not of:
            continue
        right = [r for r in of if r.get("right")]
        parameters = [r["parameters"][kind] for r in right if kind in r["parameters"]]
        rows.append(
            [
                kind,
                *(
                    _share([r for r in of if r["level"] == level], lambda r: r.get("first", False))
                    for level in ("clear", "faint")
                ),
                f"{sum(p['right'] for p in parameters)}/{len(parameters)}",
                _median([p["off"] for p in parameters if p["off"] is not None]),
                _median([r["closed"] for r in right if r.get("closed") is not None]),
                _median([r["ceiling"] for r in right if r.get("ceiling") is not None]),
                _median(
                    [
                        r["second_scene"]["closed"]
                        for r in right
                        if (r.get("second_scene") or {}).get("closed") is not None
                    ]
                ),
            ]
        )
    head = ["kind", "clear", "faint", "parameters right", "off (median)", "closed", "ceiling", "second scene"]
    return "### By kind\n\n" + table(head, rows) if rows else ""


def confusion(said: list[Result]) -> str:
    """What was named first, by what was hidden."""
    counts: dict[str, Counter[str]] = defaultdict(Counter)
    for r in said:
        if r["sort"] in ("single", "none", "nearly"):
            hidden = r["truth"]["kinds"][0] if r["truth"]["kinds"] else f"({r['sort']})"
            counts[hidden][
                r["named"][0] if r.get("named") else "failed" if "failed" in r else str(r.get("verdict"))
            ] += 1
    rows = [[hidden, ", ".join(f"{name} {n}" for name, n in named.most_common())] for hidden, named in counts.items()]
    return "### Confusion: named first\n\n" + table(["hidden", "named"], rows) if rows else ""


def stranger_table(said: list[Result]) -> str:
    """What was said of the strangers."""
    rows = []
    for r in said:
        if r["sort"] == "stranger":
            where = ", ".join(f"{w['statistic']}/{w['axis']}" for w in r.get("where", [])[:2])
            rows.append(
                [
                    r["case"],
                    r.get("verdict", "failed"),
                    "+".join(r.get("named", [])) or "-",
                    where,
                    "yes" if r.get("axis_right") else "no",
                ]
            )
    return "### Strangers\n\n" + table(["case", "verdict", "named", "where", "right axis"], rows) if rows else ""

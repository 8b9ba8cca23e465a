"""The ledger of a search: each weighed set is entered and told, and the search may be ended between two sets."""

import pytest

from tofmix.reconciliation.found import Ledger, WeighedSet, set_text

WALL = ("surface_pose", "wall")
OFFSET = ("range_offset", "")


def test_follower_gets_each_set_with_its_effects_in_order() -> None:
    lines: list[str] = []
    ledger = Ledger(lambda weighed: lines.append(weighed.line))
    ledger.weigh([WALL, OFFSET], 5321.04)
    ledger.weigh([], -0.04, "leaves the width open")
    assert [" ".join(line.split()) for line in lines] == [
        '5,321.0 nats range_offset + surface_pose "wall"',
        "0.0 nats no effect: leaves the width open",
    ]


def test_search_that_is_stopped_ends_for_good_and_is_not_complete() -> None:
    stopped = [False]
    ledger = Ledger(is_stopped=lambda: stopped[0])
    assert not ledger.ends()
    assert ledger.is_complete
    stopped[0] = True
    assert ledger.is_complete  # nobody has looked: the search came to its end before
    assert ledger.ends()
    stopped[0] = False
    assert ledger.ends()
    assert not ledger.is_complete


def test_best_has_each_set_once_with_its_most_evidence_and_none_that_lost() -> None:
    ledger = Ledger()
    for names, nats, why_not in (([OFFSET], 3.0, None), ([WALL], 9.0, None), ([OFFSET], 5.0, None), ([], 99.0, "lost")):
        ledger.weigh(names, nats, why_not)
    assert ledger.best() == [
        WeighedSet(names=(WALL,), evidence_nats=9.0),
        WeighedSet(names=(OFFSET,), evidence_nats=5.0),
    ]


@pytest.mark.parametrize(
    ("names", "text"),
    [((), "no effect"), ((OFFSET, WALL), 'range_offset + surface_pose "wall"'), ((OFFSET,), OFFSET[0])],
)
def test_set_is_told_by_its_kinds_and_surfaces(names: tuple[tuple[str, str], ...], text: str) -> None:
    assert set_text(names) == text

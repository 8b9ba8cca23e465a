import pytest

from tofmix.report.summary.findings import Remedy, count_findings, sample_findings, sigma_findings
from tofmix.report.summary.thresholds import DEFAULT_THRESHOLDS, Thresholds

REMEDY = Remedy(recording="a b.h5", window_frames=40, windows=2)


@pytest.mark.parametrize(
    ("median", "codes"), [(1.0, []), (1.09, []), (1.2, ["sigma_off_curve"]), (0.8, ["sigma_off_curve"]), (None, [])]
)
def test_sigma_off_the_curve_is_reported(median: float | None, codes: list[str]) -> None:
    assert [f.code for f in sigma_findings(count=1000, median=median, has_curve=True, remedy=REMEDY)] == codes


def test_few_components_give_no_finding() -> None:
    assert sigma_findings(count=29, median=2.0, has_curve=True, remedy=REMEDY) == []


def test_missing_curve_is_reported() -> None:
    assert [f.code for f in sigma_findings(count=0, median=None, has_curve=False, remedy=REMEDY)] == ["no_noise_curve"]


def test_sound_layers_give_no_finding() -> None:
    assert count_findings(pixels=100, by_status={"ok": 100}, by_surfaces=[0, 96, 4], max_layers=2, remedy=REMEDY) == []


def test_each_count_has_its_finding() -> None:
    by_status = {"ok": 70, "too_few_samples": 10, "not_converged": 10, "degenerate": 10}
    found = count_findings(pixels=100, by_status=by_status, by_surfaces=[0, 50, 50], max_layers=2, remedy=REMEDY)
    assert [f.code for f in found] == ["too_few_samples", "not_converged", "degenerate", "all_layers_used"]
    assert "10.0 %" in found[0].text
    assert found[-1].commands == ("tofmix estimate 'a b.h5' --max-layers 4 --overwrite",)
    assert found[0].line.endswith("Try: tofmix estimate 'a b.h5' --window 80 --overwrite")


def test_files_of_one_layer_get_no_advice_on_max_layers() -> None:
    assert count_findings(pixels=10, by_status={}, by_surfaces=[0, 10], max_layers=1, remedy=REMEDY) == []


def test_file_without_surfaces_is_reported() -> None:
    found = count_findings(pixels=10, by_status={}, by_surfaces=[10, 0], max_layers=1, remedy=REMEDY)
    assert [f.code for f in found] == ["no_surface_anywhere"]


def test_files_of_one_window_get_no_advice_on_window_length() -> None:
    alone = Remedy(recording="a.h5", window_frames=40)
    found = count_findings(pixels=1, by_status={"too_few_samples": 1}, by_surfaces=[0, 1], max_layers=2, remedy=alone)
    assert [f.commands for f in found] == [()]


def test_close_layers_name_both_remedies_except_those_already_tried() -> None:
    def commands(remedy: Remedy) -> tuple[str, ...]:
        found = count_findings(pixels=10, by_status={}, by_surfaces=[0, 9, 1], max_layers=4, close=1, remedy=remedy)
        return found[0].commands

    assert [c.split()[-3:-1] for c in commands(REMEDY)] == [["--window", "13"], ["--noise", "auto"]]
    measured = Remedy(recording="a.h5", noise="auto", window_frames=40)
    assert [c.split()[-3:-1] for c in commands(measured)] == [["--window", "13"]]


def test_close_layers_of_the_papers_procedure_name_the_default_one() -> None:
    paper = Remedy(recording="a.h5", window_frames=40, paper=True)
    found = count_findings(pixels=10, by_status={}, by_surfaces=[0, 9, 1], max_layers=4, close=1, remedy=paper)
    assert found[0].commands == ("tofmix estimate a.h5 --overwrite",)
    assert "--paper causes them too" in found[0].text
    assert paper.shorter() == "tofmix estimate a.h5 --paper --window 13 --overwrite"


@pytest.mark.parametrize(
    ("scatter", "drift", "codes"),
    [
        (None, None, []),
        (0.51, 0.9 * DEFAULT_THRESHOLDS.drift_sigmas, []),
        (1.9, None, []),
        (0.49, None, ["scatter_off_curve"]),
        (2.1, 1.1 * DEFAULT_THRESHOLDS.drift_sigmas, ["scatter_off_curve", "drift"]),
    ],
)
def test_contradiction_of_the_curve_is_reported(scatter: float | None, drift: float | None, codes: list[str]) -> None:
    found = sample_findings(scatter_over_curve=scatter, drift_sigmas=drift, remedy=REMEDY)
    assert [f.code for f in found] == codes
    assert all(f.commands for f in found)


def test_thresholds_set_when_close_layers_are_a_finding() -> None:
    def codes(thresholds: Thresholds) -> list[str]:
        found = count_findings(
            pixels=100,
            by_status={},
            by_surfaces=[0, 90, 10],
            max_layers=6,
            close=10,
            remedy=Remedy(recording="a.h5"),
            thresholds=thresholds,
        )
        return [finding.code for finding in found]

    assert codes(Thresholds()) == ["close_layers"]
    assert codes(Thresholds(close_share=0.1)) == []

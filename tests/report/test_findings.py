import pytest

from tofmix.report.findings import count_findings, sigma_findings


@pytest.mark.parametrize(
    ("median", "codes"), [(1.0, []), (1.09, []), (1.2, ["sigma_off_curve"]), (0.8, ["sigma_off_curve"]), (None, [])]
)
def test_sigma_off_the_curve_is_said(median: float | None, codes: list[str]) -> None:
    assert [f.code for f in sigma_findings(count=1000, median=median, has_curve=True)] == codes


def test_few_components_say_nothing() -> None:
    assert sigma_findings(count=29, median=2.0, has_curve=True) == []


def test_missing_curve_is_said() -> None:
    assert [f.code for f in sigma_findings(count=0, median=None, has_curve=False)] == ["no_noise_curve"]


def test_all_well_says_nothing() -> None:
    assert count_findings(pixels=100, by_status={"ok": 100}, by_surfaces=[0, 96, 4], max_layers=2) == []


def test_each_count_has_its_finding() -> None:
    by_status = {"ok": 70, "too_few_samples": 10, "not_converged": 10, "degenerate": 10}
    found = count_findings(pixels=100, by_status=by_status, by_surfaces=[0, 50, 50], max_layers=2)
    assert [f.code for f in found] == ["too_few_samples", "not_converged", "degenerate", "all_layers_used"]
    assert "10.0 %" in found[0].text
    assert "--max-layers" in found[-1].text


def test_one_layer_files_are_not_told_to_have_more() -> None:
    assert count_findings(pixels=10, by_status={}, by_surfaces=[0, 10], max_layers=1) == []


def test_no_surface_anywhere_is_said() -> None:
    found = count_findings(pixels=10, by_status={}, by_surfaces=[10, 0], max_layers=1)
    assert [f.code for f in found] == ["no_surface_anywhere"]

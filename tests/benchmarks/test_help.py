"""Every script of the benchmarks that has options says them."""

import importlib
from pathlib import Path

import pytest

SCRIPTS = [
    path.stem
    for path in sorted(Path(__file__).parent.glob("*.py"))
    if not path.stem.startswith("test_") and "ArgumentParser(" in path.read_text(encoding="utf-8")
]


@pytest.mark.slow  # it imports what all of them import
def test_every_script_with_options_prints_its_help(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    failed = {}
    for name in SCRIPTS:
        main = importlib.import_module(f"benchmarks.{name}").main
        monkeypatch.setattr("sys.argv", [f"{name}.py", "--help"])
        try:
            main()
        except SystemExit as end:
            if end.code == 0 and "usage:" in capsys.readouterr().out:
                continue
            failed[name] = f"ended with {end.code}"
        except ValueError as error:  # an unescaped % in a help text
            failed[name] = str(error)
        else:
            failed[name] = "did not end"
    assert len(SCRIPTS) > 20
    assert failed == {}

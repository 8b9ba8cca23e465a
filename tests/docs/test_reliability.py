"""Each guarantee of docs/explanation/reliability.md names a test that is there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/explanation/reliability.md").read_text()


def test_every_named_test_exists() -> None:
    named = 0
    for line in PAGE.splitlines():
        module: Path | None = None
        for path, function in re.findall(r"`(tests/[\w/]+\.py)?(?:::(\w+))?`", line):
            if not path and not function:
                continue
            module = ROOT / path if path else module
            assert module is not None, line
            text = module.read_text()
            if function:
                assert f"def {function}(" in text, f"{module}: no {function}"
            named += 1
    assert named > 30


def test_every_guarantee_names_its_test() -> None:
    offenders = []
    for section in ("Reading", "Writing", "Signals", "Code and network"):
        text = PAGE.split(f"### {section}\n", 1)[1].split("\n#", 1)[0]
        rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| guarantee")]
        assert rows, section
        offenders += [row for row in rows if "`tests/" not in row and "the same" not in row]
    assert not offenders, "\n".join(offenders)

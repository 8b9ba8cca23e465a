"""Two stand-ins for `tofmix reconcile`: one adds nothing, the other is handed the truth.

    python -m blind.fake_reconcile copy MODEL MEASURED -o FOLDER
    python -m blind.fake_reconcile EFFECTS.json MODEL MEASURED -o FOLDER

EFFECTS.json holds the [[effect]] tables to add. The tests hold the scoring by them: the first must score 0, the second
at the ceiling.
"""

import json
import shutil
import sys
from pathlib import Path

from blind.write import effect_tables


def main(arguments: list[str]) -> None:
    what, model, _, _, output = arguments
    folder = Path(output)
    folder.mkdir(parents=True)
    effects = [] if what == "copy" else json.loads(Path(what).read_text(encoding="utf-8"))
    for effect in effects:
        if "map" in effect:
            shutil.copy(Path(what).parent / effect["map"], folder / effect["map"])
    text = Path(model).read_text(encoding="utf-8") + "\n" + effect_tables(effects)
    (folder / "model.toml").write_text(text, encoding="utf-8")
    named = [
        {"kind": e["kind"], "parameters": {k: v for k, v in e.items() if k != "kind"}, "stderr": {}} for e in effects
    ]
    said = {
        "verdict": "explained" if named else "agree",
        "effects": named,
        "where": [],
        "candidates": [],
        "panel": [],
        "gap": {"before": 1.0, "after": 1.0, "floor": 1.0, "closed": None},
    }
    (folder / "gap.json").write_text(json.dumps(said), encoding="utf-8")
    (folder / "report.html").write_text("<!doctype html>\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

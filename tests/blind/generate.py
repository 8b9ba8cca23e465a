"""Write cases as folders: `model.toml`, `measured.h5`, the second scene's, and `truth.json`.

    PYTHONPATH=tests python -m blind.generate --output CASES [--select wiggling-clear] [--sealed-seed N]

Use it to look at cases by hand; `blind.bench` makes, scores and removes them by itself.
"""

import argparse
import json
from pathlib import Path
from zlib import crc32

import numpy as np

from blind.cases import OPEN_SEED, Built, Case, all_cases, build
from blind.write import model_text, write_recording


def write_case(folder: Path, built: Built) -> None:
    """Write one case's folder."""
    folder.mkdir(parents=True, exist_ok=True)
    variant = crc32(built.case.name.encode()) % 4
    if built.case.sort != "single" or "temperature_drift" in built.case.kinds:
        variant %= 3  # with `time`
    for which, (model, measured) in enumerate(
        (("model.toml", "measured.h5"), ("model_second_scene.toml", "measured_second_scene.h5"))
    ):
        text = model_text(built.device, built.models[which], built.noise, seed=1 + which)
        (folder / model).write_text(text, encoding="utf-8")
        write_recording(folder / measured, built.record(which), built.device, built.noise, variant=variant)
    truth = built.truth()
    for kind, values in built.maps().items():
        np.save(folder / f"truth_{kind}.npy", values.astype(np.float32))
    (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


def selected(names: list[str], sealed_seed: int | None) -> list[tuple[Case, int]]:
    """Cases whose name begins with one of the names, with their half's master seed; the sealed half needs its seed."""
    out = []
    for case in all_cases():
        if names and not any(case.name.startswith(name) for name in names):
            continue
        if case.half == "open":
            out.append((case, OPEN_SEED))
        elif sealed_seed is not None:
            out.append((case, sealed_seed))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--select", nargs="*", default=[], help="beginnings of case names")
    parser.add_argument("--sealed-seed", type=int)
    options = parser.parse_args()
    for case, master in selected(options.select, options.sealed_seed):
        write_case(options.output / case.name, build(case, master))
        print(case.name, flush=True)


if __name__ == "__main__":
    main()

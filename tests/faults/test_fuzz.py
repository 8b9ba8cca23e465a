"""Damaged recordings, layers and sources of every kind are read whole or refused in a line."""

import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from PIL import Image
from support.bags import AMPLITUDE, DEPTH, INFO, KINDS, new_bag
from support.files import boards

from faults.fuzz import DONE, Fuzz, judge
from faults.mutants import mutate
from faults.originals import Original, parts_with_learnt_noise
from faults.pool import Job, Outcome, Pool

MUTANTS = 90
GOOD = Outcome(code=0, hung=False, out="", err="", seconds=0.1, cpu_s=0.1, extra_bytes=0, calls=0)
REFUSED = replace(GOOD, code=3, err="tofmix: mutant.h5: not an HDF5 file\n")


@pytest.mark.faults
def test_mutants_are_done_or_refused(fuzz: Fuzz, originals: dict[str, Original]) -> None:
    verdicts = list(fuzz.run(list(originals), MUTANTS, seed=0))
    assert len(verdicts) == MUTANTS
    faults = [f"{v.fault}: {v.mutant}: {v.command}: {v.change}: {v.outcome.err}" for v in verdicts if v.fault]
    assert not faults, "\n".join(faults)
    by_kind = {kind: Counter(v.result for v in verdicts if v.kind == kind) for kind in originals}
    assert all(results["refused"] for results in by_kind.values()), by_kind
    assert sum(results["refused"] == results.total() for results in by_kind.values()) <= 3, by_kind


@pytest.mark.faults
def test_mutants_of_parts_with_learnt_noise_are_done_or_refused(pool: Pool, tmp_path: Path) -> None:
    kind = "part with learnt noise"
    verdicts = list(Fuzz(tmp_path, pool, parts_with_learnt_noise(tmp_path, pool)).run([kind], 20, seed=0))
    faults = [f"{v.fault}: {v.mutant}: {v.command}: {v.change}: {v.outcome.err}" for v in verdicts if v.fault]
    assert not faults, "\n".join(faults)
    assert {v.result for v in verdicts} >= {"done", "refused"}


@pytest.mark.parametrize(
    ("outcome", "names", "fault"),
    [
        (GOOD, {"out.csv"}, ""),
        (REFUSED, set(), ""),
        (replace(GOOD, code=6), set(), ""),
        (replace(GOOD, hung=True, code=-9), set(), "hang"),
        (replace(GOOD, code=-11), set(), "signal 11"),
        (replace(GOOD, code=1, err="Traceback (most recent call last):\n"), set(), "traceback"),
        (replace(REFUSED, err="Traceback (most recent call last):\n"), set(), "traceback"),
        (replace(REFUSED, code=9), set(), "exit code 9"),
        (replace(GOOD, extra_bytes=2 * 10**9), set(), "memory"),
        (replace(REFUSED, err="RuntimeWarning: overflow\n" + REFUSED.err), set(), "stray line on stderr"),
        (replace(REFUSED, err=""), set(), "no reason"),
        (replace(REFUSED, err="tofmix: other.h5: truncated\n"), set(), "file not named"),
        (GOOD, {".out.csv.partial"}, "files left"),
        (REFUSED, {"out.csv"}, "output of a failed run"),
    ],
)
def test_each_fault_is_seen(outcome: Outcome, names: set[str], fault: str) -> None:
    assert judge(outcome, names, mutant="mutant.h5") == fault


@pytest.mark.faults
def test_a_seed_makes_the_same_mutant(originals: dict[str, Original], tmp_path: Path) -> None:
    for kind in ("foreign recording", "model", "npz"):
        for number in range(8):
            twice = []
            for name in ("a", "b"):
                path, change = mutate(originals[kind], f"{kind} {number}", tmp_path / name)
                twice.append((path.read_bytes() if change.startswith(("bytes", "text")) else b"", change))
            assert twice[0] == twice[1]
            assert twice[0][1]


COUNT, OF_MAT = 400, 10
"""Mutants of all kinds, and how many of these are MAT files: for each, `import` starts a process, as long as ten of
another kind take."""

LENS = "--fov 40x30"


def sources(folder: Path) -> dict[str, Original]:
    """Sources of all kinds, with times, codes and packing, so that every rule of import meets damage."""
    samples, time_s = boards(8, 4, 6), np.arange(8) / 25.0
    status = np.where(samples % 5, 5, 255).astype("u1")
    codes = f"{LENS} --valid-status status=5"
    np.save(folder / "a.npy", samples)
    np.savez(folder / "a.npz", depth=samples, status=status, time=time_s)
    scipy.io.savemat(folder / "a.mat", {"depth": samples, "status": status, "time": time_s})
    with h5py.File(folder / "a.nc", "w") as root:
        packed = root.create_dataset("depth", data=((samples - 1000.0) * 2).astype("i2"), chunks=(2, 4, 6))
        packed.attrs.update({"scale_factor": 0.5, "add_offset": 1000.0, "_FillValue": np.int16(-9), "valid_min": -1000})
        root["status"], root["time"] = status, np.arange(8) * 40.0
        root["time"].attrs["units"] = "ms"
    tifffile.imwrite(folder / "a.tif", samples, description="1 count = 0.5 mm", metadata=None)
    images = folder / "bag_images"  # the name by which one of several files is damaged
    images.mkdir()
    for k in range(4):
        Image.fromarray(samples[k]).save(images / f"{k}.png")
    places = list(np.ndindex(8, 4, 6))
    long = [f"{k},{r},{c},{samples[k, r, c]},{status[k, r, c]},{k * 40}" for k, r, c in places]
    (folder / "a.csv").write_text("\n".join(["frame,row,col,range_mm,status,time_ms", *long]))
    wide = [",".join(str(value) for value in image.ravel()) for image in samples]
    (folder / "b.csv").write_text("\n".join(wide))
    found = {
        "npy": Original((folder / "a.npy",), "bytes", (f"import @ -o out.h5 {LENS}",)),
        "npz": Original((folder / "a.npz",), "bytes", (f"import @ -o out.h5 {codes}",)),
        "mat": Original((folder / "a.mat",), "bytes", (f"import @ -o out.h5 {codes} --axes frame,row,col",)),
        "nc": Original((folder / "a.nc",), "hdf5", (f"import @ -o out.h5 {codes}",)),
        "tif": Original((folder / "a.tif",), "bytes", (f"import @ -o out.h5 {LENS}",)),
        "png": Original(tuple(sorted(images.iterdir())), "bytes", (f"import @ -o out.h5 {LENS}",)),
        "long": Original((folder / "a.csv",), "text", (f"import @ -o out.h5 {codes}",)),
        "wide": Original((folder / "b.csv",), "text", (f"import @ -o out.h5 {LENS} --shape 4x6",)),
    }
    for kind in KINDS:
        with new_bag(folder, kind) as (bag, path):
            for k, image in enumerate(samples[:4]):
                bag.image(DEPTH, image, stamp_ns=10**9 + k * 40_000_000)
                bag.image(AMPLITUDE, image, stamp_ns=10**9 + k * 40_000_000)
            bag.info(INFO, (4, 6), (9.0, 9.0, 2.5, 1.5))
        files = tuple(sorted(path.iterdir())) if path.is_dir() else (path,)
        found[kind] = Original(files, "bytes", (f"import @ -o out.h5 --topic {DEPTH} --amplitude {AMPLITUDE}",))
    return found


@pytest.mark.faults
def test_damaged_sources_are_refused_in_one_line_or_give_a_sound_recording(pool: Pool, tmp_path: Path) -> None:
    originals = sources(tmp_path)
    kinds = list(originals)
    for kind, original in originals.items():  # undamaged, each is read
        whole = original.files[0] if len(original.files) == 1 else original.files[0].parent
        (tmp_path / f"{kind}-out").mkdir()
        argv = tuple(str(whole) if word == "@" else word for word in original.commands[0].split())
        assert pool.run(Job(argv=argv, cwd=str(tmp_path / f"{kind}-out"), fresh=False)).code in DONE, kind

    def result(number: int) -> tuple[str, str]:
        kind = kinds[number % len(kinds)]
        original = originals[kind]
        with tempfile.TemporaryDirectory(prefix="damage-") as name:
            mutant, change = mutate(original, f"import {number}", Path(name) / f"mutant{original.files[0].suffix}")
            out = Path(name) / "out"
            out.mkdir()
            argv = tuple(str(mutant) if word == "@" else word for word in original.commands[0].split())
            done = pool.run(Job(argv=argv, cwd=str(out), fresh=False))
            fault = judge(done, {path.name for path in out.iterdir()}, mutant=mutant.name)
            if not fault and done.code in DONE:
                verified = pool.run(Job(argv=("verify", "out.h5"), cwd=str(out), fresh=False))
                fault = "" if verified.code == 0 else f"not sound: {verified.out} {verified.err}"
            text = f"{kind} {number}: {change}: {fault}: {done.err[-300:]}" if fault else ""
            return text, f"{kind} {'done' if done.code in DONE else 'refused'}"

    some = [number for number in range(COUNT) if kinds[number % len(kinds)] != "mat" or number < OF_MAT * len(kinds)]
    results = list(pool.map(result, some))
    faults = [fault for fault, _ in results if fault]
    assert not faults, "\n".join(faults)
    counts = Counter(kind for _, kind in results)
    assert {kind.split()[0] for kind in counts} == set(kinds)
    assert all(counts[f"{kind} refused"] for kind in kinds), counts

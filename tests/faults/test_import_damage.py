"""Damaged, cut and shuffled sources of every kind: `import` refuses them in one line, or `verify` finds no fault."""

import tempfile
from collections import Counter
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
import tifffile
from PIL import Image
from support.bags import AMPLITUDE, DEPTH, INFO, KINDS, new_bag
from support.files import boards

from faults.fuzz import DONE, judge
from faults.mutants import mutate
from faults.originals import Original
from faults.pool import Job, Pool

COUNT, OF_MAT = 1000, 20
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
    assert all(counts[f"{kind} refused"] and counts[f"{kind} done"] for kind in kinds), counts

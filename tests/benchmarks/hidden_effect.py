"""Make `sample_data/hidden_effect.h5` again: the blind simulator's camera, with harmonics that the model has not.

Run as `python tests/benchmarks/hidden_effect.py FOLDER`; prints the hidden effect in the model's terms.
"""

import sys
from dataclasses import replace
from pathlib import Path

import h5py

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind.calibrate import calibrated
from blind.camera import record
from blind.cases import OPEN_SEED, draw_device
from blind.effects import Harmonics, Place
from blind.geometry import cast
from blind.scenes import draw_scene
from blind.write import model_text, write_recording

FRAMES = 60


def main(folder: Path) -> None:
    """Write model and recording; the amplitudes are left out, to keep the file small."""
    device = replace(draw_device(OPEN_SEED, 0), name="hidden effect", frames=FRAMES)
    scene = draw_scene("stairs", [OPEN_SEED, 77], device.view).surfaces
    noise = calibrated(replace(device, name="", frame_rate_hz=25.0, frames=1))
    hidden = Harmonics(third=0.012, third_phase=0.9, fifth=0.002, fifth_phase=0.2)
    (folder / "hidden_effect_model.toml").write_text(model_text(device, scene, noise), encoding="utf-8")
    whole = folder / "hidden_effect.h5.tmp"
    write_recording(whole, record(device, scene, (hidden,), seed=2008), device, noise)
    with h5py.File(whole, "r") as source, h5py.File(folder / "hidden_effect.h5", "w") as target:
        target.attrs.update(source.attrs)
        for name in ("frame", "row", "col", "range", "time", "sensor"):
            source.copy(source[name], target, name=name, expand_refs=False, without_attrs=False)
        for name in ("frame", "row", "col"):
            del target[name]
            target.create_dataset(name, data=source[name][...]).make_scale(name)
        for dataset, names in (("range", ("frame", "row", "col")), ("time", ("frame",))):
            values, attributes = source[dataset][...], {k: source[dataset].attrs[k] for k in _KEPT[dataset]}
            del target[dataset]
            packed = {"compression": "gzip", "compression_opts": 9, "shuffle": True} if dataset == "range" else {}
            made = target.create_dataset(dataset, data=values, **packed)
            made.attrs.update(attributes)
            for axis, name in enumerate(names):
                made.dims[axis].attach_scale(target[name])
    whole.unlink()
    print(hidden.equivalent(Place(device=device, surfaces=scene, beams=cast(scene, device.view))))


_KEPT = {"range": ("units", "long_name", "_FillValue"), "time": ("units", "long_name")}

if __name__ == "__main__":
    main(Path(sys.argv[1]))

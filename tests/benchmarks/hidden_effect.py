"""Make `sample_data/hidden_effect.h5` again: three boards by the blind simulator's camera, with harmonics no model has.

Run as `python tests/benchmarks/hidden_effect.py OUTPUT.h5`; prints the hidden effect in the model's terms.
`--without` leaves the harmonics out: that recording and `sample_data/three_boards_model.toml` agree, which shows that
the harmonics are all that is hidden.
"""

import argparse
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind.camera import Device, record
from blind.effects import Harmonics, Place
from blind.geometry import Array, Surface, cast
from blind.reference import NoiseTable
from blind.write import write_recording

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "sample_data" / "three_boards_model.toml"
PROFILE = ROOT / "tofmix" / "sensors" / "sr3000.toml"
HIDDEN = Harmonics(third=0.018, third_phase=0.9, fifth=0.003, fifth_phase=0.2)
_KEPT = {"range": ("units", "long_name", "_FillValue"), "time": ("units", "long_name")}


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibrated(Device):
    """A camera whose light is set, at each range, so that its measured noise is a given curve.

    What comes from nowhere, at the end of the working range, is drawn with the curve's sigma as it is.
    """

    curve: NoiseTable

    def design_sigma(self, range_mm: Array | float) -> Array:
        """Sigma, mm, of small angles: that of the arc tangent's angle is sqrt(s^2 + s^4), to the next order."""
        turn = 2 * np.pi / self.unambiguous_mm
        curve = np.interp(range_mm, self.curve.range_mm, self.curve.sigma_mm)
        small = np.sqrt((np.sqrt(1 + 4 * (curve * turn) ** 2) - 1) / 2) / turn
        return np.where(np.asarray(range_mm) < self.range_max_mm, small, curve)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("output", type=Path)
    parser.add_argument("--without", action="store_true", help="leave the harmonics out")
    parser.add_argument("--seed", type=int, default=2008)
    parser.add_argument("--frames", type=int, default=60)
    options = parser.parse_args()
    device, scene = _read(options.frames)
    hidden = () if options.without else (HIDDEN,)
    whole = options.output.with_suffix(".tmp")
    write_recording(whole, record(device, scene, hidden, seed=options.seed), device, device.curve)
    _without_amplitude(whole, options.output)
    whole.unlink()
    if hidden:
        print(HIDDEN.equivalent(Place(device=device, surfaces=scene, beams=cast(scene, device.view))))


def _read(frames: int) -> tuple[Calibrated, list[Surface]]:
    """The camera and the boards of the model file, in the blind simulator's terms."""
    model, profile = (tomllib.loads(path.read_text(encoding="utf-8")) for path in (MODEL, PROFILE))
    sensor, noise = profile["sensor"] | model["sensor"], profile["sensor"]["noise"]
    tau_ms = sensor["integration_time_ms"]
    scale = (noise["reference_integration_time_ms"] / tau_ms) ** noise["exponent"]
    curve = NoiseTable(range_mm=np.array(noise["range_mm"]), sigma_mm=scale * np.array(noise["sigma_mm"]))
    device = Calibrated(
        name="hidden effect",
        rows=sensor["rows"],
        cols=sensor["cols"],
        fov_horizontal_deg=sensor["fov_horizontal_deg"],
        fov_vertical_deg=sensor["fov_vertical_deg"],
        frequency_hz=sensor["modulation_frequency_hz"],
        integration_time_ms=tau_ms,
        frame_rate_hz=model["recording"]["frame_rate_hz"],
        frames=frames,
        range_min_mm=sensor["range_min_mm"],
        range_max_mm=sensor["range_max_mm"],
        outlier_probability=sensor["outlier_probability"],
        electrons=2.0e5,
        curve=curve,
    )
    surfaces = [
        Surface(**s | {"center_mm": tuple(s["center_mm"]), "size_mm": tuple(s["size_mm"])}) for s in model["surface"]
    ]
    return device, surfaces


def _without_amplitude(whole: Path, output: Path) -> None:
    """Copy a recording without its amplitudes, packed as small as it goes."""
    with h5py.File(whole, "r") as source, h5py.File(output, "w") as target:
        target.attrs.update(source.attrs)
        source.copy(source["sensor"], target, name="sensor")
        for name in ("frame", "row", "col"):
            target.create_dataset(name, data=source[name][...]).make_scale(name)
        for dataset, names in (("range", ("frame", "row", "col")), ("time", ("frame",))):
            packed = {"compression": "gzip", "compression_opts": 9, "shuffle": True} if dataset == "range" else {}
            made = target.create_dataset(dataset, data=source[dataset][...], **packed)
            made.attrs.update({key: source[dataset].attrs[key] for key in _KEPT[dataset]})
            for axis, name in enumerate(names):
                made.dims[axis].attach_scale(target[name])


if __name__ == "__main__":
    main()

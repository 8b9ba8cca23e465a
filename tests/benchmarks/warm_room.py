"""Make a recording of a room by the blind simulator's lock-in camera: taps of electrons, a lens, and room light.

Run as `python tests/benchmarks/warm_room.py OUTPUT.h5`; with `--warm` the camera warms up during the recording, and the
program prints the hidden drift in the model's terms. Nothing here uses the package.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from blind.calibrate import calibrated
from blind.camera import Device, record
from blind.effects import Place, WarmUp
from blind.geometry import Lens, Surface, cast
from blind.write import write_recording

DEVICE = Device(
    name="lock-in camera in room light",
    rows=24,
    cols=32,
    frame_rate_hz=0.5,  # a frame every 2 s: 2 minutes of a warm-up
    frames=60,
    electrons=1.0e8,
    # As many electrons of the room in a tap as give a board of reflectivity 0.5, at 3 m, a noise of about 12 mm.
    room_electrons=2.0e9,
    # Fields of view of about 60 and 48 degrees, with the barrel distortion of a cheap lens.
    lens=Lens(focal=(0.87, 1.12), off_center=(0.02, -0.01), radial=(-0.2, 0.03, 0.0)),
)

ROOM = (
    Surface(name="back wall", center_mm=(0.0, 0.0, 4200.0), size_mm=(9000.0, 6000.0), reflectivity=0.7),
    Surface(
        name="side wall", center_mm=(-1700.0, 0.0, 2600.0), size_mm=(5000.0, 6000.0), yaw_deg=-70.0, reflectivity=0.6
    ),
    Surface(name="cupboard", center_mm=(900.0, 500.0, 2900.0), size_mm=(1300.0, 2400.0), reflectivity=0.4),
)

WARM_UP = WarmUp(delay_mm_per_kelvin=1.5, rise_kelvin=8.0, time_constant_s=40.0)
"""12 mm in the end, of which 95 % come within the two minutes."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("output", type=Path)
    parser.add_argument("--warm", action="store_true", help="the camera warms up")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    noise = calibrated(replace(DEVICE, name="", lens=None))
    mechanisms = [WARM_UP] if options.warm else []
    made = record(DEVICE, list(ROOM), mechanisms, seed=options.seed)
    write_recording(options.output, made, DEVICE, noise)
    if options.warm:
        print(WARM_UP.equivalent(Place(device=DEVICE, surfaces=list(ROOM), beams=cast(list(ROOM), DEVICE.view))))


if __name__ == "__main__":
    main()

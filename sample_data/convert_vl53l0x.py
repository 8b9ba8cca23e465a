"""Cut two minutes, ten minutes apart, out of four hours of a VL53L0X (an .npz with the array `range_mm`).

Usage: python convert_vl53l0x.py vl53l0x_static_4h.npz FOLDER

It writes vl53l0x_minute.h5 and vl53l0x_later.h5 into the folder.
"""

import sys
from pathlib import Path

import h5py
import numpy as np

import tofmix as tm

RATE_HZ = 55.0
"""Ranges a second, about: the record has no times."""
MINUTE = int(60 * RATE_HZ)
FIRST, LATER = 20, 30
"""Minutes from switching on."""
LICENCE = "MIT License, Copyright (c) 2025 Tomás Suárez; full text in sample_data/LICENSE-vl53l0x.txt"
SOURCE = "github.com/tomisuarez2/TimeOfFlightCalibration: a static target at about 76 mm, four hours from switching on"


def convert(source: Path, folder: Path) -> None:
    """Write the two recordings; their times count from the start of each."""
    with np.load(source, allow_pickle=False) as record:
        range_mm = record["range_mm"]
    for name, minute in (("minute", FIRST), ("later", LATER)):
        part = range_mm[minute * MINUTE : (minute + 1) * MINUTE].reshape(-1, 1, 1)
        recording = tm.from_array(part, units="mm", sensor="vl53l0x", time_s=np.arange(MINUTE) / RATE_HZ)
        path = folder / f"vl53l0x_{name}.h5"
        recording.save(path, overwrite=True)
        with h5py.File(path, "r+") as root:
            root.attrs.update({"source": f"{SOURCE}; minute {minute}", "license": LICENCE})


if __name__ == "__main__":
    convert(Path(sys.argv[1]), Path(sys.argv[2]))

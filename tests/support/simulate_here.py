"""`tofmix simulate` in this process for the blind bench's tests, which takes a tenth of the time of one of its own.

It stands outside of tests/blind, which imports nothing of the package.
"""

from pathlib import Path

from blind.camera import Recording
from blind.write import read_recording

from tofmix.cli.main import main


def simulate_here(model: Path, seed: int) -> Recording:
    """What `blind.score.simulate` returns."""
    output = model.with_suffix(f".{seed}.h5")
    arguments = ["simulate", str(model), "-o", str(output), "--seed", str(seed)]
    main.main(args=arguments, prog_name="tofmix", standalone_mode=False)
    recording = read_recording(output)
    output.unlink()
    return recording

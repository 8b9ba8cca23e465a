"""Running the command line in this process, with the exit code that the shell would see; layers for its commands."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from numpy.typing import NDArray
from support.commandline import Estimated, Tofmix, signals_kept
from support.files import write_recording

_LAYERS: dict[tuple[str, int], bytes] = {}


@pytest.fixture
def tofmix(capsys: pytest.CaptureFixture[str]) -> Iterator[Tofmix]:
    """Run commands in this process."""
    with signals_kept():
        yield Tofmix(capsys.readouterr)


@pytest.fixture
def estimated(tofmix: Tofmix, tmp_path: Path) -> Estimated:
    """Write a.h5 and its a.layers.h5, and return the latter; the same samples are estimated for one test alone."""

    def make(samples: NDArray[Any], *, window: int, **written: Any) -> Path:  # noqa: ANN401  as `write_recording` takes it
        recording, layers = write_recording(tmp_path / "a.h5", samples, **written), tmp_path / "a.layers.h5"
        key = hashlib.sha256(recording.read_bytes()).hexdigest(), window
        if key not in _LAYERS:
            tofmix.done("estimate", recording, "--window", window)
            _LAYERS[key] = layers.read_bytes()
        layers.write_bytes(_LAYERS[key])
        return layers

    return make

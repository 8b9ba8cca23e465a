"""Coverage-guided fuzzing of the readers with atheris (libFuzzer): new inputs are made of those that reached new code.

Usage: python -m faults.guided SECONDS FOLDER. It ends with 0, or with what libFuzzer found, which is kept in FOLDER.
Readers are called in this process; the process that looks at HDF5 files first, as always, is another one.
"""

import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["tofmix"]):
    from tofmix.errors import TofmixError
    from tofmix.io.importers import open_source
    from tofmix.io.importers.base import SourceRequest
    from tofmix.io.layers.journal import open_part
    from tofmix.io.layers.layers_file import open_layers
    from tofmix.io.model_file import load_model
    from tofmix.io.recording.recording_file import open_recording

from faults.originals import make
from faults.pool import Pool

MOST_BYTES = 65536


def _recording(path: Path) -> None:
    with open_recording(path) as recording:
        frames, rows, cols = recording.shape
        if frames * rows * cols < 1 << 20:
            recording.read_range(slice(None), slice(None))
            recording.read_time()
            recording.attributes()


def _layers(path: Path) -> None:
    with open_layers(path) as layers:
        windows, rows, cols = layers.shape
        if windows * rows * cols * layers.max_layers < 1 << 20:
            layers.read_window(0)
            layers.tally()
            layers.header_image()


def _model(path: Path) -> None:
    load_model(str(path))


def _part(path: Path) -> None:
    with open_part(path) as part:
        for cell in part.done():
            part.cell(cell)


def _source(path: Path) -> None:
    with open_source(path, SourceRequest(axes="frame,row,col", image=(6, 8))) as source:
        for _ in zip(range(5), source.frames, strict=False):
            pass


READERS: dict[str, tuple[str, Callable[[Path], None]]] = {
    "recording.h5": (".h5", _recording),
    "foreign.h5": (".h5", _recording),
    "layers.h5": (".h5", _layers),
    "model.toml": (".toml", _model),
    "1.part": (".part", _part),
    "a.npy": (".npy", _source),
    "a.npz": (".npz", _source),
    "b.mat": (".mat", _source),
    "a.tif": (".tif", _source),
    "bag.bag": (".bag", _source),
}
"""Originals by their names, the ends that a reader knows them by, and what reads them. The first byte of an input
chooses."""


def main() -> None:
    seconds, folder = int(sys.argv[1]), Path(sys.argv[2])
    corpus, work = folder / "corpus", folder / "work"
    for place in (corpus, work):
        place.mkdir(parents=True, exist_ok=True)
    with Pool(1) as pool:
        (folder / "originals").mkdir(exist_ok=True)
        if not (folder / "originals" / "bag_mcap").exists():
            make(folder / "originals", pool)
    for number, name in enumerate(READERS):
        (corpus / name).write_bytes(bytes([number]) + (folder / "originals" / name).read_bytes())

    def read(data: bytes) -> None:
        if not data:
            return
        end, reader = list(READERS.values())[data[0] % len(READERS)]
        path = work / f"input{end}"
        path.write_bytes(data[1:])
        with suppress(TofmixError):
            reader(path)

    options = [f"-max_total_time={seconds}", "-timeout=20", "-rss_limit_mb=2048", f"-max_len={MOST_BYTES}", "-seed=1"]
    atheris.Setup([sys.argv[0], *options, f"-artifact_prefix={folder}/found-", str(corpus)], read)
    atheris.Fuzz()


if __name__ == "__main__":
    main()

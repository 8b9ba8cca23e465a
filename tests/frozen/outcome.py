"""What commands leave, as arrays and lines of text: `run_case` runs them in this process, and returns it."""

import contextlib
import hashlib
import io
import json
import re
import shlex
import signal
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import h5py
import numpy as np
from numpy.typing import NDArray

from frozen.cases import Case
from frozen.inputs import INPUTS

Outcome: TypeAlias = dict[str, NDArray[np.generic] | list[str]]
"""Arrays and lines, by the name of their file and their name in it."""

_LINES = {".csv", ".ply", ".obj", ".yaml", ".toml", ".html", ".svg", ".pcd"}
"""Files of text; those that turn out to be binary are bytes."""
_DATA = re.compile(r"base64,([A-Za-z0-9+/=]{64,})|\b([A-Za-z0-9+/=]{200,})")
"""Pictures and data within a page."""
_OF_TIME = re.compile(r": compiling the kernels;|^tofmix: \w+: [\d,]+ of [\d,]+ .* \(\d+ %\)$")
"""Lines on stderr of a run that takes long: kernels that are not kept, and progress."""


def write_inputs(names: str, folder: Path) -> None:
    """Write inputs, named with spaces between, into a folder."""
    for name in names.split():
        INPUTS[name](folder)


def run_case(case: Case, folder: Path) -> Outcome:
    """Run the commands of a case in a folder with its inputs; return all that they write, and no input.

    `case`: the case.
    `folder`: with the inputs.
    Returns Outcome: streams and exit codes under the number of their command and its line, files under their names.
    """
    from tofmix.cli.main import run

    inputs = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    out: Outcome = {}
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    lines = [line.strip() for line in case.commands.replace("\\\n", " ").strip().splitlines()]
    with contextlib.chdir(folder):
        for number, line in enumerate(lines, 1):
            streams = io.StringIO(), io.StringIO()
            with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
                try:
                    run(shlex.split(line))
                except SystemExit as leave:
                    code = leave.code
            said = [text for text in streams[1].getvalue().splitlines() if not _OF_TIME.search(text)]
            shown = [*streams[0].getvalue().splitlines(), "-- standard error", *said]
            out[f"{number}: tofmix {' '.join(line.split())}"] = [f"-- exit code {code}", *shown]
    for number, handler in handlers.items():
        signal.signal(number, handler)
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if inputs.get(path) != path.read_bytes():
            out |= read_file(path, path.relative_to(folder).as_posix())
    return out


def read_file(path: Path, name: str) -> Outcome:
    """The contents of a file: arrays of HDF5 and NumPy, lines of texts, else bytes."""
    if path.suffix == ".h5":
        return {f"{name}:{key}": values for key, values in _hdf5(path)}
    if path.suffix == ".npy":
        return {name: np.load(path)}
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {f"{name}:{key}": arrays[key] for key in arrays}
    stored = path.read_bytes()
    with contextlib.suppress(UnicodeDecodeError):
        if path.suffix in {".json", ".geojson"}:
            return {name: json.dumps(json.loads(stored), indent=1, sort_keys=True).splitlines()}
        if path.suffix in _LINES:
            return {name: [_DATA.sub(_digest, line) for line in stored.decode().splitlines()]}
    return {name: np.frombuffer(stored, np.uint8)}


def _digest(found: re.Match[str]) -> str:
    data = found.group(1) or found.group(2)
    return f"[{len(data)} characters, {hashlib.sha256(data.encode()).hexdigest()[:12]}]"


def _hdf5(path: Path) -> Iterator[tuple[str, NDArray[np.generic] | list[str]]]:
    """Datasets, and attributes as lines."""
    found: dict[str, h5py.Dataset] = {}
    attributes: list[str] = []
    with h5py.File(path) as root:

        def visit(name: str, item: h5py.HLObject) -> None:
            if isinstance(item, h5py.Dataset):
                found[name] = item
            attributes.extend(
                f"{name}@{key} = {np.asarray(value).tolist()!r}"
                for key, value in sorted(item.attrs.items())
                if key not in {"REFERENCE_LIST", "DIMENSION_LIST"}
            )

        visit("", root)
        root.visititems(visit)
        yield "attributes", attributes
        for name, dataset in found.items():
            values = np.asarray(dataset[()])
            if values.dtype.kind == "O":
                yield name, [str(value) for value in values.ravel()]
            else:
                yield name, values


def save(outcome: Outcome, path: Path) -> None:
    """Store an outcome: arrays and texts in one archive."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, value in outcome.items():
            stored = io.BytesIO()
            if isinstance(value, list):
                stored.write("\n".join(value).encode("utf-8", "surrogateescape"))
            else:
                np.save(stored, value, allow_pickle=False)
            archive.writestr(("text " if isinstance(value, list) else "array ") + name, stored.getvalue())


def load(path: Path) -> Outcome:
    """Read what `save` stored."""
    out: Outcome = {}
    with zipfile.ZipFile(path) as archive:
        for entry in archive.namelist():
            kind, _, name = entry.partition(" ")
            stored = archive.read(entry)
            out[name] = (
                stored.decode("utf-8", "surrogateescape").split("\n")
                if kind == "text"
                else np.load(io.BytesIO(stored), allow_pickle=False)
            )
    return out

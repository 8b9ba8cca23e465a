"""A separate program that checks the structure of HDF5 files, because the library can hang or crash on a damaged one.

It reads requests as lines of JSON, ``{"path": ...}`` or ``{"image": base64}`` with ``"limit_s"``, and answers each with
a line: ``{"identity": [...]}``, the identity of the checked file, ``{"refused": reason}``, or ``{"no_memory": true}``
where no file at all could be opened. Should the library not come back within the limit, the kernel ends this process,
for no Python code can run then. `tofmix.io.guard.guard` starts it; nothing imports it.
"""

import base64
import io
import json
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[3]))  # started with -P: the package is where this file is, nowhere else

import h5py

from tofmix.io.guard.hdf5_memory import reserve_memory
from tofmix.io.guard.structure_rules import RefusedError, check_structure, library_reason

_MEMORY_BYTES = 1 << 30
"""Memory for the check of one file beyond the program itself, bytes."""


def main() -> None:
    """Answer until stdin ends."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # not an inherited handler: the signal must end this process
    _bound_memory()
    for line in sys.stdin:
        request = json.loads(line)
        signal.setitimer(signal.ITIMER_REAL, request["limit_s"])
        answer = _answer(request) if _memory_is_free() else {"no_memory": True}
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.stdout.write(json.dumps(answer) + "\n")
        sys.stdout.flush()


def _bound_memory() -> None:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:  # not Linux
        return
    limit, hard = pages * os.sysconf("SC_PAGE_SIZE") + _MEMORY_BYTES, resource.getrlimit(resource.RLIMIT_AS)[1]
    resource.setrlimit(resource.RLIMIT_AS, (limit if hard == resource.RLIM_INFINITY else min(limit, hard), hard))


def _memory_is_free() -> bool:
    try:
        reserve_memory()
    except MemoryError:
        return False
    return True


def _answer(request: dict[str, Any]) -> dict[str, Any]:
    try:
        if "image" in request:
            data = base64.b64decode(request["image"])
            with h5py.File(io.BytesIO(data), "r") as root:
                check_structure(root, len(data))
            return {"identity": []}
        return _look(request["path"])
    except RefusedError as error:
        return {"refused": str(error)}
    except MemoryError:
        return {"refused": "cannot be read: its structure takes more memory than any recording's"}
    except OSError as error:
        return {"refused": error.strerror if error.errno and error.strerror else library_reason(error)}
    except Exception as error:  # noqa: BLE001  a damaged file can raise any error
        return {"refused": f"cannot be read: {library_reason(error)}"}


def _look(path: str) -> dict[str, Any]:
    with Path(path).open("rb") as probe:
        probe.read(1)
    if not h5py.is_hdf5(path):
        return {"refused": "not an HDF5 file"}
    with h5py.File(path, "r") as root:
        status = os.fstat(root.id.get_vfd_handle())
        check_structure(root, status.st_size)
        return {"identity": [status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns]}


if __name__ == "__main__":
    main()

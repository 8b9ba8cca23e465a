"""Room for HDF5 to open a file in: where the memory ends within an opening, the library ends the process.

`H5AC_create` of HDF5 (seen in 2.0) reads from the metadata cache that it could not allocate, and the process dies of
signal 11. That structure, of half a MB, comes from a free list of the library's. There it would stay when its file is
closed, but for a limit of 64 kB. Here the limit is raised, and files in memory, opened and closed at once, leave
structures for the next openings. Call `reserve_memory` before each opening; it fails in good order.
"""

import ctypes
import io
from contextlib import ExitStack
from functools import cache

import h5py

_PREFLIGHT_BYTES = 4 << 20
"""Memory that must be free before an opening, bytes; the library takes less than 1 MB for one."""


_LIST_BYTES, _ALL_LISTS_BYTES = 16 << 20, 32 << 20
"""Memory that the library may keep for freed objects of one kind, and of all kinds, bytes."""


_caches = [0]
"""Number of caches, in use or in the list."""


def reserve_memory() -> None:
    """See to it that the next opening finds the memory that it needs.

    Raises
    ------
    MemoryError
        If there is none.
    """
    _keep_caches()
    bytearray(_PREFLIGHT_BYTES)
    opened = h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE)
    ahead = 4  # number of files whose caches are allocated together, before the files are opened
    if opened >= _caches[0]:
        with ExitStack() as stack:
            for _ in range(ahead):
                stack.enter_context(h5py.File(io.BytesIO(), "w"))
        most_files = 28  # the caches of so many files fit into the list; it is emptied when more of them are given back
        _caches[0] = min(opened + ahead, most_files)


@cache
def _keep_caches() -> None:
    """Raise the limits of the library's free lists; without such lists only the rest of `reserve_memory` helps."""
    library = ctypes.PyDLL(h5py.h5.__file__)
    set_limits = getattr(library, "H5set_free_list_limits", None)
    if set_limits is not None:
        # Lists of structures; of arrays (as the library's defaults); of blocks (the same).
        set_limits(*map(ctypes.c_int, (_ALL_LISTS_BYTES, _LIST_BYTES, 4 << 20, 256 << 10, 16 << 20, 1 << 20)))

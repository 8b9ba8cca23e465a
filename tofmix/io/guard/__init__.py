"""Reading HDF5 files of unknown origin: structure checks in a child process, bounded memory, a limit of time."""

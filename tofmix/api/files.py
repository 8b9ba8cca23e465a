"""One function that opens recordings and layers files."""

from pathlib import Path

from tofmix.api.estimates import Estimate, read_estimate
from tofmix.api.recordings import Recording, opened_recording


def open_file(path: str | Path) -> Recording | Estimate:
    """Open a recording, or the layers that `tofmix estimate` or `Estimate.save` wrote.

    Parameters
    ----------
    path : str or Path
        An HDF5 file.

    Returns
    -------
    Recording or Estimate
        Samples of a recording are read on access; layers are read at once.

    Raises
    ------
    BadInputError
        If the file is missing, damaged or neither of the two, or its ranges are probably not in mm.

    Warns
    -----
    DoubtWarning
        If many of a recording's samples are exactly 0 and count as ranges.
    """
    from tofmix.io.file_kind import format_of
    from tofmix.io.layers.layers_file import FORMAT

    file = Path(path)
    return read_estimate(file) if format_of(file) == FORMAT else opened_recording(file)

"""Options of `tofmix import` that name columns: their meanings, and the codes of valid samples."""

from tofmix.errors import UsageError

MEANINGS = ("frame", "time", "row", "col", "target", "range", "amplitude", "status")
"""Meanings of a column."""


def columns_of(text: str | None) -> dict[str, str]:
    """Meanings of columns by their names, lower case, from a text such as ``y=row,x=col,depth=range``.

    Raises
    ------
    UsageError
        If it is none, or a meaning is unknown or given twice.
    """
    pairs = [part.partition("=") for part in (text or "").split(",") if part.strip()]
    found = {theirs.strip().lower(): ours.strip().lower() for theirs, _, ours in pairs}
    for theirs, ours in found.items():
        if not theirs or ours not in MEANINGS:
            raise UsageError(f"--columns: {text!r}: {theirs}={ours}; the right side is one of {', '.join(MEANINGS)}")
    if text is not None and (not found or len(set(found.values())) < len(pairs)):
        raise UsageError(f"--columns: {text!r} is not THEIRS=OURS,..., each once, such as y=row,x=col,depth=range")
    return found


def status_of(text: str | None) -> tuple[str, tuple[int, ...]] | None:
    """Name of a column of codes, and the valid ones, from a text such as ``status=5,9``.

    Raises
    ------
    UsageError
        If it is none.
    """
    if text is None:
        return None
    name, _, codes = text.rpartition("=")
    try:
        found = tuple(int(code) for code in codes.split(","))
    except ValueError:
        found = ()
    if not name.strip() or not found:
        raise UsageError(f"--valid-status: {text!r} is not NAME=CODE,..., such as status=5,9")
    return name.strip(), found

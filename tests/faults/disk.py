"""A small disk of its own for tests, where the system lets one be mounted."""

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def small_disk(place: Path, *, bytes_: int = 8 << 20) -> Iterator[Path | None]:
    """Mount a disk in memory at a new folder; None where that is not allowed."""
    place.mkdir()
    command: list[str | Path] = ["/usr/bin/mount", "-t", "tmpfs", "-o", f"size={bytes_}", "tmpfs", place]
    try:
        mounted = subprocess.run(command, capture_output=True, check=False).returncode == 0
    except OSError:  # no such program
        mounted = False
    try:
        yield place if mounted else None
    finally:
        if mounted:
            subprocess.run(["/usr/bin/umount", "-l", place], check=True)
        place.rmdir()


def make_read_only(place: Path) -> None:
    """Let nothing more be written to a disk of `small_disk`."""
    subprocess.run(["/usr/bin/mount", "-o", "remount,ro", place], check=True)

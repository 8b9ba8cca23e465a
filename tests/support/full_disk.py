"""A disk that is full after some writes."""

import errno
import os


class FullDisk:
    """`os.pwrite` of a disk with room for `left` more writes; set as an attribute of `os`."""

    def __init__(self, left: int) -> None:
        self.left = left
        self._write = os.pwrite

    def __call__(self, descriptor: int, data: bytes, offset: int) -> int:
        self.left -= 1
        if self.left < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        return self._write(descriptor, data, offset)

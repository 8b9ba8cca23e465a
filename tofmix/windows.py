"""Cutting a sequence of frames into windows, each of which gives its own layers."""

from dataclasses import dataclass

from tofmix.wording import counted


@dataclass(frozen=True, slots=True)
class Windows:
    """Windows [start, start + length) of frames, `stride` apart.

    Frames after the last whole window are left out and counted in `frames_left_out`.
    """

    length: int
    stride: int
    count: int
    frames_left_out: int

    def of_samples(self, each: int) -> "Windows":
        """The same windows in samples of a pixel, where each frame has `each` of them."""
        return Windows(self.length * each, self.stride * each, self.count, self.frames_left_out * each)

    def in_frames(self, each: int) -> "Windows":
        """The inverse of `of_samples`: the windows in frames."""
        return Windows(self.length // each, self.stride // each, self.count, self.frames_left_out // each)

    def start(self, window: int) -> int:
        """First frame of a window."""
        return window * self.stride

    def stop(self, window: int) -> int:
        """One past the last frame of a window."""
        return window * self.stride + self.length


def plan_windows(n_frames: int, *, window: int | None = None, stride: int | None = None) -> Windows:
    """Plan the windows of a recording.

    Parameters
    ----------
    n_frames : int
        Frames in the recording, at least 1.
    window : int, optional
        Frames in a window; one window over all frames without it.
    stride : int, optional
        Frames from one window's start to the next; `window` without it.

    Returns
    -------
    Windows
        Whole windows only.

    Raises
    ------
    ValueError
        If a number is below 1, or the window is longer than the recording.
    """
    length = n_frames if window is None else window
    step = length if stride is None else stride
    if length < 1 or step < 1:
        raise ValueError(f"window {length} and stride {step} must be at least 1 frame")
    if length > n_frames:
        raise ValueError(f"a window of {counted(length, 'frame')} is longer than the recording's {n_frames}")
    count = (n_frames - length) // step + 1
    used = (count - 1) * step + length
    return Windows(length=length, stride=step, count=count, frames_left_out=n_frames - used)

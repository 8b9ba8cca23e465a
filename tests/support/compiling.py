"""Compile the kernels once for all of pytest's workers, each from another end of the list of parts.

Without this every worker compiles nearly every kernel by itself, on the same few processors. Parts are compiled before
tests are collected. Tests load from the cache what they use.
"""

import fcntl
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tofmix.compiled.kept import cache_folder


def layers() -> None:
    """Compile what counts and fits surfaces, which takes as long as all else."""
    from tofmix.estimation.layering import warm_up
    from tofmix.estimation.settings import EstimateOptions

    warm_up(EstimateOptions())


def noise_and_reconciliation() -> None:
    """Compile what needs no layers."""
    from tofmix.io.model_file import load_model
    from tofmix.pipeline.kernels import compile_noise
    from tofmix.reconciliation.workflow import warm_up

    compile_noise()
    warm_up(load_model("three-boards"))


def learnt_noise() -> None:
    """Compile what learns noise, and counts under it."""
    from tofmix.estimation.learnt.recordings import warm_up

    warm_up()


def further_options() -> None:
    """Compile what other options of the estimator take, beside the default layers."""
    from tofmix.pipeline.kernels import compile_options

    compile_options()


def images() -> None:
    """Compile what unmixing and surfaces take."""
    from tofmix.pipeline.kernels import compile_images

    compile_images()


def scenes() -> None:
    """Compile what maps, scenes and the steps of one pixel take."""
    from tofmix.pipeline.kernels import compile_scenes

    compile_scenes()


PARTS: tuple[Callable[[], None], ...] = (
    layers,
    images,
    scenes,
    further_options,
    noise_and_reconciliation,
    learnt_noise,
)
"""The first two take about as long together as the others."""

WITH_LAYERS = frozenset({images, scenes, further_options})
"""Parts that call what `layers` compiles: they wait for it, or they would compile it a second time."""


def begin(worker: int) -> None:
    """Compile the parts that no other worker has begun; every other worker begins with the last one."""
    for part in PARTS if worker % 2 == 0 else PARTS[::-1]:
        if part in WITH_LAYERS:
            with _alone_with(layers):
                pass
        done = _folder() / f"{part.__name__}.done"
        with suppress(BlockingIOError), _alone_with(part, wait=False):
            if not done.exists():
                part()
                done.touch()


def finish() -> None:
    """Wait for the parts that others have begun."""
    for part in PARTS:
        with _alone_with(part):
            pass


def _folder() -> Path:
    """The folder of kept code.

    Raises FileNotFoundError: If no folder can be written: then each worker compiles by itself.
    """
    folder = cache_folder()
    if folder is None:
        raise FileNotFoundError("no folder keeps compiled code")
    return folder


@contextmanager
def _alone_with(part: Callable[[], None], *, wait: bool = True) -> Iterator[None]:
    """Let one process at a time into the block.

    Raises BlockingIOError: If another one is in it, and this one is not to wait.
    """
    with (_folder() / f"{part.__name__}.lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield

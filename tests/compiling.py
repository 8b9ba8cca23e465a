"""Compile the kernels once for all of pytest's workers: each begins with another part, then loads what others made.

Without this every worker compiles nearly every kernel by itself, on the same few processors. The longest part is begun
before tests are collected, and what is left is compiled after that.
"""

import fcntl
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress

from tofmix.jit import cache_folder


def layers() -> None:
    """Compile what counts and fits surfaces, which takes as long as all else."""
    from tofmix.estimation.layering import warm_up
    from tofmix.estimation.settings import EstimateOptions

    warm_up(EstimateOptions())


def noise_and_reconciliation() -> None:
    """Compile what needs no layers."""
    from tofmix.io.model_file import load_model
    from tofmix.pipeline.kernels import compile_noise
    from tofmix.reconciliation.warm_up import warm_up

    compile_noise()
    warm_up(load_model("three-boards"))


def learnt_noise() -> None:
    """Compile what learns noise, and counts under it."""
    from tofmix.estimation.learnt.warm_up import warm_up

    warm_up()


PARTS: tuple[Callable[[], None], ...] = (layers, learnt_noise, noise_and_reconciliation)


def begin(worker: int) -> None:
    """Compile the parts that no other worker has begun, each worker from another one on."""
    first = worker % len(PARTS)
    for part in PARTS[first:] + PARTS[:first]:
        done = cache_folder() / f"{part.__name__}.done"
        with suppress(BlockingIOError), _alone_with(part, wait=False):
            if not done.exists():
                part()
                done.touch()


def finish() -> None:
    """Wait for all parts, load them, and compile what is left."""
    from tofmix.pipeline.kernels import compile_all

    with ExitStack() as locks:
        for part in PARTS:
            locks.enter_context(_alone_with(part))
        noise_and_reconciliation()
        compile_all()


@contextmanager
def _alone_with(part: Callable[[], None], *, wait: bool = True) -> Iterator[None]:
    """Let one process at a time into the block.

    Raises
    ------
    BlockingIOError
        If another one is in it, and this one is not to wait.
    """
    cache_folder().mkdir(parents=True, exist_ok=True)
    with (cache_folder() / f"{part.__name__}.lock").open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX if wait else fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield

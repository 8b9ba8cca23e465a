"""A first run: its kernels are compiled by two processes, the largest by this one and the others by a second.

A compiler holds a lock in its process, so threads would wait for each other. The second process writes each kernel to
the folder of kept code; this one waits for it where it needs the kernel, or compiles it where the other has failed.
"""

import os
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from tofmix.compiled.kept import PACKAGE, cache_folder, compiled_elsewhere, is_kept
from tofmix.compiled.watching import Unwatched, watched, watcher
from tofmix.estimation.peaks.counters import COUNTERS, Counter
from tofmix.estimation.settings import EstimateOptions, counts_with_learnt
from tofmix.sensor import Sensor

_LAYERS = "estimation.layering._layer_block"
_UNMIXING = ("unmixing.seeds._fit_windows", "unmixing.surface_fit.fill_surfaces")
_LEARNT_FIRST = (
    "estimation.learnt.clusters.find_clusters",
    "estimation.learnt.clusters.fit_clusters",
    "estimation.learnt.folds.held_out_scores",
)
_LEARNT_LATER = (
    "estimation.learnt.background.background_shares",
    "estimation.learnt.background.pixel_widths",
    "estimation.learnt.blocks.fill_layers",
    "estimation.learnt.bootstrap._gains",
)


class CompilerProcess:
    """A second process that compiles kernels, and ends.

    Parameters
    ----------
    kernels : sequence of str
        Kernels that it compiles, as `tofmix.compiled.kept` names them.
    tasks : sequence of str
        What it does, as `main` takes it.
    """

    def __init__(self, kernels: Sequence[str], tasks: Sequence[str]) -> None:
        self._kernels = frozenset(kernels)
        path = os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH"))))
        self._process = subprocess.Popen(  # noqa: S603  this very file
            [sys.executable, "-P", str(Path(__file__).with_name("first_run.py")), *tasks],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": path},
        )
        compiled_elsewhere(self._wait_for)

    def _wait_for(self, kernel: str) -> bool:
        if kernel not in self._kernels:
            return False
        poll_s = 0.02  # between two looks for a kernel
        while not is_kept(kernel):
            if self._process.poll() is not None:
                return is_kept(kernel)
            time.sleep(poll_s)
        return True

    def end(self) -> None:
        """Wait for its end."""
        self._process.wait()


def start_beside(kernels: Sequence[str], *tasks: str) -> CompilerProcess | None:
    """Let a second process compile what is missing of some kernels.

    Parameters
    ----------
    kernels : sequence of str
        The kernels.
    *tasks : str
        What compiles them, as `main` takes it.

    Returns
    -------
    Beside or None
        None where nothing is missing, or there is one processor alone, or no folder that keeps code.
    """
    missing = [kernel for kernel in kernels if not is_kept(kernel)]
    if not missing or _processors() < 2 or not sys.executable or cache_folder() is None:  # noqa: PLR2004  two processes
        return None
    with suppress(OSError):  # no memory, or no process more
        return CompilerProcess(missing, tasks)
    return None


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_for(options: EstimateOptions, sensor: Sensor, *, unmixes: bool) -> None:
    """Compile the kernels of an estimate, or load them; a second process compiles all but the largest.

    Parameters
    ----------
    sensor : Sensor
        Of the recording.
    unmixes : bool
        Whether the recording's pixels are looked through for phasor sums.
    """
    from tofmix.estimation.layering import warm_up

    others, tasks = (_UNMIXING, ["unmixing"]) if unmixes else ((), [])
    if not options.paper and not counts_with_learnt(sensor, options):
        others = (_kernel_of(options.counter), *others)
        tasks += [name for name, kind in COUNTERS.items() if type(options.counter) is kind]
        watcher().expects(sum(not is_kept(kernel) for kernel in (_LAYERS, *others)))
        if is_kept(_LAYERS) and len(others) == 1:
            others = ()  # one kernel alone is compiled here
    beside = start_beside(others, *tasks)
    warm_up(options, sensor)
    if beside is not None:
        beside.end()


def _kernel_of(counter: Counter) -> str:
    return f"{type(counter).__module__.removeprefix('tofmix.')}._fill_{type(counter).__name__.lower()}"


def compile_learning_beside() -> CompilerProcess | None:
    """Let a second process compile half of the kernels that learn noise; the other half comes first here."""
    watcher().expects(sum(not is_kept(kernel) for kernel in (*_LEARNT_FIRST, *_LEARNT_LATER)))
    return start_beside(_LEARNT_LATER, "learning")


def main() -> None:
    """Do the tasks that the command line names: ``unmixing``, ``learning``, or the peaks of a counter by its name."""
    with watched(Unwatched()):
        for task in sys.argv[1:]:
            _compile(task)


def _compile(task: str) -> None:
    if task == "unmixing":
        from tofmix.unmixing.unmix import warm_up

        warm_up()
    elif task == "learning":
        from tofmix.estimation.learnt.recordings import warm_up_later

        warm_up_later()
    else:
        from tofmix.estimation.layering import find_made_up_peaks

        find_made_up_peaks(EstimateOptions(counter=COUNTERS[task]()))


if __name__ == "__main__":
    main()

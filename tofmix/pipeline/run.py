"""Run a job: cells from an engine into a journal, and from the journal into the layers file.

The layers file is written when all cells are ready, in their order, so it does not depend on workers, order or
interruptions.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from tofmix.errors import BadInputError, StorageError, TofmixError, UsageError
from tofmix.flags import MixingLaw
from tofmix.grid import Grid, Windows
from tofmix.io.layers.journal import (
    WHOLE,
    Journal,
    Shard,
    journal_path,
    open_journal,
    open_part,
    partial_path,
    remove_journal,
)
from tofmix.io.layers.layers_file import open_layers, read_header_image
from tofmix.io.storage import check_output
from tofmix.pipeline.assembly import assemble, total
from tofmix.pipeline.job import Engine, Job
from tofmix.wording import counted


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of a run: the output, the job's grid, and the pixels by their number of surfaces.

    The grid counts samples; `windows` are its windows in frames. `continued` is the number of cells of an earlier run.
    `mixture` is the law of mixing, if it was measured; for a part it is not known yet.
    """

    target: Path
    grid: Grid
    tally: tuple[int, ...]
    cells: int
    continued: int = 0
    targets: int = 0
    mixture: MixingLaw | None = None

    @property
    def windows(self) -> Windows:
        """The windows, in frames."""
        return self.grid.windows.in_frames(max(1, self.targets))


def run_job(
    job: Job,
    engine: Engine,
    target: Path,
    *,
    shard: Shard = WHOLE,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[int], object] = lambda _: None,
    say: Callable[[str], object] = lambda _: None,
    verify_source: Callable[[], object] = lambda: None,
) -> Outcome:
    """Run a job, or continue it.

    Parameters
    ----------
    job : Job
        From `tofmix.pipeline.job.plan_job`.
    engine : Engine
        The engine that computes cells.
    target : Path
        The layers file, or a part if `shard` is not the whole.
    shard : Shard
        Which of the cells.
    overwrite : bool
        Whether `target` may be replaced.
    resume : bool
        Whether to continue from the journal of an interrupted run, and to accept a finished output.
    progress : callable
        Called with the number of pixels done since the last call.
    say : callable
        Called with a line for the user.
    verify_source : callable
        Called after the last read, before an output gets its name: the recording's `verify_unchanged`.

    Returns
    -------
    Outcome
        Result of the run.

    Raises
    ------
    UsageError
        If `target` may not be written, another run writes it, or the journal to resume belongs to another job.
    BadInputError, StorageError
        If the recording cannot be read, or an output cannot be written.
    """
    header, real = job.header(), Path(os.path.realpath(target))
    cells, targets = shard.cells(job.grid.count), job.provenance.targets
    if resume and (finished := _finished(real, header, shard)) is not None:
        remove_journal(journal_path(real))
        progress(sum(job.grid.pixels(job.grid.cell(index)) for index in cells))
        return Outcome(
            target=target,
            grid=job.grid,
            tally=finished[0],
            cells=len(cells),
            continued=len(cells),
            targets=targets,
            mixture=finished[1],
        )
    check_output(target, overwrite=overwrite, inputs=(job.recording,))
    with _open(journal_path(real), header, shard, resume=resume, say=say) as journal, _left_as_fits(journal):
        done = journal.done()
        progress(sum(job.grid.pixels(job.grid.cell(index)) for index in done))
        wanted = [job.grid.cell(index) for index in cells if index not in done]
        for cell, encoded in engine(job, wanted) if wanted else ():
            journal.add(cell.index, encoded)
            progress(job.grid.pixels(cell))
        verify_source()
        tally, mixture = total(journal.done().values()), None
        if shard == WHOLE:
            parts = ((job.grid.cell(index), journal.cell(index)) for index in cells)
            temporary = partial_path(journal.path)  # the lock of the journal protects it
            tally, mixture = assemble(
                parts, journal.path, header, target, overwrite=overwrite, inputs=(job.recording,), temporary=temporary
            )
            journal.remove()
        else:
            check_output(target, overwrite=overwrite)
            journal.publish(real)
    return Outcome(
        target=target,
        grid=job.grid,
        tally=tally,
        cells=len(cells),
        continued=len(done),
        targets=targets,
        mixture=mixture,
    )


@contextmanager
def _left_as_fits(journal: Journal) -> Iterator[None]:
    """Keep the journal of a failed run only if a resumed run could succeed."""
    try:
        yield
    except BadInputError:
        journal.remove()  # a continued run would meet the same fault
        raise
    except StorageError as error:
        if journal.has_cells:
            raise StorageError(f"{error}; --resume continues from the finished blocks") from error
        journal.remove()
        raise
    except BaseException:
        if not journal.has_cells:
            journal.remove()
        raise


def _open(path: Path, header: bytes, shard: Shard, *, resume: bool, say: Callable[[str], object]) -> Journal:
    """Open the journal: an old one is continued on request; otherwise it is reported and replaced."""
    try:
        journal = open_journal(path, header, shard)
    except BadInputError as error:
        if resume:
            raise UsageError(f"{error}; without --resume it is replaced") from error
        say(f"{error}; starting afresh")
        remove_journal(path)
        return open_journal(path, header, shard)
    done = len(journal.done())
    if resume and (journal.header, journal.shard) != (header, shard):
        journal.close()
        raise UsageError(
            f"{path}: the interrupted run differed in {_difference(journal, header, shard)};"
            " repeat its options, or start afresh without --resume"
        )
    if not resume and (done or journal.header != header or journal.shard != shard):
        say(
            f"{path}: an interrupted run left {done} of {counted(len(shard.cells(_grid(journal).count)), 'block')};"
            " starting afresh; --resume would have continued it"
        )
        journal.remove()
        return open_journal(path, header, shard)
    return journal


def _grid(journal: Journal) -> Grid:
    return read_header_image(journal.header, journal.path)[1]


def _difference(journal: Journal, header: bytes, shard: Shard) -> str:
    """Describe the differences between a journal's job and another."""
    (old, old_grid), (new, new_grid) = (read_header_image(image, journal.path) for image in (journal.header, header))
    keys = sorted(
        key for key in old.options.keys() | new.options.keys() if old.options.get(key) != new.options.get(key)
    )
    found = [f"--{key.replace('_', '-')} ({old.options.get(key)}, now {new.options.get(key)})" for key in keys]
    if old.source_sha256 != new.source_sha256:
        found.insert(0, f"its recording ({old.source}), which has other content")
    if old.version != new.version:
        found.append(f"its version ({old.version}, now {new.version})")
    if journal.shard != shard:
        found.append(f"--shard ({journal.shard.number}/{journal.shard.count}, now {shard.number}/{shard.count})")
    return ", ".join(found) or ("its grid" if old_grid != new_grid else "its sensor or source name")


def _finished(target: Path, header: bytes, shard: Shard) -> tuple[tuple[int, ...], MixingLaw | None] | None:
    """Return tally and mixture of an output that equals the output of the job; None if it is missing or different."""
    try:
        if shard == WHOLE:
            with open_layers(target) as layers:
                return (layers.tally(), layers.mixing_law) if layers.header_image() == header else None
        with open_part(target) as part:
            if (part.header, part.shard) != (header, shard):
                return None
            return total(part.done().values()), None
    except TofmixError:
        return None


def merge_parts(parts: Sequence[Path], target: Path, *, overwrite: bool = False) -> Outcome:
    """Merge the parts of a sharded run into the same bytes as an unsharded run.

    Parameters
    ----------
    parts : sequence of Path
        All parts of one run, in any order.
    target : Path
        The layers file.
    overwrite : bool
        Whether `target` may be replaced.

    Returns
    -------
    Outcome
        Result of the run.

    Raises
    ------
    UsageError
        If a part is missing, doubled or of another run, or `target` may not be written.
    BadInputError, StorageError
        If a part is damaged, or the output cannot be written.
    """
    check_output(target, overwrite=overwrite, inputs=tuple(parts))
    with ExitStack() as stack:
        opened = [stack.enter_context(open_part(path)) for path in parts]
        _check_parts(opened)
        header, first = opened[0].header, opened[0].path
        grid, owner = _grid(opened[0]), dict[int, Journal]()
        for part in opened:
            owner |= dict.fromkeys(part.done(), part)
        missing = grid.count - len(owner)
        if missing:
            raise BadInputError(
                f"{first}: {missing} of {counted(grid.count, 'block')} are in no part; a part is damaged"
            )
        cells = ((grid.cell(index), owner[index].cell(index)) for index in range(grid.count))
        tally, mixture = assemble(cells, first, header, target, overwrite=overwrite, inputs=tuple(parts))
    targets = read_header_image(header, first)[0].targets
    return Outcome(target=target, grid=grid, tally=tally, cells=grid.count, targets=targets, mixture=mixture)


def _check_parts(parts: Sequence[Journal]) -> None:
    first, seen = parts[0], dict[int, Journal]()
    for part in parts:
        _grid(part)  # a damaged header is reported with the name of its own file
        if part.header != first.header:
            raise UsageError(
                f"{part.path}: belongs to another run than {first.path}; it differs in"
                f" {_difference(part, first.header, part.shard)}"
            )
        if part.shard.count != first.shard.count:
            raise UsageError(
                f"{part.path}: one of {counted(part.shard.count, 'part')}, but {first.path} is one of"
                f" {first.shard.count}"
            )
        if part.shard.number in seen:
            raise UsageError(
                f"{part.path}: part {part.shard.number} twice; the other is {seen[part.shard.number].path}"
            )
        seen[part.shard.number] = part
    missing = [str(number) for number in range(1, first.shard.count + 1) if number not in seen]
    if missing:
        raise UsageError(
            f"{first.path}: the run has {counted(first.shard.count, 'part')}; missing: {', '.join(missing)}"
        )

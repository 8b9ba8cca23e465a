"""Several outputs that belong together: all whole, or none that is new.

Use it for files of moderate size that are made in memory, such as a map's image and the text that names it.
"""

from contextlib import ExitStack
from pathlib import Path

from tofmix.errors import TofmixError
from tofmix.io.atomic.storage import AtomicFile


def write_atomic_group(contents: dict[Path, bytes], *, overwrite: bool, inputs: tuple[Path, ...] = ()) -> None:
    """Write several files; each gets its name only when all are completely on disk.

    The files get their names in the order of `contents`: put one that names another after it. Should a renaming
    fail, files that did not exist before are removed again; one that was replaced by then stays replaced. The options
    are those of `tofmix.io.atomic.storage.AtomicFile`.
    """
    with ExitStack() as stack:
        files = [AtomicFile(path, overwrite=overwrite, inputs=inputs) for path in contents]
        for file, content in zip(files, contents.values(), strict=True):
            stack.enter_context(file)
            file.sink.write(content)
        for file in files:
            file.check()
        made: list[Path] = []
        for file in files:
            is_new = not file.path.exists()
            try:
                file.commit()
            except TofmixError:
                for path in made:
                    path.unlink(missing_ok=True)
                raise
            if is_new:
                made.append(file.path)

"""What a job says while it runs. The command line prints it, Python warns of it."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TYPE_CHECKING

from tofmix.errors import UsageError

if TYPE_CHECKING:
    from tofmix.report.summary.findings import Finding


class OptionError(UsageError, ValueError):
    """An option that is out of its bounds, or excludes another: a usage error, and in Python a `ValueError`."""


class Reporter:
    """Callbacks of a job; this one says nothing, and spells options as Python does."""

    def option(self, name: str) -> str:
        """An option's name as the caller writes it."""
        return name

    def spell(self, name: str, value: str) -> str:
        """An option with its value as the caller writes it; a switch has no value."""
        return f"{name}={value!r}" if value else f"{name}=True"

    def warn(self, text: str) -> None:
        """A doubt: the result may be wrong."""

    def note(self, text: str) -> None:
        """Anything else that is worth a line."""

    def finding(self, about: object, finding: "Finding") -> None:
        """A finding about a recording or a layers file."""

    def steps(self, total: int, what: str, unit: str) -> AbstractContextManager[None]:  # noqa: ARG002  for a bar
        """A block of so many steps."""
        return nullcontext()

    def progress(self, steps: int) -> None:
        """Further steps of the job are done."""

    def weighed(self, line: str) -> None:
        """A set of effects was weighed: its evidence, its effects, and why it lost."""

    def is_stopped(self) -> bool:
        """Whether the user wants the job to end with the best result so far."""
        return False

    def before_learning(self) -> None:
        """Noise is learnt next, which not every recording needs."""

    @contextmanager
    def learning(self) -> Iterator[Callable[[int, int], None] | None]:
        """A callable of the steps done and of all steps, while noise is learnt."""
        yield None

    def aside(self) -> AbstractContextManager[object]:
        """A block without a bar: its lines, or another bar, may be shown."""
        return nullcontext()

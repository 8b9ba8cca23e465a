"""Mutants through the commands that read them: done, or refused in one clear line; anything else is a fault."""

import shlex
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from faults.mutants import mutate
from faults.originals import Original
from faults.pool import Job, Outcome, Pool
from faults.same import same_content

MOST_EXTRA_BYTES = 1_000_000_000
"""The default of --memory; no mutant's own content needs a hundredth of it."""

MOST_REFUSED = 2
"""Commands that a foreign recording has not all for: --noise auto and --wrap."""

DONE = (0, 6)
REFUSED = (2, 3, 4)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What became of a command on a mutant; `fault` is empty where it is as it must be."""

    kind: str
    mutant: str
    command: str
    change: str
    outcome: Outcome
    fault: str = ""
    result: str = "refused"


def judge(outcome: Outcome, names: set[str], *, mutant: str) -> str:
    """Return what is wrong with how a command ended, or an empty text.

    `outcome`: from a pool.
    `names`: what stands in the command's own folder beside the mutant, folders with a slash; outputs are named out*.
    `mutant`: name of the file, which a refusal must tell.
    """
    lines = [line for line in outcome.err.split("\n") if line]
    said = lines[-1:] or outcome.out.split("\n")  # verify lists what is wrong on stdout
    rules = (
        (outcome.hung, "hang"),
        (outcome.code < 0, f"signal {-outcome.code}"),
        ("Traceback" in outcome.err or outcome.code == 1, "traceback"),
        (outcome.code not in (*DONE, *REFUSED), f"exit code {outcome.code}"),
        (outcome.extra_bytes > MOST_EXTRA_BYTES, "memory"),
        (any(not line.startswith("tofmix: ") for line in lines), "stray line on stderr"),
        (outcome.code in REFUSED and not "".join(said), "no reason"),
        (outcome.code in REFUSED and mutant not in "".join(said), "file not named"),
        (any(not name.startswith("out") for name in names), "files left"),
        (outcome.code in REFUSED and bool(names), "output of a failed run"),
    )
    return next((text for wrong, text in rules if wrong), "")


class Fuzz:
    """A folder of originals, a pool, and what sound commands write.

    `folder`: where the originals are.
    `pool`: who runs the commands.
    `originals`: by kind.
    """

    def __init__(self, folder: Path, pool: Pool, originals: Mapping[str, Original]) -> None:
        self._folder, self._pool, self._originals = folder, pool, originals
        self._sound: dict[str, Path] = {}

    def run(self, kinds: list[str], count: int, *, seed: int, commands: int = 1) -> Iterator[Verdict]:
        """Make mutants of the kinds in turn, and run some of their commands on each; yields in order."""
        numbers = range(seed, seed + count)
        for verdicts in self._pool.map(lambda number: self._mutant(kinds, number, commands), numbers):
            yield from verdicts

    def check_originals(self) -> None:
        """Run every command on its original: fuzzing tells nothing of a reader that refuses sound files."""
        work = [(kind, command) for kind, original in self._originals.items() for command in original.commands]

        def run(item: tuple[str, str]) -> tuple[str, Outcome]:
            kind, command = item
            given = self._originals[kind].given
            with tempfile.TemporaryDirectory(prefix="fuzz-") as cwd:
                return command, self._pool.run(Job(argv=self.arguments(command, given), cwd=cwd, fresh=False))

        refused = [f"{command}: {outcome.err}" for command, outcome in self._pool.map(run, work) if outcome.code]
        if len(refused) > MOST_REFUSED:
            raise AssertionError("\n".join(refused))

    def _mutant(self, kinds: list[str], number: int, commands: int) -> list[Verdict]:
        kind = kinds[number % len(kinds)]
        original = self._originals[kind]
        turn = number // len(kinds)
        chosen = {original.commands[(turn + step) % len(original.commands)] for step in range(commands)}
        with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
            place = Path(name) / f"mutant{original.files[0].suffix}"
            mutant, change = mutate(original, f"{kind} {number}", place)
            return [self._command(kind, f"{kind} {number}", mutant, command, change) for command in sorted(chosen)]

    def arguments(self, command: str, given: Path) -> tuple[str, ...]:
        """Fill in a command of an original."""
        names: dict[str, Path | str] = {
            "@": given,
            "%recording": "recording.h5",
            "%layers": "layers.h5",
            "%sensor": "sensor.toml",
        }
        names |= {"%array": "a.npy", "%part": "2.part", "%learnt": "learnt 2.part"}
        filled = (names.get(word, word) for word in shlex.split(command))
        return tuple(str(self._folder / word if str(word) in _SOUND else word) for word in filled)

    def _command(self, kind: str, seed: str, mutant: Path, command: str, change: str) -> Verdict:
        with tempfile.TemporaryDirectory(prefix="fuzz-") as cwd:
            outcome = self._pool.run(Job(argv=self.arguments(command, mutant), cwd=cwd, fresh=False))
            names = {path.name for path in Path(cwd).iterdir()}
            names |= {path.name for path in mutant.parent.iterdir()} - {mutant.name}
            fault = judge(outcome, names, mutant=mutant.name)
            result = "done" if outcome.code in DONE else "refused"
            if not fault and result == "done" and self._comparable(kind, change, outcome):
                result, fault = self._compared(kind, command, mutant, Path(cwd))
        return Verdict(
            kind=kind, mutant=seed, command=command, change=change, outcome=outcome, fault=fault, result=result
        )

    def _comparable(self, kind: str, change: str, outcome: Outcome) -> bool:
        """Whether the result must be the original's: all values have checksums, and the command says nothing else."""
        return self._originals[kind].own and change.startswith("bytes") and not outcome.err

    def _compared(self, kind: str, command: str, mutant: Path, cwd: Path) -> tuple[str, str]:
        """Compare what was made of a damaged file with what its original gives: the same, as it could be read."""
        if command.startswith("verify"):
            same = same_content(self._originals[kind].given, mutant)
            return ("done, the same", "") if same else ("done", "wrong in silence: verify found nothing")
        outputs = sorted(cwd.iterdir())
        if not outputs:
            return "done", ""
        sound = self._sound_outputs(kind, command)
        wrong = [path.name for path in outputs if not same_content(sound / path.name, path)]
        return ("done, the same", "") if not wrong else ("done", f"wrong in silence: {', '.join(wrong)}")

    def _sound_outputs(self, kind: str, command: str) -> Path:
        key = f"{kind} {command}"
        if key not in self._sound:
            folder = Path(tempfile.mkdtemp(dir=self._folder))
            original = folder.parent / f"sound-{folder.name}" / f"mutant{self._originals[kind].files[0].suffix}"
            original.parent.mkdir()
            shutil.copyfile(self._originals[kind].files[0], original)
            outcome = self._pool.run(Job(argv=self.arguments(command, original), cwd=str(folder)))
            if outcome.code not in DONE:
                raise RuntimeError(outcome.err)
            self._sound[key] = folder
        return self._sound[key]


_SOUND = ("recording.h5", "layers.h5", "sensor.toml", "a.npy", "2.part", "learnt 2.part")


def table(verdicts: list[Verdict]) -> str:
    """Counts by kind, as Markdown."""
    lines = ["| kind | commands | done | of them compared | refused | faults |", "|---|---|---|---|---|---|"]
    for kind in dict.fromkeys(verdict.kind for verdict in verdicts):
        own = [verdict for verdict in verdicts if verdict.kind == kind]
        results = Counter(verdict.result for verdict in own if not verdict.fault)
        done = results["done"] + results["done, the same"]
        faults = sum(bool(verdict.fault) for verdict in own)
        lines.append(
            f"| {kind} | {len(own)} | {done} | {results['done, the same']} | {results['refused']} | {faults} |"
        )
    return "\n".join(lines)

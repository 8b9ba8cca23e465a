"""The command ``tofmix``, and its exit codes."""

import io
import os
import signal
import sys
from collections.abc import Mapping
from types import FrameType
from typing import NoReturn, TextIO

import click

from tofmix.cli.estimate import estimate, merge
from tofmix.cli.export import export, surfaces
from tofmix.cli.import_ import import_
from tofmix.cli.info import info, sensors, verify
from tofmix.cli.inspect import inspect
from tofmix.cli.map import map_
from tofmix.cli.options import from_environment, quiet_option, running_command, variables_of
from tofmix.cli.reconcile import reconcile
from tofmix.cli.report import compare, report
from tofmix.cli.reporter import announced
from tofmix.cli.simulate import scene, simulate
from tofmix.cli.warmup import warmup
from tofmix.errors import EXIT_CODE_MEANINGS, ExitCode, TofmixError, os_error_text
from tofmix.io.guard import watchdog
from tofmix.io.locks import discard_partial_outputs, is_resumable
from tofmix.version import __version__

_EPILOG = """\b
Start here:
  tofmix simulate three-boards -o boards.h5
  tofmix estimate boards.h5
  tofmix report boards.layers.h5 --recording boards.h5 --html boards.html

\b
Completion of commands and options, for this shell:
  eval "$(_TOFMIX_COMPLETE=bash_source tofmix)"
  eval "$(_TOFMIX_COMPLETE=zsh_source tofmix)"
  _TOFMIX_COMPLETE=fish_source tofmix | source

\b
Environment: TOFMIX_COMMAND_OPTION sets an option that takes a value.
  TOFMIX_ESTIMATE_WORKERS=1 tofmix estimate boards.h5
  NUMBA_CACHE_DIR=/opt/tofmix-kernels tofmix warmup

\b
Exit codes:
""" + "\n".join(f"  {int(code):3d}  {text}" for code, text in EXIT_CODE_MEANINGS.items())


class _InOrder(click.Group):
    """Lists the commands as a user meets them, not by the alphabet."""

    def list_commands(self, _: click.Context) -> list[str]:
        return list(self.commands)

    def invoke(self, ctx: click.Context) -> object:
        try:
            return super().invoke(ctx)
        except TofmixError as error:
            command = running_command(ctx)
            if command is not None:
                error.add_note(from_environment(command, str(error)))
            raise


@click.group(
    cls=_InOrder,
    invoke_without_command=True,
    subcommand_metavar="COMMAND [ARGS]...",
    epilog=_EPILOG,
    context_settings={"help_option_names": ["-h", "--help"], "auto_envvar_prefix": "TOFMIX", "max_content_width": 100},
)
@click.version_option(__version__, prog_name="tofmix", allow_from_autoenv=False)
@click.pass_context
def main(context: click.Context, /) -> None:
    """The surfaces in a time-of-flight pixel.

    A pixel of a time-of-flight camera sees a cone. If the cone meets several
    surfaces, the camera's averaging reports obstacles between them. tofmix reads
    recorded range sequences and recovers the surfaces in each pixel: their number,
    ranges, shares of the beam, and errors.
    """
    if context.invoked_subcommand is None:
        click.echo(context.get_help(), err=True)
        context.exit(ExitCode.USAGE)
    context.with_resource(announced())


for _command in (
    simulate,
    estimate,
    report,
    reconcile,
    inspect,
    info,
    verify,
    compare,
    import_,
    export,
    map_,
    surfaces,
    scene,
    sensors,
    merge,
    warmup,
):
    main.add_command(_command)
    quiet_option(_command)
    for _option in _command.params:
        if isinstance(_option, click.Option) and _option.allow_from_autoenv:
            _option.envvar = variables_of(_command.name or "", _option)


def unknown_variables(environment: Mapping[str, str]) -> dict[str, str]:
    """Variables that look like an option's and set none, each with the reason."""
    options = {
        variable: option
        for name, command in main.commands.items()
        for option in command.params
        if isinstance(option, click.Option)
        for variable in variables_of(name, option)
    }
    unknown = {}
    for name in sorted(name for name in environment if name.startswith("TOFMIX_")):
        option = options.get(name)
        if name == watchdog.VARIABLE:
            if not watchdog.is_limit(environment[name]):
                unknown[name] = f"{environment[name]!r} is no number of seconds above 0"
        elif option is None:
            unknown[name] = "no option has this name"
        elif option is not None and not option.allow_from_autoenv:
            unknown[name] = f"{option.opts[-1]} is for the command line alone"
    return unknown


def _say_unknown_variables() -> None:
    unknown = unknown_variables(os.environ)
    for reason in dict.fromkeys(unknown.values()):
        names = ", ".join(name for name, why in unknown.items() if why == reason)
        click.echo(f"tofmix: not used: {names}, in the environment: {reason}", err=True)


def _take_any_name() -> None:
    """Let standard output print names of files that are no UTF-8, as the bytes that they are."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="surrogateescape")


def run(arguments: list[str] | None = None) -> NoReturn:
    """Run the command line and leave with its exit code; never a traceback for a fault of the user's or the disk's."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _die)
    watchdog.arm()
    _take_any_name()
    code = ExitCode.DONE
    try:
        _say_unknown_variables()
        code = main.main(args=arguments, prog_name="tofmix", standalone_mode=False) or code
        sys.stdout.flush()
        if code == ExitCode.INTERRUPTED:  # with a whole result; a shell loop around the command stops all the same
            _end_by(signal.SIGINT)
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "tofmix"
        text = error.format_message()
        variables = from_environment(error.ctx, text) if error.ctx else ""
        _fail(f"{text}{variables} See {command} --help.", ExitCode.USAGE)
    except click.ClickException as error:
        _fail(error.format_message(), ExitCode.USAGE)
    except TofmixError as error:
        _fail("".join((str(error), *getattr(error, "__notes__", ()))), error.exit_code)
    except SystemExit as leave:
        # click leaves with 1 where the reader of a pipe has ended (`| head`); in our table 1 is a bug.
        sys.exit(ExitCode.CLOSED_PIPE if leave.code == 1 else leave.code)
    except OSError as error:
        _discard(sys.stdout)
        _fail(os_error_text(error, error.filename or "standard output"), ExitCode.STORAGE)
    except Exception as error:
        if not _is_want_of_memory(error):
            raise
        _fail("out of memory; close other programs, or choose a smaller --memory or fewer --workers", ExitCode.STORAGE)
    sys.exit(code)


def _is_want_of_memory(error: BaseException | None) -> bool:
    """Whether it is a MemoryError, or has one as its cause: a library may fail in another way after one."""
    return error is not None and (isinstance(error, MemoryError) or _is_want_of_memory(error.__context__))


def _fail(text: str, code: ExitCode) -> NoReturn:
    try:
        click.echo(f"tofmix: {' '.join(text.split())}", err=True)
    except OSError:  # stderr may be a file on the full disk; then the exit code alone reports the error
        _discard(sys.stderr)
    sys.exit(code)


def _discard(stream: TextIO) -> None:
    """Keep the interpreter from failing again at exit, on the rest of a stream's buffer, with exit code 120."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _die(number: int, _: FrameType | None) -> None:
    """Remove partial files and end by the signal itself, so that a shell loop around the command stops too.

    Not by an exception: raised while a kernel is compiled, it would be lost in the compiler's callbacks.
    """
    discard_partial_outputs()
    if number == signal.SIGINT:
        os.write(sys.stderr.fileno(), b"tofmix: interrupted\n")
    if is_resumable():
        os.write(sys.stderr.fileno(), b"tofmix: finished blocks are kept; --resume continues\n")
    _end_by(number)


def _end_by(number: int) -> None:
    """End by a signal; a shell sees the exit code 128 + its number."""
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)

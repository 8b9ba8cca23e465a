"""Options of several commands, progress, and values from the shell."""

import math
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import click

from tofmix.errors import UsageError
from tofmix.options import Option
from tofmix.sensor_schema import ShareLaw

F = TypeVar("F", bound=Callable[..., Any])
"""A command's function, or the command."""


class _Path(click.Path):
    """A path that the package checks instead of click, for its own exit codes."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401  as click has it
        if not str(value):
            self.fail("the path is empty", param, ctx)
        return super().convert(value, param, ctx)


class _Hdf5Path(_Path):
    """The path of a new HDF5 file, without the extension of another kind of file."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:  # noqa: ANN401  as click has it
        path = super().convert(value, param, ctx)
        if _OTHER_KINDS.fullmatch(path.suffix):
            self.fail(
                f"{path}: the file will be HDF5, so its name must not end in {path.suffix}; choose .h5.", param, ctx
            )
        return path


_PAIR = re.compile(r"\s*([0-9.eE+-]+)\s*[x,]\s*([0-9.eE+-]+)\s*")
_MOST_DEG = 360.0, 180.0
"""Largest field of view, degrees: a whole turn, and from pole to pole."""

_OTHER_KINDS = re.compile(
    r"\.(npy|npz|mat|csv|tsv|txt|png|tiff?|bag|mcap|db3|toml|json|geojson|html|ya?ml|pgm|la[sz]|ply|pcd|obj|svg)",
    re.IGNORECASE,
)
"""Ends of names of all that tofmix reads or writes and that is no HDF5."""

PATH = _Path(path_type=Path)
HDF5_PATH = _Hdf5Path(path_type=Path)


class _Memory(click.ParamType):  # type: ignore[type-arg,unused-ignore]  # generic since click 8.2
    """Bytes, from a text such as 300MB or 1.5GB."""

    name = "size"
    _units: ClassVar = {"": 1, "K": 10**3, "M": 10**6, "G": 10**9, "T": 10**12, "KI": 2**10, "MI": 2**20, "GI": 2**30}

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:  # noqa: ANN401  as click has it
        if isinstance(value, int):
            return value
        found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*([KMGT]?I?)B?\s*", str(value).upper())
        if found is None or found[2] not in self._units:
            self.fail(f"{value!r} is not a size; write 300MB or 1.5GB", param, ctx)
        size = int(float(found[1]) * self._units[found[2]])
        least_memory = 250_000_000  # bytes: the program with its kernels, and one block
        if size < least_memory:
            self.fail(f"{value!r} is too small; give at least {least_memory // 10**6}MB", param, ctx)
        return size


class _Shard(click.ParamType):  # type: ignore[type-arg,unused-ignore]  # generic since click 8.2
    """Part I of N, from a text such as 3/8."""

    name = "shard"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:  # noqa: ANN401  as click has it
        found = re.fullmatch(r"([0-9]+)/([0-9]+)", str(value))
        number, count = (int(found[1]), int(found[2])) if found else (0, 0)
        if not 1 <= number <= count:
            self.fail(f"{value!r} is not a part I/N with I from 1 to N", param, ctx)
        return number, count


SHARD = _Shard()

_QUIET, _COMMAND = "tofmix.quiet", "tofmix.command"  # keys of a context's `meta`, which its parents share

MEMORY = _Memory()

FILE, AUTO = "file", "auto"
"""Values of --noise and --outliers, as in `tofmix.estimation.noise_choice`, which imports numba."""

overwrite_option = click.option(
    "--overwrite", is_flag=True, help="Replace an output that is already there.", allow_from_autoenv=False
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON on stdout, for scripts.", allow_from_autoenv=False
)


def declared(options: Mapping[str, Option], name: str, *flags: str, **more: Any) -> Callable[[F], F]:  # noqa: ANN401  of click
    """The decorator of an option that is declared in `tofmix.options`, with `more` that the command adds."""
    option = options[name]
    before = more.pop("before", "")
    words: Any = {"help": before + option.help[0].lower() + option.help[1:] if before else option.help}
    if option.is_flag:
        words["is_flag"] = True
    elif option.choices:
        words["type"] = click.Choice(option.choices)
    else:
        high = None if math.isinf(option.high) else option.high
        bounds = {"min_open": option.low_open, "max_open": option.high_open}
        whole = click.IntRange(int(option.low), None if high is None else int(high), **bounds)
        words["type"] = whole if option.whole else click.FloatRange(option.low, high, **bounds)
    if option.default is not None and not option.is_flag:
        words |= {"default": option.default, "show_default": True}
    return click.option(*(flags or (f"--{name.replace('_', '-')}",)), **(words | more))


suspect_option = click.option(
    "--suspect", is_flag=True, help="Take suspect layers too: scattered light, folded, passing, near returns."
)


def default_workers() -> int:
    """Processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def nearer_of(**values: Any) -> tuple[Any, ...]:  # noqa: ANN401  values of any options
    """Values of options that exclude one another: those of the environment give way to those of the command line.

    `values` are those of the running command's parameters, by name. They return in their order, None in place of each
    that is not given or gives way.
    """
    context = click.get_current_context()
    line = click.core.ParameterSource.COMMANDLINE
    typed = {name for name, value in values.items() if value is not None and context.get_parameter_source(name) is line}
    return tuple(value if not typed or name in typed else None for name, value in values.items())


def only_one_of(what: str, **values: Any) -> tuple[Any, ...]:  # noqa: ANN401  values of any options
    """Values of options that set the same, `what`, of which one may be given; as `nearer_of` has them."""
    nearer = nearer_of(**values)
    given = [f"--{name.replace('_', '-')}" for name, value in zip(values, nearer, strict=True) if value is not None]
    if others := given[1:]:
        all_of_them = "both" if len(others) == 1 else "all"
        raise UsageError(f"{' and '.join(given)} {all_of_them} set the {what}; give one of them")
    return nearer


def give_way(values: dict[str, Any], ruling: str, others: Iterable[str]) -> dict[str, Any]:
    """Values in which an option of the environment gives way to one of the command line that excludes it.

    What gives way has its default, and counts as not given. `values` are those of the running command's parameters, by
    name; the parameter `ruling` excludes the `others`.
    """
    context, others = click.get_current_context(), tuple(others)
    line, environment = click.core.ParameterSource.COMMANDLINE, click.core.ParameterSource.ENVIRONMENT
    weaker: tuple[str, ...] = ()
    if context.get_parameter_source(ruling) is line:
        weaker = others
    elif any(context.get_parameter_source(name) is line for name in others):
        weaker = (ruling,)
    settled = dict(values)
    for option in context.command.params:
        name = option.name or ""
        if name in weaker and context.get_parameter_source(name) is environment:
            settled[name] = option.get_default(context)
            context.set_parameter_source(name, click.core.ParameterSource.DEFAULT)
    return settled


def variables_of(command: str, option: click.Option) -> list[str]:
    """Variables of the environment with the long names of a command's option: those that set it, if any may."""
    return [f"TOFMIX_{command}_{name[2:]}".upper().replace("-", "_") for name in option.opts if name.startswith("--")]


def from_environment(context: click.Context, text: str) -> str:
    """Names of the variables whose options a message names and the environment sets, in words; empty without any."""
    names: list[str] = []
    for option in context.command.params:
        of_environment = context.get_parameter_source(option.name or "") is click.core.ParameterSource.ENVIRONMENT
        if isinstance(option, click.Option) and of_environment and any(_names(text, name) for name in option.opts):
            names += [name for name in variables_of(context.command.name or "", option) if os.environ.get(name)]
    return f" ({', '.join(names)} in the environment)" if names else ""


def _names(text: str, option: str) -> bool:
    return re.search(rf"(?<![\w-]){re.escape(option)}(?![\w-])", text) is not None


def running_command(context: click.Context) -> click.Context | None:
    """The context of the command that runs below this one; None before its options are read."""
    found: click.Context | None = context.meta.get(_COMMAND)
    return found


def _hush(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    context.meta[_QUIET], context.meta[_COMMAND] = wanted, context


quiet_option = click.option(
    "-q",
    "--quiet",
    is_flag=True,
    expose_value=False,
    callback=_hush,
    allow_from_autoenv=False,
    help="No progress bar and no notes on stderr; results, warnings and errors stay.",
)


def is_quiet() -> bool:
    """Whether the running command has --quiet."""
    context = click.get_current_context(silent=True)  # its `meta` is that of all its parents
    return context is not None and bool(context.meta.get(_QUIET))


def note(text: str) -> None:
    """Print a note on stderr; --quiet suppresses it."""
    if not is_quiet():
        click.echo(f"tofmix: {text}", err=True)


def say_written(what: str, path: Path, *, beside_json: bool) -> None:
    """Name a file that was written: on stdout, or as a note on stderr where stdout has JSON."""
    if not beside_json:
        click.echo(f"{what}: {path}")
    elif not is_quiet():
        click.echo(f"{what}: {path}", err=True)


def shares_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--shares``, the law by which samples share out among the surfaces of a pixel."""
    return click.option(
        "--shares",
        type=click.Choice([law.value for law in ShareLaw]),
        help="What a share of the samples measures. area: the part of the pixel that the surface covers. detections:"
        " that part times the brightness (single photons). strongest: the camera keeps the brightest return.  [default:"
        " the file's or the sensor's; else area]",
    )(command)


projection_option = click.option(
    "--projection",
    type=click.Choice(["equiangular", "pinhole"]),
    default="equiangular",
    show_default=True,
    help="What --fov is of: equal angles between pixels, or an ideal pinhole.",
)


def examples(text: str) -> Callable[[click.Command], click.Command]:
    """Add an examples section to a command's help, kept as it is written."""

    def add(command: click.Command) -> click.Command:
        command.epilog = "\b\nExamples:\n" + "\n".join("  " + line for line in text.strip().splitlines())
        return command

    return add


def view_of(text: str | None) -> tuple[float, float] | None:
    """Field of view (horizontal, vertical), degrees, from a text such as 70x55."""
    if text is None:
        return None
    try:
        found = _PAIR.fullmatch(text)
        view = (float(found[1]), float(found[2])) if found else (0.0, 0.0)
    except ValueError:
        view = (0.0, 0.0)
    if not all(0.0 < angle <= most for angle, most in zip(view, _MOST_DEG, strict=True)):
        raise UsageError(f"--fov: {text!r} is not HxV in degrees, up to 360x180, such as 70x55")
    return view

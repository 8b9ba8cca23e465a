"""The effects as a Markdown page: ``python -m tofmix.simulation.effects.reference > docs/reference/effects.md``.

Made from the registry alone, so that the page says what the code does: docstrings,
declared parameters, magnitudes and their basis. The figures beside it are drawn by
``python docs/figures/effect_figures.py``.
"""

import inspect
import sys
from collections.abc import Iterator

from tofmix.simulation.effects.base import LEVEL_NAMES, Effect, Level
from tofmix.simulation.effects.parameter import Holds, Parameter
from tofmix.simulation.effects.registry import EFFECTS
from tofmix.wording import table_cell

COMMAND = "python -m tofmix.simulation.effects.reference > docs/reference/effects.md"

_HEAD = f"""\
# Effects of real cameras

Made by `{COMMAND}`; change the effects, not this page.

Without effects, `tofmix simulate` draws samples from equation (1). A model lists what its camera does beyond that:

```toml
[[effect]]
kind = "wiggling"
amplitude_mm = 12.0
phase_rad = 0.3
```

`tofmix simulate MODEL --explain` says in words what a model will do. [model.md](../explanation/model.md) explains the
two forward models of a mixed pixel, equation (1) and the phasor sum.

## How effects act together

- Effects act level by level, whatever their order in the file: geometry, light, correlation, range, read-out. Within
  a level they act in file order. A kind may be there twice only with another surface.
- z is a sample's phasor, amplitude times exp(2 pi i r / d_u), d_u = c / (2 f). A light effect replaces z by z': the
  range is then d_u arg(z') / 2 pi on the turn nearest the old one, the amplitude |z'|, sigma times |z| / |z'|. Where
  light cancels itself, sigma grows up to a factor of 1e9, and samples end at the limits of what can be stored.
- Sigma is taken at the surface's true range, before any bias. Bias effects leave it alone.
- **No return.** Samples without a return have z = 0 and stay around `range_max_mm` with their noise, whatever happens
  to the light, the range or sigma of the others. Only `temporal_correlation`, `outliers`, `dropout`, `stuck_pixels`
  and `quantisation` act on them. Samples of a surface with reflectivity 0 have z = 0 too: light effects leave them.
- **Random values**, those of `outlier_probability` as well, replace whatever their pixel would have returned, after
  all but stuck pixels and quantisation. They are never lost, and their amplitude is 0. What lies behind one still
  reaches its neighbours by `pixel_crosstalk`, and its noise goes on in `temporal_correlation`.
- A stuck pixel returns its value in every frame: none of its samples is lost.
- Every effect draws from a random stream of its own, by seed, kind, surface and frame. One effect more, or one of
  magnitude zero, changes no draw of the others.
- With `--averaged`, all but the read-out effects act on each exposure, and read-out effects on the mean: `threshold`
  is then held against the amplitude of the whole time. Effects that have no meaning there are refused (below).
- A `map` is an .npy file of float32, (row, col), named by a path within the model's folder. Paths that are absolute
  or lead out of it are refused: a model and its maps stay one folder.
- What is drawn once a recording is part of its truth, in `truth/effects`; see [formats.md](formats.md).

## Magnitudes

The basis of each figure: *physics*, it follows from a formula and a test holds it; *reported*, it is in the
literature, but was recalled, and no copy was at hand to check it; *assumed*, neither.
"""
_FIGURES = """\
Pictures are drawn by `python docs/figures/effect_figures.py`. Grey is the scene without the effect, colour with it;
lines are what the model predicts. The magnitudes in them are chosen to be seen.
"""


def reference() -> str:
    """Return the page, ending in one newline."""
    parts = [_HEAD, *_magnitudes(), _FIGURES]
    for level in Level:
        parts.append(f"## Level: {LEVEL_NAMES[level]}\n")
        for effect in EFFECTS.values():
            if effect.level == level:
                parts += _effect(effect)
    return "\n".join(parts)


def _magnitudes() -> Iterator[str]:
    yield "| effect | level | magnitude | basis |\n|---|---|---|---|"
    for kind, effect in EFFECTS.items():
        level = LEVEL_NAMES[Level(effect.level)]
        yield f"| [`{kind}`](#{kind}) | {level} | {table_cell(effect.typical)} | {table_cell(effect.basis)} |"
    yield ""


def _effect(effect: type[Effect]) -> Iterator[str]:
    text, _, sources = inspect.getdoc(effect).partition("\n\nReferences\n----------\n")  # type: ignore[union-attr]
    yield f"### {effect.kind}\n"
    yield _paragraphs(text)
    yield "| parameter | unit | bounds | left out | |\n|---|---|---|---|---|"
    for parameter in effect.parameters().values():
        yield _row(parameter)
    yield ""
    yield f"- **Shows as**: {effect.signature}."
    yield f"- **Prediction**: {effect.predicts}."
    if not effect.averages:
        yield "- **With `--averaged`**: refused."
    if sources:
        yield f"- **Source**: {' '.join(sources.split())}"
    yield f"\n![{effect.kind}: with and without](../images/effects/{effect.kind}.png)\n"


def _row(parameter: Parameter) -> str:
    bounds = parameter.bounds if parameter.holds is Holds.NUMBER else parameter.holds.value
    left_out = "" if parameter.required else "-" if parameter.default is None else f"{parameter.default:g}"
    unit = parameter.unit
    return f"| `{parameter.name}` | {unit} | {bounds} | {left_out} | {table_cell(parameter.sentence)} |"


def _paragraphs(text: str) -> str:
    paragraphs = (" ".join(paragraph.split()) for paragraph in text.replace("``", "`").split("\n\n"))
    return "\n\n".join(paragraphs) + "\n"


if __name__ == "__main__":
    sys.stdout.write(reference())

"""The effects as a Markdown page: ``python docs/generators/effects_page.py > docs/reference/effects.md``.

The page consists of the docstrings, parameters, magnitudes and their basis in the registry. ``python
docs/figures/effect_figures.py`` draws its figures.
"""

import inspect
import sys
from collections.abc import Iterator

from commands import table_cell

from tofmix.simulation.effects import EFFECTS
from tofmix.simulation.effects.base import LEVEL_NAMES, Effect, Level
from tofmix.simulation.effects.parameter import Holds, Parameter

COMMAND = "python docs/generators/effects_page.py > docs/reference/effects.md"

_HEAD = f"""\
# Effects of real cameras

Made by `{COMMAND}`; change the effects, not this page.

Without effects, `tofmix simulate` draws samples from equation (1). A model lists the further effects of its camera:

```toml
[[effect]]
kind = "wiggling"
amplitude_mm = 12.0
phase_rad = 0.3
```

`tofmix simulate MODEL --explain` describes a simulation in words. [model.md](../explanation/model.md) explains the two
forward models of a mixed pixel, equation (1) and the phasor sum.

## How effects act together

- Effects act level by level, in any order of the file: geometry, light, correlation, range, read-out. Within a level
  they act in file order. A kind may occur twice only with another surface.
- z is the phasor of a sample, amplitude times exp(2 pi i r / d_u), d_u = c / (2 f). A light effect replaces z by z'.
  The range is then d_u arg(z') / 2 pi on the turn nearest the old range, the amplitude is |z'|, and sigma is multiplied
  by |z| / |z'|. Where light cancels, sigma grows up to a factor of 1e9, and samples end at the limits of storage.
- Sigma belongs to the surface's true range, before any bias. Bias effects do not change it.
- **No return.** Samples without a return have z = 0 and stay around `range_max_mm` with their noise. Effects on light,
  range or sigma do not change them. Only `temporal_correlation`, `outliers`, `dropout`, `stuck_pixels` and
  `quantisation` act on them. Samples of a surface with reflectivity 0 have z = 0 too, and light effects do not change
  them.
- **Random values**, also those of `outlier_probability`, replace the pixel's sample after all effects but stuck pixels
  and quantisation. They are never lost, and their amplitude is 0. The replaced sample still acts on its neighbours by
  `pixel_crosstalk`, and its noise continues in `temporal_correlation`.
- A stuck pixel returns its value in every frame: none of its samples is lost.
- Every effect has a separate random stream, by seed, kind, surface and frame. A further effect, or one of magnitude
  zero, changes no draw of the others.
- With `--averaged`, read-out effects act on the mean, and all others on each exposure. `threshold` is then compared
  with the amplitude of the whole time. Effects without a meaning there are refused (below).
- A `map` is an .npy file of float32, (row, col), given by a path within the model's folder. Absolute paths, and paths
  out of the folder, are refused: a model and its maps stay in one folder.
- Draws that hold for a whole recording are part of its truth, in `truth/effects`; see [formats.md](formats.md).

## Magnitudes

The basis of each figure: *physics*, it follows from a formula that a test checks; *reported*, it is in the literature,
but was recalled without a copy to check; *assumed*, neither.

**Priors.** From these magnitudes each effect declares the density of its numbers before a recording is seen. Only
`tofmix reconcile` uses it: estimates are the most probable numbers given the recording and the prior, and an effect
whose numbers lie beyond the interval given below is never named, since real cameras and scenes do not have them. The
interval ends where a normal number has three standard deviations. Numbers without a prior can have any magnitude.
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
    priors = [f"`{p.name}` {p.prior.words(p.unit)}" for p in effect.parameters().values() if p.prior is not None]
    if priors:
        yield f"- **Prior**: {'; '.join(priors)}."
    if not effect.averages:
        yield "- **With `--averaged`**: refused."
    if sources:
        yield f"- **Source**: {' '.join(sources.split())}"
    yield f"\n![{effect.kind}: with and without](../images/effects/{effect.kind}.png)\n"


def _row(parameter: Parameter) -> str:
    bounds = parameter.bounds if parameter.holds is Holds.NUMBER else parameter.holds.value
    left_out = "" if parameter.required else "all" if parameter.name == "surface" else _shown(parameter.default)
    unit = parameter.unit
    return f"| `{parameter.key}` | {unit} | {bounds} | {left_out} | {table_cell(parameter.sentence)} |"


def _shown(default: float | str | None) -> str:
    return f"{default:g}" if isinstance(default, int | float) else "-"


def _paragraphs(text: str) -> str:
    paragraphs = (" ".join(paragraph.split()) for paragraph in text.replace("``", "`").split("\n\n"))
    return "\n\n".join(paragraphs) + "\n"


if __name__ == "__main__":
    sys.stdout.write(reference())

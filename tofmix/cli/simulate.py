"""``tofmix simulate``: a model in, a synthetic recording out."""

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tofmix.cli.options import HDF5_PATH, default_workers, examples, json_option, overwrite_option
from tofmix.cli.progress import Progress
from tofmix.errors import BadInputError
from tofmix.wording import counted

if TYPE_CHECKING:
    from tofmix.simulation.model import Model


def _list_models(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if not wanted or context.resilient_parsing:
        return
    from tofmix.simulation.builtin import BUILTIN_MODELS, builtin_description

    for name in BUILTIN_MODELS:
        click.echo(f"{name:14s} {builtin_description(name)}")
    context.exit()


@examples(
    """
tofmix simulate three-boards -o boards.h5
tofmix simulate three-boards --averaged -o averaged.h5
tofmix simulate corridor --print-model > my_scene.toml
tofmix simulate my_scene.toml --explain
tofmix simulate my_scene.toml -o my_scene.h5 --frames 500 --seed 7
tofmix simulate my_scene.toml -o my_scene.h5 --repeat 3
"""
)
@click.command(short_help="Write a synthetic recording of a model scene.")
@click.argument("model")
@click.option("-o", "--output", type=HDF5_PATH, help="Recording to write.")
@click.option("--frames", type=click.IntRange(1), help="Frames.  [default: the model's]")
@click.option("--seed", type=click.IntRange(0), help="Seed; the same seed gives the same file.  [default: the model's]")
@click.option(
    "--averaged",
    is_flag=True,
    allow_from_autoenv=False,
    help="Write the means that the camera's on-board averaging returns.",
)
@click.option(
    "--print-model", is_flag=True, allow_from_autoenv=False, help="Print the model as TOML, as a start for your own."
)
@click.option(
    "--explain", is_flag=True, allow_from_autoenv=False,
    help="Describe the simulation in words, effect by effect, and write nothing.",
)  # fmt: skip
@click.option(
    "--repeat", type=click.IntRange(1, 999), metavar="N",
    help="Write N recordings, OUTPUT_001.h5 and so on, with ascending seeds.",
)  # fmt: skip
@click.option(
    "--list", is_flag=True, is_eager=True, expose_value=False, callback=_list_models, allow_from_autoenv=False,
    help="List the built-in models.",
)  # fmt: skip
@json_option
@overwrite_option
def simulate(
    model: str,
    output: Path | None,
    frames: int | None,
    seed: int | None,
    averaged: bool,
    print_model: bool,
    explain: bool,
    repeat: int | None,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Write a synthetic recording of MODEL, a TOML file or a built-in model.

    A model describes a camera and the boards in its view. Each sample shows a surface, with the probability of its
    share of the pixel's beam; or no return, or a random value. The camera's noise at this range is added. A model may
    list effects of real cameras (docs/reference/effects.md). The recording contains the true surfaces.
    """
    if as_json and (print_model or explain):
        raise click.UsageError("--json describes written recordings; leave out --print-model and --explain")
    if print_model:
        from tofmix.io.model_file import load_model_text

        click.echo(load_model_text(model), nl=False)
        return
    from tofmix.io.model_file import load_model

    if output is None and not explain:
        raise click.UsageError("Missing option '-o' / '--output'.")
    scene = load_model(model)
    recording = scene.recording
    chosen = replace(
        recording,
        frames=recording.frames if frames is None else frames,
        seed=recording.seed if seed is None else seed,
    )
    scene = replace(scene, recording=chosen)
    if output is None or explain:
        _explain(scene)
        return

    from tofmix.io.atomic.storage import check_output, locked

    outputs = [output] if repeat is None else [_numbered(output, k) for k in range(1, repeat + 1)]
    for path in outputs:
        check_output(path, overwrite=overwrite, inputs=(Path(model),))
    for k, path in enumerate(outputs):
        with locked(path, overwrite=overwrite, inputs=(Path(model),)):
            seeded = replace(scene, recording=replace(chosen, seed=chosen.seed + k))
            line, made = _write(seeded, model, path, averaged, overwrite)
        click.echo(json.dumps(made) if as_json else line)


def _numbered(output: Path, number: int) -> Path:
    return output.with_name(f"{output.stem}_{number:03d}{output.suffix}")


def _explain(scene: "Model") -> None:
    from tofmix.simulation.explain import explain

    click.echo(explain(scene))


def _write(model: "Model", name: str, output: Path, averaged: bool, overwrite: bool) -> tuple[str, dict[str, Any]]:
    from tofmix.io.recording.recording_writer import CHUNK_FRAMES, RecordingWriter
    from tofmix.simulation.casting.cast import cast_scene
    from tofmix.simulation.exposure import drawn_truth
    from tofmix.simulation.render import recording_sensor, render_blocks

    n_frames, seed = model.recording.frames, model.recording.seed
    shape = (n_frames, model.sensor.rows, model.sensor.cols)
    try:
        sensor = recording_sensor(model, averaged=averaged)
        truth = cast_scene(model)
        model.placed((n_frames - 1) / model.recording.frame_rate_hz)
    except BadInputError as error:
        raise BadInputError(f"{name}: {error}") from error
    writer = RecordingWriter(
        output,
        shape=shape,
        sensor=sensor,
        truth=truth,
        model_text=model.text,
        effect_truth=drawn_truth(model, seed=seed, n_frames=n_frames),
        moving=model.moves,
        title=f"synthetic recording of {Path(name).name}",
        attributes={"seed": seed, "averaged": int(averaged)},
        overwrite=overwrite,
    )
    with Progress(n_frames, "simulate", "frame") as bar, writer:  # the bar stays until the file has its name
        for block in render_blocks(
            model,
            truth,
            n_frames=n_frames,
            seed=seed,
            averaged=averaged,
            block_frames=CHUNK_FRAMES,
            threads=default_workers(),
        ):
            writer.write(
                block.start,
                block.range_mm,
                time_s=block.time_s,
                amplitude=block.amplitude,
                range_true=block.range_true,
            )
            bar.update(len(block.range_mm))
    frames = counted(n_frames, "averaged frame" if averaged else "frame")
    made = {"output": str(output), "frames": n_frames, "rows": shape[1], "cols": shape[2], "seed": seed}
    line = f"{output}: {frames} of {shape[1]} x {shape[2]} pixels, seed {seed}"
    return line, made | {"averaged": averaged}

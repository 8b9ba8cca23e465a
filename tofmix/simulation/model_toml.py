"""A model file's text into a `Model`, a model with another noise, and a model in words.

A model file's text into a `Model`. Every refusal is one line: file, table, key, value, remedy.

Reading the file itself is left to the caller, and the built-in models to `tofmix.simulation`.

A model's parts as the text of a model file: `model_text`.

A model with another noise than its file has, and its text with this noise.

Use `with_noise` for a noise that was measured: the model and its text then say the same.

Description of a simulation in words, effect by effect, for ``simulate --explain``.
"""

import json
import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tofmix.circle import unambiguous_range_mm
from tofmix.errors import BadInputError
from tofmix.noise_shape import WHOLE_MM
from tofmix.sensor import AmplitudeLaw, NoiseCurve
from tofmix.sensors import camera_of_model
from tofmix.sensors.camera import CompleteCamera
from tofmix.sensors.camera_toml import camera_toml, noise_toml
from tofmix.simulation.effects import EFFECTS, Effect, PixelMap
from tofmix.simulation.effects.base import LEVEL_NAMES, Level
from tofmix.simulation.effects.parameter import Holds, Parameter
from tofmix.simulation.effects.quantisation import Quantisation
from tofmix.simulation.measured_scene import MeasuredScene, SceneParts, scene_words
from tofmix.simulation.model import Model, RecordingSettings
from tofmix.simulation.surface import Surface
from tofmix.toml_table import MapReader, TomlTable, nearest, parse_toml, toml_string
from tofmix.wording import counted

BACKGROUND_MAP = "noise_background.npy"
"""Path of the map of background shares beside the written model."""

SceneReader = Callable[[TomlTable], SceneParts]
"""Reads the files that a table ``[scene]`` names; BadInputError, with the key, if it cannot."""

_TABLE = re.compile(r"^\[sensor\.noise\][^\n]*\n(?:(?!\[)[^\n]*(?:\n|\Z))*", re.MULTILINE)


def with_noise(model: Model, curve: NoiseCurve, *, step_mm: float | None = None) -> Model:
    """The model with this noise at its integration time.

    Parameters
    ----------
    model : Model
        The model; its file has the noise in a table ``[sensor.noise]``, or in its profile.
    curve : NoiseCurve
        The noise. A background that is not uniform over the range becomes uniform.
    step_mm : float, optional
        Step on which the ranges lie. One above 1 mm becomes the effect `quantisation`, if the model has none.

    Raises
    ------
    BadInputError
        If the file has the noise in another form than a table of its own.
    """
    sensor = model.sensor
    curve = _explicit(replace(curve, background_density=None), sensor.noise)
    path = BACKGROUND_MAP if curve.background is not None and curve.background.ndim else None
    stepped = step_mm is not None and step_mm > WHOLE_MM
    added = () if not stepped or any(isinstance(e, Quantisation) for e in model.effects) else (_step(step_mm),)
    text = model.text
    if text:
        table = noise_toml(
            curve, integration_time_ms=sensor.integration_time_ms, exponent=sensor.exponent, background=path
        )
        bare = _TABLE.sub("", text)
        if "noise" in parse_toml(bare, source="model").table("sensor").values:
            raise BadInputError("[sensor]: noise: give it as a table [sensor.noise], so that another can replace it")
        text = f"{bare.rstrip()}\n\n{table}" + "".join(
            f'\n[[effect]]\nkind = "{Quantisation.kind}"\nstep_mm = {e.step_mm!r}\n' for e in added
        )
    changed = replace(sensor, noise=curve, reference_integration_time_ms=sensor.integration_time_ms)
    return replace(model, sensor=changed, effects=(*model.effects, *added), text=text)


def _step(step_mm: float | None) -> Quantisation:
    return Quantisation(step_mm=float(step_mm or 0.0))


def _explicit(curve: NoiseCurve, given: NoiseCurve) -> NoiseCurve:
    """The curve with every part that a table would otherwise inherit from the model's profile."""
    if curve.law is None and given.law is not None:
        ones = np.ones(curve.range_mm.size)
        curve = replace(curve, law=AmplitudeLaw(reference=ones, amplitude=np.ones(1), factor=np.ones(1)))
    if curve.background is None and given.background is not None:
        curve = replace(curve, background=np.zeros(()))
    return curve


def model_text(
    sensor: CompleteCamera,
    surfaces: Sequence[Surface],
    recording: RecordingSettings,
    effects: Sequence[Effect] = (),
    *,
    background: str | None = None,
    remarks: Sequence[str] = (),
    about: Sequence[str] = (),
) -> str:
    """The text of a model file, ending in a newline; `parse_model` reads it.

    Parameters
    ----------
    surfaces : sequence of Surface
        The scene. Lengths are written to a thousandth of a mm, angles to a millionth of a degree.
    recording : RecordingSettings
        Frames, frame rate, seed.
    effects : sequence of Effect
        Effects without maps.
    background : str, optional
        Path of the map of background shares, relative to the model's folder.
    remarks : sequence of str
        Comments at the head of the file, one a line.
    about : sequence of str
        A comment for each surface; none if it is empty.
    """
    tables = [
        *([_comments(remarks)] if remarks else []),
        camera_toml(sensor, background=background),
        _table_text("[recording]", _recording_values(recording)),
    ]
    for number, surface in enumerate(surfaces):
        tables.append((_comments(about[number : number + 1])) + surface_table(surface))
    return "\n".join([*tables, *_effect_texts(effects)])


def surface_values(surface: Surface) -> dict[str, Any]:
    """The keys of a surface's table and their values, lengths to a thousandth of a mm, angles to a millionth degree."""
    return {
        "name": surface.name,
        "center_mm": [round(x, 3) + 0.0 for x in surface.center_mm],
        "size_mm": [round(x, 3) for x in surface.size_mm],
        **{key: round(getattr(surface, key), 6) + 0.0 for key in ("yaw_deg", "pitch_deg", "roll_deg")},
        "reflectivity": round(surface.reflectivity, 4),
    }


def surface_table(surface: Surface) -> str:
    """The table of a surface in a model file."""
    return _table_text("[[surface]]", surface_values(surface))


def _comments(lines: Sequence[str]) -> str:
    return "".join(f"# {_one_line(line)}\n" for line in lines)


def _table_text(head: str, values: dict[str, Any]) -> str:
    """A table with texts, numbers and lists of numbers, which JSON writes as TOML does."""
    shown = ((key, toml_string(v) if isinstance(v, str) else json.dumps(v)) for key, v in values.items())
    return "\n".join([head, *(f"{key} = {value}" for key, value in shown)]) + "\n"


def explain(model: Model) -> str:
    """The model in words, one fact a line, without a newline at the end."""
    return "\n".join([*_camera(model), *_scene(model), *_samples(model), *_effects(model)])


def _camera(model: Model) -> Iterator[str]:
    sensor, recording = model.sensor, model.recording
    yield (
        f"camera: {sensor.name}, {sensor.rows} x {sensor.cols} pixels over {sensor.optics.words(sensor.shape)}, "
        f"{sensor.range_min_mm:g} to {sensor.range_max_mm:g} mm"
    )
    frequency = sensor.modulation_frequency_hz
    if frequency is None:
        yield f"light: no phase is measured; {sensor.integration_time_ms:g} ms a sample"
    else:
        yield (
            f"light: {frequency / 1e6:g} MHz, the phase turns once in {unambiguous_range_mm(frequency):.0f} mm; "
            f"{sensor.integration_time_ms:g} ms a sample"
        )
    middle = math.sqrt(max(sensor.range_min_mm, 1.0) * sensor.range_max_mm)
    sigma = float(sensor.noise_at(sensor.integration_time_ms).sigma(middle))
    law = "" if sensor.noise.law is None else "; less where a sample is bright, more where it is faint"
    kind = (
        "Gaussian"
        if sensor.noise.shape is None
        else f"of its own shape, skewness {sensor.noise.shape.moments()[2]:.2g}"
    )
    yield f"noise: {kind}, sigma(r) of the camera, such as {sigma:.3g} mm at {middle:.0f} mm{law}"
    if sensor.noise.width_spread:
        spread = f"{sensor.noise.width_spread:g}"
        yield f"widths: each pixel has a factor on its noise, of median 1, with a spread of its logarithm of {spread}"
    if sensor.noise.background is not None:
        low, high = 100 * float(sensor.noise.background.min()), 100 * float(sensor.noise.background.max())
        share = f"{low:.3g} %" if low == high else f"{low:.3g} to {high:.3g} %, by pixel,"
        yield f"background: {share} of the samples are random values, in addition to outlier_probability"
    yield (
        f"recording: {counted(recording.frames, 'frame')} at {recording.frame_rate_hz:g} Hz, "
        f"{recording.frames / recording.frame_rate_hz:g} s in all, seed {recording.seed}"
    )


def _scene(model: Model) -> Iterator[str]:
    if model.scene is not None:
        yield f"scene: as measured; {scene_words(model.scene)}"
        return
    names = ", ".join(f'"{surface.name}"' for surface in model.surfaces)
    yield (
        f"scene: {counted(len(model.surfaces), 'surface')}: {names}"
        if names
        else "scene: no surface, no return anywhere"
    )


def _samples(model: Model) -> Iterator[str]:
    yield (
        "samples: each sample shows one surface with its share of the pixel's beam, no return around "
        f"{model.sensor.range_max_mm:g} mm, or, with probability {model.sensor.outlier_probability:g}, a random value"
    )


def _effects(model: Model) -> Iterator[str]:
    if not model.effects:
        yield "effects: none; samples are drawn from equation (1)"
        return
    yield "effects, in the order in which they act:"
    for effect in model.acting():
        yield f"  {LEVEL_NAMES[Level(effect.level)]}: {effect.kind}: {effect.explain()}"


def parse_model(
    text: str, *, source: str, read_map: MapReader | None = None, read_scene: SceneReader | None = None
) -> Model:
    """Read a model.

    Parameters
    ----------
    text : str
        The TOML text.
    source : str
        The file's name, for messages.
    read_map : callable, optional
        Reads the .npy files that effects and the noise name. Without it a model that names one is refused.
    read_scene : callable, optional
        Reads the layers that ``[scene]`` names. Without it a model with a measured scene is refused.

    Returns
    -------
    Model
        The model; its `text` is `text`.

    Raises
    ------
    BadInputError
        If it is not TOML, has an unknown key, lacks one, or has one of a wrong type or outside its bounds.
    """
    root = parse_toml(text, source=source)
    root.refuse_unknown({"sensor", "recording", "scene", "surface", "effect"})
    scene = None
    if "scene" in root:
        sensor, scene = _read_scene(root, read_scene)
        surfaces = scene.surfaces
    else:
        sensor = camera_of_model(root, read_map=read_map)
        surfaces = tuple(_read_surface(table, number) for number, table in enumerate(root.tables("surface"), 1))
    recording = _read_recording(root.table("recording"))
    effects = tuple(_read_effect(table, sensor, read_map) for table in root.tables("effect"))
    try:
        return Model(sensor=sensor, surfaces=surfaces, recording=recording, text=text, effects=effects, scene=scene)
    except ValueError as error:
        message = _one_line(str(error))
        raise root.error(message, "" if message.startswith(("[[effect]]", "[sensor")) else "[[surface]]") from None


def _read_scene(root: TomlTable, read_scene: SceneReader | None) -> SceneParts:
    """The camera and the scene of the table ``[scene]``, beside which nothing else says what they are."""
    table = root.table("scene")
    table.refuse_unknown({"layers", "surfaces", "window", "frame_noise", "walks", "range_max_mm", "every", "way_mm"})
    if "surface" in root:
        raise root.error("a model has either rectangles or a measured scene; leave out one of both", "[[surface]]")
    if "sensor" in root:
        raise root.error("the camera and its noise are those of the layers of [scene]; leave it out", "[sensor]")
    if read_scene is None:
        raise table.error("a model without a file of its own has no layers beside it", "layers")
    return read_scene(table)


def scene_text(
    scene: MeasuredScene,
    recording: RecordingSettings,
    effects: Sequence[Effect] = (),
    *,
    window: int = 0,
    remarks: Sequence[str] = (),
) -> str:
    """The text of a model of a measured scene, ending in a newline.

    Parameters
    ----------
    scene : MeasuredScene
        With the paths of its files.
    recording : RecordingSettings
        Frames, frame rate, seed.
    effects : sequence of Effect
        Effects without maps.
    window : int
        Window of the layers.
    remarks : sequence of str
        Comments at the head of the file, one a line.
    """
    values: dict[str, Any] = {"layers": scene.layers_path}
    values |= {"surfaces": scene.surfaces_path} if scene.surfaces_path else {}
    values |= {"window": window} if window else {}
    values |= {"frame_noise": round(scene.frame_noise, 4)} if scene.frame_noise > 0 else {}
    values |= {"walks": [round(p, 4) for p in scene.walks]} if scene.walks else {}
    values |= {"range_max_mm": scene.range_max_mm} if scene.range_max_mm > 0 else {}
    values |= {"every": scene.every} if scene.every > 1 else {}
    values |= {"way_mm": round(scene.way_mm, 1)} if scene.way_mm else {}
    tables = [
        *([_comments(remarks)] if remarks else []),
        _table_text("[recording]", _recording_values(recording)),
        _table_text("[scene]", values),
        *_effect_texts(effects),
    ]
    return "\n".join(tables)


def _recording_values(recording: RecordingSettings) -> dict[str, Any]:
    return {"frames": recording.frames, "frame_rate_hz": float(recording.frame_rate_hz), "seed": recording.seed}


def _effect_texts(effects: Sequence[Effect]) -> Iterator[str]:
    for effect in effects:
        given = {p.key: getattr(effect, name) for name, p in effect.parameters().items()}
        values = {key: value for key, value in given.items() if value not in (None, "")}
        yield _table_text("[[effect]]", {"kind": effect.kind, **values})


def background_path(model: Model) -> str | None:
    """Where, relative to a model's file, its map of background shares is; None where it has none."""
    if not model.text:
        return None
    noise = parse_toml(model.text, source="model").table("sensor").table("noise")
    return noise.text("background") if isinstance(noise.values.get("background"), str) else None


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _read_effect(table: TomlTable, sensor: CompleteCamera, read_map: MapReader | None) -> Effect:
    kind = table.text("kind")
    if kind not in EFFECTS:
        raise table.error(f"{json.dumps(kind)} is not an effect{nearest(kind, EFFECTS)}", "kind")
    parameters = EFFECTS[kind].parameters()
    table.refuse_unknown({"kind", *(parameter.key for parameter in parameters.values())})
    table.require(parameter.key for parameter in parameters.values() if parameter.required)
    settings = {
        name: _read_parameter(table, parameter, sensor, read_map)
        for name, parameter in parameters.items()
        if parameter.key in table
    }
    try:
        return EFFECTS[kind](**settings)
    except ValueError as error:
        raise table.error(str(error)) from None


def _read_parameter(
    table: TomlTable, parameter: Parameter, sensor: CompleteCamera, read_map: MapReader | None
) -> float | str | PixelMap | tuple[tuple[float, ...], ...]:
    if parameter.holds is Holds.NUMBER:
        return table.number(parameter.key)
    if parameter.holds is Holds.SINES:
        return table.number_lists(parameter.key)
    path = table.text(parameter.key)
    if parameter.holds is Holds.SURFACE:
        return path
    if read_map is None:
        raise table.error("a model without a file of its own has no maps beside it", parameter.name)
    try:
        return PixelMap(path, read_map(path, (sensor.rows, sensor.cols)))
    except ValueError as error:
        raise table.error(_one_line(str(error)), parameter.name) from None


def _read_surface(table: TomlTable, number: int) -> Surface:
    angles = ("yaw_deg", "pitch_deg", "roll_deg", "reflectivity")
    table.refuse_unknown({"name", "center_mm", "size_mm", *angles})
    table.require(("center_mm", "size_mm"))
    settings: dict[str, Any] = {key: table.number(key) for key in angles if key in table}
    settings["name"] = table.text("name") if "name" in table else f"surface {number}"
    settings["center_mm"] = table.numbers("center_mm", 3)
    settings["size_mm"] = table.numbers("size_mm", 2)
    try:
        return Surface(**settings)
    except ValueError as error:
        raise table.error(str(error)) from None


def _read_recording(table: TomlTable) -> RecordingSettings:
    table.refuse_unknown({"frames", "frame_rate_hz", "seed"})
    settings: dict[str, Any] = {key: table.integer(key) for key in ("frames", "seed") if key in table}
    if "frame_rate_hz" in table:
        settings["frame_rate_hz"] = table.number("frame_rate_hz")
    try:
        return RecordingSettings(**settings)
    except ValueError as error:
        raise table.error(str(error)) from None

"""Light and correlation effects against the four taps, in distribution, on pixels that see several surfaces.

Both sides simulate the same camera and boards, and share no code. The image is four columns of many equal rows: column
1 sees three boards, column 2 two, the others one. The rows' samples of a column are pooled, 10^5 of each side, and held
against each other by the two-sample Kolmogorov-Smirnov test. It sees a bias of a tenth of sigma and a sigma off by a
twentieth, as a test holds. That a magnitude of zero changes no sample is held in tests/simulation/effects.

Where the contract's law is an approximation of the taps, the test stays where it holds, and says so:

- The phase noise is 0.02 to 0.1 rad. From about 0.2 rad on, the arctangent of noisy charges is no Gaussian.
- wiggling: up to 1 % of third harmonic (12 mm at 20 MHz). At 5 % the second order is 1.5 mm, and sigma swings by 5 %,
  which the contract leaves alone. Light of several ranges in one sample brings the harmonics of each, not those of
  the mean range: by up to 6 times the swing times the other light's share. So wiggling is tested without it.
- interference: the stranger's light is as strong in all samples, so that a sigma in mm goes with one amplitude. The
  boards are of one amplitude here.
- temporal_correlation: the charges remember their noise. A sample's phase noise is the part of it across its phasor, so
  that from one surface to another the memory is less by the cosine of the phase between them. The boards are near to
  each other here, or the pixels see one.
- saturation: the well fills with the light of the pixel, here all modulated, and without noise of its own.
- A pixel without a return has no phase at all; the contract puts it at the range limit and lets light effects leave it
  there. Such samples are left out; what they do to their neighbours and to the stray light is held.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats
from simulation.four_taps import Board, Camera, Errors, Seen, look, record

from tofmix.simulation.casting.cast import cast_scene
from tofmix.simulation.model_toml import parse_model
from tofmix.simulation.render import render_blocks

Floats = NDArray[np.float64]

ALPHA = 1e-4  # one false alarm in ten thousand tests on another random stream; these streams are fixed
ROWS, COLS, FRAMES = 200, 4, 500
PIXEL_DEG = 0.267
RANGE_MAX_MM = 14_000.0
NOISE_MM = [500.0, 1000.0, 2000.0, 3000.0, 5000.0, 7500.0]
NOISE_SIGMA = [4.0, 6.0, 20.0, 32.0, 90.0, 180.0]
BOARDS = (
    Board(left_mm=-3000.0, right_mm=-5.0, z_mm=1800.0, reflectivity=0.5),
    Board(left_mm=-3.0, right_mm=8.0, z_mm=2600.0, reflectivity=0.9),
    Board(left_mm=-4000.0, right_mm=4000.0, z_mm=3500.0, reflectivity=0.7),
)


@cache
def camera(rows: int = ROWS, frequency_hz: float = 20.0e6) -> Camera:
    return Camera(
        rows=rows,
        cols=COLS,
        fov_horizontal_deg=COLS * PIXEL_DEG,
        fov_vertical_deg=0.02,
        frequency_hz=frequency_hz,
        tau_ms=1.2,
        sigma=lambda r: np.interp(r, NOISE_MM, NOISE_SIGMA),
    )


@cache
def look_at(like: Camera, boards: tuple[Board, ...]) -> Seen:
    return look(like, boards)


def model_text(like: Camera, boards: tuple[Board, ...], effects: str = "") -> str:
    """The same camera and boards as a model file."""
    surfaces = "\n".join(
        f"""[[surface]]
name = "board {k}"
center_mm = [{(board.left_mm + board.right_mm) / 2}, 0.0, {board.z_mm}]
size_mm = [{board.right_mm - board.left_mm}, 3000.0]
reflectivity = {board.reflectivity}
"""
        for k, board in enumerate(boards)
    )
    return f"""
[sensor]
rows = {like.rows}
cols = {like.cols}
fov_horizontal_deg = {like.fov_horizontal_deg}
fov_vertical_deg = {like.fov_vertical_deg}
range_min_mm = 300.0
range_max_mm = {RANGE_MAX_MM}
modulation_frequency_hz = {like.frequency_hz}
integration_time_ms = {like.tau_ms}
outlier_probability = 0.0
[sensor.noise]
range_mm = {NOISE_MM}
sigma_mm = {NOISE_SIGMA}
reference_integration_time_ms = {like.tau_ms}
exponent = 0.5
{surfaces}
{effects}
"""


def simulated(text: str, *, frames: int = FRAMES, seed: int = 1) -> tuple[Floats, Floats]:
    """What the package records: ranges (frame, row, col), NaN where invalid, and amplitudes."""
    model = parse_model(text, source="test")
    block = next(render_blocks(model, cast_scene(model), n_frames=frames, seed=seed, block_frames=frames))
    return np.where(block.range_mm == 0, np.nan, block.range_mm.astype(np.float64)), block.amplitude.astype(np.float64)


def p_value(one: Floats, other: Floats) -> float:
    """Two-sample KS of the valid samples, in whole mm as they are stored."""
    one, other = (np.rint(samples[np.isfinite(samples)]) for samples in (one, other))
    return float(stats.ks_2samp(one, other, method="asymp").pvalue)


MIXED = (1, 2)
"""The columns that see several boards."""


def assert_same(ours: Floats, theirs: Floats) -> None:
    """Every column has the same distribution on both sides, and as many invalid samples."""
    assert ours[:, :, MIXED[0]].size >= 100_000
    for col in range(COLS):
        one, other = ours[:, :, col].ravel(), theirs[:, :, col].ravel()
        lost = np.isnan(one).sum(), np.isnan(other).sum()
        assert abs(lost[0] - lost[1]) <= 5 * np.sqrt(sum(lost) * (1 - sum(lost) / (2 * one.size)))
        if max(lost) < one.size:
            assert p_value(one, other) > ALPHA, f"column {col}"


@cache
def without_errors() -> Floats:
    """What the taps record of the boards with nothing in their way."""
    cam = camera()
    return record(cam, look_at(cam, BOARDS), FRAMES, np.random.default_rng(8), Errors())[0]


def effect(kind: str, **parameters: float | str) -> str:
    """An [[effect]] table."""
    lines = [f"{key} = {value!r}" for key, value in parameters.items()]
    return "\n".join(["[[effect]]", f"kind = {kind!r}", *lines, ""])


def test_the_boards_are_seen_as_described() -> None:
    cam = camera()
    seen = look_at(cam, BOARDS)
    np.testing.assert_array_equal((seen.share > 0.1).sum(axis=0)[0], [1, 3, 2, 1])
    assert (seen.share[seen.share > 0] > 0.1).all()
    phase_noise = cam.sigma(seen.range_mm[seen.share > 0]) * 2 * np.pi / cam.turn_mm
    assert phase_noise.max() < 0.05


def test_without_effects_the_taps_are_equation_1() -> None:
    cam = camera()
    ours, light = simulated(model_text(cam, BOARDS))
    theirs, measured = record(cam, look_at(cam, BOARDS), FRAMES, np.random.default_rng(5), Errors())
    assert_same(ours, theirs)
    assert light[:, :, 0].mean() == pytest.approx(measured[:, :, 0].mean(), rel=1e-3)
    assert light[:, :, 3].mean() == pytest.approx(measured[:, :, 3].mean(), rel=1e-3)
    for col in (0, 3):  # one board each
        assert light[:, :, col].std() == pytest.approx(measured[:, :, col].std(), rel=0.02)


def test_the_comparison_finds_a_bias_of_a_tenth_of_sigma_and_a_sigma_off_by_a_twentieth() -> None:
    cam = camera()
    seen = look_at(cam, BOARDS)
    ours, _ = simulated(model_text(cam, BOARDS))
    theirs, _ = record(cam, seen, FRAMES, np.random.default_rng(6), Errors())
    with pytest.raises(AssertionError, match="column"):
        assert_same(ours, theirs + 0.1 * cam.sigma(theirs))
    wider = replace(cam, sigma=lambda r: 1.05 * cam.sigma(r))
    with pytest.raises(AssertionError, match="column"):
        assert_same(ours, record(wider, seen, FRAMES, np.random.default_rng(7), Errors())[0])


TURN_MM = 299_792_458_000.0 / 20.0e6 / 2.0
HARMONIC = 2 * np.pi / TURN_MM  # of a bias in mm


def falloff(corner_factor: float) -> Floats:
    """Illumination with `corner_factor` times the sigma in the corner pixel."""
    cam = camera()
    az = np.radians((np.arange(COLS) - (COLS - 1) / 2) * cam.fov_horizontal_deg / COLS)
    el = np.radians((np.arange(ROWS) - (ROWS - 1) / 2) * cam.fov_vertical_deg / ROWS)
    cosine = np.cos(el)[:, np.newaxis] * np.cos(az)
    return np.asarray(cosine ** (-np.log(corner_factor) / np.log(cosine[0, 0])))


CASES = {
    "multipath": (
        effect("multipath", surface="board 1", share=0.4, extra_path_mm=1400.0),
        Errors(second_path={1: (0.4, 1400.0)}),
    ),
    "scattering": (effect("scattering", share=0.2), Errors(lens=0.2)),
    "internal_reflection": (
        effect("internal_reflection", amplitude=16.0, range_mm=20.0),
        Errors(window=(16.0, 20.0)),
    ),
    "pixel_crosstalk": (effect("pixel_crosstalk", share=0.08), Errors(neighbours=0.08)),
    "flying_pixels": (effect("flying_pixels", probability=0.5), Errors(all_at_once=0.5)),
    "vignetting": (effect("vignetting", corner_factor=2.5), Errors(falloff=falloff(2.5))),
    "wiggling": (
        effect("wiggling", amplitude_mm=12.0, phase_rad=0.7),
        Errors(harmonic=12.0 * HARMONIC, harmonic_phase=0.7 + np.pi),
    ),
    "tap_mismatch": (
        effect("tap_mismatch", amplitude_1_mm=5.0, phase_1_rad=np.pi, amplitude_2_mm=10.0, phase_2_rad=np.pi),
        Errors(unequal=(20.0 * HARMONIC, 5.0 * HARMONIC)),
    ),
    "saturation": (effect("saturation", full_well_amplitude=60.0), Errors(full_well=60.0)),
    "six light effects": (
        effect("vignetting", corner_factor=1.3)
        + effect("multipath", surface="board 1", share=0.1, extra_path_mm=1400.0)
        + effect("flying_pixels", probability=0.3)
        + effect("scattering", share=0.03)
        + effect("pixel_crosstalk", share=0.01)
        + effect("saturation", full_well_amplitude=132.0),
        Errors(
            falloff=falloff(1.3),
            second_path={1: (0.1, 1400.0)},
            all_at_once=0.3,
            lens=0.03,
            neighbours=0.01,
            full_well=132.0,
        ),
    ),
    "wiggling of saturated light": (
        effect("saturation", full_well_amplitude=120.0)
        + effect("wiggling", amplitude_mm=9.0, phase_rad=-1.2)
        + effect("vignetting", corner_factor=1.3),
        Errors(falloff=falloff(1.3), harmonic=9.0 * HARMONIC, harmonic_phase=-1.2 + np.pi, full_well=120.0),
    ),
}
"""Effects large enough that the comparison sees them, and the errors of the taps that they stand for."""


BY_SHARES = [pytest.mark.compiled("edges in 800 pixels, whose shares must be right to a thousandth")]
SLOW = [pytest.mark.slow]


@pytest.mark.parametrize(
    "name",
    [
        # Leaking neighbours take longest.
        pytest.param(
            name,
            marks=(BY_SHARES if name in ("flying_pixels", "six light effects") else [])
            + (SLOW if name in ("pixel_crosstalk", "six light effects") else []),
        )
        for name in CASES
    ],
)
def test_the_recording_has_the_distribution_of_the_taps(name: str) -> None:
    cam = camera()
    text, errors = CASES[name]
    apart = 3 if errors.neighbours else 1  # neighbouring rows share light; every third shares none with the next
    ours, _ = simulated(model_text(cam, BOARDS, text), frames=apart * FRAMES, seed=11)
    theirs, _ = record(cam, look_at(cam, BOARDS), apart * FRAMES, np.random.default_rng(0), errors)
    assert_same(ours[:, ::apart], theirs[:, ::apart])
    with pytest.raises(AssertionError):  # the magnitude is not within the noise of the comparison
        assert_same(ours[:, ::apart], without_errors())


@pytest.mark.parametrize(
    ("text", "errors"),
    [
        (effect("scattering", share=0.1), Errors(lens=0.1)),
        pytest.param(effect("pixel_crosstalk", share=0.05), Errors(neighbours=0.05), marks=SLOW),
        (effect("flying_pixels", probability=0.7), Errors(all_at_once=0.7)),
    ],
)
def test_empty_beam_gives_no_light(text: str, errors: Errors) -> None:
    """Without the far board: columns 1 and 2 see gaps, column 3 nothing but one.

    Where all light is taken at once, a gap beside a board leaves fewer samples without a return.
    """
    cam, boards = camera(), BOARDS[:2]
    apart = 3 if errors.neighbours else 1
    ours, _ = simulated(model_text(cam, boards, text), frames=apart * FRAMES)
    theirs, _ = record(cam, look_at(cam, boards), apart * FRAMES, np.random.default_rng(12), errors)
    assert (ours[:, :, 3] > RANGE_MAX_MM - 1000).all()
    ours[ours > RANGE_MAX_MM - 1000] = np.nan
    gaps = np.isnan(theirs).mean(axis=(0, 1))
    assert gaps[0] == 0
    assert (gaps[1:3] > 0.2 * (1 - errors.all_at_once)).all()
    np.testing.assert_allclose(np.isnan(ours).mean(axis=(0, 1)), gaps, atol=0.02)
    assert_same(ours[:, ::apart], theirs[:, ::apart])


def test_phase_wrapping_is_what_the_arctangent_does() -> None:
    """Two boards fold, one of them at the end of its turn."""
    cam = camera(frequency_hz=60.0e6)
    boards = (BOARDS[0], replace(BOARDS[1], z_mm=2 * 1249.1), BOARDS[2])
    text = effect("phase_wrapping", unambiguous_range_mm=cam.turn_mm)
    ours, _ = simulated(model_text(cam, boards, text))
    theirs, _ = record(cam, look_at(cam, boards), FRAMES, np.random.default_rng(2), Errors(), fold=True)
    assert_same(ours, np.maximum(np.rint(theirs), 1.0))


EVEN = [replace(board, reflectivity=0.4 * (board.z_mm / BOARDS[0].z_mm) ** 2) for board in BOARDS[:2]]
"""Two boards of one amplitude."""


@pytest.mark.parametrize(
    ("share", "sigma_mm"),
    [(0.4, 40.0), (0.2, 80.0)],
)
@pytest.mark.slow
def test_interference_is_a_strangers_light_in_bursts(share: float, sigma_mm: float) -> None:
    """Few rows and many frames, for all pixels share the bursts. Column 1 sees both boards."""
    cam = camera(rows=10)
    boards = (EVEN[0], replace(EVEN[1], left_mm=-3000.0, right_mm=4000.0))
    seen = look_at(cam, boards)
    strength = np.sqrt(2.0) * sigma_mm * seen.amplitude.max() * 2 * np.pi / cam.turn_mm
    text = effect("interference", probability=share, sigma_mm=sigma_mm, burst_frames=5)
    ours, _ = simulated(model_text(cam, boards, text), frames=10_000)
    theirs, _ = record(cam, seen, 10_000, np.random.default_rng(3), Errors(stranger=(share, 5.0, strength)))
    assert (seen.share[:, 0, 1] > 0.2).all()
    for col in range(COLS):
        assert p_value(ours[:, :, col], theirs[:, :, col]) > ALPHA, f"column {col}"
    np.testing.assert_allclose(memory_of_squares(ours[:, :, 0]), memory_of_squares(theirs[:, :, 0]), atol=0.02)


def memory_of_squares(samples: Floats) -> Floats:
    """Correlation of the frames' squared deviations over 1 to 12 frames: how long bursts last."""
    square = (samples - samples.mean()) ** 2
    frame = square.mean(axis=1)
    frame = frame - frame.mean()
    return np.array([np.mean(frame[k:] * frame[:-k]) / np.mean(square**2) for k in range(1, 13)])


@pytest.mark.slow
@pytest.mark.parametrize(("coefficient", "forgets"), [(0.3, 4), (0.8, 20)])
def test_temporal_correlation_is_the_charges_memory(coefficient: float, forgets: int) -> None:
    """Samples far apart have the same distribution as without it, and steps between frames that of the taps.

    One column that sees two boards 250 mm apart: the cosine of the phase between them is 0.978.
    """
    cam = replace(camera(rows=2000), cols=1, fov_horizontal_deg=PIXEL_DEG)
    boards = (replace(BOARDS[0], right_mm=1.0), replace(BOARDS[0], left_mm=-3000.0, right_mm=4000.0, z_mm=2050.0))
    seen = look_at(cam, boards)
    assert (seen.share > 0.2).all()
    frames = 50 * forgets + 3
    text = effect("temporal_correlation", coefficient=coefficient)
    ours, _ = simulated(model_text(cam, boards, text), frames=frames)
    theirs, _ = record(cam, seen, frames, np.random.default_rng(4), Errors(memory=coefficient))
    assert ours[3::forgets].size >= 100_000
    assert p_value(ours[3::forgets], theirs[3::forgets]) > ALPHA
    for lag in (1, 3):
        one, other = (samples[lag::forgets] - samples[:-lag:forgets] for samples in (ours, theirs))
        assert p_value(one, other) > ALPHA, f"steps over {lag}"
    one, other = ours[1::forgets], ours[:-1:forgets]
    strangers = np.random.default_rng(5).permuted(other, axis=1)
    assert p_value(one - strangers, one - other) < ALPHA  # the memory shows

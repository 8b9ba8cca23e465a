"""How fast a full image is estimated in memory, beside other ways to do the same.

Usage: python tests/benchmarks/kernels.py [--rounds 5] [--seed 71] [--sklearn-pixels 12]

144 x 176 pixels of 100 samples, noise of an SR-3000 at 1.2 ms; 15 % of the pixels see 2 or 3 surfaces, at least 6
sigma apart, the others one. In one run, best of `rounds`:

- tofmix: sorting, both steps, the final count by likelihood, gains and standard errors, on 1 and 2 threads;
- NumPy: the two steps of the paper as one would write them batch by batch: a binned density on a warped range axis by
  convolution, and EM in float32 for the pixels with more than one peak, 50 iterations, sigma free; no final count;
- JAX, where it is installed: the same EM, compiled for the CPU, after NumPy's first step and alone;
- scikit-learn: GaussianMixture with BIC over 1 to 4 components, on a few pixels;
- reading the samples with h5py, and nothing else.
"""

import argparse
import tempfile
import time
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
from scipy.ndimage import convolve1d
from support.costs import least_s

from tofmix.arrays import Float32Array, FloatArray, IntArray
from tofmix.compiled.jit import jit
from tofmix.compiled.vector import exp_minus
from tofmix.estimation.beam import Beam, beam_of
from tofmix.estimation.blocks.sequence import estimate_layers
from tofmix.estimation.layering import layer_pixels
from tofmix.estimation.mixture.em import Components, Scratch, expect, maximise, new_components, new_scratch, start_at
from tofmix.estimation.samples import Readings, readings_of
from tofmix.estimation.settings import MODE_PRIOR
from tofmix.recording import ArrayRecording
from tofmix.sensor import NoiseCurve, Sensor

ROWS, COLS, FRAMES = 144, 176, 100
MULTI = 0.15
APART = 6.0
NOISE = NoiseCurve(
    np.array([500.0, 1000, 2000, 3000, 5000, 7500]), np.array([3.0, 6, 13, 24, 67, 150]) * (10.0 / 1.2) ** 0.5
)
CAMERA = Sensor(name="SR-3000 at 1.2 ms", range_min_mm=650.0, range_max_mm=7500.0, noise=NOISE)
BINS_A_SIGMA = 8
MOST = 3
ITERATIONS = 50


def scene(rng: np.random.Generator) -> tuple[Float32Array, IntArray]:
    """Samples (frame, row, col) and the number of surfaces (row, col)."""
    pixels = ROWS * COLS
    count = np.where(rng.random(pixels) < MULTI, rng.integers(2, MOST + 1, pixels), 1)
    samples = np.empty((FRAMES, pixels), dtype=np.float32)
    for pixel in range(pixels):
        while True:
            mean = np.sort(rng.uniform(900.0, 5000.0, count[pixel]))
            if (np.diff(mean) > APART * NOISE.sigma(mean[1:])).all():
                break
        share = 0.1 + (1 - 0.1 * count[pixel]) * rng.dirichlet(np.ones(count[pixel]))
        seen = mean[rng.choice(count[pixel], FRAMES, p=share / share.sum())]
        drawn = seen + NOISE.sigma(seen) * rng.standard_normal(FRAMES)
        outlier = rng.random(FRAMES) < CAMERA.outlier_probability
        drawn[outlier] = rng.uniform(650.0, 7500.0, outlier.sum())
        samples[:, pixel] = np.maximum(np.rint(drawn), 1.0)
    return samples.reshape(FRAMES, ROWS, COLS), count.reshape(ROWS, COLS)


def numpy_starts(samples: Float32Array) -> tuple[Float32Array, FloatArray]:
    """Step 1 by binning: means (pixel, MOST) float32 at the highest peaks, NaN past them, and the warped axis."""
    edges = [650.0]
    while edges[-1] < 7800.0:
        edges.append(edges[-1] + float(NOISE.sigma(edges[-1])) / BINS_A_SIGMA)
    axis = np.array(edges)
    frames, pixels = samples.shape
    place = np.clip(np.searchsorted(axis, samples), 0, len(axis) - 1)
    flat = (np.arange(pixels) * len(axis) + place).ravel()
    counts = np.bincount(flat, minlength=pixels * len(axis)).reshape(pixels, len(axis)).astype(np.float32)
    reach = np.arange(-2 * BINS_A_SIGMA, 2 * BINS_A_SIGMA + 1) / (0.5 * BINS_A_SIGMA)
    density = convolve1d(counts, np.exp(-0.5 * reach**2).astype(np.float32), axis=1, mode="constant")
    peak = np.zeros_like(density, dtype=bool)
    inner = density[:, 1:-1]
    peak[:, 1:-1] = (inner > density[:, :-2]) & (inner >= density[:, 2:]) & (inner > max(0.02 * frames, 3.0) * 0.447)
    height = np.where(peak, density, 0.0)
    order = np.argpartition(-height, MOST, axis=1)[:, :MOST]
    means = np.where(np.take_along_axis(height, order, axis=1) > 0, axis[order], np.nan)
    return means.astype(np.float32), axis


def numpy_em(samples: Float32Array, means: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Batched EM in float32: samples (pixel, frame), means (pixel, K); free sigmas above a tenth of the curve's."""
    mean = means[:, :, np.newaxis].copy()
    sigma = NOISE.sigma(mean.astype(np.float64)).astype(np.float32)
    least = 0.1 * sigma
    weight = np.full_like(mean, 1.0 / mean.shape[1])
    x, floor = samples[:, np.newaxis, :], np.float32(1.5e-8 * 2.5066)
    for _ in range(ITERATIONS):
        z = (x - mean) / sigma
        term = weight / sigma * np.exp(-0.5 * z * z)
        term /= term.sum(axis=1, keepdims=True) + floor
        support = term.sum(axis=2, keepdims=True) + np.float32(1e-12)
        mean = (term * x).sum(axis=2, keepdims=True) / support
        away = x - mean
        sigma = np.maximum(np.sqrt((term * away * away).sum(axis=2, keepdims=True) / support), least)
        weight = support / samples.shape[1]
    return mean[..., 0], sigma[..., 0], weight[..., 0]


def two_steps_in_numpy(samples: Float32Array) -> None:
    """Both steps, by number of peaks."""
    block = samples.reshape(FRAMES, -1)
    means, _ = numpy_starts(block)
    found, ordered = np.isfinite(means).sum(axis=1), np.ascontiguousarray(block.T)
    for k in range(2, MOST + 1):
        chosen = found == k
        if chosen.any():
            start = np.sort(means[chosen], axis=1)[:, :k]
            numpy_em(ordered[chosen], start)


def jax_em(samples: Float32Array) -> Callable[[], None] | None:
    """The same EM compiled by JAX, on the same starts; None where JAX is not installed."""
    if find_spec("jax") is None:
        return None
    import jax  # type: ignore[import-not-found,unused-ignore]  # not among the project's packages
    import jax.numpy as jnp  # type: ignore[import-not-found,unused-ignore]

    block = samples.reshape(FRAMES, -1)
    means, _ = numpy_starts(block)
    found, ordered = np.isfinite(means).sum(axis=1), np.ascontiguousarray(block.T)

    @jax.jit  # type: ignore[misc,unused-ignore]
    def fit(x, mean, sigma):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
        x, least, weight = x[:, None, :], 0.1 * sigma, jnp.full_like(mean, 1.0 / mean.shape[1])

        def step(_, state):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
            mean, sigma, weight = state
            z = (x - mean) / sigma
            term = weight / sigma * jnp.exp(-0.5 * z * z)
            term = term / (term.sum(axis=1, keepdims=True) + 1.5e-8 * 2.5066)
            support = term.sum(axis=2, keepdims=True) + 1e-12
            mean = (term * x).sum(axis=2, keepdims=True) / support
            away = x - mean
            sigma = jnp.maximum(jnp.sqrt((term * away * away).sum(axis=2, keepdims=True) / support), least)
            return mean, sigma, support / x.shape[2]

        return jax.lax.fori_loop(0, ITERATIONS, step, (mean, sigma, weight))

    jobs = []
    for k in range(2, MOST + 1):
        start = np.sort(means[found == k], axis=1)[:, :k, np.newaxis]
        jobs.append((ordered[found == k], start, NOISE.sigma(start).astype(np.float32)))

    def run() -> None:
        for job in jobs:
            jax.block_until_ready(fit(*job))

    return run


def sklearn_seconds(samples: Float32Array, pixels: IntArray) -> float | None:
    """Seconds a pixel of GaussianMixture with BIC over 1 to 4 components; None where scikit-learn is missing."""
    if find_spec("sklearn") is None:
        return None
    from sklearn.mixture import GaussianMixture  # type: ignore[import-not-found,import-untyped,unused-ignore]

    block = samples.reshape(FRAMES, -1)
    start = time.perf_counter()
    for pixel in pixels:
        x = block[:, pixel : pixel + 1].astype(np.float64)
        min((GaussianMixture(k, random_state=0).fit(x) for k in range(1, 5)), key=lambda fit: fit.bic(x))
    return (time.perf_counter() - start) / len(pixels)


@jit
def _many_vectorised(x: FloatArray, out: FloatArray, times: int) -> None:
    for _ in range(times):
        for j in range(len(x)):
            out[j] = exp_minus(x[j])


@jit
def _many_scalar(x: FloatArray, out: FloatArray, times: int) -> None:
    for _ in range(times):
        for j in range(len(x)):
            out[j] = np.exp(-x[j])


@jit
def _many_em(data: Readings, k: int, fit: Components, beam: Beam, scratch: Scratch, times: int) -> None:
    for _ in range(times):
        expect(data, k, fit, beam, scratch)
        maximise(k, fit, beam, MODE_PRIOR)


def rates(rounds: int, rng: np.random.Generator) -> tuple[float, float, float]:
    """Exponentials a second, vectorised and scalar, and EM's component-sample terms a second, on one core."""
    x, out, times = rng.uniform(0.0, 20.0, 1000), np.empty(1000), 1000
    mean = np.array([1500.0, 2500.0, 3500.0])
    data = readings_of(mean[rng.integers(0, 3, FRAMES)] + 30.0 * rng.standard_normal(FRAMES))
    fit, scratch, beam = new_components(3), new_scratch(3, FRAMES), beam_of(CAMERA)
    start_at(mean, np.ones(3), 3, 0.0, fit, beam)
    _many_em(data, 3, fit, beam, scratch, 1)
    _many_vectorised(x, out, 1)
    _many_scalar(x, out, 1)
    seconds = least_s(
        lambda: _many_vectorised(x, out, times),
        lambda: _many_scalar(x, out, times),
        lambda: _many_em(data, 3, fit, beam, scratch, times),
        rounds=3 * rounds,
    )
    return times * 1000 / seconds[0], times * 1000 / seconds[1], times * 3 * FRAMES / seconds[2]


def reading(samples: Float32Array, folder: Path) -> Callable[[], None]:
    """Read the samples from a file as tofmix writes them."""
    path = folder / "samples.h5"
    with h5py.File(path, "w") as root:
        root.create_dataset(
            "range",
            data=samples.astype(np.uint16),
            chunks=(FRAMES, 16, 22),
            compression=1,
            shuffle=True,
            fletcher32=True,
        )

    def run() -> None:
        with h5py.File(path) as root:
            root["range"][...]

    return run


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=71)
    parser.add_argument("--sklearn-pixels", type=int, default=12)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    samples, count = scene(rng)
    recording = ArrayRecording(samples, CAMERA)
    found = estimate_layers(recording, workers=2)
    one = count == 1
    print(
        f"surfaces right: {np.mean(found.n_modes[0][one] == 1):.4f} of the pixels with one,"
        f" {np.mean((found.n_modes[0] == count)[~one]):.4f} of those with 2 or 3"
    )
    compiled = jax_em(samples)
    with tempfile.TemporaryDirectory() as folder:
        work: list[tuple[str, Callable[[], object]]] = [
            ("tofmix, 2 threads", lambda: estimate_layers(recording, workers=2)),
            ("tofmix, 1 thread", lambda: layer_pixels(samples, CAMERA)),
            ("NumPy, the two steps", lambda: two_steps_in_numpy(samples)),
            ("h5py, reading alone", reading(samples, Path(folder))),
        ]
        if compiled is not None:
            compiled()
            work.append(
                ("NumPy's first step, EM in JAX", lambda: (numpy_starts(samples.reshape(FRAMES, -1)), compiled()))
            )
            work.append(("JAX, EM alone", compiled))
        seconds = least_s(*(step for _, step in work), rounds=arguments.rounds)
    ours = seconds[0]
    print("\n| | seconds | million samples/s | in units of tofmix |\n|---|---|---|---|")
    for (name, _), took in zip(work, seconds, strict=True):
        print(f"| {name} | {took:.3f} | {samples.size / took / 1e6:.1f} | {took / ours:.2f} |")
    chosen = rng.choice(ROWS * COLS, arguments.sklearn_pixels, replace=False)
    pixel = sklearn_seconds(samples, chosen)
    if pixel is not None:
        took = pixel * ROWS * COLS
        print(
            f"| scikit-learn, from {len(chosen)} pixels | {took:.0f} | {samples.size / took / 1e6:.4f} |"
            f" {took / ours:.0f} |"
        )
    vectorised, scalar, terms = rates(arguments.rounds, rng)
    print(
        f"\nexponentials, one core: {vectorised / 1e6:.0f} million/s vectorised, {scalar / 1e6:.0f} scalar"
        f" ({vectorised / scalar:.1f} times); EM {terms / 1e6:.0f} million component-sample terms/s"
    )


if __name__ == "__main__":
    main()

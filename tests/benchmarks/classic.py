"""Classic one-dimensional data sets: the log likelihoods of `fit_gaussians` beside those of another program.

Run as ``python tests/benchmarks/classic.py FOLDER``; the folder holds ``cls_<name>.csv``, a column x, and
``cls_mclust_fits.csv`` with the columns dataset, G, model (E equal or V free variances, X one component), loglik, sd.
"""

import argparse
import csv
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.plain import fit_gaussians

FLOOR = 0.01
MARGIN = 1e-3
"""The references are rounded results of an iteration: reached means no more than this below, nat."""


class Reference(NamedTuple):
    """Another program's fit: data set, components, `equal` or `free`, log likelihood and least sigma."""

    name: str
    k: int
    variances: str
    log_likelihood: float
    least_sigma: float


def read_samples(folder: Path, name: str) -> NDArray[np.float64]:
    """Samples of one data set."""
    return np.loadtxt(folder / f"cls_{name}.csv", skiprows=1)


def read_references(folder: Path) -> Iterator[Reference]:
    """The references; one component belongs to both models."""
    found: dict[tuple[str, int, str], tuple[float, list[float]]] = {}
    with (folder / "cls_mclust_fits.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            key = (row["dataset"], int(row["G"]), row["model"])
            found.setdefault(key, (float(row["loglik"]), []))[1].append(float(row["sd"]))
    for (name, k, model), (likelihood, sigmas) in found.items():
        for variances in {"E": ["equal"], "V": ["free"]}.get(model, ["equal", "free"]):
            yield Reference(name, k, variances, likelihood, min(sigmas))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    fit_gaussians(np.arange(9.0), 2)  # compiles
    print("| data set | k | variances | tofmix, nat | reference, nat | difference | seconds | |")
    print("|---|---|---|---|---|---|---|---|")
    missed, excused, count, slowest = 0, 0, 0, 0.0
    for reference in read_references(folder):
        samples = read_samples(folder, reference.name)
        start = time.perf_counter()
        fit = fit_gaussians(samples, reference.k, variances=reference.variances, floor=FLOOR)
        seconds = time.perf_counter() - start
        difference, note = fit.log_likelihood - reference.log_likelihood, ""
        if difference < -MARGIN:
            below = reference.least_sigma < FLOOR * samples.std()
            note, excused, missed = (
                ("below the floor", excused + 1, missed) if below else ("missed", excused, missed + 1)
            )
        if not fit.converged:
            note += " not converged"
        count, slowest = count + 1, max(slowest, seconds)
        print(
            f"| {reference.name} | {reference.k} | {reference.variances} | {fit.log_likelihood:.4f}"
            f" | {reference.log_likelihood:.4f} | {difference:+.4f} | {seconds:.2f} | {note} |"
        )
    print(
        f"\n{count} fits: {missed} missed, {excused} with a reference below the floor; the slowest took {slowest:.2f} s"
    )


if __name__ == "__main__":
    main()

"""What a recording must be to hold something out of it, and how it is split."""

from dataclasses import replace

import numpy as np
import pytest

from tofmix.errors import BadInputError
from tofmix.reconciliation.evidence import make_evidence
from tofmix.simulation.model import Model


def test_samples_are_whole_millimetres_and_0_where_invalid(model: Model) -> None:
    range_mm = np.full((40, 20, 24), 1000.4)
    range_mm[3, 2, 1] = np.nan
    range_mm[4, 0, 0] = 1e6
    evidence = make_evidence(model, range_mm.astype(np.float32))
    assert evidence.samples[3, 2 * 24 + 1] == 0
    assert evidence.samples[4, 0] == 65_534
    assert (np.delete(evidence.samples.ravel(), [3 * 480 + 49, 4 * 480]) == 1000).all()
    np.testing.assert_allclose(evidence.time_s, np.arange(40) / model.recording.frame_rate_hz)


def test_fitted_and_held_out_parts_are_disjoint_and_cover_all(model: Model) -> None:
    evidence = make_evidence(model, np.full((40, 20, 24), 1000.0, np.float32))
    for split in ("frames", "pixels"):
        cells = np.zeros(evidence.shape, dtype=int)
        for fit in (True, False):
            cells[np.ix_(*evidence.part(fit=fit, split=split))] += 1
        assert (cells == 1).all(), split
    fitted, held = (evidence.part(fit=fit, split="frames,pixels") for fit in (True, False))
    assert not set(fitted[0]) & set(held[0])
    assert not set(fitted[1]) & set(held[1])


@pytest.mark.parametrize(
    ("shape", "value", "times", "reason"),
    [
        ((40, 20, 23), 1000.0, None, "the model's camera has 20 x 24; give .sensor. of the model rows = 20, cols = 23"),
        ((3, 20, 24), 1000.0, None, "3 frames; at least"),
        ((40, 20, 24), np.nan, None, "no sample is valid"),
        ((40, 20, 24), 1000.0, np.zeros(40), "do not ascend"),
        ((40, 20, 24), 1000.0, np.r_[0:39, np.nan], "do not ascend"),
        ((40, 20, 24), 1000.0, np.r_[0:20, 5, 21:40], "frame 20 has 5 s; tofmix import puts frames in order"),
        ((7, 20, 24), 1000.0, None, "record 1 more"),
        ((40, 2, 20, 24), 1000.0, None, "--target nearest"),
    ],
)
def test_recording_too_small_for_held_out_data_is_refused_with_the_reason(
    model: Model, shape: tuple[int, ...], value: float, times: np.ndarray | None, reason: str
) -> None:
    with pytest.raises(BadInputError, match=reason):
        make_evidence(replace(model), np.full(shape, value, np.float32), time_s=times)


def test_frames_of_one_time_lie_between_it_and_the_next(model: Model) -> None:
    times = np.array([0.0, 0.1, 0.1, 0.3, 0.4, 0.5, 0.6, 0.7, 0.7])
    ranges = np.random.default_rng(1).normal(1000, 9, (9, 20, 24)).astype(np.float32)
    found = make_evidence(model, ranges, time_s=times).time_s
    np.testing.assert_allclose(found, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.75])


@pytest.mark.parametrize("frames", [8, 9, 12, 19])
def test_half_of_the_frames_are_held_out_of_short_recordings(model: Model, frames: int) -> None:
    ranges = np.random.default_rng(1).normal(1000, 9, (frames, 20, 24)).astype(np.float32)
    fitted = make_evidence(model, ranges).fit_frames
    assert abs(fitted.sum() - frames / 2) < 2
    assert np.abs(np.diff(fitted.astype(int))).sum() >= 3, "at least four blocks"

"""What is computed is what a filter of these models expects."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from imm_tdoa.bench import jobs


def test_the_innovations_are_as_large_as_the_models_say():
    """A third of the targets each stand, move steadily, accelerate: all in the bank."""
    job = jobs.job(300, 30)
    track = job.run(engine="numpy")
    late = track.nis[:, 5:]
    # the mixture's innovations are a little smaller than its covariance, never larger
    mean, spread = np.mean(late), np.sqrt(2.0 * 3.0 / late.size)
    assert 2.0 < mean < 3.0 + 4.0 * spread
    assert np.mean(late > chi2.ppf(0.999, 3)) < 0.004


def test_fewer_targets_and_scans_are_the_first_ones():
    job = jobs.job(5, 8)
    part = job.first(2, 3)
    assert_array_equal(part.values, job.values[:2, :3])
    assert_array_equal(part.times, job.times[:3])
    assert (job.steps, part.steps) == (40, 6)


def test_large_batches_are_drawn_in_pieces_that_differ(monkeypatch):
    monkeypatch.setattr(jobs, "PIECE", 4)
    values = jobs.job(10, 3).values
    assert np.isfinite(values).all()
    assert len({tuple(v) for v in values.reshape(10, -1)}) == 10


def test_the_same_seed_gives_the_same():
    assert_array_equal(jobs.job(4, 5, seed=3).values, jobs.job(4, 5, seed=3).values)
    assert not np.array_equal(jobs.job(4, 5, seed=3).values, jobs.job(4, 5, seed=4).values)


@pytest.mark.parametrize("dims", [2, 3])
def test_the_ring_has_its_reference_in_the_middle(dims):
    places = jobs.ring(6, dims).positions
    assert places.shape == (6, dims)
    assert_array_equal(places[0], 0.0)
    assert_allclose(np.linalg.norm(places[1:, :2], axis=-1), jobs.RADIUS)


def test_one_pair_at_a_time_follows_the_target():
    job = jobs.one_pair_at_a_time(400)
    assert job.values.shape == (1, 400, 1)
    assert (job.pairs[..., 0] != job.pairs[..., 1]).all()
    assert len(np.unique(job.pairs)) == 8
    assert (np.diff(job.times) > 0.0).all()
    assert len(np.unique(np.round(np.diff(job.times), 6))) > 10
    track = job.run(engine="numpy")
    assert 0.7 < np.mean(track.nis) < 1.3

"""The other libraries compute the same, so that the comparison is of the same work."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM
from imm_tdoa.bench import jobs, peers


@pytest.mark.parametrize("member", peers.MEMBERS)
@pytest.mark.parametrize("modes", [2, 3, 6])
def test_filterpy_embedded_in_equal_dimensions_agrees(member, modes):
    job = jobs.job(3, 25, modes=modes)
    assert peers.disagreement(job, 3, member, engine="numpy") < 1e-8


@pytest.mark.parametrize(
    "change",
    [{"mean_sojourn": 20.0}, {"birth_std": {"velocity": 40.0, "acceleration": 2.0}}],
)
def test_another_bank_is_noticed(change):
    job = jobs.job(2, 25)
    bank = attrs.evolve(job.imm.bank, **change)
    imm = IMM(bank, job.imm.measurement)
    track = attrs.evolve(job, imm=imm, start=jobs.start(imm)).run(engine="numpy")
    theirs = peers.filterpy_imm(job, peers.Extended)
    for z in peers.columns(job, 0):
        theirs.predict(0)
        theirs.update(z)
    assert np.max(np.abs(track.mode_probability[0, -1] - theirs.mu)) > 1e-4


def test_range_differences_as_a_user_writes_them():
    job = jobs.job(1, 2, stations=5)
    seen = peers.Differences(job.imm.measurement.stations.positions, 6)
    p = np.array([3e3, -7e3])
    seen.look(np.concatenate([p, np.zeros(4)])[:, None])
    tdoa = job.imm.measurement
    assert_allclose(seen.h[:, 0], tdoa.predict(p, 0 * p, 0.0), rtol=1e-12)
    assert_allclose(seen.H[:, :2], tdoa.jacobian(p, 0 * p, 0.0)[0], rtol=1e-12, atol=1e-15)
    assert_array_equal(seen.H[:, 2:], 0.0)


def test_fastest_is_one_of_them():
    assert peers.fastest(jobs.job(1, 5)) in peers.MEMBERS


def test_stone_soup_agrees():
    pytest.importorskip("stonesoup", reason="Stone Soup is not installed (extra 'bench')")
    job = jobs.job(3, 20, modes=1)
    track = job.run(engine="numpy", keep="final")
    means = peers.StoneSoup(job, jobs.MODES[1][1]["psd"]).follow(3)
    std = np.sqrt(np.diagonal(track.covariance[:, -1], axis1=-2, axis2=-1))
    assert np.max(np.abs(track.mean[:, -1] - means) / std) < 1e-8

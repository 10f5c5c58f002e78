"""Where a track starts when nobody says where."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import IMM, Bank, Stations, initiation
from imm_tdoa.locate import gauss_newton
from imm_tdoa.locate.fix import Fix
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Position,
    Static,
)
from imm_tdoa.scans import Scans

C = 299_792_458.0
SIGMA = 10e-9
CORNERS = np.array([[0.0, 0.0], [2e3, 0.0], [0.0, 2e3], [2.1e3, 2.2e3], [900.0, -800.0]])
STATIONS = Stations(CORNERS)
BIRTH = {"velocity": 30.0, "acceleration": 3.0}


def bank():
    return Bank(
        [Static(psd=0.5), ConstantVelocity(psd=2.0), ConstantAcceleration(psd=0.3)],
        birth_std=BIRTH,
    )


def imm_2d(stations=STATIONS, sigma=SIGMA):
    return IMM(bank(), TDOA(stations, toa_sigma=sigma))


def recording(seed, T, p=(700.0, 900.0), v=(12.0, -9.0), stations=CORNERS, sigma=SIGMA, dt=1.0):
    """Times, path (T, 2) and noisy arrival times (T, S)."""
    rng = np.random.default_rng(seed)
    t = 100.0 + dt * np.arange(T)
    path = np.array(p) + np.array(v) * (t - 100.0)[:, None]
    clean = np.linalg.norm(path[:, None] - stations, axis=-1) / C
    return t, path, clean + sigma * rng.normal(size=clean.shape)


def against_first(toa):
    return toa[..., 1:] - toa[..., :1]


def least_squares(toa, p, sigma=SIGMA):
    """Reference-free Gauss-Newton from the truth: position and covariance (§3.1, §1.1)."""
    p = np.array(p, dtype=float)
    heard = np.isfinite(toa)
    for _ in range(50):
        d = p - CORNERS[heard]
        r = np.linalg.norm(d, axis=1)
        U = d / r[:, None]
        U = U - U.mean(axis=0)
        nu = C * toa[heard] - r
        A = U.T @ U
        p = p + np.linalg.solve(A, U.T @ (nu - nu.mean()))
    return p, (C * sigma) ** 2 * np.linalg.inv(A)


def test_a_complete_first_scan_is_row_0():
    t, path, toa = recording(0, 8)
    track = imm_2d().run(t, against_first(toa))
    p, P = least_squares(toa[0], path[0])
    assert_array_equal(track.times, t)
    assert_allclose(track.position[0], p, atol=1e-5)
    assert_allclose(track.position_covariance[0], P, rtol=1e-5)
    assert_array_equal(track.mode_probability[0], [1 / 3] * 3)
    assert_array_equal(track.velocity[0], [0.0, 0.0])
    assert track.log_likelihood[0] == 0.0
    assert np.isnan(track.nis[0])
    assert track.nis_dof[0] == 0
    for P, name in zip(track.mode_covariances[1:], ("cv", "ca"), strict=True):
        assert_allclose(P[0][2:4, 2:4], 900.0 * np.eye(2), rtol=1e-6, err_msg=name)


def test_the_first_scan_is_not_used_twice():
    """T30: row 1 is the fix, predicted, and scan 1 alone; its likelihood is scan 1's."""
    t, path, toa = recording(1, 6)
    imm = imm_2d()
    track = imm.run(t, against_first(toa))
    p, P = least_squares(toa[0], path[0])
    by_hand = imm.run(t[1:], against_first(toa)[1:], start=imm.start(t[0], p, P))
    assert_allclose(track.mean[1:], by_hand.mean, rtol=1e-6, atol=1e-4)
    assert_allclose(track.covariance[1:], by_hand.covariance, rtol=1e-5, atol=1e-4)
    assert_allclose(track.log_likelihood[1:], by_hand.log_likelihood, rtol=1e-6)
    assert_allclose(track.log_likelihood[1], by_hand.log_likelihood[0], rtol=1e-6)
    twice = imm.run(t, against_first(toa), start=imm.start(t[0], p, P))
    assert np.abs(twice.covariance[0, 0, 0] / track.covariance[0, 0, 0] - 0.5) < 0.1


@pytest.mark.parametrize("form", ["station 3", "arrivals"])
def test_the_reference_station_does_not_matter(form):
    t, _, toa = recording(2, 8)
    toa[0, 1] = np.nan
    first = imm_2d().run(t, against_first(toa))
    if form == "arrivals":
        other = IMM(bank(), TOA(STATIONS, sigma=SIGMA)).run(t, toa + np.arange(8.0)[:, None])
    else:
        pairs = np.array([[i, 3] for i in (0, 1, 2, 4)])
        values = toa[:, pairs[:, 0]] - toa[:, pairs[:, 1]]
        other = IMM(bank(), TDOA(STATIONS, toa_sigma=SIGMA, pairs=pairs)).run(t, values)
    assert_array_equal(other.times, first.times)
    assert_allclose(other.mean, first.mean, rtol=1e-6, atol=1e-4)
    assert_allclose(other.log_likelihood, first.log_likelihood, rtol=1e-6, atol=1e-6)


def test_a_fixed_position_is_its_own_fix():
    imm = IMM(Bank([Static(psd=1.0)]), Position([2.0, 3.0]))
    track = imm.run([0.0, 1.0], [[5.0, 6.0], [5.5, 6.5]])
    assert_allclose(track.position[0], [5.0, 6.0], atol=1e-5)
    assert_allclose(track.covariance[0], np.diag([4.0, 9.0]), rtol=1e-9)
    start = imm.start(0.0, [5.0, 6.0], np.diag([4.0, 9.0]))
    assert_allclose(track.mean[1], imm.step(start, 1.0, [5.5, 6.5]).mean, rtol=1e-6)


def test_one_pair_at_a_time_is_gathered():
    """Single differences of changing pairs: the start waits until they determine a position."""
    t, path, toa = recording(3, 50, dt=0.5)
    rng = np.random.default_rng(0)
    pairs = np.stack([rng.permutation(5)[:2] for _ in t])[:, None, :]
    z = np.take_along_axis(toa, pairs[:, 0, :1], 1) - np.take_along_axis(toa, pairs[:, 0, 1:], 1)
    track = imm_2d().run(t, z, pairs=pairs)
    used = len(t) - len(track.times) + 1
    assert 3 <= used <= 15
    assert_array_equal(track.times, t[used - 1 :])
    assert track.log_likelihood[0] == 0.0
    error = track.position[0] - path[used - 1]
    P = track.position_covariance[0]
    assert error @ np.linalg.solve(P, error) < 20.0
    late = np.linalg.norm(track.position - path[used - 1 :], axis=1)[-10:]
    assert np.median(late) < 10.0


def test_empty_scans_are_passed_over():
    t, _, toa = recording(4, 8)
    toa[:3] = np.nan
    track = imm_2d().run(t, against_first(toa))
    alone = imm_2d().run(t[3:], against_first(toa[3:]))
    assert_array_equal(track.times, t[3:])
    assert_allclose(track.mean, alone.mean, rtol=1e-9, atol=1e-9)


def test_an_empty_scan_after_the_start_is_a_prediction():
    t, _, toa = recording(4, 4)
    toa[1] = np.nan
    track = imm_2d().run(t, against_first(toa))
    assert track.log_likelihood[1] == 0.0
    assert np.isnan(track.nis[1])
    assert track.covariance[1, 0, 0] > track.covariance[0, 0, 0]


def test_a_scan_that_contradicts_itself_is_waited_on():
    t, path, toa = recording(5, 8)
    toa[0, 2] += 2e-6
    track = imm_2d().run(t, against_first(toa))
    assert_array_equal(track.times, t[1:])
    p, _ = least_squares(toa[1], path[1])
    assert np.linalg.norm(track.position[0] - p) < 10.0
    assert np.linalg.norm(track.position[-1] - path[-1]) < 10.0


def a_fix(position, covariance):
    return Fix(
        position=np.array(position, float),
        velocity=None,
        covariance=np.array(covariance, float),
        converged=np.array(True),
        iterations=np.array(3),
        chi2=np.array(1.0),
        dof=np.array(2),
    )


FORMS = {
    "station 0": TDOA(STATIONS, toa_sigma=SIGMA),
    "station 3": TDOA(STATIONS, toa_sigma=SIGMA, pairs=[[i, 3] for i in (0, 1, 2, 4)]),
    "all pairs": TDOA(
        STATIONS, toa_sigma=SIGMA, pairs=[[i, j] for i in range(5) for j in range(5) if i != j]
    ),
    "arrivals": TOA(STATIONS, sigma=SIGMA),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("spread", [10.0, 60.0, 200.0])
def test_bending_is_the_curvature_over_the_fix(form, spread):
    """Half the second derivative along the axes of the ellipse, reference-free, in sigmas."""
    p, P = np.array([700.0, 900.0]), spread**2 * np.array([[1.0, 0.3], [0.3, 0.2]])
    t, _, toa = recording(0, 3)
    toa[-1, 1] = np.nan
    measurement = FORMS[form]
    values = toa
    if isinstance(measurement, TDOA):
        values = toa[:, measurement.pairs[:, 0]] - toa[:, measurement.pairs[:, 1]]
    scans = Scans.checked(measurement, t, values)
    heard = CORNERS[[0, 2, 3, 4]]
    worst = 0.0
    for variance, axis in zip(*np.linalg.eigh(P), strict=True):
        step = np.sqrt(variance) * axis
        ranges = [np.linalg.norm(p + k * step - heard, axis=1) for k in (-1, 0, 1)]
        bend = 0.5 * (ranges[0] + ranges[2]) - ranges[1]
        worst = max(worst, np.linalg.norm(bend - bend.mean()) / (C * SIGMA))
    assert_allclose(initiation._bending(scans, a_fix(p, P)), worst, rtol=1e-6)
    usable = initiation._usable(scans, a_fix(p, P), spare=0)
    assert usable == (worst <= initiation.BENDING)


def test_a_fix_is_no_start_where_it_is_unknown_contradicted_or_rivalled():
    t, _, toa = recording(0, 3)
    scans = Scans.checked(FORMS["station 0"], t, against_first(toa))
    good = a_fix([700.0, 900.0], 25.0 * np.eye(2))
    assert initiation._usable(scans, good, spare=1)
    for change in (
        {"converged": np.array(False)},
        {"covariance": np.full((2, 2), np.nan)},
        {"chi2": np.array(50.0)},
        {"mirror": np.array([0.0, 0.0])},
        {"dof": np.array(0), "chi2": np.array(0.0)},
    ):
        assert not initiation._usable(scans, attrs.evolve(good, **change), spare=1), change


THREE = CORNERS[:3]
BEHIND = (-800.0, -150.0)  # two hyperbolas cross twice there


def test_an_ambiguous_scan_is_waited_on():
    """Two places explain three stations behind one of them; a fourth station decides."""
    t, path, toa = recording(6, 6, p=BEHIND, v=(0.0, 0.0))
    few = toa.copy()
    few[:2, 3:] = np.nan
    fix = gauss_newton(STATIONS, against_first(few)[0], toa_sigma=SIGMA)
    assert fix.mirror is not None
    track = imm_2d().run(t, against_first(few))
    assert_array_equal(track.times, t[2:])
    assert np.linalg.norm(track.position[0] - path[2]) < 50.0


def test_a_place_that_stays_ambiguous_starts_no_track():
    line = np.array([[0.0, 0.0], [1e3, 0.0], [2e3, 0.0], [3e3, 0.0]])
    t, _, toa = recording(7, 4, stations=line)
    with pytest.raises(ValueError, match=r"values: no run of up to .*two places explain"):
        imm_2d(Stations(line)).run(t, against_first(toa))


@pytest.mark.parametrize("T", [1, 6, 30])
def test_two_stations_start_no_track(T):
    """One hyperbola at a time, and the mirror image across the baseline always fits as well."""
    t, _, toa = recording(8, T, stations=CORNERS[:2])
    with pytest.raises(ValueError, match="determine"):
        imm_2d(Stations(CORNERS[:2])).run(t, against_first(toa))


def test_no_data_at_all_starts_no_track():
    with pytest.raises(ValueError, match=r"values: no run .* determines a position"):
        imm_2d().run(np.arange(3.0), np.full((3, 4), np.nan))
    with pytest.raises(ValueError, match=r"give start=IMM.start\(time, mean, covariance\)"):
        imm_2d().run([0.0], np.full((1, 4), np.nan))


def test_targets_of_a_batch_start_when_they_can():
    t, path, toa = recording(9, 10)
    toa = np.stack([toa] * 4)
    toa[1, :3] = np.nan  # nothing heard for three scans
    toa[2, 0, 2] += 2e-6  # contradicts itself
    toa[3, 0, 3:] = np.nan  # three stations are enough here
    track = imm_2d().run(t, against_first(toa))
    assert track.mean.shape == (4, 10, 6)
    began = [np.flatnonzero(np.isfinite(track.mean[b, :, 0]))[0] for b in range(4)]
    assert began[:3] == [0, 3, 1]
    for b, k in enumerate(began):
        for name in ("mean", "covariance", "mode_probability", "log_likelihood", "nis"):
            assert np.isnan(getattr(track, name)[b, :k]).all()
        for j in range(3):
            assert np.isnan(track.mode_means[j][b, :k]).all()
            assert np.isnan(track.mode_covariances[j][b, :k]).all()
        assert_array_equal(track.nis_dof[b, : k + 1], 0)
        assert track.log_likelihood[b, k] == 0.0
        assert np.isfinite(track.mean[b, k:]).all()
    for b in range(4):
        one = imm_2d().run(t, against_first(toa[b]))
        assert len(one.times) == 10 - began[b]
        assert_allclose(track.mean[b, began[b] :], one.mean, rtol=1e-9, atol=1e-9)
    assert np.linalg.norm(track.position[:, -1] - path[-1], axis=-1).max() < 10.0


def test_a_batch_whose_earliest_target_starts_late_begins_there():
    t, _, toa = recording(10, 6)
    toa = np.stack([toa, toa])
    toa[0, :2] = np.nan
    toa[1, :3] = np.nan
    track = imm_2d().run(t, against_first(toa))
    assert_array_equal(track.times, t[2:])
    assert track.mean.shape == (2, 4, 6)
    assert_array_equal(np.isnan(track.mean[:, 0, 0]), [False, True])


def test_a_bank_without_velocity_starts_from_positions_alone():
    t, path, toa = recording(11, 5, v=(0.0, 0.0))
    imm = IMM(Bank([Static(psd=0.0)]), TDOA(STATIONS, toa_sigma=SIGMA))
    track = imm.run(t, against_first(toa))
    assert track.components == ("x", "y")
    _, P = least_squares(toa[0], path[0])
    assert_allclose(track.covariance[0], P, rtol=1e-5)
    assert_allclose(track.covariance[-1], P / 5.0, rtol=0.05)


def test_targets_with_times_and_pairs_of_their_own_start_by_themselves():
    rng = np.random.default_rng(12)
    B, T = 4, 12
    t = np.cumsum(rng.uniform(0.2, 1.5, (B, T)), axis=1)
    path = np.array([700.0, 900.0]) + np.array([12.0, -9.0]) * t[..., None]
    toa = np.linalg.norm(path[:, :, None] - CORNERS, axis=-1) / C
    toa += SIGMA * rng.normal(size=toa.shape)
    order = rng.permuted(np.tile(np.arange(5), (B, T, 1)), axis=-1)
    pairs = np.stack([order[..., [0, 1]], order[..., [2, 3]]], axis=-2)
    z = np.take_along_axis(toa, pairs[..., 0], -1) - np.take_along_axis(toa, pairs[..., 1], -1)
    z[0, :2] = np.nan
    batch = imm_2d().run(t, z, pairs=pairs)
    for b in range(B):
        one = imm_2d().run(t[b], z[b], pairs=pairs[b])
        rows = slice(batch.mean.shape[1] - len(one.times), None)
        assert_array_equal(batch.times[b, rows], one.times)
        assert np.isnan(batch.mean[b, : rows.start]).all()
        assert_allclose(batch.mean[b, rows], one.mean, rtol=1e-9, atol=1e-9)
        assert_allclose(batch.log_likelihood[b, rows], one.log_likelihood, rtol=1e-9)


@pytest.mark.parametrize("height", [1500.0, -1500.0])
def test_receivers_on_the_ground_start_above_it(height):
    """In their plane's mirror an emitter above looks like one below; they fly, so it is above."""
    rng = np.random.default_rng(13)
    ground = Stations(np.column_stack([CORNERS, np.zeros(5)]))
    imm = IMM(bank(), TDOA(ground, toa_sigma=1e-9))
    p = np.array([700.0, 900.0, height])
    toa = np.linalg.norm(p - ground.positions, axis=1) / C + 1e-9 * rng.normal(size=(4, 5))
    track = imm.run(np.arange(4.0), against_first(toa))
    assert len(track.times) == 4
    assert_allclose(track.position[-1], [700.0, 900.0, 1500.0], atol=10.0)
    both = imm.run(np.arange(4.0), against_first(np.stack([toa, toa])))
    assert_allclose(both.position[1], track.position, atol=1e-6)

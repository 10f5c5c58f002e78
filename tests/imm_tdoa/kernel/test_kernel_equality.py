"""The compiled engine against NumPy: the same numbers, whatever the bank and the scans."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from kernel_cases import (
    SPEED,
    Case,
    assert_alike,
    assert_engines_agree,
    cases,
    station_array,
)
from numpy.testing import assert_allclose

from imm_tdoa import IMM, Bank
from imm_tdoa.kernel import sharing
from imm_tdoa.kernel.machine import machine
from imm_tdoa.models import (
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Height,
    Position,
    RangeRate,
    Stack,
    Static,
)

TRIED = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
BANK = Bank(
    [Static(psd=1.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)], mean_sojourn=20.0
)


def made_up(measurement, targets, T=8, seed=0, spread=4e3):
    """Times (T,) and values (targets, T, m) of emitters on straight courses, and their starts."""
    rng = np.random.default_rng(seed)
    d = measurement.dims
    times = np.arange(1.0, T + 1.0)
    velocity = np.broadcast_to(rng.uniform(-40.0, 40.0, (targets, 1, d)), (targets, T, d))
    place = rng.uniform(-spread, spread, (targets, 1, d)) + velocity * times[:, None]
    clean = measurement.predict(place, velocity, times)
    R = measurement.noise_covariance(place, velocity, times)
    noise = np.sqrt(np.einsum("...ii->...i", R)) * rng.normal(size=clean.shape)
    return times, (clean + noise) / measurement.scale, place[:, 0] - velocity[:, 0]


def tdoa(moving=False, dims=2, **more):
    stations = station_array(dims, np.random.default_rng(1), count=5, moving=moving)
    return TDOA(stations, toa_sigma=3.0 / SPEED, **more)


# --- whatever the bank, the measurement and the scans --------------------------------------------


@TRIED
@given(cases())
def test_the_engines_agree(case):
    assert_engines_agree(case)


@pytest.mark.parametrize("engine", ["numpy", "compiled"])
def test_the_golden_case(engine):
    """ALGORITHMS §14.1, computed by two independent programs."""
    bank = Bank(
        [ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)],
        transition=[[0.95, 0.05], [0.1, 0.9]],
        prior=[0.8, 0.2],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    start = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    values = np.array([0.5, 1.1, 1.8, 2.4])[:, None]
    track = imm.run(np.arange(1.0, 5.0), values, start=start, engine=engine)
    assert track.engine == engine
    mu = [0.7866390984, 0.8282530223, 0.8500452005, 0.8714552665]
    log_l = [-2.18038616, -3.79944816, -5.40309315, -6.90420894]
    assert_allclose(track.mode_probability[:, 0], mu, atol=1e-10)
    assert_allclose(track.log_likelihood, log_l, atol=1e-8)


def test_a_chance_that_is_nearly_none():
    """One over it is infinite in doubles."""
    bank = Bank(BANK.models[:2], transition=[[1.0, 1e-310], [0.5, 0.5]], prior=[1.0, 0.0])
    times, values, at = made_up(tdoa(), 2)
    imm = IMM(bank, tdoa())
    assert_engines_agree(Case(imm, times, values, imm.start(0.0, at, 900.0 * np.eye(2))))


@pytest.mark.parametrize("exponent", [6, 9, 12])
def test_a_start_that_knows_next_to_nothing(exponent):
    """P up to 1e12 times R; such a start is given to a filter by people who have none.

    S = H P H' + R of more rows than unknowns has directions in which only R is left, got by
    subtracting numbers of the size of P: what remains of R is known to eps P / R, and so is what
    these rows say. The states are then pulled to where the scan says, to the same share of their
    own deviation.
    """
    measurement = tdoa()
    times, values, at = made_up(measurement, 12, T=5)
    imm = IMM(BANK, measurement)
    start = imm.start(0.0, at, 9.0 * 10.0**exponent * np.eye(2))
    rounding = 16.0 * np.finfo(float).eps * 10.0**exponent
    assert_engines_agree(Case(imm, times, values, start), max(1e-9, rounding))


# --- what runs are given -------------------------------------------------------------------------


def many(moving=False):
    """Twelve targets with gaps, rows missing; and their IMM."""
    measurement = tdoa(moving)
    times, values, at = made_up(measurement, 12)
    values[np.random.default_rng(3).random(values.shape) < 0.2] = np.nan
    imm = IMM(BANK, measurement)
    return Case(imm, times, values, imm.start(0.0, at, 900.0 * np.eye(2)))


def around(case, *batch):
    """Starts about where the first of the targets is."""
    at = case.start.means[0][0] + np.random.default_rng(4).normal(0.0, 20.0, (12, 2))
    return case.imm.start(0.0, at.reshape(*(batch or (12,)), 2), 900.0 * np.eye(2))


@pytest.mark.parametrize("keep", ["all", "final", "every 1", "every 3", "every 50"])
@pytest.mark.parametrize("threads", [None, 2])
def test_what_is_kept(keep, threads):
    case = many()
    want = assert_engines_agree(case, keep=keep, threads=threads)
    whole = case.run("numpy")
    rows = {"all": range(8), "final": [7], "every 1": range(8), "every 3": [0, 3, 6, 7]}
    kept = list(rows.get(keep, [0, 7]))
    assert_alike(want, attrs.evolve(whole, **{
        name: getattr(whole, name)[:, kept]
        for name in ("log_likelihood", "log_mode_probability", "nis", "nis_dof", "row_weight",
                     "mode_log_likelihood", "mode_nis", "lost", "reopened")
    } | {
        "times": whole.times[kept],
        "mode_means": tuple(x[:, kept] for x in whole.mode_means),
        "mode_covariances": tuple(P[:, kept] for P in whole.mode_covariances),
    }))  # fmt: skip


@pytest.mark.parametrize("targets", [1, 2, 3, 8, 9, 16, 17, 40])
def test_any_number_of_targets_in_any_number_of_threads(targets):
    """Blocks that are full and not; a target's numbers do not depend on its company."""
    measurement = tdoa()
    times, values, at = made_up(measurement, targets, T=3)
    imm = IMM(BANK, measurement)
    case = Case(imm, times, values, imm.start(0.0, at, 900.0 * np.eye(2)))
    want = assert_engines_agree(case)
    one = case.run("compiled", threads=1)
    three = case.run("compiled", threads=3)
    np.testing.assert_array_equal(three.mode_means[2], one.mode_means[2])
    assert_alike(three, want)


def test_targets_begin_when_they_have_a_fix():
    """start=None: each target from its own first complete scan, NaN before it."""
    case = many()
    values = np.array(case.values)
    for target in range(6):
        values[target, :target] = np.nan
    values[7, 0] = np.nan
    want = assert_engines_agree(case._replace(values=values, start=None))
    assert np.isnan(want.mean[3, 0]).all()
    assert np.isfinite(want.mean[3, -1]).all()
    for keep in ("final", "every 2"):
        assert_engines_agree(case._replace(values=values, start=None), keep=keep)


def test_one_target_begins_with_its_fix():
    case = many()
    assert_engines_agree(case._replace(values=case.values[0], start=None))


def test_the_whole_track_is_the_fix():
    case = many()
    assert_engines_agree(case._replace(times=[1.0], values=made_up(tdoa(), 3, T=1)[1], start=None))


def test_times_of_each_target_its_own():
    case = many(moving=True)
    own = case.times + np.linspace(0.0, 1.0, 12)[:, None]
    assert_engines_agree(case._replace(times=own))
    assert_engines_agree(case._replace(times=own, values=case.values[0], start=around(case)))


def test_starts_at_times_of_their_own():
    case = many()
    start = case.imm.start(np.linspace(-1.0, 1.0, 12), case.start.means[0], 900.0 * np.eye(2))
    assert_engines_agree(case._replace(start=start))


@pytest.mark.parametrize("moving", [False, True])
def test_pairs_that_change(moving):
    """One pair at a time, by scan and by target; and triples that close a loop."""
    measurement = tdoa(moving)
    every = np.array([[i, j] for i in range(5) for j in range(i)])
    rng = np.random.default_rng(5)
    for rows in (1, 3):
        own = tdoa(moving, pairs=every[:rows])
        imm = IMM(BANK, own)
        for shape in ((20,), (12, 20)):
            picks = np.array([rng.permutation(10)[:rows] for _ in range(int(np.prod(shape)))])
            pairs = every[picks].reshape(*shape, rows, 2)
            times, _, at = made_up(measurement, 12, T=20)
            place = at[:, None] + np.zeros((20, 1))
            z = own.with_pairs(pairs).predict(place, place * 0.0, times) / SPEED
            z[rng.random(z.shape) < 0.1] = np.nan
            start = imm.start(0.0, at, 900.0 * np.eye(2))
            assert_engines_agree(Case(imm, times, z, start, pairs))
            other = IMM(BANK, measurement)  # of four rows itself
            assert_engines_agree(Case(other, times, z, start, pairs))


def test_targets_share_what_is_the_same_for_all():
    """Values or starts of one target for many; all axes of a batch."""
    case = many()
    first = np.array(case.values[0])
    noise = np.random.default_rng(6).normal(0.0, 3.0 / SPEED, (12, 8, 4))
    one = case.imm.start(0.0, case.start.means[0][0], 900.0 * np.eye(2))
    assert_engines_agree(case._replace(start=one, values=first + noise))
    assert_engines_agree(case._replace(start=one, values=(first + noise)[:1]))
    assert_engines_agree(case._replace(start=around(case), values=first))
    grid = around(case, 3, 4)
    assert_engines_agree(case._replace(values=(first + noise)[:4], start=grid))
    assert_engines_agree(case._replace(values=(first + noise).reshape(3, 4, 8, 4), start=grid))
    row = case.imm.start(0.0, around(case).means[0].reshape(12, 2)[:3, None], 900.0 * np.eye(2))
    assert_engines_agree(case._replace(values=(first + noise)[:4], start=row))


def test_no_sigma_is_needed_where_nothing_is_measured():
    """A scan without rows, say to predict: sampled standard deviations need not know its time."""
    stations = station_array(2, np.random.default_rng(1), count=4, moving=False)
    sampled = TDOA(stations, toa_sigma=np.full((3, 4), 3.0 / SPEED), sigma_times=[1.0, 2.0, 4.0])
    values = np.zeros((12, 4, 3))
    values[:, 2] = np.nan
    for robust in (None, "gate"):
        imm = IMM(BANK, sampled, robust=robust)
        start = imm.start(0.0, np.zeros((12, 2)), 900.0 * np.eye(2))
        assert_engines_agree(Case(imm, [1.0, 2.0, 3.0, 4.0], values, start))


# --- no input has the kernel compiled anew -------------------------------------------------------


def test_no_kind_of_array_has_the_kernel_compiled_anew():
    case = many()
    known = len(machine._run.signatures)
    values = np.array(case.values)
    layouts = (
        values.tolist(),
        np.asfortranarray(values),
        np.repeat(values, 2, axis=0)[::2],
        values.astype(">f8"),
        np.where(np.isnan(values), 0.0, values).astype(bool),
        np.where(np.isnan(values), 0.0, values * 1e9).astype(np.int32),
        values[0],
    )
    for given_values in layouts:
        case._replace(values=given_values).run("compiled")
    pairs = np.broadcast_to(case.imm.measurement.pairs, (8, 4, 2))
    for given_pairs in (pairs, pairs.astype("u1"), pairs.tolist(), np.asfortranarray(pairs)):
        case._replace(pairs=given_pairs).run("compiled")
    own = np.broadcast_to(case.times, (12, 8))
    for times in (case.times.astype(int), case.times.tolist(), own):
        case._replace(times=times).run("compiled", keep="final")
    stations = case.imm.measurement.stations
    others = (
        Position(10.0),
        Position([10.0, 20.0]),
        TOA(stations, sigma=np.full(5, 1e-8)),
        Stack(RangeRate(stations, sigma=1.0), Position(10.0)),
    )
    for measurement in others:
        imm = IMM(Bank([Static(psd=0.0)]), measurement)
        start = imm.start(0.0, np.zeros((12, 2)), np.eye(2))
        imm.run([1.0], np.full((12, 1, measurement.size), np.nan), start=start, engine="compiled")
        imm = IMM(imm.bank, measurement, robust="student-t")
        imm.run([1.0], np.zeros((12, 1, measurement.size)), start=start, engine="compiled")
    high = IMM(Bank([Static(psd=0.0)]), Height(10.0))
    start = high.start(0.0, np.zeros((12, 3)), np.eye(3))
    high.run([1.0], np.zeros((12, 1, 1)), start=start, engine="compiled")
    assert len(machine._run.signatures) == known


# --- errors --------------------------------------------------------------------------------------


def test_a_scan_that_no_mode_explains():
    case = many()
    values = np.array(case.values)
    values[4, 5, 1] = 1e200
    with pytest.raises(ValueError, match="at time 6 s no mode can explain"):
        case._replace(values=values).run("compiled")
    assert_engines_agree(case._replace(values=values))
    one = case._replace(values=values[4], start=case.imm.start(0.0, [0.0, 0.0], np.eye(2)))
    assert_engines_agree(one)


@pytest.mark.parametrize("threads", [1, 2])
def test_of_several_that_no_mode_explains_the_earliest_scan_is_named(threads, monkeypatch):
    """And of its targets the first, with the time that is its own."""
    monkeypatch.setattr(sharing, "CHUNK", 32)
    times, values, at = made_up(tdoa(), 70)
    for target, scan in ((3, 5), (40, 2), (41, 2), (66, 2), (69, 3)):
        values[target, scan, 1] = 1e200
    own = times + 0.01 * np.arange(70)[:, None]
    imm = IMM(BANK, tdoa())
    case = Case(imm, own, values, imm.start(0.0, at, 900.0 * np.eye(2)))
    with pytest.raises(ValueError, match=r"at time 3\.4 s no mode can explain"):
        case.run("compiled", threads=threads)
    assert_engines_agree(case, threads=threads)

"""Numbers that others computed: ALGORITHMS §14.1, §12.10, §9.3 and §5.4."""

from __future__ import annotations

import numpy as np
import pytest
from imm_oracles import Mode, exact
from numpy.testing import assert_allclose
from scipy.special import ellipe

from imm_tdoa import IMM, Bank, Stations
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Position, Static

Z = [0.5, 1.1, 1.8, 2.4]
PI = np.array([[0.95, 0.05], [0.1, 0.9]])
IMM_COLUMN = [
    (0.7866390984, -2.18038616),
    (0.8282530223, -3.79944816),
    (0.8500452005, -5.40309315),
    (0.8714552665, -6.90420894),
]
EXACT_COLUMN = [
    (0.7866390984, -2.18038616),
    (0.8265765989, -3.79151223),
    (0.8478112051, -5.38556751),
    (0.8684552498, -6.87509827),
]


def two_modes() -> IMM:
    bank = Bank(
        [ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)], transition=PI, prior=[0.8, 0.2]
    )
    return IMM(bank, Position(1.0, dims=1))


def enumerated():
    """The exact posterior of the same case."""
    g = np.array([0.5, 1.0])
    F = np.array([[1.0, 1.0], [0.0, 1.0]])

    def mode(q):
        return Mode(("x", "vx"), lambda dt: F, lambda dt: q * np.outer(g, g))

    return exact(
        [mode(0.01), mode(4.0)],
        [0.8, 0.2],
        PI,
        np.zeros(2),
        np.diag([10.0, 1.0]),
        Z,
        np.array([[1.0, 0.0]]),
        np.eye(1),
    )


def test_the_enumeration_gives_the_exact_column():
    probability, evidence = enumerated()
    for mu, log_l, (want_mu, want_log_l) in zip(probability, evidence, EXACT_COLUMN, strict=True):
        assert_allclose(mu[0], want_mu, atol=1e-10)
        assert_allclose(log_l, want_log_l, atol=1e-8)


def test_two_mode_case_step_by_step():
    imm = two_modes()
    state = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    probability, evidence = enumerated()
    for k, (z, (mu, log_l)) in enumerate(zip(Z, IMM_COLUMN, strict=True)):
        state = imm.step(state, k + 1.0, [z])
        assert_allclose(state.mode_probability, [mu, 1.0 - mu], atol=1e-10)
        assert_allclose(state.log_likelihood, log_l, atol=1e-8)
        if k == 0:  # the IMM merges nothing before its second scan
            assert_allclose(state.mode_probability, probability[0], atol=1e-14)
            assert_allclose(state.log_likelihood, evidence[0], atol=1e-14)


def test_two_mode_case_as_a_run():
    imm = two_modes()
    start = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    track = imm.run(np.arange(1.0, 5.0), np.array(Z)[:, None], start=start)
    mu, log_l = np.array(IMM_COLUMN).T
    assert_allclose(track.mode_probability[:, 0], mu, atol=1e-10)
    assert_allclose(track.log_likelihood, log_l, atol=1e-8)


def test_transposing_the_chain_would_show():
    bank = Bank(
        [ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)],
        transition=[[0.9, 0.1], [0.05, 0.95]],
        prior=[0.8, 0.2],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    state = imm.step(imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0])), 1.0, [Z[0]])
    assert abs(state.mode_probability[0] - IMM_COLUMN[0][0]) > 0.01


@pytest.mark.parametrize("lam", [0.05, 0.5, 1.0, 3.0, 20.0])
@pytest.mark.parametrize("dt", [1.0, 0.25])
def test_steady_state_is_the_alpha_beta_filter(lam, dt):
    """Kalata's gains (ALGORITHMS §4, §12.10), read off the answer to a unit innovation."""
    sigma_z = 3.0
    bank = Bank([ConstantVelocity(std=lam * sigma_z / dt**2)])
    imm = IMM(bank, Position(sigma_z, dims=1))
    steps = 40 + int(60 / lam)
    track = imm.run(
        dt * np.arange(1, steps + 1),
        np.zeros((steps, 1)),
        start=imm.start(0.0, [0.0, 0.0], np.diag([1.0, 1.0])),
    )
    state = imm.start(track.times[-1], track.mean[-1], track.covariance[-1])
    here = imm.step(state, state.time + dt, [0.0]).mean
    there = imm.step(state, state.time + dt, [1.0]).mean
    root = (4.0 + lam - np.sqrt(8.0 * lam + lam**2)) / 4.0
    alpha = 1.0 - root**2
    beta = 2.0 * (2.0 - alpha) - 4.0 * np.sqrt(1.0 - alpha)
    assert_allclose(there - here, [alpha, beta / dt], atol=1e-9)
    assert_allclose(beta**2 / (1.0 - alpha), lam**2, rtol=1e-9)
    if lam == 1.0:
        assert_allclose([alpha, beta], [0.75, 0.5], rtol=1e-12)


# --- ALGORITHMS §5.4: the IMM on Source A's geometry -------------------------------------------

RADIUS, SIGMA, DT, STEPS = 100e3, 100e-9, 2.0, 20
AZIMUTH = np.radians([0.0, 120.0, 240.0])
SOURCE_A = Stations(
    np.vstack([np.zeros(2), RADIUS * np.stack([np.cos(AZIMUTH), np.sin(AZIMUTH)], axis=1)])
)
START = np.array([[300e3, 400e3], [350e3, 450e3], [250e3, 350e3]])
SPEED = np.array([[0.0, 1e3], [0.0, -1e3], [0.0, 1e3]])
ACCELERATION = np.array([[-100.0, 0.0], [100.0, 0.0], [100.0, 0.0]])
RUNS = 100


def source_a(kind: str, seed: int):
    """Truth (300, 21, 2) and TDOAs (300, 21, 3): 100 runs of each of the three targets."""
    t = DT * np.arange(STEPS + 1)[:, None]
    v = 0.0 if kind == "static" else SPEED[:, None]
    a = ACCELERATION[:, None] if kind == "acceleration" else 0.0
    truth = np.tile(START[:, None] + v * t + 0.5 * a * t**2, (RUNS, 1, 1))
    r = np.linalg.norm(truth[..., None, :] - SOURCE_A.positions, axis=-1)
    rng = np.random.default_rng(seed)
    clean = (r[..., 1:] - r[..., :1]) / 299_792_458.0
    return truth, clean + SIGMA * rng.normal(size=clean.shape)


def mean_error(kind: str, mixing: str, seed: int = 20240501):
    """Mean error per run over steps 1..20, km (300,), last mode probabilities, last errors."""
    truth, values = source_a(kind, seed)
    bank = Bank(
        [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
        mean_sojourn=60.0,
        mixing=mixing,
        birth_std={"velocity": 5e3, "acceleration": 500.0},
    )
    imm = IMM(bank, TDOA(SOURCE_A, tdoa_sigma=SIGMA))
    # the row-0 fix by itself: the filter's own start is judged elsewhere
    mean, covariance = first_fix(values[:, 0])
    start = imm.start(0.0, mean, covariance)
    track = imm.run(DT * np.arange(1, STEPS + 1), values[:, 1:], start=start)
    error = np.linalg.norm(track.position - truth[:, 1:], axis=-1) / 1e3
    return error.mean(axis=1), track.mode_probability[:, -1], error[:, -1]


def first_fix(values):
    """Gauss-Newton from the true place: the least-squares solution, no search."""
    c = 299_792_458.0
    p = np.tile(START, (RUNS, 1))
    for _ in range(30):
        d = p[:, None] - SOURCE_A.positions
        r = np.linalg.norm(d, axis=-1)
        u = d / r[..., None]
        H = u[:, 1:] - u[:, :1]
        nu = c * values - (r[:, 1:] - r[:, :1])
        A = np.swapaxes(H, -1, -2) @ H
        p = p + np.linalg.solve(A, np.einsum("bmi,bm->bi", H, nu)[..., None])[..., 0]
    return p, (c * SIGMA) ** 2 * np.linalg.inv(A)


def within(errors, figure: float, digits: float = 0.0005) -> bool:
    """Whether a mean over runs fits a figure that came from as many other runs, at 4 sigma.

    The difference of two independent means of n runs has standard error s sqrt(2 / n); `digits`
    is half the last digit of the printed figure.
    """
    return abs(errors.mean() - figure) < 4 * errors.std(ddof=1) * np.sqrt(2 / errors.size) + digits


@pytest.mark.parametrize(
    ("kind", "figure", "last", "true_mode", "probability"),
    [
        ("static", 0.339, 0.215, 0, 1.00),
        ("velocity", 0.601, 0.394, 1, 0.99),
        ("acceleration", 0.816, None, 2, 0.97),
    ],
)
def test_birth_prior_on_source_a(kind, figure, last, true_mode, probability):
    errors, mu, final = mean_error(kind, "birth")
    assert within(errors, figure)
    if last is not None:
        assert within(final, last, 0.03)
    assert_allclose(mu[:, true_mode].mean(), probability, atol=0.01)


def test_mixing_rules_differ_as_the_table_says():
    """CV target: birth 0.601, zero 0.603, unbiased 0.606 km; mode probability .99 / .87 / .94.

    The three rules see the same data, so their differences are tested pairwise.
    """
    birth, mu_birth, _ = mean_error("velocity", "birth")
    zero, mu_zero, _ = mean_error("velocity", "zero")
    unbiased, mu_unbiased, _ = mean_error("velocity", "unbiased")
    assert within(zero, 0.603)
    assert within(unbiased, 0.606)
    for other, gap in ((zero, 0.002), (unbiased, 0.005)):
        difference = other - birth
        assert within(difference, gap, 0.001)
    p_zero, p_unbiased, p_birth = (m[:, 1].mean() for m in (mu_zero, mu_unbiased, mu_birth))
    assert p_zero < p_unbiased < p_birth
    assert_allclose([p_zero, p_unbiased, p_birth], [0.87, 0.94, 0.99], atol=0.02)


def switching_truth(runs: int):
    """15 steps static, 15 at constant velocity, 15 at constant acceleration: (3 runs, 46, 2)."""
    p, v = np.tile(START, (runs, 1)), np.zeros((3 * runs, 2))
    path = [p]
    for k in range(45):
        if k == 15:
            v = np.tile(SPEED, (runs, 1))
        a = np.tile(ACCELERATION, (runs, 1)) if k >= 30 else np.zeros_like(v)
        p, v = p + v * DT + 0.5 * a * DT**2, v + a * DT
        path.append(p)
    return np.stack(path, axis=1)


def test_switching_target_needs_the_birth_prior():
    """§5.4: two programs found zero 7.23 / 8.07, unbiased 2.97 / 2.69, birth 0.564 / 0.592 km."""
    truth = switching_truth(RUNS)
    r = np.linalg.norm(truth[..., None, :] - SOURCE_A.positions, axis=-1)
    clean = (r[..., 1:] - r[..., :1]) / 299_792_458.0
    values = clean + SIGMA * np.random.default_rng(5).normal(size=clean.shape)
    error = {}
    for mixing in ("zero", "unbiased", "birth"):
        bank = Bank(
            [Static(psd=0.0), ConstantVelocity(psd=0.0), ConstantAcceleration(psd=0.0)],
            transition=0.985 * np.eye(3) + 0.005,
            mixing=mixing,
            birth_std={"velocity": 5e3, "acceleration": 500.0},
        )
        imm = IMM(bank, TDOA(SOURCE_A, tdoa_sigma=SIGMA))
        start = imm.start(0.0, *first_fix(values[:, 0]))
        track = imm.run(DT * np.arange(1, 46), values[:, 1:], start=start)
        error[mixing] = np.linalg.norm(track.position - truth[:, 1:], axis=-1).mean(axis=1) / 1e3
    assert within(error["birth"], 0.578, 0.014)  # half-way between the two programs, +- half
    assert within(error["unbiased"], 2.83, 0.14)
    assert within(error["zero"], 7.65, 0.42)


def test_mean_error_of_the_first_fix_follows_from_its_covariance():
    """Row 0 of Source A's table, 0.989 km: the elliptic mean of §3.6, without Monte Carlo."""
    _, values = source_a("static", seed=7)
    p, P = first_fix(values[:, 0])
    s2, s1 = np.sqrt(np.linalg.eigvalsh(P)).T
    predicted = np.sqrt(2 / np.pi) * s1 * ellipe(1 - (s2 / s1) ** 2)
    assert_allclose(predicted.reshape(RUNS, 3).mean() / 1e3, 0.9886, atol=0.01)
    error = np.linalg.norm(p - np.tile(START, (RUNS, 1)), axis=-1)
    assert abs(error.mean() - predicted.mean()) < 4 * error.std(ddof=1) / np.sqrt(error.size)

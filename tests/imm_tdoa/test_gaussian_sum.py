"""The Gaussian-sum filter: every component a Kalman filter, weighed by what it foresaw."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import multivariate_normal

import imm_tdoa
from imm_tdoa import IMM, Bank, GaussianSum, Stations, gaussian_sum, mixture
from imm_tdoa.models import TDOA, TOA, ConstantVelocity, Position, Static

PLACES = Stations([[0.0, 0.0], [9e3, 1e3], [2e3, 8e3], [-7e3, -5e3]])
SIGMA = 2e-7
TIMES = np.array([1.0, 2.0, 4.0, 7.0, 7.0])
CV = ConstantVelocity(psd=2.0)


def cloud(seed: int, batch: tuple[int, ...] = (), N: int = 4) -> tuple:
    """Hypotheses about (3, 4) km of states [x, y, vx, vy], one of them of weight zero."""
    rng = np.random.default_rng(seed)
    x = np.array([3e3, 4e3, 10.0, -5.0]) + rng.normal(size=(*batch, N, 4)) * [300, 300, 20, 20]
    A = rng.normal(size=(*batch, N, 4, 4))
    D = np.diag([200.0, 200.0, 10.0, 10.0])
    P = D @ (A @ np.swapaxes(A, -1, -2) + np.eye(4)) @ D
    w = rng.dirichlet(np.ones(N), size=batch)
    w[..., 0] = 0.0
    return x, P, w


def kalman(x, P, w, times, values, R):
    """Components, weights and log-likelihood by the textbook, one at a time; positions measured."""
    H, before, total = np.eye(2, 4), 0.0, 0.0
    x, P, w = np.array(x), np.array(P), np.array(w) / np.sum(w)
    for t, z in zip(times, values, strict=True):
        dt = t - before
        F = np.eye(4) + dt * np.eye(4, k=2)
        q = 2.0 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        likelihood = np.ones(len(w))
        for i in range(len(w)):
            x[i], P[i] = F @ x[i], F @ P[i] @ F.T + np.kron(q, np.eye(2))
            rows = np.isfinite(z)
            if not rows.any():
                continue
            h = H[rows]
            S = h @ P[i] @ h.T + R[np.ix_(rows, rows)]
            likelihood[i] = multivariate_normal.pdf(z[rows], h @ x[i], S)
            K = P[i] @ h.T @ np.linalg.inv(S)
            x[i], P[i] = x[i] + K @ (z[rows] - h @ x[i]), P[i] - K @ S @ K.T
        total += np.log(np.sum(w * likelihood))
        w = w * likelihood / np.sum(w * likelihood)
        before = t
    return x, P, w, total


def test_a_linear_sum_is_the_exact_posterior() -> None:
    """Rows missing, a scan missing, two scans at one time, a slot empty."""
    x, P, w = cloud(1)
    z = np.random.default_rng(2).normal([3e3, 4e3], 150.0, (5, 2))
    z[1, 0], z[2] = np.nan, np.nan
    gs = GaussianSum(CV, Position(sigma=[150.0, 90.0]), prune_below=0.0)
    track = gs.run(TIMES, z, gs.start(0.0, x, P, 3.0 * w))
    want_x, want_P, want_w, total = kalman(x, P, w, TIMES, z, np.diag([150.0, 90.0]) ** 2)
    assert_allclose(track.weight[-1], want_w, rtol=1e-9)
    assert_allclose(track.means[-1, 1:], want_x[1:], rtol=1e-9)
    assert_allclose(track.covariances[-1, 1:], want_P[1:], rtol=1e-7, atol=1e-6)
    assert_allclose(track.log_likelihood[-1], total, rtol=1e-10)
    m, C = mixture.moments(want_w, want_x, want_P)
    assert_allclose(track.mean[-1], m, rtol=1e-10)
    assert_allclose(track.covariance[-1], C, rtol=1e-7, atol=1e-6)
    assert_allclose(track.position, track.mean[:, :2])
    assert_allclose(track.velocity, track.mean[:, 2:])
    assert_allclose(track.position_covariance, track.covariance[:, :2, :2])
    assert_array_equal(track.nis_dof, [2, 1, 0, 2, 2])
    assert np.all(np.isnan(track.nis[2]))
    assert_array_equal(np.isnan(track.nis[-1]), [True, False, False, False])


@pytest.mark.parametrize("update", ["ekf", "iekf", "ukf", "ckf"])
@pytest.mark.parametrize("model", [TDOA(PLACES, toa_sigma=SIGMA), TOA(PLACES, sigma=SIGMA)])
def test_one_component_is_an_imm_of_one_mode(update, model) -> None:
    x, P, _ = cloud(3, N=1)
    p = np.array([3e3, 4e3]) + np.arange(5)[:, None] * [30.0, 10.0]
    z = model.predict(p, np.zeros_like(p), TIMES) / model.scale
    z = z + np.random.default_rng(4).normal(0.0, SIGMA, z.shape)
    z[1, 0] = np.nan
    gs = GaussianSum(CV, model, update=update)
    track = gs.run(TIMES, z, gs.start(0.0, x, P))
    imm = IMM(Bank([CV]), model, update=update)
    want = imm.run(TIMES, z, imm.start(0.0, x[0], P[0]))
    assert_allclose(track.mean, want.mean, rtol=1e-9)
    assert_allclose(track.covariance, want.covariance, rtol=1e-7, atol=1e-9)
    assert_allclose(track.log_likelihood, want.log_likelihood, rtol=1e-9)
    assert_allclose(track.nis[:, 0], want.nis, rtol=1e-7)
    assert_array_equal(track.nis_dof, want.nis_dof)


def test_equal_components_are_one() -> None:
    x, P, _ = cloud(3, N=1)
    model = TDOA(PLACES, toa_sigma=SIGMA)
    z = model.predict(np.array([3e3, 4e3]), np.zeros(2), 0.0) / model.scale
    gs = GaussianSum(CV, model, merge_distance=1.0)
    one = gs.step(gs.start(0.0, x, P), 1.0, z)
    three = gs.step(gs.start(0.0, np.repeat(x, 3, 0), np.repeat(P, 3, 0)), 1.0, z)
    assert_allclose(three.mean, one.mean, rtol=1e-12)
    assert_allclose(three.covariance, one.covariance, rtol=1e-9)
    assert_allclose(three.log_likelihood, one.log_likelihood, rtol=1e-12)
    assert np.count_nonzero(three.weight) == 1


@pytest.mark.parametrize(
    "options",
    [{}, {"merge_distance": 150.0}, {"merge_distance": 0.5, "merge_by": "mahalanobis"}],
)
def test_a_batch_is_what_each_is_alone_and_step_is_run(options) -> None:
    model = TDOA(PLACES, toa_sigma=SIGMA)
    rng = np.random.default_rng(5)
    x, P, w = cloud(6, (3,))
    z = rng.normal(0.0, 5e-7, (3, 5, 3))
    z += model.predict(np.array([3e3, 4e3]), np.zeros(2), 0.0) / model.scale
    z[1, 2], z[2, 3, 1] = np.nan, np.nan
    times = TIMES + np.arange(3)[:, None]
    gs = GaussianSum(CV, model, prune_below=1e-3, **options)
    track = gs.run(times, z, gs.start(np.zeros(3), x, P, w))
    for i in range(3):
        alone = gs.start(0.0, x[i], P[i], w[i])
        for k in range(5):
            alone = gs.step(alone, times[i, k], z[i, k])
            assert_allclose(track.mean[i, k], alone.mean, rtol=1e-9)
            assert_allclose(track.weight[i, k], alone.weight, rtol=1e-7, atol=1e-12)
            assert_allclose(track.log_likelihood[i, k], alone.log_likelihood, rtol=1e-9)
    if options:
        assert np.any(np.isneginf(track.log_weight[:, -1, 1:]))


def test_one_start_serves_a_batch_of_runs() -> None:
    x, P, w = cloud(6)
    z = np.random.default_rng(7).normal(3e3, 400.0, (8, 5, 2))
    z[3] = np.nan
    gs = GaussianSum(CV, Position(sigma=300.0))
    track = gs.run(TIMES, z, gs.start(0.0, x, P, w))
    assert track.mean.shape == (8, 5, 4)
    one = gs.run(TIMES, z[5], gs.start(0.0, x, P, w))
    assert_allclose(track.covariance[5], one.covariance, rtol=1e-9, atol=1e-9)


def test_pairs_may_change_from_scan_to_scan_and_run_to_run() -> None:
    model = TDOA(PLACES, toa_sigma=SIGMA)
    p = np.array([3e3, 4e3])
    x, P, w = cloud(6, (2,))
    pairs = np.array([[[[1, 0], [2, 0]], [[3, 1], [2, 3]]], [[[2, 1], [3, 0]], [[1, 0], [3, 2]]]])
    z = np.stack(
        [[model.with_pairs(q).predict(p, 0 * p, 0.0) / model.speed for q in each] for each in pairs]
    )
    gs = GaussianSum(CV, model)
    track = gs.run([1.0, 2.0], z, gs.start(0.0, x, P, w), pairs=pairs)
    for i in range(2):
        alone = gs.start(0.0, x[i], P[i], w[i])
        for k in range(2):
            alone = gs.step(alone, 1.0 + k, z[i, k], pairs=pairs[i, k])
        assert_allclose(track.mean[i, -1], alone.mean, rtol=1e-9)


def test_positions_alone_get_the_birth_law() -> None:
    gs = GaussianSum(CV, Position(sigma=10.0), birth_std={"velocity": 30.0})
    state = gs.start(0.0, np.zeros((2, 2)), np.tile(np.eye(2), (2, 1, 1)))
    assert state.components == ("x", "y", "vx", "vy")
    assert_array_equal(state.covariance, np.diag([1.0, 1.0, 900.0, 900.0]))
    with pytest.raises(ValueError, match=r"^birth_std: .* needs a birth standard deviation"):
        GaussianSum(CV, Position(sigma=10.0)).start(0.0, np.zeros((1, 2)), np.eye(2)[None])
    assert_array_equal(GaussianSum(Static(psd=1.0), Position()).space.components, ("x", "y"))


def test_dropped_components_do_no_harm() -> None:
    """A component that is impossible leaves, and the slot repeats what is left."""
    x = np.array([[0.0, 0.0], [1e6, 0.0]])
    gs = GaussianSum(Static(psd=1.0), Position(sigma=1.0))
    state = gs.step(gs.start(0.0, x, np.tile(np.eye(2), (2, 1, 1))), 1.0, [0.5, 0.5])
    assert_array_equal(state.weight, [1.0, 0.0])
    assert_array_equal(state.means[1], state.means[0])
    static = gs.run([2.0], [[0.1, 0.1]], state)
    assert_array_equal(static.velocity, 0.0)


def test_public_name() -> None:
    assert imm_tdoa.GaussianSum is GaussianSum
    assert gaussian_sum.GaussianSum is GaussianSum


GOOD = GaussianSum(CV, Position(sigma=10.0))
STATE = GOOD.start(5.0, np.zeros((2, 4)), np.tile(np.eye(4), (2, 1, 1)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion": ConstantVelocity}, "motion: no motion model"),
        ({"motion": Position()}, "motion: no motion model"),
        ({"measurement": "tdoa"}, "measurement: no measurement model"),
        ({"update": "enkf"}, "update: expected one of 'ekf'"),
        ({"merge_distance": 0.0}, "merge_distance: expected a number above 0"),
        ({"merge_by": "cosine"}, "merge_by: expected one of 'euclidean'"),
        ({"prune_below": 1.0}, "prune_below: expected a weight"),
        ({"birth_std": {"velocity": -1.0}}, r"birth_std\['velocity'\]: expected a number"),
    ],
)
def test_bad_filters(change, message) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        attrs.evolve(GOOD, **change)


EYES = np.tile(np.eye(4), (2, 1, 1))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: GOOD.start(0.0, np.zeros((0, 4)), np.zeros((0, 4, 4))), "means: expected at le"),
        (lambda: GOOD.start(0.0, np.zeros((2, 3)), EYES), "means: expected 4 components"),
        (lambda: GOOD.start(0.0, np.zeros(4), EYES), r"means: expected shape \(..., N, n\)"),
        (lambda: GOOD.start(0.0, np.zeros((2, 4)), -EYES), "covariances: a variance"),
        (lambda: GOOD.start(0.0, np.zeros((2, 4)), EYES, [0, 0]), "weights: expected weights"),
        (lambda: GOOD.start(0.0, np.zeros((2, 4)), EYES, [2, -1]), "weights: expected weights"),
        (lambda: GOOD.start(0.0, np.zeros((2, 4)), EYES, [1]), "weights: expected shape"),
        (
            lambda: GOOD.start(np.zeros(2), np.zeros((3, 2, 4)), EYES),
            "batch axes do not fit together",
        ),
        (lambda: GOOD.step(STATE, 4.0, [0.0, 0.0]), "time: expected a time at or after the state"),
        (lambda: GOOD.step(STATE, 6.0, [0.0]), "values: expected shape"),
        (lambda: GOOD.step(STATE, 6.0, [0.0, np.inf]), "values: infinite values"),
        (lambda: GOOD.step(STATE, 6.0, [0.0, 0.0], pairs=[[1, 0]]), "pairs: Position does not"),
        (lambda: GOOD.step("state", 6.0, [0.0, 0.0]), "state: expected a state of this motion"),
        (lambda: GOOD.run([4.0], [[0.0, 0.0]], STATE), "times: expected a time at or after the st"),
        (lambda: GOOD.run([6.0, 5.5], np.zeros((2, 2)), STATE), "times: expected times that do"),
        (
            lambda: GaussianSum(Static(psd=1.0), Position()).run([6.0], [[0.0, 0.0]], STATE),
            "start: expected a state of this motion",
        ),
        (lambda: GOOD.step(STATE, 6.0, [1e300, 0.0]), "values: at time 6 s no component can"),
        (lambda: gaussian_sum.settled(np.zeros((1, 2)), [0, 0]), "position: expected two or more"),
        (lambda: gaussian_sum.settled(np.zeros((3, 2)), [0.0]), "origin: expected shape"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_bad_calls(call, message) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        call()


def test_the_output_rule_takes_the_smallest_change_of_range() -> None:
    """§7.1-7, by hand: ranges 10, 7, 5, 4.5, 3, seen from the origin or from a moving one."""
    r = np.array([10.0, 7.0, 5.0, 4.5, 3.0])
    p = np.stack([r * 0.6, r * 0.8], axis=-1)
    assert gaussian_sum.settled(p, [0.0, 0.0]) == 3
    assert_array_equal(gaussian_sum.settled(np.stack([p, p[::-1]]), [0.0, 0.0]), [3, 2])
    moving = p - np.array([[0.0, 1.0], [0.0, 1.0], [0.0, 3.0], [0.0, 6.0], [0.0, 6.0]])
    assert gaussian_sum.settled(p, moving) == 1

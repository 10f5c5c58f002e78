"""Where a Gaussian sum begins: lobes of an ambiguous phase (Source C), a branch of a hyperbola."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa import GaussianSum, Stations, mixture
from imm_tdoa.gaussian_sum import hyperbola, lobes
from imm_tdoa.gaussian_sum.interferometers import ranges_along
from imm_tdoa.models import FDOA, TDOA, PhaseDifference, Position, Static

DEG = np.pi / 180.0
C = 299792458.0
EMITTER, STILL = np.array([60e3, 80e3]), np.zeros(2)
BEARING = float(np.arctan2(80e3, 60e3))
BASE = PhaseDifference(
    Stations(
        [[0.0, 0.0]],
        velocities=[[270.0, 0.0]],
        position_covariance=100.0 * np.eye(2)[None],
        velocity_covariance=np.diag([4.0, 0.0])[None],
    ),
    baseline=10.0,
    frequency=6e9,
    sigma_phase=10 * DEG,
    sigma_rate=0.5 * DEG,
)
EXACT = BASE.predict(EMITTER, STILL, 0.0)


def test_ranges_of_the_source() -> None:
    """§7.2: 402, 741 and 2618 m of range from rate, speed along the track, and 1° of bearing."""
    found = ranges_along(BASE, [BEARING], EXACT[1], 0.0)
    assert_allclose(found.range, [100e3], rtol=1e-9)
    assert_allclose(np.sqrt(found.parts["rate"]), [402.0], atol=0.5)
    assert_allclose(np.sqrt(found.parts["velocity"]), [741.0], atol=0.5)
    assert_allclose(np.abs(found.by_bearing) * DEG, [2618.0], atol=0.5)
    assert_allclose(found.variance, found.parts["rate"] + found.parts["velocity"])
    # eastward track: R = -K v sin² / rate
    K = BASE.electrical_length
    theta = np.array([0.5, 1.2, 2.0])
    assert_allclose(
        ranges_along(BASE, theta, EXACT[1], 0.0).range, -K * 270 * np.sin(theta) ** 2 / EXACT[1]
    )


@pytest.mark.parametrize("bearing", [BEARING, -0.7, 2.6])
def test_range_derivatives_are_difference_quotients(bearing: float) -> None:
    """All six of §7.1-3, at a turning baseline that is not along the track."""
    settings = {
        "azimuth_times": [0.0, 10.0],
        "azimuth_sigma": 0.3 * DEG,
        "azimuth_rate_sigma": 0.05 * DEG,
        "frequency_sigma": 2e6,
    }
    stations = attrs.evolve(
        BASE.stations,
        velocities=np.array([[250.0, 90.0]]),
        velocity_covariance=np.array([[[4.0, 1.0], [1.0, 3.0]]]),
    )
    model = attrs.evolve(BASE, stations=stations, baseline_azimuth=[0.2, 0.3], **settings)
    place = 70e3 * np.array([np.cos(bearing), np.sin(bearing)])
    rate = model.predict(place, STILL, 4.0)[1]

    def r(m=model, theta=bearing, z=rate):
        return float(ranges_along(m, [theta], z, 4.0).range[0])

    def moved(vector):
        return attrs.evolve(model, stations=attrs.evolve(stations, velocities=vector))

    def slope(h, f):
        return (f(h) - f(-h)) / (2 * h)

    found = ranges_along(model, [bearing], rate, 4.0)
    v, a = stations.velocities, np.array([0.2, 0.3])
    assert_allclose(found.range, 70e3, rtol=1e-9)
    assert_allclose(found.by_bearing, slope(1e-6, lambda e: r(theta=bearing + e)), rtol=1e-5)
    by_v = np.array([slope(1e-3, lambda e, k=k: r(moved(v + e * np.eye(2)[k]))) for k in (0, 1)])
    expected = {
        "rate": slope(1e-5, lambda e: r(z=rate + e)) * 0.5 * DEG,
        "azimuth": 0.3
        * DEG
        * slope(1e-6, lambda e: r(attrs.evolve(model, baseline_azimuth=a + e))),
        "azimuth_rate": slope(
            1e-7, lambda e: r(attrs.evolve(model, baseline_azimuth=a + e * np.array([-4.0, 6.0])))
        )
        * 0.05
        * DEG,
        "frequency": slope(1e4, lambda e: r(attrs.evolve(model, frequency=6e9 + e))) * 2e6,
    }
    for name, sigma in expected.items():
        assert_allclose(found.parts[name], sigma**2, rtol=1e-4)
    Q = stations.velocity_covariance[0]
    assert_allclose(found.parts["velocity"], by_v @ Q @ by_v, rtol=1e-4)


def test_six_of_fifty_six() -> None:
    """§7.2: the window holds 56 integers, every 9th of which are 3.2° apart; six are taken."""
    assert lobes(BASE, 0.0, EXACT, BEARING, 5 * DEG).means.shape[0] in (55, 56)
    six = lobes(BASE, 0.0, EXACT, BEARING, 5 * DEG, every=9, count=6, lobe_sigma=DEG)
    assert_allclose(six.weights, np.full(6, 1 / 6))
    theta = np.arctan2(six.means[:, 1], six.means[:, 0])
    assert_allclose(np.mean(np.abs(np.diff(theta))) / DEG, 3.2, atol=0.05)
    assert np.all(np.abs(theta - BEARING) < 10 * DEG)
    assert_allclose(np.mean(theta), BEARING, atol=2.5 * DEG)
    turns = (BASE.electrical_length * np.cos(theta) - EXACT[0]) / (2 * np.pi)
    assert_allclose(turns, np.round(turns), atol=1e-6)
    assert_array_equal(np.diff(np.round(turns)), 9)
    # one for nine integers: anywhere within the spacing, spacing / sqrt 12, about a degree
    wide = lobes(BASE, 0.0, EXACT, BEARING, 5 * DEG, every=9, count=6).covariances
    across = np.stack([-np.sin(theta), np.cos(theta)], axis=-1)
    r = np.linalg.norm(six.means, axis=-1)
    width = np.sqrt(np.einsum("na,nab,nb->n", across, wide, across)) / r
    spacing = 9 * 2 * np.pi / (BASE.electrical_length * np.sin(theta))
    assert_allclose(width, spacing / np.sqrt(12.0), rtol=0.01)
    assert_allclose(np.mean(width) / DEG, 0.93, atol=0.02)


def test_every_lobe_s_covariance_is_what_errors_make_of_the_place() -> None:
    """Oracle: phase, rate and speed drawn at random and inverted exactly, the integer known."""
    found = lobes(BASE, 0.0, EXACT, BEARING, 5 * DEG)
    nearest = int(np.argmin(np.linalg.norm(found.means - EMITTER, axis=-1)))
    assert_allclose(found.means[nearest], EMITTER, rtol=1e-9)
    rng, runs, K = np.random.default_rng(1), 40_000, BASE.electrical_length
    phase = np.sqrt(BASE.noise_covariance(EMITTER, STILL, 0.0)[0, 0])
    theta = np.arccos((K * 0.6 + phase * rng.normal(size=runs)) / K)
    rate = EXACT[1] + 0.5 * DEG * rng.normal(size=runs)
    r = -K * (270.0 + 2.0 * rng.normal(size=runs)) * np.sin(theta) ** 2 / rate
    places = r[:, None] * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    L = np.linalg.cholesky(found.covariances[nearest])
    white = np.linalg.solve(L, np.cov(places.T))
    white = np.linalg.solve(L, white.T)
    assert_allclose(white, np.eye(2), atol=5 * np.sqrt(2.0 / runs))


def test_diagonal_as_in_the_source() -> None:
    """§7.1-4: M diag(sigma_R², sigma_theta²) M', with the bearing's share in sigma_R."""
    found = lobes(
        BASE, 0.0, EXACT, BEARING, 5 * DEG, every=9, count=1, lobe_sigma=DEG, covariance="diagonal"
    )
    x, y = found.means[0]
    r, theta = np.hypot(x, y), np.arctan2(y, x)
    ranging = ranges_along(BASE, [theta], EXACT[1], 0.0)
    M = np.array([[np.cos(theta), -r * np.sin(theta)], [np.sin(theta), r * np.cos(theta)]])
    sigma_r = ranging.variance[0] + (ranging.by_bearing[0] * DEG) ** 2
    assert_allclose(found.covariances[0], M @ np.diag([sigma_r, DEG**2]) @ M.T, rtol=1e-9)


def test_below_the_baseline_and_in_batches() -> None:
    below = np.array([60e3, -80e3])
    z = np.stack([EXACT, BASE.predict(below, STILL, 0.0)])
    both = lobes(BASE, 0.0, z, [BEARING, -BEARING], 5 * DEG)
    assert_allclose(both.means[1], both.means[0] * [1.0, -1.0], rtol=1e-9)
    for i, sign in enumerate((1.0, -1.0)):
        one = lobes(BASE, 0.0, z[i], sign * BEARING, 5 * DEG)
        assert_allclose(both.means[i], one.means)
        assert_allclose(both.covariances[i], one.covariances)


def test_fewer_integers_than_slots_leave_slots_empty() -> None:
    found = lobes(BASE, 0.0, EXACT, BEARING, 0.5 * DEG, every=1, count=20)
    there = found.weights > 0.0
    assert 4 <= np.count_nonzero(there) < 20
    assert_allclose(found.weights[there], 1.0 / np.count_nonzero(there))
    GaussianSum(Static(psd=0.0), BASE).start(0.0, *found)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: lobes(attrs.evolve(BASE, use="rate"), 0.0, EXACT[1:], 1.0, 0.1), "interferometer"),
        (lambda: lobes(Position(), 0.0, EXACT, 1.0, 0.1), "interferometer: expected"),
        (lambda: lobes(BASE, 0.0, [np.nan, 0.0], 1.0, 0.1), "values: expected finite numbers"),
        (lambda: lobes(BASE, 0.0, EXACT[:1], 1.0, 0.1), "values: expected shape"),
        (lambda: lobes(BASE, 0.0, EXACT, 1.0, 0.0), "bearing_sigma: expected a number above 0"),
        (lambda: lobes(BASE, 0.0, EXACT, 1.0, 0.1, window=-1.0), "window: expected a number above"),
        (lambda: lobes(BASE, 0.0, EXACT, 1.0, 0.1, every=0), "every: expected a whole number"),
        (lambda: lobes(BASE, 0.0, EXACT, 1.0, 0.1, count=2.5), "count: expected a whole number"),
        (lambda: lobes(BASE, 0.0, EXACT, 1.0, 0.1, lobe_sigma=0), "lobe_sigma: expected a number"),
        (lambda: lobes(BASE, 0.0, EXACT, 1.0, 0.1, covariance="x"), "covariance: expected one of"),
        (lambda: lobes(BASE, 0.0, EXACT, [1.0, 1.0, 1.0, 1.0], 1e-5), "bearing: no ambiguity int"),
        (lambda: lobes(BASE, 0.0, [EXACT] * 2, [1.0] * 3, 0.1), "bearing: batch axes"),
        (lambda: lobes(BASE, 0.0, -EXACT, BEARING, 0.1), "values: the phase rate gives no range"),
        (
            lambda: lobes(
                attrs.evolve(BASE, baseline_azimuth=[0.0, 0.0], azimuth_times=[5.0, 6.0]),
                0.0,
                EXACT,
                BEARING,
                0.1,
            ),
            "time: the observer or its baseline is not known at 0 s",
        ),
    ],
)
def test_bad_lobes(call, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        call()


PAIR = Stations([[1e3, 2e3], [9e3, -2e3]])
LINE = TDOA(PAIR, toa_sigma=1e-7)


@pytest.mark.parametrize("place", [[15e3, 12e3], [-3e3, 9e3], [5e3, 0.0], [30e3, -20e3]])
def test_the_branch_passes_the_emitter_and_nowhere_else(place) -> None:
    rho = LINE.predict(np.array(place), STILL, 0.0)
    found = hyperbola(LINE, 0.0, rho / C, 60e3, count=80)
    assert_allclose(LINE.predict(found.means, np.zeros((80, 2)), 0.0)[:, 0], rho[0], atol=1e-6)
    away = np.array(place) - found.means
    d2 = np.einsum("ni,nij,nj->n", away, np.linalg.inv(found.covariances), away)
    assert d2.min() < 4.0  # within the ends of a uniform piece (sqrt 3 sigmas) and a bit across
    centre = PAIR.positions.mean(axis=0)
    assert np.all(np.linalg.norm(found.means - centre, axis=-1) < 60e3)
    assert_allclose(found.weights.sum(), 1.0)


def grid_posterior(model, z, times, places, reach):
    """Log density of an emitter anywhere in the disc, exact likelihood, after every scan."""
    centre = PAIR.positions.mean(axis=0)
    log_p = np.where(np.linalg.norm(places - centre, axis=-1) <= reach, 0.0, -np.inf)
    for t, value in zip(times, z, strict=True):
        h = model.predict(places, np.zeros_like(places), t)
        log_p = log_p - 0.5 * np.sum((value * C - h) ** 2, axis=-1) / (2.0 * (1e-7 * C) ** 2)
        yield log_p


@pytest.mark.parametrize("place", [[15e3, 12e3], [-3e3, 9e3]])
def test_two_stations_find_the_emitter_that_a_grid_finds(place) -> None:
    """Oracle: uniform prior on a grid along the first hyperbola, times exact likelihoods.

    Station 1 flies; each scan is one hyperbola. At the start the sum has the grid's mean within
    0.01 sigma and spread within 1 %. Later, with a few pieces left of 100, within 0.08 sigma and
    7 %: neighbouring Gaussians do not add up to an even density along the branch.
    """
    times = np.arange(0.0, 101.0, 10.0)
    path = np.stack(
        [np.tile(PAIR.positions[0], (11, 1)), PAIR.positions[1] + times[:, None] * [-30.0, 60.0]], 1
    )
    model = TDOA(Stations(path, times=times), toa_sigma=1e-7)
    p = np.array(place)
    rng = np.random.default_rng(8)
    z = model.predict(p, STILL, times) / C + np.sqrt(2) * 1e-7 * rng.normal(size=(11, 1))
    start = hyperbola(model, 0.0, z[0], 40e3, count=100)
    # the grid: hyperbolas of neighbouring differences, points at equal steps along each
    rho, u = np.meshgrid(
        z[0, 0] * C + 43.0 * np.linspace(-4.5, 4.5, 61), np.linspace(-4.0, 4.0, 6001), indexing="ij"
    )
    e = (PAIR.positions[1] - PAIR.positions[0]) / (2 * (half := np.hypot(4e3, 2e3)))
    a = -0.5 * rho
    b = np.sqrt(half**2 - a**2)
    x, y = a * np.cosh(u), b * np.sinh(u)
    places = PAIR.positions.mean(axis=0) + x[..., None] * e + y[..., None] * [-e[1], e[0]]
    jacobian = np.abs(
        (-0.5 * np.cosh(u)) * (b * np.cosh(u)) - (a * np.sinh(u)) * (0.25 * -rho / b * np.sinh(u))
    )
    gs = GaussianSum(Static(psd=0.0), model)
    state = gs.start(0.0, *start)
    for k, log_p in enumerate(grid_posterior(model, z, times, places, 40e3)):
        if k:
            state = gs.step(state, times[k], z[k])
        w = np.exp(log_p - log_p.max()) * jacobian
        w = w / w.sum()
        m, P = mixture.moments(w.ravel(), places.reshape(-1, 2), np.zeros((w.size, 2, 2)))
        L = np.linalg.cholesky(P)
        off = np.linalg.norm(np.linalg.solve(L, state.mean - m))
        ratio = np.sqrt(np.trace(state.covariance) / np.trace(P))
        near, same = (0.01, 0.01) if k == 0 else (0.08, 0.07)
        assert off < near, (k, off)
        assert abs(ratio - 1.0) < same, (k, ratio)


def test_a_batch_of_hyperbolas() -> None:
    z = np.array([[0.0], [1e-5], [-2e-5]])
    many = hyperbola(LINE, 0.0, z, 30e3, count=7)
    for i in range(3):
        for a, b in zip(many, hyperbola(LINE, 0.0, z[i], 30e3, count=7), strict=True):
            assert_allclose(a[i], b)
    assert_allclose(many.weights[0], many.weights[0][::-1])  # the line between is symmetric


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: hyperbola(Position(), 0.0, [0.0], 1e4), "measurement: expected time differences"),
        (
            lambda: hyperbola(TDOA(Stations([[0.0, 0], [1, 0], [0, 1]]), toa_sigma=1), 0, [0], 9.0),
            "measurement: expected one pair",
        ),
        (
            lambda: hyperbola(TDOA(Stations([[0.0] * 3, [1.0] * 3]), toa_sigma=1), 0, [0], 9.0),
            "measurement: expected one pair",
        ),
        (lambda: hyperbola(LINE, 0.0, [np.nan], 1e5), "values: expected finite numbers"),
        (lambda: hyperbola(LINE, 0.0, [4e-5], 1e5), "values: the range difference 11991.7 m is at"),
        (lambda: hyperbola(LINE, 0.0, [0.0], 4e3), "reach: expected more than half the distance"),
        (lambda: hyperbola(LINE, 0.0, [0.0], 1e5, count=1), "count: expected a whole number"),
        (
            lambda: hyperbola(
                TDOA(Stations(np.stack([PAIR.positions] * 2), times=[0.0, 1.0]), toa_sigma=1e-7),
                2.0,
                [0.0],
                1e5,
            ),
            "time: not both stations are heard at 2 s",
        ),
    ],
)
def test_bad_hyperbolas(call, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        call()


def test_frequency_differences_are_no_hyperbola() -> None:
    with pytest.raises(ValueError, match=r"^measurement: expected time differences"):
        hyperbola(FDOA(PAIR, range_rate_sigma=0.1), 0.0, [0.0], 1e5)

"""The closed form of Chan & Ho: roots, mirror images, errors, agreement with the iteration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from locate_cases import differences, distances, geometries, mahalanobis, pairs_against
from numpy.testing import assert_allclose

from imm_tdoa import Stations, bounds
from imm_tdoa.locate import chan_ho, gauss_newton

SQUARE = np.array([(0, 0), (1000, 0), (0, 1000), (1100, 1200), (500, -400)], float)
CUBE = np.array(
    [(0, 0, 0), (1000, 0, 50), (0, 1000, 120), (1100, 1200, 10), (500, -400, 300), (600, 500, 700)],
    float,
)
PLACES = {2: np.array([1700.0, -900.0]), 3: np.array([1700.0, -900.0, 800.0])}
ARRAYS = {2: SQUARE, 3: CUBE}


def exact(p, s):
    return differences(distances(p, s))


def either(fix, truth, tolerance):
    """Whether position or mirror of each fix is the truth."""
    away = np.linalg.norm(fix.position - truth, axis=-1)
    if fix.mirror is not None:
        away = np.fmin(away, np.linalg.norm(fix.mirror - truth, axis=-1))
    return np.all(away <= tolerance)


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("extra", [0, 1])
def test_both_stages_find_a_noise_free_emitter(dims, extra):
    s, p = ARRAYS[dims][: dims + 2 + extra], PLACES[dims]
    fix = chan_ho(Stations(s), exact(p, s), toa_sigma=1e-3, speed=1.0)
    assert_allclose(fix.position, p, atol=1e-6)
    assert fix.mirror is None
    assert bool(fix.converged)
    assert fix.dof == len(s) - 1 - dims
    assert_allclose(fix.chi2, 0.0, atol=1e-9)
    assert_allclose(
        fix.covariance, bounds.crlb(Stations(s), p, toa_sigma=1e-3, speed=1.0), rtol=1e-6
    )


@settings(deadline=None, max_examples=60)
@given(data=st.data(), dims=st.sampled_from([2, 3]))
def test_the_closed_form_agrees_with_the_iteration_at_low_noise(data, dims):
    """It is efficient: it departs from the least-squares fix by less than its own error.

    Provided that stage 1, which knows nothing of the relation between place and range, has them
    within 1 cm: what it misses enters stage 2 by its square over the distance. With just d + 2
    stations its equations may be nearly dependent.
    """
    stations, p = data.draw(geometries(dims, dims + 2 + data.draw(st.integers(0, 4))))
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    s, sigma = stations.positions, 1e-4
    r = distances(p, s)
    G = np.column_stack([s[1:] - s[0], r[1:] - r[0]]) / r[1:, None]
    first = np.linalg.inv(G.T @ np.linalg.solve(np.eye(len(G)) + 1.0, G)) * sigma**2
    assume(np.trace(first) < 1e-4)
    z = differences(distances(p, s) + rng.normal(0.0, sigma, (20, len(s))))
    closed = chan_ho(stations, z, toa_sigma=sigma, speed=1.0)
    iterated = gauss_newton(stations, z, toa_sigma=sigma, speed=1.0, initial=p)
    assert closed.converged.all()
    away = mahalanobis(closed.position - iterated.position, iterated.covariance)
    assert np.max(away) < 0.1**2
    assert_allclose(closed.covariance, iterated.covariance, rtol=1e-2)


def test_an_emitter_on_an_axis_through_the_reference_is_no_worse():
    """The squares of stage 2 would lose a component near zero; the turned axes keep it."""
    s, sigma = SQUARE, 0.1
    rng = np.random.default_rng(5)
    for p in (np.array([0.0, 2500.0]), np.array([2500.0, 0.0]), np.array([-1800.0, -1e-3])):
        z = differences(distances(p, s) + rng.normal(0.0, sigma, (4000, len(s))))
        fix = chan_ho(Stations(s), z, toa_sigma=sigma, speed=1.0)
        away = mahalanobis(
            fix.position - p, bounds.crlb(Stations(s), p, toa_sigma=sigma, speed=1.0)
        )
        assert abs(np.mean(away) - 2.0) < 4.0 * np.std(away) / np.sqrt(len(away))


@settings(deadline=None, max_examples=60)
@given(data=st.data(), dims=st.sampled_from([2, 3]))
def test_a_minimal_set_gives_the_emitter_and_a_second_root_that_fits(data, dims):
    stations, p = data.draw(geometries(dims, dims + 1))
    s = stations.positions
    z = exact(p, s)
    fix = chan_ho(stations, z, toa_sigma=1e-4, speed=1.0)
    C = bounds.crlb(stations, p, toa_sigma=1e-4, speed=1.0)
    assert either(fix, p, 1e-3 * np.sqrt(np.trace(C)) + 1e-6)
    assert_allclose(exact(fix.position, s), z, atol=1e-4)
    if fix.mirror is not None:
        assert_allclose(exact(fix.mirror, s), z, atol=1e-4)
        centre = s.mean(axis=0)
        assert np.linalg.norm(fix.position - centre) <= np.linalg.norm(fix.mirror - centre)


def test_the_two_roots_of_three_stations():
    """Close to a station of three the hyperbolas cross twice: both crossings are constructed."""
    s = np.array([(0, 0), (1000, 0), (0, 1000)], float)
    p = np.array([-150.0, -250.0])
    z = exact(p, s)
    fix = chan_ho(Stations(s), z, toa_sigma=1e-3, speed=1.0)
    assert fix.mirror is not None
    assert either(fix, p, 1e-6)
    assert_allclose(exact(fix.mirror, s), z, atol=1e-8)
    assert np.linalg.norm(fix.position - fix.mirror) > 1.0


def test_an_emitter_at_the_reference_station_is_found():
    s = np.array([(0, 0), (1000, 0), (0, 1000)], float)
    fix = chan_ho(Stations(s), exact(s[0], s), toa_sigma=1e-3, speed=1.0)
    assert_allclose(fix.position, s[0], atol=1e-6)


def test_differences_that_no_emitter_makes_give_no_fix():
    """A range difference beyond the distance of its stations leaves both roots negative."""
    s = np.array([(0, 0), (1000, 0), (0, 1000)], float)
    fix = chan_ho(Stations(s), [-2500.0, -2500.0], toa_sigma=1.0, speed=1.0)
    assert np.isnan(fix.position).all()
    assert not bool(fix.converged)
    assert np.isnan(fix.covariance).all()


def rotation(dims, seed):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(dims, dims)))
    return q


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("extra", [0, 1, 3])
def test_flat_arrays_give_the_emitter_and_its_image(dims, extra):
    """Stations in a line (2-D) or plane (3-D), anywhere: image constructed by reflection."""
    rng = np.random.default_rng(11)
    for seed in range(20):
        turn = rotation(dims, seed)
        shift = rng.normal(size=dims) * 1e3
        flat = np.zeros((dims + 1 + extra, dims))
        flat[:, : dims - 1] = rng.uniform(-1e3, 1e3, (len(flat), dims - 1))
        along = rng.uniform(-2e3, 2e3, dims - 1)
        height = rng.uniform(200.0, 2000.0)
        s = flat @ turn.T + shift
        p = np.append(along, height) @ turn.T + shift
        image = np.append(along, -height) @ turn.T + shift
        fix = chan_ho(Stations(s), exact(p, s), toa_sigma=1e-3, speed=1.0)
        assert fix.mirror is not None
        found = np.stack([fix.position, fix.mirror])
        upper = p if p[-1] > image[-1] else image
        assert_allclose(found[0], upper, atol=1e-5)
        assert_allclose(found.sum(axis=0), p + image, atol=1e-5)


def test_nothing_is_claimed_about_the_height_of_an_emitter_in_line_with_its_stations():
    s = np.array([(0, 0), (1000, 0), (1700, 0), (2500, 0)], float)
    for x in (600.0, 1234.5, 1900.0):
        fix = chan_ho(Stations(s), exact(np.array([x, 0.0]), s), toa_sigma=1e-3, speed=1.0)
        assert not bool(fix.converged) or fix.covariance[1, 1] > 1e6


@pytest.mark.parametrize("reweight", [0, 1, 3])
def test_weights_matter_less_and_less(reweight):
    """Near stations the ranges differ: without weights the spread is larger, one pass suffices."""
    s, p, sigma = SQUARE, np.array([450.0, 380.0]), 1.0
    z = differences(distances(p, s) + np.random.default_rng(0).normal(0.0, sigma, (20_000, len(s))))
    fix = chan_ho(Stations(s), z, toa_sigma=sigma, speed=1.0, reweight=reweight)
    error = np.sum((fix.position - p) ** 2, axis=-1)
    bound = np.trace(bounds.crlb(Stations(s), p, toa_sigma=sigma, speed=1.0))
    excess = np.mean(error) / bound - 1.0
    tolerance = 4.0 * np.std(error) / np.sqrt(len(error)) / bound
    assert fix.iterations.max() == 1 + reweight
    assert (excess > tolerance) if reweight == 0 else (abs(excess) < tolerance)


@pytest.mark.parametrize("dims", [2, 3])
def test_any_pairs_that_connect_the_stations_give_the_same_fix(dims):
    s, p = ARRAYS[dims], PLACES[dims]
    t = distances(p, s) + np.random.default_rng(1).normal(0.0, 1.0, (4, len(s)))
    base = chan_ho(Stations(s), differences(t), toa_sigma=1.0, speed=1.0)
    star = pairs_against(len(s), 0)
    loops = np.concatenate([star, [[1, 2], [3, 1]]])
    chain = np.array([[i, i + 1] for i in range(len(s) - 1)])
    for pairs, index in (("adjacent", chain), (star[::-1], star[::-1]), (loops, loops)):
        z = t[:, index[:, 0]] - t[:, index[:, 1]]
        fix = chan_ho(Stations(s), z, toa_sigma=1.0, speed=1.0, pairs=pairs)
        assert_allclose(fix.position, base.position, atol=1e-6)
        assert_allclose(fix.covariance, base.covariance, rtol=1e-6)
        assert_allclose(fix.chi2, base.chi2, rtol=1e-6)


def test_independent_differences_are_weighted_by_their_own_errors():
    """More differences than S - 1 are joined by least squares: as good as the iteration."""
    s, p = SQUARE, PLACES[2]
    pairs = np.concatenate([pairs_against(5, 0), [[2, 1], [3, 2], [4, 3]]])
    sigma = np.array([1.0, 3.0, 1.0, 2.0, 0.5, 1.0, 4.0])
    t = distances(p, s)
    z = t[pairs[:, 0]] - t[pairs[:, 1]]
    z = z + 1e-3 * sigma * np.random.default_rng(2).normal(size=(50, 7))
    arguments = {"tdoa_sigma": 1e-3 * sigma, "speed": 1.0, "pairs": pairs}
    closed = chan_ho(Stations(s), z, **arguments)
    iterated = gauss_newton(Stations(s), z, initial=p, **arguments)
    assert_allclose(closed.covariance, iterated.covariance, rtol=1e-3)
    assert np.max(mahalanobis(closed.position - iterated.position, iterated.covariance)) < 1e-4


def test_receiver_errors_are_part_of_the_weights_and_of_the_covariance():
    rng = np.random.default_rng(6)
    Q = np.array([1.0, 25.0, 4.0, 100.0, 9.0])[:, None, None] * np.eye(2)
    stations = Stations(SQUARE, position_covariance=Q)
    p = PLACES[2]
    moved = SQUARE - rng.normal(size=(4000, 5, 2)) * np.sqrt(np.diagonal(Q, axis1=1, axis2=2))
    r = np.sqrt(np.sum((p - moved) ** 2, axis=-1)) + rng.normal(0.0, 1.0, (4000, 5))
    fix = chan_ho(stations, differences(r), toa_sigma=1.0, speed=1.0)
    bound = bounds.crlb(stations, p, toa_sigma=1.0, speed=1.0)
    away = mahalanobis(fix.position - p, bound)
    assert abs(np.mean(away) - 2.0) < 4.0 * np.std(away) / np.sqrt(len(away))
    trusting = bounds.crlb(Stations(SQUARE), p, toa_sigma=1.0, speed=1.0)
    assert np.trace(trusting) < 0.2 * np.trace(bound)


def test_batches_of_any_shape_and_the_speed_of_light():
    c = 299_792_458.0
    rng = np.random.default_rng(4)
    p = rng.uniform(-2e3, 2e3, (3, 2, 2))
    z = differences(distances(p, SQUARE))
    fix = chan_ho(Stations(SQUARE), z / c, toa_sigma=1e-9)
    assert fix.position.shape == (3, 2, 2)
    assert fix.covariance.shape == (3, 2, 2, 2)
    assert fix.chi2.shape == fix.dof.shape == fix.converged.shape == fix.iterations.shape == (3, 2)
    assert_allclose(fix.position, p, atol=1e-4)
    for index in np.ndindex(3, 2):
        one = chan_ho(Stations(SQUARE), z[index] / c, toa_sigma=1e-9)
        assert_allclose(fix.position[index], one.position, atol=1e-6)


@pytest.mark.parametrize(
    ("stations", "values", "arguments", "message"),
    [
        (SQUARE[:2], [0.0], {}, "stations: 2 stations cannot fix a position in 2 dimensions"),
        (CUBE[:3], [0.0, 0.0], {}, "expected at least 4"),
        (
            np.column_stack([np.arange(5.0), np.arange(5.0), 2 * np.arange(5.0)]),
            np.zeros(4),
            {},
            "stations: they stand in a straight line",
        ),
        (SQUARE, np.zeros(3), {}, "tdoa: expected shape"),
        (SQUARE, [0.0, np.nan, 0.0, 0.0], {}, "tdoa: expected finite numbers"),
        (SQUARE, np.zeros(4), {"toa_sigma": 0.0}, "toa_sigma: expected standard deviations above"),
        (SQUARE, np.zeros(4), {"toa_sigma": [1.0, 2.0]}, "toa_sigma: expected"),
        (SQUARE, np.zeros(4), {"toa_sigma": None}, "exactly one of toa_sigma"),
        (SQUARE, np.zeros(4), {"tdoa_sigma": 1.0}, "exactly one of toa_sigma"),
        (SQUARE, np.zeros(4), {"speed": -1.0}, "speed: expected a number above 0"),
        (SQUARE, np.zeros(4), {"reweight": -1}, "reweight: expected a whole number"),
        (SQUARE, np.zeros(3), {"pairs": [[1, 0], [2, 1], [2, 0]]}, "pairs: they do not connect"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(stations, values, arguments, message):
    with pytest.raises(ValueError, match=message):
        chan_ho(Stations(stations), values, **{"toa_sigma": 1.0, **arguments})


def test_moving_stations_are_refused():
    moving = Stations(np.stack([SQUARE, SQUARE + 1.0]), times=[0.0, 1.0])
    with pytest.raises(ValueError, match="use gauss_newton for moving ones"):
        chan_ho(moving, np.zeros(4), toa_sigma=1.0)

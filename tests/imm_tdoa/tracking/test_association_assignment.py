"""Global nearest neighbour against brute force over all assignments."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose, assert_array_equal

from imm_tdoa.tracking import GlobalNearest, Prediction, Unlabelled, assign
from imm_tdoa.tracking.gates import threshold


def every_choice(N, L):
    """All ways to give N targets one of L candidates each, or none (-1)."""
    slots = [*range(L), *[-1] * N]
    return set(permutations(slots, N))


def cost_of(choice, cost, unassigned):
    return sum(unassigned[n] if k < 0 else cost[n, k] for n, k in enumerate(choice))


@st.composite
def contests(draw):
    N, L = draw(st.integers(1, 5)), draw(st.integers(0, 5))
    cost = draw(
        arrays(float, (N, L), elements=st.floats(-20.0, 20.0) | st.sampled_from([np.inf, 0.0]))
    )
    return cost, draw(arrays(float, N, elements=st.floats(-20.0, 20.0)))


@settings(deadline=None, max_examples=120)
@given(contests())
def test_assignment_equals_brute_force(contest):
    cost, unassigned = contest
    got = assign(cost, unassigned)
    best = min(cost_of(c, cost, unassigned) for c in every_choice(*cost.shape))
    assert_allclose(cost_of(got, cost, unassigned), best, rtol=1e-12, atol=1e-9)
    used = got[got >= 0]
    assert len(set(used)) == len(used)


def test_assignment_refuses_what_is_no_cost():
    for bad, message in (
        ([1.0], "cost: expected shape"),
        ([[np.nan]], "cost: expected numbers"),
        ([[-np.inf]], "cost: expected numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            assign(bad)
    with pytest.raises(ValueError, match="unassigned: expected one cost or 1"):
        assign([[1.0]], [1.0, 2.0])
    with pytest.raises(ValueError, match="unassigned: expected finite"):
        assign([[1.0]], np.inf)


def test_nearest_for_both_is_given_to_the_one_that_fits_all():
    """Both targets are nearest 10; target 1 can also have 14: 0.25 + 1 against 4 + 2.25."""
    prediction = Prediction([[9.0], [12.0]], np.full((2, 1, 1), 4.0))
    got = GlobalNearest(over="station")(prediction, Unlabelled([10.0, 14.0], [0, 0]))
    assert_array_equal(got.values, [[10.0], [14.0]])
    assert_array_equal(got.unclaimed, [0.0, 0.0])


def test_the_more_certain_target_has_the_contested_value():
    """Normalised distances alone would give it to the uncertain one: 1/100 against 1/4."""
    prediction = Prediction([[0.0], [2.0]], [[[4.0]], [[100.0]]])
    got = GlobalNearest(over="station")(prediction, Unlabelled([1.0], [0]))
    assert_array_equal(got.values, [[1.0], [np.nan]])


def test_gate_and_price():
    one = Prediction([[0.0]], [[[1.0]]])
    edge = float(np.sqrt(threshold(0.99, np.array(1))))
    gate = GlobalNearest(gate_probability=0.99)
    assert_array_equal(gate(one, Unlabelled([edge - 1e-9], [0])).values, [[edge - 1e-9]])
    assert np.isnan(gate(one, Unlabelled([edge + 1e-9], [0])).values).all()
    # nis 4 and log det 0 against a price of 3.9 and 4.1
    for price, taken in ((3.9, False), (4.1, True)):
        got = GlobalNearest(unassigned=price)(one, Unlabelled([2.0], [0]))
        assert np.isfinite(got.values).all() == taken


@st.composite
def scans(draw, most_stations=3):
    N, m = draw(st.integers(1, 3)), draw(st.integers(1, most_stations))
    number = st.floats(-10.0, 10.0)
    mean = draw(arrays(float, (N, m), elements=number))
    A = draw(arrays(float, (N, m, m), elements=st.floats(-3.0, 3.0)))
    S = A @ np.swapaxes(A, -1, -2) + np.eye(m)
    row = np.repeat(np.arange(m), [draw(st.integers(0, 3)) for _ in range(m)])
    values = draw(arrays(float, len(row), elements=number))
    return Prediction(mean, S), Unlabelled(values, row)


@settings(deadline=None, max_examples=60)
@given(scans())
def test_each_station_by_itself_equals_brute_force(case):
    prediction, scan = case
    got = GlobalNearest(over="station")(prediction, scan)
    mean, S = prediction.bank()
    gate = float(threshold(0.9999, np.array(1)))
    for i in range(prediction.size):
        own = np.flatnonzero(scan.row == i)
        nis = (scan.values[own] - mean[:, [i]]) ** 2 / S[:, [i], i]
        log_det = np.broadcast_to(np.log(S[:, [i], i]), nis.shape)
        price = np.max(np.where(nis <= gate, gate + log_det, -np.inf), axis=0, initial=-np.inf)
        cost = np.where(nis <= gate, nis + log_det - price, np.inf)
        zero = np.zeros(prediction.count)
        best = min(cost_of(c, cost, zero) for c in every_choice(*cost.shape))
        n, k = np.nonzero(got.weight[:, own])
        assert len(set(k)) == len(k)
        assert_allclose(np.sum(cost[n, k]), best, rtol=1e-9, atol=1e-9)


def total_cost(prediction, scan, choices, gate_probability=0.9999):
    """Cost of all rows under their joint covariance; infinite outside the gates."""
    mean, S = prediction.bank()
    gate = float(threshold(gate_probability, np.array(1)))
    total = 0.0
    taken = [[] for _ in range(prediction.count)]
    for i, choice in choices.items():
        own = np.flatnonzero(scan.row == i)
        nis = (scan.values[own] - mean[:, [i]]) ** 2 / S[:, [i], i]
        edge = np.where(nis <= gate, gate + np.log(S[:, [i], i]), -np.inf)
        price = np.max(edge, axis=0, initial=-np.inf)
        for n, k in enumerate(choice):
            if k < 0:
                continue
            if nis[n, k] > gate:
                return np.inf
            total -= price[k]
            taken[n].append((i, scan.values[own[k]]))
    for n, rows in enumerate(taken):
        if rows:
            i = np.array([i for i, _ in rows])
            nu = np.array([z for _, z in rows]) - mean[n, i]
            part = S[n][np.ix_(i, i)]
            total += nu @ np.linalg.solve(part, nu) + np.linalg.slogdet(part)[1]
    return total


def chosen(prediction, scan, association):
    result = {}
    for i in np.unique(scan.row):
        own = np.flatnonzero(scan.row == i)
        part = association.weight[:, own]
        result[i] = tuple(int(np.argmax(w)) if w.any() else -1 for w in part)
    return result


@settings(deadline=None, max_examples=40)
@given(scans(most_stations=2))
def test_the_whole_scan_is_never_worse_than_its_stations(case):
    """And optimal at each station given the others; brute force bounds it from below."""
    prediction, scan = case
    sizes = {i: int(np.count_nonzero(scan.row == i)) for i in np.unique(scan.row)}
    whole = chosen(prediction, scan, GlobalNearest()(prediction, scan))
    alone = chosen(prediction, scan, GlobalNearest(over="station")(prediction, scan))
    got = total_cost(prediction, scan, whole)
    assert got <= total_cost(prediction, scan, alone) + 1e-9
    each = {i: every_choice(prediction.count, L) for i, L in sizes.items()}
    everything = (dict(zip(each, c, strict=True)) for c in product(*each.values()))
    assert got >= min((total_cost(prediction, scan, c) for c in everything), default=0.0) - 1e-9
    for i in each:
        others = (total_cost(prediction, scan, {**whole, i: c}) for c in each[i])
        assert got <= min(others) + 1e-9


def test_rows_that_contradict_each_other_do_not_go_to_one_target():
    """Station by station each target would take the value nearer by a hair.

    The rows of a target are off by the same amount (correlation 0.99), so the values of target 0
    are 20 and 20, those of target 1 are 10 and 11, whatever each station thinks by itself.
    """
    S = 400.0 * np.array([[1.0, 0.99], [0.99, 1.0]])
    prediction = Prediction([[14.0, 16.0], [14.5, 15.5]], [S, S])
    scan = Unlabelled([20.0, 10.0, 22.0, 11.0], [0, 0, 1, 1])
    got = GlobalNearest()(prediction, scan).values
    pairs = {tuple(row) for row in got}
    assert pairs == {(20.0, 22.0), (10.0, 11.0)}


def test_an_emission_goes_to_one_target_whole():
    """At the third station by itself the targets would have each other's value."""
    prediction = Prediction(
        [[0.0, 0.0, 12.5], [30.0, 30.0, 10.0]], np.broadcast_to(9.0 * np.eye(3), (2, 3, 3))
    )
    values = [0.5, -1.0, 9.9, 29.0, 31.0, 13.0]
    together = Unlabelled(values, [0, 1, 2, 0, 1, 2], emission=[0, 0, 0, 1, 1, 1])
    got = GlobalNearest()(prediction, together)
    assert_array_equal(got.values, [[0.5, -1.0, 9.9], [29.0, 31.0, 13.0]])
    apart = GlobalNearest(over="station")(prediction, Unlabelled(values, [0, 1, 2, 0, 1, 2]))
    assert_array_equal(apart.values[:, 2], [13.0, 9.9])


def test_a_target_without_an_emission_and_an_emission_without_a_target():
    prediction = Prediction([[0.0, 0.0], [50.0, 50.0]], np.broadcast_to(np.eye(2), (2, 2, 2)))
    scan = Unlabelled([0.1, -0.2, 25.0, 25.0], [0, 1, 0, 1], emission=[3, 3, 9, 9])
    got = GlobalNearest()(prediction, scan)
    assert_array_equal(got.values, [[0.1, -0.2], [np.nan, np.nan]])
    assert_array_equal(got.unclaimed, [0, 0, 1, 1])

"""Scans in the order a filter takes them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from imm_tdoa import Stations
from imm_tdoa.models import TDOA, Position
from imm_tdoa.scans import Scans

STATIONS = Stations([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
TDOA3 = TDOA(STATIONS, toa_sigma=1e-9)
PAIRS = np.array([[[1, 0]], [[2, 0]], [[3, 1]], [[2, 1]], [[3, 2]]])


def test_scans_unpack():
    values = np.zeros((5, 3))
    measurement, times, got, pairs = Scans.checked(TDOA3, range(5), values)
    assert measurement is TDOA3
    assert_array_equal(times, np.arange(5.0))
    assert_array_equal(got, values)
    assert pairs is None


def test_times_may_repeat():
    assert Scans.checked(TDOA3, [0.0, 0.0, 1.0], np.zeros((3, 3))).count == 3


@pytest.mark.parametrize(
    ("times", "values", "batch"),
    [
        (np.arange(4.0), np.zeros((4, 3)), ()),
        (np.arange(4.0), np.zeros((2, 5, 4, 3)), (2, 5)),
        (np.zeros((7, 4)), np.zeros((4, 3)), (7,)),
        (np.zeros((7, 4)), np.zeros((2, 7, 4, 3)), (2, 7)),
    ],
)
def test_batch_axes_of_times_and_values_broadcast(times, values, batch):
    scans = Scans.checked(TDOA3, times, values)
    assert scans.batch == batch
    assert scans.count == 4


def test_pairs_of_each_scan():
    scans = Scans.checked(TDOA3, np.arange(5.0), np.zeros((5, 1)), PAIRS)
    for k in range(5):
        assert_array_equal(scans.measured_at(k).pairs, PAIRS[k])
    assert_array_equal(scans.together().pairs, PAIRS)
    part = scans.part(slice(2, 4))
    assert_array_equal(part.times, [2.0, 3.0])
    assert_array_equal(part.measured_at(0).pairs, PAIRS[2])
    assert Scans.checked(TDOA3, [0.0], np.zeros((1, 3))).measured_at(0) is TDOA3


@pytest.mark.parametrize("shared", [True, False])
def test_every_scan_by_itself(shared):
    rng = np.random.default_rng(3)
    values, times = rng.normal(size=(2, 5, 1)), np.sort(rng.normal(size=(2, 5)))
    pairs = PAIRS if shared else np.stack([PAIRS, PAIRS[::-1]])
    whole = Scans.checked(TDOA3, times, values, pairs)
    single = whole.apart()
    assert (single.batch, single.count) == ((10,), 1)
    for i in range(2):
        one = whole.of_target((i,))
        for k in range(5):
            here = single.of_target((5 * i + k,))
            assert_array_equal(here.times, one.times[k : k + 1])
            assert_array_equal(here.values, one.values[k : k + 1])
            assert_array_equal(here.pairs, one.pairs[k : k + 1])
    assert Scans.checked(TDOA3, times, rng.normal(size=(2, 5, 3))).apart().pairs is None


def test_one_target_of_a_batch():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(2, 3, 5, 1))
    times = np.sort(rng.uniform(size=(3, 5)))
    pairs = np.stack([PAIRS, PAIRS[::-1], PAIRS])
    scans = Scans.checked(TDOA3, times, values, pairs)
    one = scans.of_target((1, 1))
    assert_array_equal(one.times, times[1])
    assert_array_equal(one.values, values[1, 1])
    assert_array_equal(one.pairs, PAIRS[::-1])
    assert one.batch == ()
    shared = Scans.checked(TDOA3, np.arange(5.0), values, PAIRS).of_target((0, 2))
    assert_array_equal(shared.pairs, PAIRS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"times": 3.0}, r"times: expected shape \(\.\.\., T,\)"),
        ({"times": []}, "times: expected at least one scan, got none"),
        ({"times": [0.0, np.nan, 1.0]}, "times: expected finite .* index 1"),
        ({"times": [0.0, 2.0, 1.0]}, r"times\[2\] = 1 s follows 2 s"),
        ({"times": [[0.0, 1.0, 2.0], [0.0, 5.0, 4.0]]}, r"times\[2\] = 4 s follows 5 s"),
        ({"times": "now"}, "times: expected numbers"),
        ({"values": np.zeros((3, 2))}, r"values: expected shape \(\.\.\., 3, 3\), got \(3, 2\)"),
        ({"values": np.zeros((4, 3))}, r"values: expected shape \(\.\.\., 3, 3\)"),
        ({"values": np.zeros(3)}, r"values: expected shape \(\.\.\., 3, 3\)"),
        ({"values": np.full((3, 3), -np.inf)}, r"values: infinite .* index \(0, 0\)"),
        (
            {"times": np.zeros((4, 3)), "values": np.zeros((5, 3, 3))},
            r"times: batch axes \(4,\) do not fit those of values, \(5,\)",
        ),
        ({"pairs": [[1, 0], [2, 0], [3, 0]]}, r"pairs: expected shape \(3, m, 2\)"),
        ({"pairs": [[[1, 0]], [[2, 0]]]}, r"pairs: expected shape \(3, m, 2\), got \(2, 1, 2\)"),
        ({"pairs": [[[1, 0, 2]]] * 3}, r"pairs: expected shape \(3, m, 2\)"),
        ({"pairs": [[[1, 0]]] * 3}, r"values: expected shape \(\.\.\., 3, 1\)"),
        ({"pairs": [[[1, 0]], [[9, 0]], [[1, 0]]]}, "pairs: station 9 does not exist"),
        ({"pairs": [[[1, 0]], [[1, 1]], [[1, 0]]]}, "pairs: station 1 is paired with itself"),
        ({"pairs": [[[1.5, 0]]] * 3}, "pairs: expected integers"),
        ({"pairs": [[[1, 0]], [[1]], [[1, 0]]]}, "pairs: expected "),
    ],
)
def test_refused(arguments, message):
    good = {"times": np.arange(3.0), "values": np.zeros((3, 3)), "pairs": None}
    if "pairs" in arguments and "values" not in message:
        good["values"] = np.zeros((3, 1))
    with pytest.raises(ValueError, match=message):
        Scans.checked(TDOA3, **{**good, **arguments})


def test_pairs_of_a_measurement_without_pairs_are_refused():
    with pytest.raises(ValueError, match="pairs: Position does not measure station pairs"):
        Scans.checked(Position(1.0), [0.0], np.zeros((1, 2)), [[[1, 0]]])

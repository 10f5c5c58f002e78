"""Constructors of measurement models refuse nonsense and name the argument."""

from __future__ import annotations

import numpy as np
import pytest

from imm_tdoa import Stations
from imm_tdoa.models import FDOA, TDOA, TOA, Height, Position, RangeRate, Stack

S = Stations([[0.0, 0.0], [6e3, 0.0], [0.0, 8e3]])
ONE = {
    "toa_sigma": lambda v, **more: TDOA(S, toa_sigma=v, **more),
    "tdoa_sigma": lambda v, **more: TDOA(S, tdoa_sigma=v, **more),
    "range_rate_sigma": lambda v, **more: FDOA(S, range_rate_sigma=v, **more),
    "difference_sigma": lambda v, **more: FDOA(S, difference_sigma=v, **more),
    "sigma": lambda v, **more: TOA(S, sigma=v, **more),
}
ROWS = {"toa_sigma": 3, "tdoa_sigma": 2, "range_rate_sigma": 3, "difference_sigma": 2, "sigma": 3}
OTHERS = [
    lambda v, **more: RangeRate(S, sigma=v, **more),
    lambda v, **more: Position(sigma=v, dims=2, **more),
    lambda v, **more: Height(sigma=v, **more),
]
EVERY = [*ONE.items(), *(("sigma", build) for build in OTHERS)]


@pytest.mark.parametrize(("name", "build"), EVERY)
@pytest.mark.parametrize("bad", [-1e-9, 0.0, np.nan, np.inf, "wide"])
def test_sigma_must_be_a_positive_number(name, build, bad):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        build(bad)


@pytest.mark.parametrize(("name", "build"), EVERY)
@pytest.mark.parametrize("shape", [(4,), (1, 2, 3), (3, 1)])
def test_sigma_must_have_one_number_per_row(name, build, shape):
    with pytest.raises(ValueError, match=rf"^{name}: expected one number or \d of them, got \("):
        build(np.ones(shape))


@pytest.mark.parametrize(("name", "build"), ONE.items())
def test_one_wrong_number_among_several(name, build):
    good = np.ones(ROWS[name])
    build(good)
    with pytest.raises(ValueError, match=f"^{name}: expected standard deviations above 0, got -2"):
        build(np.where(np.arange(len(good)) == 1, -2.0, good))


@pytest.mark.parametrize(("name", "build"), ONE.items())
def test_sampled_sigma(name, build):
    n = ROWS[name]
    build(np.ones((2, n)), sigma_times=[0.0, 1.0])
    build(np.array([[1.0] * n, [np.nan] * n]), sigma_times=[0.0, 1.0])
    with pytest.raises(ValueError, match=rf"^{name}: expected shape \(2, {n}\), got \(3, {n}\)"):
        build(np.ones((3, n)), sigma_times=[0.0, 1.0])
    with pytest.raises(ValueError, match=r"^sigma_times: expected strictly increasing times"):
        build(np.ones((2, n)), sigma_times=[1.0, 1.0])
    with pytest.raises(ValueError, match=f"^{name}: expected standard deviations above 0"):
        build(np.zeros((2, n)), sigma_times=[0.0, 1.0])


@pytest.mark.parametrize(
    ("cls", "names"),
    [(TDOA, ("toa_sigma", "tdoa_sigma")), (FDOA, ("range_rate_sigma", "difference_sigma"))],
)
def test_exactly_one_sigma(cls, names):
    for given in ({}, dict.fromkeys(names, 1.0)):
        with pytest.raises(ValueError, match=f"{cls.__name__}: give exactly one of {names[0]} "):
            cls(S, **given)


@pytest.mark.parametrize("cls", [TDOA, FDOA])
@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ([[3, 0]], "station 3 does not exist; there are 3"),
        ([[-1, 0]], "station -1 does not exist"),
        ([[1, 1]], "station 1 is paired with itself"),
        ([[1.0, 0.0]], "expected integers, got float64"),
        ([1, 0], r"expected shape \(\.\.\., m, 2\)"),
        ([[1, 0, 2]], r"expected shape \(\.\.\., m, 2\)"),
        ("all", "expected 'reference', 'adjacent' or an array"),
    ],
)
def test_pairs(cls, pairs, message):
    given = {"toa_sigma": 1e-7} if cls is TDOA else {"range_rate_sigma": 0.1}
    with pytest.raises(ValueError, match=f"^pairs: {message}"):
        cls(S, pairs=pairs, **given)
    with pytest.raises(ValueError, match=f"^pairs: {message}"):
        cls(S, **given).with_pairs(pairs)


def test_new_pairs_must_fit_the_sigma_of_each_row():
    model = TDOA(S, tdoa_sigma=[1e-7, 2e-7])
    assert model.with_pairs([[0, 1], [2, 1]]).size == 2
    with pytest.raises(ValueError, match=r"^tdoa_sigma: expected one number or 1 of them"):
        model.with_pairs([[0, 1]])


@pytest.mark.parametrize("build", [TDOA, TOA])
@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, "fast"])
def test_speed(build, bad):
    sigma = {"toa_sigma": 1e-7} if build is TDOA else {"sigma": 1e-7}
    with pytest.raises(ValueError, match=r"^speed: expected"):
        build(S, speed=bad, **sigma)


@pytest.mark.parametrize("bad", [0, 4, 1.5, True, "2"])
def test_dims_of_position(bad):
    with pytest.raises(ValueError, match=r"^dims: expected 1, 2 or 3"):
        Position(dims=bad)


def test_models_without_pairs_say_so():
    for model in (Position(), Height(), TOA(S, sigma=1e-7), RangeRate(S, sigma=1.0)):
        with pytest.raises(ValueError, match=f"pairs: {type(model).__name__} does not measure"):
            model.with_pairs([[1, 0]])


def test_stack():
    with pytest.raises(ValueError, match="Stack: expected at least one measurement model"):
        Stack()
    with pytest.raises(ValueError, match="Stack: argument 1 is no measurement model: 3"):
        Stack(TOA(S, sigma=1e-7), 3)
    with pytest.raises(ValueError, match="Stack: models of 2 and 3 dimensions do not go together"):
        Stack(TOA(S, sigma=1e-7), Height())

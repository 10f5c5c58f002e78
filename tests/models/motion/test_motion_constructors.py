"""Constructors of motion models refuse nonsense and name the argument."""

from __future__ import annotations

import pytest

from imm_tdoa.models import (
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Singer,
    Static,
)

ALL = [Static, ConstantVelocity, ConstantAcceleration, Singer, CoordinatedTurn]


@pytest.mark.parametrize("cls", ALL)
@pytest.mark.parametrize("name", ["psd", "std"])
@pytest.mark.parametrize("bad", [-1.0, float("nan"), float("inf"), "1", [1.0], True])
def test_bad_noise(cls, name, bad):
    with pytest.raises(ValueError, match=f"^{name}: expected"):
        cls(**{name: bad})


@pytest.mark.parametrize("cls", ALL)
@pytest.mark.parametrize("given", [{}, {"psd": 1.0, "std": 1.0}])
def test_exactly_one_of_psd_and_std(cls, given):
    with pytest.raises(ValueError, match=f"{cls.__name__}: give exactly one of psd .* and std"):
        cls(**given)


@pytest.mark.parametrize("bad", [0.0, -1.0, float("nan")])
def test_time_constant(bad):
    with pytest.raises(ValueError, match=r"^time_constant: expected"):
        Singer(psd=1.0, time_constant=bad)


@pytest.mark.parametrize("bad", [-1.0, float("nan")])
def test_turn_rate_noise(bad):
    with pytest.raises(ValueError, match=r"^turn_rate_psd: expected"):
        CoordinatedTurn(psd=1.0, turn_rate_psd=bad)


@pytest.mark.parametrize("cls", ALL)
def test_models_are_values(cls):
    assert cls(psd=1.0) == cls(psd=1.0) != cls(psd=2.0)
    with pytest.raises(AttributeError):
        cls(psd=1.0).psd = 2.0

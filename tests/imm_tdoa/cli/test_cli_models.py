"""``imm-tdoa models``."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import pytest
from cli_cases import run, words

from imm_tdoa import registry, testing
from imm_tdoa.cli import models
from imm_tdoa.contract import LinearMotion, component_names


class Leaky(LinearMotion):
    """Loses its velocity matrix."""

    def components(self, dims: int) -> tuple[str, ...]:
        if dims not in (1, 2, 3):
            raise ValueError("dims")
        return component_names(dims, 1)

    def transition(self, dt: Any, dims: int) -> Any:
        dt = np.asarray(dt, dtype=float)
        if not np.all(dt >= 0):
            raise ValueError("dt")
        F = np.eye(2 * dims) + np.zeros((*dt.shape, 2 * dims, 2 * dims))
        F[..., :dims, dims:] = 1.1 * dt[..., None, None] * np.eye(dims)
        return F

    def process_noise(self, dt: Any, dims: int) -> Any:
        dt = np.asarray(dt, dtype=float)
        return dt[..., None, None] * np.eye(2 * dims)


@pytest.fixture(autouse=True)
def few_examples(monkeypatch: pytest.MonkeyPatch) -> None:
    """The laws themselves are tried elsewhere."""
    monkeypatch.setattr(testing, "verdicts", partial(testing.verdicts, examples=5))


def test_every_model_is_listed() -> None:
    code, text = run("models")
    assert code == 0
    for name in registry.names():
        assert name in text
    assert "turn_rate_psd" in text
    assert "imm-tdoa" in text
    assert "§" not in text


def test_models_by_name() -> None:
    code, text = run("models", "toa", "static")
    assert code == 0
    assert text.splitlines()[1].startswith("static")
    assert "coordinated-turn" not in text
    code, text = run("models", "statik", "--check")
    assert code == 2
    assert text.startswith("imm-tdoa: error: there is no model 'statik' (did you mean 'static'?)")
    assert text.count("\n") == 1


def test_check_tells_law_by_law(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [models.Entry("static", "imm-tdoa", registry.load("static"))]
    monkeypatch.setattr(models, "_entries", lambda: entries)
    code, text = run("models", "--check")
    assert code == 0
    assert "static: all 19 laws hold" in words(text)
    assert "1 of 1 models keep every law" in words(text)
    assert "semigroup" not in text
    code, text = run("models", "static", "--check")
    assert code == 0
    assert "static: all 19 laws hold" in words(text)
    assert "semigroup holds propagate(propagate(x, a), b) = propagate(x, a + b)" in words(text)


def test_check_returns_1_for_a_broken_law(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [
        models.Entry("leaky", "elsewhere", Leaky),
        models.Entry("gone", "elsewhere", error="cannot be loaded: ImportError: no such thing"),
    ]
    monkeypatch.setattr(models, "_entries", lambda: entries)
    code, text = run("models", "--check")
    assert code == 1
    assert "BROKEN" in text
    assert "kinematics BROKEN d position / dt = velocity" in words(text)
    assert "gone: cannot be loaded: ImportError: no such thing" in words(text)
    assert words(text).endswith("0 of 2 models keep every law; not leaky, gone")
    assert run("models")[0] == 0


def test_a_plugin_that_fails_to_load_does_not_hide_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    load = registry.load

    def failing(name: str) -> Any:
        if name == "singer":
            raise ImportError("its package is missing")
        return load(name)

    monkeypatch.setattr(registry, "load", failing)
    found = {entry.name: entry for entry in models._entries()}
    assert found["singer"].error == "cannot be loaded: ImportError: its package is missing"
    assert found["singer"].kind == "-"
    assert found["tdoa"].kind == "measurement"
    assert found["static"].kind == "motion"

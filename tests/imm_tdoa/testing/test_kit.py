"""The kit itself: reports, registries, determinism, and what it leaves behind."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np
import pytest

from imm_tdoa import registry, testing
from imm_tdoa.contract import MeasurementModel, MotionModel
from imm_tdoa.models import TDOA, ConstantVelocity, CoordinatedTurn, Position
from imm_tdoa.testing.compare import agree, finite, show
from imm_tdoa.testing.derivative import derivative
from imm_tdoa.testing.laws import ViolationError


def test_laws_have_names_and_statements():
    for laws in (testing.motion_laws(), testing.measurement_laws()):
        names = [law.name for law in laws]
        assert len(set(names)) == len(names)
        assert all(law.statement and "\n" not in law.statement for law in laws)
        assert all(law.holds.__doc__ for law in laws)


def test_verdicts_tell_exemptions_with_their_reason():
    found = {v.law: v for v in testing.verdicts(ConstantVelocity(std=1.0), examples=5)}
    assert found["noise composes"].outcome == "exempt"
    assert "composes = False" in found["noise composes"].message
    assert {v.outcome for name, v in found.items() if name != "noise composes"} == {"holds"}
    found = {v.law: v for v in testing.verdicts(Position(dims=2), examples=5)}
    assert found["translation"].outcome == "exempt"
    assert "no attrs class with the fields stations" in found["translation"].message


@pytest.mark.parametrize(
    ("check", "model", "message"),
    [
        (testing.check_motion_model, ConstantVelocity, "expected an instance, got the class Cons"),
        (testing.check_measurement_model, TDOA, r"make one, TDOA\(\.\.\.\), and check that"),
        (testing.broken_laws, TDOA, "expected an instance"),
        (testing.check_motion_model, np.linalg.norm, "expected a model, got the function norm"),
        (testing.broken_laws, 3, "neither process_noise nor noise_covariance"),
    ],
)
def test_no_model_at_all(check, model, message):
    with pytest.raises(ValueError, match=f"model: .*{message}"):
        check(model)


@pytest.mark.parametrize("bad", [0, -1, 2.5, True])
def test_examples_must_be_a_count(bad):
    with pytest.raises(ValueError, match="examples: expected a whole number above 0"):
        testing.check_motion_model(ConstantVelocity(psd=1.0), examples=bad)


def test_dims_and_without_are_checked():
    model = ConstantVelocity(psd=1.0)
    with pytest.raises(ValueError, match="dims: expected 1, 2 or 3"):
        testing.check_motion_model(model, dims=(4,))
    with pytest.raises(ValueError, match="dims: expected some of 1, 2 and 3, got none"):
        testing.check_motion_model(model, dims=())
    with pytest.raises(ValueError, match="without: there is no law 'gravity'; there are: inter"):
        testing.check_motion_model(model, without=("gravity",))


def test_dims_a_model_refuses_are_left_out_but_one_must_remain():
    testing.check_motion_model(CoordinatedTurn(psd=1.0), dims=(1, 2), examples=5)
    with pytest.raises(AssertionError, match="components refuses all of dims = 1"):
        testing.check_motion_model(CoordinatedTurn(psd=1.0), dims=(1,), examples=5)


def test_the_same_report_every_time():
    class Broken(ConstantVelocity):
        def jacobian(self, x, dt):
            return np.swapaxes(super().jacobian(x, dt), -1, -2)

    first, second = (testing.broken_laws(Broken(psd=1.0), examples=12) for _ in range(2))
    assert first == second
    assert {one.law for one in first} == {"linear", "jacobian"}


@pytest.mark.parametrize("name", registry.names())
def test_every_registered_model_has_a_specimen(name):
    cls = registry.load(name)
    model = testing.specimen(cls)
    assert isinstance(model, cls)
    assert isinstance(model, MotionModel) != isinstance(model, MeasurementModel)


def test_specimen_prefers_what_the_class_offers_and_names_what_it_cannot_guess():
    class Own:
        def __init__(self, frequency):
            self.frequency = frequency

    with pytest.raises(ValueError, match=r"Own: cannot guess its argument frequency; .*specimen"):
        testing.specimen(Own)
    Own.specimen = classmethod(lambda cls: cls(433e6))
    assert testing.specimen(Own).frequency == 433e6

    class Stubborn:
        def __init__(self, psd):
            raise ValueError("psd: never right")

    with pytest.raises(ValueError, match="psd: never right"):
        testing.specimen(Stubborn)


def test_import_is_lazy_and_a_check_leaves_nothing_behind(tmp_path):
    """`import imm_tdoa` loads no hypothesis; a check writes no .hypothesis folder."""
    script = (
        "import sys, imm_tdoa\n"
        "assert 'hypothesis' not in sys.modules\n"
        "from imm_tdoa.models import Static\n"
        "imm_tdoa.testing.check_motion_model(Static(psd=1.0), examples=3)\n"
        "assert 'hypothesis' in sys.modules\n"
    )
    env = {k: v for k, v in os.environ.items() if not k.startswith("HYPOTHESIS")}
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env=env, check=True, timeout=120)
    assert list(tmp_path.iterdir()) == []


def test_derivative_of_known_functions():
    """Against the derivatives of sine and of a cubic; the error bound covers the error."""
    x = np.array([0.3, -2.0])
    best, error = derivative(
        lambda y: np.array([np.sin(10.0 * y[0]), y[0] * y[1] ** 3]), x, np.full(2, 0.01)
    )
    exact = np.array([[10.0 * np.cos(3.0), 0.0], [-8.0, 3.0 * 0.3 * 4.0]])
    assert np.all(np.abs(best - exact) <= error + 1e-300)
    assert np.all(error < 1e-9)
    ahead, error = derivative(lambda t: np.exp(-t), np.zeros(1), np.array([0.1]), one_sided=True)
    assert abs(ahead[0, 0] + 1.0) <= error[0, 0] < 1e-4


def test_agree_tells_the_worst_entry():
    a = np.array([[1.0, 2.0], [3.0, 4.0]])
    with pytest.raises(ViolationError) as caught:
        agree("A", a, "B", a + np.array([[0.0, 0.1], [0.0, 1.0]]), names=("x", "vx"))
    assert str(caught.value) == (
        "A[vx, vx] is 4, but B[vx, vx] is 5 (they differ by 1; 2 entries differ, this one most)"
    )
    with pytest.raises(ViolationError, match=r"A has shape \(2, 2\), but B \(2,\)"):
        agree("A", a, "B", a[0])
    with pytest.raises(ViolationError, match=r"A\[1\] is nan, but B\[1\] is 0"):
        agree("A", np.array([0.0, np.nan]), "B", np.zeros(2))
    agree("A", np.array([np.nan, np.inf]), "B", np.array([np.nan, np.inf]))
    agree("A", np.array([1e-9]), "0", np.zeros(1), scale=np.array([10.0]))


def test_finite_tells_what_is_wrong():
    with pytest.raises(ViolationError, match="f is no array of numbers but str"):
        finite("f", "x", ())
    with pytest.raises(ViolationError, match=r"f is not finite: \[1, nan\]"):
        finite("f", [1.0, np.nan], (2,))


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.0, "1"),
        (np.float64(0.1), "0.1"),
        (np.array([1.0, 1 / 3]), "[1, 0.333333]"),
        (np.array([[True, False]]), "[[True, False]]"),
        (np.array(2.5), "2.5"),
        (3, "3"),
        (np.array([0, 2]), "[0, 2]"),
    ],
)
def test_values_are_shown_short(value, text):
    assert show(value) == text

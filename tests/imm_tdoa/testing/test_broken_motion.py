"""Motion models with one fault each: the law that should catch it does, and no unrelated one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from imm_tdoa.models import ConstantVelocity, CoordinatedTurn
from imm_tdoa.testing import broken_laws, check_motion_model

EYE = np.eye(2)


def step(dt: Any) -> Any:
    """Return dt, refused where it is no time step."""
    dt = np.asarray(dt, dtype=float)
    if not np.all(dt >= 0.0):
        raise ValueError(f"dt: expected at least 0 s, got {dt}")
    return dt


def kron(f: Any, d: int) -> Any:
    """Blocked layout, one matrix for all axes."""
    f = np.asarray(f)
    full = np.einsum("...ab,ij->...aibj", f, np.eye(d))
    return full.reshape(*f.shape[:-2], f.shape[-2] * d, f.shape[-1] * d)


def rows(*entries: Any) -> Any:
    """Build (..., k, k) from rows of numbers and arrays (...)."""
    shape = np.broadcast_shapes(*(np.shape(e) for row in entries for e in row))
    return np.stack(
        [np.stack([np.broadcast_to(e, shape) for e in row], axis=-1) for row in entries], axis=-2
    )


class Sound:
    """Constant velocity with white acceleration of density 1, written from the textbook."""

    def components(self, dims):
        if dims not in (1, 2, 3):
            raise ValueError("dims: expected 1, 2 or 3")
        return tuple("xyz"[:dims]) + tuple("v" + axis for axis in "xyz"[:dims])

    def f(self, dt):
        return rows([1.0, dt], [0.0, 1.0])

    def q(self, dt):
        return rows([dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt])

    def propagate(self, x, dt):
        return np.einsum("...ij,...j->...i", kron(self.f(step(dt)), x.shape[-1] // self.order), x)

    def jacobian(self, x, dt):
        return kron(self.f(step(dt)), x.shape[-1] // self.order)

    def process_noise(self, dt, dims):
        self.components(dims)
        return kron(self.q(step(dt)), dims)

    order = 2


class WrongScaling(Sound):
    def q(self, dt):
        return np.asarray(dt)[..., None, None] * super().q(dt)


class MissingPositionNoise(Sound):
    def q(self, dt):
        return rows([0.0 * dt, 0.0], [0.0, dt])


class NoPositionNoiseEver(MissingPositionNoise):
    composes = False


class AsymmetricNoise(Sound):
    """dt J, J the quarter turn, composes as a covariance would."""

    def q(self, dt):
        return super().q(dt) + 0.1 * rows([0.0, dt], [-dt, 0.0])


class IndefiniteNoise(Sound):
    """Composes with a negative density, too."""

    def q(self, dt):
        return -super().q(dt)


class NoiseAtOnce(Sound):
    composes = False

    def q(self, dt):
        return super().q(dt) + EYE


class FadingNoise(Sound):
    composes = False

    def q(self, dt):
        return super().q(dt) * np.exp(-dt)[..., None, None]


class LopsidedNoise(Sound):
    """Three times as much noise along x: a frame that nothing in the state knows about."""

    def process_noise(self, dt, dims):
        Q = np.array(super().process_noise(dt, dims))
        along_x = np.diag(np.tile([3.0**0.5] + [1.0] * (dims - 1), 2))
        return along_x @ Q @ along_x


class Transposed(Sound):
    def f(self, dt):
        return np.swapaxes(super().f(dt), -1, -2)


class NotSquared(Sound):
    order = 3

    def components(self, dims):
        return (*super().components(dims), *("a" + axis for axis in "xyz"[:dims]))

    def f(self, dt):
        return rows([1.0, dt, dt / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0])

    def q(self, dt):
        return 0.0 * self.f(dt)


class Drifting(Sound):
    """Adds a metre whatever the step."""

    def propagate(self, x, dt):
        return super().propagate(x, dt) + 1.0


class Noiseless(Sound):
    def q(self, dt):
        return 0.0 * super().q(dt)


class RotatedFrame(Noiseless):
    """Drag along x alone."""

    def propagate(self, x, dt):
        return np.einsum("...ij,...j->...i", self.jacobian(x, dt), x)

    def jacobian(self, x, dt):
        F = np.array(super().jacobian(x, dt))
        d = x.shape[-1] // 2
        decay = np.exp(-0.1 * step(dt))
        F[..., 0, d] = (1.0 - decay) / 0.1
        F[..., d, d] = decay
        return F


class Homing(Noiseless):
    """The position relaxes to the origin: it knows a place."""

    order = 1

    def components(self, dims):
        return super().components(dims)[:dims]

    def f(self, dt):
        return rows([np.exp(-0.1 * dt)])

    def q(self, dt):
        return rows([0.0 * dt])


class WrongNames(Sound):
    def components(self, dims):
        return tuple(
            name.replace("x", "east").replace("y", "north") for name in super().components(dims)
        )


class HalfVelocity(Sound):
    def components(self, dims):
        names = super().components(dims)
        return (*names[:-1], "speed") if dims > 1 else names


class RepeatedName(Sound):
    def components(self, dims):
        return (*super().components(dims)[:-1], "x")


class Interleaved(Sound):
    """Claims blocks and computes x vx y vy."""

    def propagate(self, x, dt):
        return np.einsum("...ij,...j->...i", self.jacobian(x, dt), x)

    def jacobian(self, x, dt):
        f, d = self.f(step(dt)), x.shape[-1] // 2
        return np.einsum("...ab,ij->...iajb", f, np.eye(d)).reshape(*f.shape[:-2], 2 * d, 2 * d)


class RefusesNothing(Sound):
    def components(self, dims):
        return tuple("xyzw"[:dims]) + tuple("v" + axis for axis in "xyzw"[:dims])

    def propagate(self, x, dt):
        return np.einsum("...ij,...j->...i", self.jacobian(x, dt), x)

    def jacobian(self, x, dt):
        return kron(self.f(np.asarray(dt)), x.shape[-1] // 2)

    def process_noise(self, dt, dims):
        return kron(self.q(np.asarray(dt)), dims)


class OneAtATime(Sound):
    """Takes no batch of time steps."""

    def process_noise(self, dt, dims):
        if np.ndim(dt) and np.all(step(dt) >= 0):
            raise TypeError("only single steps")
        return super().process_noise(dt, dims)


class InPlace(Sound):
    def propagate(self, x, dt):
        before = np.array(x)
        after = super().propagate(x, dt)
        if step(dt).size == 1 and x.ndim == 1 and np.any(after != before):
            x[: x.shape[-1] // 2] += 0.0
            x[-1] += 1e-30 + 1e-13 * abs(x[-1])
        return after


class ScalesItsJacobian(Sound):
    """A transition matrix that is right, beside a Jacobian with dt in the wrong column."""

    def transition(self, dt, dims):
        self.components(dims)
        return kron(self.f(step(dt)), dims)

    def jacobian(self, x, dt):
        return super().jacobian(x, dt) * np.where(np.asarray(dt) > 0.0, 1.01, 1.0)[..., None, None]


class JacobianSign(CoordinatedTurn):
    """The influence of the turn rate with the wrong sign."""

    def jacobian(self, x, dt):
        F = np.array(super().jacobian(x, dt))
        F[..., :-1, -1] *= -1.0
        return F


CASES = [
    (WrongScaling(), {"noise composes"}),
    (MissingPositionNoise(), {"noise reaches position", "noise composes"}),
    (NoPositionNoiseEver(), {"noise reaches position"}),
    (AsymmetricNoise(), {"noise covariance"}),
    (IndefiniteNoise(), {"noise covariance", "noise grows"}),
    (NoiseAtOnce(), {"noise at once"}),
    (FadingNoise(), {"noise grows"}),
    (LopsidedNoise(), {"isotropy"}),
    (Transposed(), {"kinematics", "translation", "noise composes"}),
    (NotSquared(), {"semigroup", "kinematics"}),
    (Drifting(), {"identity", "semigroup", "rotation"}),
    (RotatedFrame(), {"rotation"}),
    (Homing(), {"translation"}),
    (WrongNames(), {"components"}),
    (HalfVelocity(), {"components", "rotation", "isotropy"}),  # half a vector cannot be turned
    (RepeatedName(), {"components", "rotation", "isotropy"}),
    (Interleaved(), {"kinematics", "translation", "rotation", "noise composes"}),
    (RefusesNothing(), {"refusal"}),
    (OneAtATime(), {"batch"}),
    (InPlace(), {"pure"}),
    (ScalesItsJacobian(), {"linear", "jacobian"}),
    (JacobianSign(psd=1.0), {"jacobian"}),
]


def test_the_sound_one_breaks_nothing():
    assert broken_laws(Sound(), examples=20) == []


@pytest.mark.parametrize(("model", "expected"), CASES, ids=lambda v: type(v).__name__)
def test_each_fault_is_caught_by_its_law(model, expected):
    assert {one.law for one in broken_laws(model, examples=10)} == expected


def test_the_report_names_law_equation_values_and_size():
    with pytest.raises(AssertionError) as caught:
        check_motion_model(WrongScaling(), examples=12)
    text = str(caught.value)
    assert "breaks 1 of the 19 laws of motion models" in text
    assert "noise composes: Q(a + b) = F(b) Q(a) F(b)' + Q(b), F at rest" in text
    assert "for dims = 1, a = 1, b = 1" in text  # the simplest example there is
    assert "Q(a + b)[x, x] is 5.33333, but F(b) Q(a) F(b)' + Q(b)[x, x] is 2.66667" in text
    assert "(they differ by 2.66667; 4 entries differ, this one most)" in text


def test_all_broken_laws_are_listed():
    with pytest.raises(AssertionError) as caught:
        check_motion_model(Transposed(), examples=12)
    for law in ("kinematics", "translation", "noise composes"):
        assert f"\n  {law}: " in str(caught.value)


def test_an_exception_in_the_model_is_told_with_its_method():
    class Raises(Sound):
        def jacobian(self, x, dt):
            step(dt)
            raise IndexError("list index out of range")

    found = {one.law: one.message for one in broken_laws(Raises(), examples=12)}
    assert set(found) == {"shapes"}  # a gate: what needs a Jacobian is not tried
    assert "jacobian raised IndexError: list index out of range" in found["shapes"]
    assert "for dims = 1, x = [0, 0], dt = 1" in found["shapes"]


def test_a_model_that_dices_is_told_so():
    generator = np.random.default_rng(1)

    class Dices(Sound):
        def propagate(self, x, dt):
            return super().propagate(x, dt) * (1.0 + 1e-3 * generator.uniform(0.5, 1.0))

    assert "pure" in {one.law for one in broken_laws(Dices(), examples=12)}


def test_a_missing_method_and_a_wrong_count_close_the_gate():
    class NoNoise:
        def components(self, dims):
            return ("x",)

    with pytest.raises(AssertionError, match=r"has no propagate, jacobian, process_noise") as e:
        check_motion_model(NoNoise())
    assert "(18 could not be tried)" in str(e.value)

    class OneNameTooMany(Sound):
        def components(self, dims):
            return (*super().components(dims), "omega")

    found = broken_laws(OneNameTooMany())
    assert [one.law for one in found] == ["shapes"]


def test_no_dimension_at_all():
    class Refuses(Sound):
        def components(self, dims):
            raise ValueError("dims: none will do")

    found = {one.law: one.message for one in broken_laws(Refuses())}
    assert set(found) == {"components", "shapes"}
    assert "refuses all of dims = 1, 2, 3" in found["components"]


def test_a_law_can_be_left_out():
    check_motion_model(Homing(), without=("translation",), examples=12)
    check_motion_model(ConstantVelocity(psd=1.0), dims=(2,), examples=5)

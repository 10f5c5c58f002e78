"""Banks: the Markov chain over time, names, components, and what is refused."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from imm_tdoa import Bank
from imm_tdoa.contract import LinearMotion
from imm_tdoa.models import (
    TDOA,
    ConstantAcceleration,
    ConstantVelocity,
    CoordinatedTurn,
    Position,
    Singer,
    Static,
)

times = st.floats(1e-3, 1e4)
THREE = [Static(psd=0.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)]


def modes(r):
    return [ConstantVelocity(psd=float(k + 1)) for k in range(r)]


class TestChain:
    @settings(deadline=None, max_examples=60)
    @given(a=st.floats(0.5, 1e4), b=st.floats(0.5, 1e4), dt=st.floats(0.0, 1e5))
    def test_two_modes_closed_form(self, a, b, dt):
        """ALGORITHMS §9.2, leave rates a = 1/tau_1, b = 1/tau_2."""
        bank = Bank(modes(2), mean_sojourn=[a, b])
        p, q = 1.0 / a, 1.0 / b
        gone = -np.expm1(-(p + q) * dt)
        want = np.eye(2) + gone / (p + q) * np.array([[-p, p], [q, -q]])
        assert_allclose(bank.chain(dt), want, atol=2e-14)

    @settings(deadline=None, max_examples=60)
    @given(r=st.integers(2, 5), tau=st.floats(0.5, 1e4), dt=st.floats(0.0, 1e5))
    def test_equal_modes_closed_form(self, r, tau, dt):
        Pi = Bank(modes(r), mean_sojourn=tau).chain(dt)
        stay = 1 / r + (1 - 1 / r) * np.exp(-r / (r - 1) * dt / tau)
        want = np.where(np.eye(r) == 1, stay, (1 - stay) / (r - 1))
        assert_allclose(Pi, want, atol=2e-14)

    def test_the_number_of_the_specification(self):
        assert_allclose(Bank(THREE, mean_sojourn=60.0).chain(2.0)[0, 0], 0.967486, atol=5e-7)

    @settings(deadline=None, max_examples=60)
    @given(a=times, b=times, tau=st.lists(st.floats(0.5, 1e4), min_size=2, max_size=4))
    def test_semigroup(self, a, b, tau):
        bank = Bank(modes(len(tau)), mean_sojourn=tau)
        assert_allclose(bank.chain(a + b), bank.chain(a) @ bank.chain(b), atol=1e-14)

    @settings(deadline=None, max_examples=30)
    @given(dt=times, tau=st.lists(st.floats(0.5, 1e4), min_size=2, max_size=4))
    def test_rows_are_probabilities(self, dt, tau):
        Pi = Bank(modes(len(tau)), mean_sojourn=tau).chain(dt)
        assert np.all(Pi >= 0.0)
        assert_allclose(Pi.sum(axis=-1), 1.0, rtol=1e-15)

    @pytest.mark.parametrize("dt", [1e-12, 1e-3, 1.0, 17.0, 1e3])
    @pytest.mark.parametrize("tau", [[1e-2, 1e7, 40.0], [1.0, np.inf, 3.0], [5.0, 5.0, 5.0]])
    def test_any_rates_and_steps(self, tau, dt):
        bank = Bank(modes(3), mean_sojourn=tau)
        assert_allclose(bank.chain(dt), expm(bank.generator() * dt), rtol=1e-10, atol=1e-12)

    def test_after_a_long_time_only_the_sojourn_times_count(self):
        """Leaving goes evenly to the others, so each mode's share is its mean sojourn time."""
        tau = np.array([1e-2, 1e5, 40.0])
        got = Bank(modes(3), mean_sojourn=tau).chain(1e9)
        assert_allclose(got, np.tile(tau / tau.sum(), (3, 1)), rtol=1e-10)
        for_ever = Bank(modes(2), mean_sojourn=[1.0, 3.0]).chain(1e300)
        assert_allclose(for_ever, [[0.25, 0.75]] * 2, rtol=1e-12)

    def test_many_steps_at_once(self):
        dt = np.random.default_rng(0).exponential(30.0, (40, 25))
        bank = Bank(modes(3), mean_sojourn=[5.0, 50.0, 500.0])
        assert_allclose(bank.chain(dt)[7, 3], bank.chain(dt[7, 3]), atol=1e-15)
        assert bank.chain(np.zeros((0, 4))).shape == (0, 4, 3, 3)

    def test_generator(self):
        bank = Bank(modes(3), mean_sojourn=[10.0, 20.0, 40.0])
        want = [[-0.1, 0.05, 0.05], [0.025, -0.05, 0.025], [0.0125, 0.0125, -0.025]]
        assert_allclose(bank.generator(), want, rtol=1e-15)
        assert_allclose(bank.chain(7.0), expm(7.0 * np.array(want)), atol=1e-15)

    def test_no_time_no_switch(self):
        for bank in (
            Bank(modes(2), mean_sojourn=1e-3),
            Bank(modes(2), transition=[[0.5, 0.5], [0.1, 0.9]]),
        ):
            assert_array_equal(bank.chain(0.0), np.eye(2))

    def test_times_of_a_batch_each_have_their_own_chain(self):
        bank = Bank(THREE, mean_sojourn=[10.0, 30.0, 5.0])
        dt = np.array([[0.0, 1.0], [0.5, 1.0], [1e4, 0.0]])
        Pi = bank.chain(dt)
        assert Pi.shape == (3, 2, 3, 3)
        for index in np.ndindex(dt.shape):
            assert_allclose(Pi[index], bank.chain(dt[index]), atol=1e-15)

    def test_a_fixed_transition_is_applied_once_whatever_the_step(self):
        Pi = np.array([[0.9, 0.1], [0.3, 0.7]])
        bank = Bank(modes(2), transition=Pi)
        dt = np.array([0.0, 1e-9, 1.0, 50.0])
        assert_array_equal(bank.chain(dt), [np.eye(2), Pi, Pi, Pi])
        with pytest.raises(ValueError, match="no generator"):
            bank.generator()

    def test_one_mode_stays(self):
        assert_array_equal(Bank(modes(1)).chain(np.array([0.0, 3.0])), np.ones((2, 1, 1)))

    def test_an_endless_sojourn_is_the_identity_chain(self):
        assert_array_equal(Bank(modes(3), mean_sojourn=np.inf).chain(1e6), np.eye(3))

    @pytest.mark.parametrize("dt", [-1.0, np.nan, np.inf])
    def test_bad_time_steps(self, dt):
        with pytest.raises(ValueError, match="dt: expected a finite time step of at least 0"):
            Bank(modes(2)).chain(dt)

    def test_the_default_sojourn_is_a_minute(self):
        assert_array_equal(Bank(modes(2)).mean_sojourn, [60.0, 60.0])
        assert_array_equal(Bank(modes(2)).prior, [0.5, 0.5])


@attrs.frozen
class Drifting(LinearMotion):
    """A stranger's model whose components come in another order, one of them its own."""

    def components(self, dims):
        return ("bias", *(f"v{a}" for a in "xyz"[:dims]), *"xyz"[:dims])

    def transition(self, dt, dims):
        raise NotImplementedError

    def process_noise(self, dt, dims):
        raise NotImplementedError


class TestSpace:
    def test_union_of_components_in_order_of_derivative(self):
        space = Bank([CoordinatedTurn(psd=1.0), ConstantAcceleration(psd=1.0), Static(psd=0.0)])
        space = space.space(2)
        assert space.components == ("x", "y", "vx", "vy", "ax", "ay", "omega")
        assert space.modes[0] == ("x", "y", "vx", "vy", "omega")
        assert_array_equal(space.position[1], [0, 1])
        assert_array_equal(space.velocity[1], [2, 3])
        assert len(space.velocity[2]) == 0

    def test_components_are_matched_by_name_not_by_place(self):
        bank = Bank([Drifting(), ConstantVelocity(psd=1.0)], birth_std={"bias": 3.0})
        space = bank.space(2)
        lift = space.lifts[0][1]
        assert_array_equal(lift.source, [3, 4, 1, 2])
        assert_array_equal(lift.target, [0, 1, 2, 3])
        back = space.lifts[1][0]
        assert_array_equal(back.missing, [0])
        assert_array_equal(back.birth_variance, [9.0])
        assert_array_equal(space.position[0], [3, 4])

    def test_a_strange_component_needs_a_birth_law(self):
        with pytest.raises(ValueError, match=r"birth_std: .*component 'bias'"):
            Bank([Drifting(), ConstantVelocity(psd=1.0)]).space(2)

    @pytest.mark.parametrize(
        ("components", "message"),
        [
            (("x", "vx", "vy"), "expected position components x, y"),
            (("x", "y", "vx"), "expected all of"),
            (("x", "y", "x"), "appears twice"),
        ],
    )
    def test_components_that_make_no_state(self, components, message):
        class Odd(Drifting):
            def components(self, dims):
                return components

        with pytest.raises(ValueError, match=message):
            Bank([Odd()], names=["odd"]).space(2)

    def test_a_turn_needs_a_plane(self):
        with pytest.raises(ValueError, match="CoordinatedTurn needs 2 or 3"):
            Bank([CoordinatedTurn(psd=1.0)]).space(1)


class TestNames:
    def test_registered_names_numbered_where_they_repeat(self):
        bank = Bank([Static(psd=0.0), *modes(2), Singer(psd=1.0)])
        assert bank.names == ("static", "constant-velocity-1", "constant-velocity-2", "singer")
        assert len(bank) == 4

    def test_given_names(self):
        assert Bank(modes(2), names=["slow", "fast"]).names == ("slow", "fast")

    @pytest.mark.parametrize("names", [["a"], ["a", "a"], ["a", "b", "c"]])
    def test_bad_names(self, names):
        with pytest.raises(ValueError, match="names: expected 2 different names"):
            Bank(modes(2), names=names)


class TestRefused:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"transition": [[0.9, 0.2], [0.1, 0.9]]}, r"row 0 sums to 1\.1"),
            ({"transition": [[0.9, 0.3], [0.1, 0.7]]}, r"is it transposed\?"),
            ({"transition": [[1.1, -0.1], [0.1, 0.9]]}, "transition: expected probabilities"),
            ({"transition": [[np.nan, 0.1], [0.1, 0.9]]}, "transition: expected finite numbers"),
            ({"transition": np.eye(3)}, r"transition: expected shape \(2, 2\), got \(3, 3\)"),
            ({"transition": [0.5, 0.5]}, r"transition: expected shape \(2, 2\)"),
            ({"transition": "often"}, "transition: expected numbers"),
            ({"prior": [0.5, 0.6]}, r"prior: .*they sum to 1\.1"),
            ({"prior": [1.5, -0.5]}, "prior: expected probabilities"),
            ({"prior": [1.0]}, r"prior: expected shape \(2,\)"),
            ({"prior": [np.nan, 1.0]}, "prior: expected finite"),
            ({"mean_sojourn": 0.0}, "mean_sojourn: expected times above 0 s"),
            ({"mean_sojourn": [5.0, -1.0]}, "mean_sojourn: expected times above 0 s"),
            ({"mean_sojourn": np.nan}, "mean_sojourn: expected times above 0 s"),
            ({"mean_sojourn": [1.0, 2.0, 3.0]}, "mean_sojourn: expected one time or 2"),
            ({"mean_sojourn": "long"}, "mean_sojourn: expected one time or 2"),
            ({"mean_sojourn": 5.0, "transition": np.eye(2)}, "mean_sojourn or transition, not"),
            ({"mixing": "shaken"}, "mixing: expected one of birth, unbiased, zero, got 'shaken'"),
            ({"birth_std": {"speed": 3.0}}, "birth_std: unknown key 'speed'"),
            ({"birth_std": {"velocity": -3.0}}, r"birth_std\['velocity'\]: .*at least 0"),
            ({"birth_std": {"velocity": np.inf}}, r"birth_std\['velocity'\]: .*finite"),
            ({"birth_std": 100.0}, "birth_std: expected a mapping"),
        ],
    )
    def test_arguments(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            Bank(modes(2), **arguments)

    @pytest.mark.parametrize(
        ("models", "message"),
        [
            ([], "models: expected at least one"),
            ([ConstantVelocity], "pass an instance, not the class"),
            ([ConstantVelocity(psd=1.0), "cv"], r"models\[1\] is no motion model: 'cv'"),
            ([Position(1.0)], r"models\[0\] is no motion model"),
            ([TDOA], "pass an instance, not the class|is no motion model"),
            (ConstantVelocity(psd=1.0), "models: expected a sequence of motion models"),
        ],
    )
    def test_models(self, models, message):
        with pytest.raises(ValueError, match=message):
            Bank(models)

    def test_birth_by_component_goes_before_birth_by_kind(self):
        bank = Bank(THREE, birth_std={"velocity": 7.0, "vy": 2.0})
        assert_array_equal(bank.space(2).lifts[0][1].birth_variance, [49.0, 4.0])
        assert_array_equal(bank.space(2).lifts[0][2].birth_variance, [49.0, 4.0, 100.0, 100.0])

"""Scan by scan through the compiled engine: the same states as NumPy's, and the same errors."""

from __future__ import annotations

import pickle

import attrs
import numpy as np
import pytest
from kernel_cases import SPEED, assert_alike, station_array

from imm_tdoa import IMM, Bank
from imm_tdoa.compiled import REMEMBERED
from imm_tdoa.cycle import Cycle
from imm_tdoa.kernel.machine import machine
from imm_tdoa.kernel.stepping import PackedState
from imm_tdoa.models import (
    TDOA,
    ConstantAcceleration,
    ConstantVelocity,
    Position,
    Static,
)
from imm_tdoa.state import State

STATIONS = station_array(2, np.random.default_rng(1), count=4, moving=False)
BANK = Bank(
    [Static(psd=1.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)], mean_sojourn=20.0
)
MEASUREMENT = TDOA(STATIONS, toa_sigma=3.0 / SPEED)
AT = np.array([400.0, -300.0])
FEW = 8


@pytest.fixture
def imm():
    return IMM(BANK, MEASUREMENT).compile()


def scans(measurement=MEASUREMENT, targets=(), seed=0, gross=0.0):
    """Times and values of an emitter that stands still; a row and a scan are missing."""
    rng = np.random.default_rng(seed)
    times = np.array([0.5, 1.0, 1.0, 2.5, 4.0, 5.0, 5.5, 9.0])
    m = measurement.size
    clean = measurement.predict(AT, np.zeros(2), times)
    values = (clean + 3.0 * rng.normal(size=(*targets, FEW, m))) / measurement.scale
    values[..., 3, 0] = np.nan
    values[..., 5, :] = np.nan
    if gross:
        values[..., 2:5, 1] += gross
    return times, values


def start(imm, batch=()):
    return imm.start(0.0, np.broadcast_to(AT, (*batch, 2)), 900.0 * np.eye(2))


def through(imm, engine, batch=(), **more):
    """States after each scan."""
    times, values = scans(targets=batch, **more)
    state, states = start(imm, batch), []
    for k in range(FEW):
        state = imm.step(state, times[k], values[..., k, :], engine=engine)
        states.append(state)
    return states


def test_one_target(imm):
    for got, want in zip(through(imm, "compiled"), through(imm, "numpy"), strict=True):
        assert type(got) is PackedState
        assert_alike(got, want)
        assert got.time == want.time
        assert got.components == want.components


def test_a_run_is_its_steps(imm):
    times, values = scans()
    track = imm.run(times, values, start=start(imm), engine="compiled")
    for k, state in enumerate(through(imm, "compiled")):
        np.testing.assert_allclose(state.mean, track.mean[k], rtol=1e-12)
        np.testing.assert_allclose(state.log_likelihood, track.log_likelihood[k], rtol=1e-12)


@pytest.mark.parametrize(
    ("robust", "batch"),
    [
        (None, (1,)),
        (None, (5,)),
        (None, (3, 4)),
        ("gate", (1,)),
        ("gate", (3, 4)),
        ("student-t", (1,)),
        ("student-t", (3, 4)),
    ],
)
def test_batches(batch, robust):
    imm = IMM(BANK, MEASUREMENT, robust=robust, reopen_after=2)
    more = {"gross": 3e-6} if robust else {}
    wanted = through(imm, "numpy", batch, **more)
    for got, want in zip(through(imm, "compiled", batch, **more), wanted, strict=True):
        assert_alike(got, want)
        for name in ("rejected", "used", "since"):
            np.testing.assert_array_equal(getattr(got.trust, name), getattr(want.trust, name))


def test_one_robust_target_that_is_lost_and_found():
    imm = IMM(BANK, MEASUREMENT, robust="gate", reopen_after=2)
    rng = np.random.default_rng(3)
    _, values = scans()
    ours = theirs = start(imm)
    lost = []
    for k in range(20):
        z = values[0] + (rng.uniform(-3e-6, 3e-6, 3) if 3 <= k < 12 else 0.0)
        ours = imm.step(ours, k + 1.0, z, engine="compiled")
        theirs = imm.step(theirs, k + 1.0, z, engine="numpy")
        assert_alike(ours, theirs)
        lost.append(bool(ours.trust.lost))
    assert any(lost)
    assert not lost[-1]


def test_what_each_step_is_given_is_broadcast(imm):
    """A batch of states, of times and of values, in any combination."""
    _, values = scans(targets=(4,))
    z = values[:, 0]
    times = np.array([[1.0], [2.0], [3.0]])
    some = imm.start(np.zeros(3)[:, None], np.broadcast_to(AT, (3, 1, 2)), 900.0 * np.eye(2))
    for state, time, value in (
        (start(imm), 1.0, z),
        (start(imm), times, z[0]),
        (start(imm), [1.0], z[0]),
        (some, times, z),
        (start(imm, (4,)), 1.0, z[0]),
    ):
        got = imm.step(state, time, value, engine="compiled")
        want = imm.step(state, time, value, engine="numpy")
        assert got.log_likelihood.shape == want.log_likelihood.shape
        assert_alike(got, want)


def test_pairs_of_a_step(imm):
    _, values = scans()
    pairs = [[0, 1], [2, 1], [3, 0]]
    got, want = (
        imm.step(start(imm), 1.0, -values[0], pairs=pairs, engine=e) for e in ("compiled", "numpy")
    )
    assert_alike(got, want)


def test_states_pass_between_the_engines(imm):
    """NumPy's state into the kernel and back, at every other scan."""
    times, values = scans()
    mixed = state = start(imm)
    for k in range(FEW):
        state = imm.step(state, times[k], values[k], engine="numpy")
        mixed = imm.step(mixed, times[k], values[k], engine=("numpy", "compiled")[k % 2])
        assert_alike(mixed, state)


def test_a_state_is_a_state(imm):
    """It can be pickled, changed by attrs.evolve, started a run with, and used by another IMM."""
    state = through(imm, "compiled")[-1]
    plain = through(imm, "numpy")[-1]
    assert isinstance(state, State)
    assert "log_likelihood" in repr(state)
    again = pickle.loads(pickle.dumps(state))
    assert type(again) is State
    assert_alike(again, state, 1e-12)
    later = attrs.evolve(state, time=np.array(10.0))
    assert type(later) is State
    assert later.time == 10.0
    assert_alike(later, state, 1e-12)
    times, values = scans()
    for engine in ("numpy", "compiled"):
        got = imm.run(times + 10.0, values, start=state, engine=engine)
        assert_alike(got, imm.run(times + 10.0, values, start=plain, engine="numpy"))
    other = IMM(attrs.evolve(BANK, mean_sojourn=5.0, transition=None), MEASUREMENT).compile()
    assert_alike(
        other.step(state, 11.0, values[0]), other.step(plain, 11.0, values[0], engine="numpy")
    )


def test_a_step_does_not_change_the_state_before(imm):
    times, values = scans()
    before = imm.step(start(imm), times[0], values[0], engine="compiled")
    mean, P = before.mean.copy(), before.covariance.copy()
    means = [x.copy() for x in before.means]
    imm.step(before, times[1], values[1], engine="compiled")
    np.testing.assert_array_equal(before.mean, mean)
    np.testing.assert_array_equal(before.covariance, P)
    for x, y in zip(before.means, means, strict=True):
        np.testing.assert_array_equal(x, y)


def test_after_a_scan_of_another_measurement(imm):
    """Of another number of rows: what the state says of that scan does not fit this IMM's."""
    two = TDOA(STATIONS, toa_sigma=3.0 / SPEED, pairs=[[1, 0], [2, 0]])
    _, values = scans()
    for batch in ((), (12,)):
        first = imm.step(start(imm, batch), 1.0, values[0, :2], measurement=two)
        got = imm.step(first, 2.0, values[1], engine="compiled")
        assert_alike(got, imm.step(first, 2.0, values[1], engine="numpy"))


TWO = TDOA(STATIONS, toa_sigma=3.0 / SPEED, pairs=[[1, 0], [2, 0]])
OTHERS = {
    "fewer rows": TWO,
    "as many rows, worse": TDOA(STATIONS, toa_sigma=9.0 / SPEED),
    "another kind": Position(20.0),
}


@pytest.mark.parametrize("name", list(OTHERS))
@pytest.mark.parametrize("batch", [(), (12,)])
def test_a_scan_of_another_measurement(imm, name, batch, monkeypatch):
    """Computed by the engine that is asked for."""
    other = OTHERS[name]
    values = other.predict(AT, np.zeros(2), 1.0) / other.scale
    state = start(imm, batch)
    want = imm.step(state, 1.0, values, measurement=other, engine="numpy")
    monkeypatch.setattr(Cycle, "__call__", None)
    for engine in ("compiled", "auto"):
        assert_alike(imm.step(state, 1.0, values, measurement=other, engine=engine), want)


def test_other_pairs_and_not_as_many(imm, monkeypatch):
    state, values = start(imm), scans()[1][0, :2]
    want = imm.step(state, 1.0, values, pairs=TWO.pairs, engine="numpy")
    monkeypatch.setattr(Cycle, "__call__", None)
    assert_alike(imm.step(state, 1.0, values, pairs=TWO.pairs, engine="compiled"), want)


def test_scans_of_many_measurements_that_take_turns(imm):
    state = start(imm)
    for k in range(30):
        other = TDOA(STATIONS, toa_sigma=(3.0 + k) / SPEED)
        got, want = (
            imm.step(state, 1.0, scans()[1][0], measurement=other, engine=engine)
            for engine in ("compiled", "numpy")
        )
        assert_alike(got, want)
    assert len(imm._compiled._others) <= REMEMBERED


def test_another_measurement_that_cannot_be_compiled(imm):
    class Own(TDOA):
        def predict(self, *given):
            return super().predict(*given)

    own = Own(STATIONS, toa_sigma=3.0 / SPEED)
    values = scans()[1][0]
    with pytest.raises(ValueError, match="does not support the measurement model Own"):
        imm.step(start(imm), 1.0, values, measurement=own, engine="compiled")
    assert_alike(
        imm.step(start(imm), 1.0, values, measurement=own),
        imm.step(start(imm), 1.0, values, engine="numpy"),
    )


def test_a_sigma_that_is_known_at_certain_times_only():
    """To predict, a step without values may go to any time."""
    sampled = TDOA(STATIONS, toa_sigma=np.full((2, 4), 3.0 / SPEED), sigma_times=[1.0, 2.0])
    imm = IMM(BANK, sampled).compile()
    state = imm.step(start(imm), 1.0, scans()[1][0], engine="compiled")
    got = imm.step(state, 1.7, np.full(3, np.nan), engine="compiled")
    assert_alike(got, imm.step(state, 1.7, np.full(3, np.nan), engine="numpy"))


WRONG = {
    "backwards": (-1.0, [0.0, 0.0, 0.0]),
    "no number": (np.nan, [0.0, 0.0, 0.0]),
    "infinite time": (np.inf, [0.0, 0.0, 0.0]),
    "infinite": (1.0, [0.0, np.inf, 0.0]),
    "negative infinite": (1.0, [0.0, 0.0, -np.inf]),
    "too few": (1.0, [0.0, 0.0]),
    "too many": (1.0, [0.0, 0.0, 0.0, 0.0]),
    "one number": (1.0, 0.0),
    "words": (1.0, ["a", "b", "c"]),
    "no time": ("soon", [0.0, 0.0, 0.0]),
    "none": (None, [0.0, 0.0, 0.0]),
    "impossible": (1.0, [1e200, 0.0, 0.0]),
    "batches": ([1.0, 2.0], [[0.0] * 3] * 3),
}


@pytest.mark.parametrize("name", list(WRONG))
def test_what_is_wrong_is_said_alike(imm, name):
    time, values = WRONG[name]
    begun = (start(imm), through(imm, "compiled")[0])
    for state in begun:
        messages = []
        for engine in ("numpy", "compiled", "auto"):
            with pytest.raises(ValueError) as caught:
                imm.step(state, time, values, engine=engine)
            messages.append(str(caught.value))
        assert len(set(messages)) == 1


def test_a_foreign_state_and_an_unknown_engine(imm):
    foreign = IMM(Bank([Static(psd=1.0)]), Position(1.0))
    state = foreign.start(0.0, [0.0, 0.0], np.eye(2))
    for engine in ("numpy", "compiled", "auto"):
        with pytest.raises(ValueError, match="state: expected a state of this bank's modes"):
            imm.step(state, 1.0, np.zeros(3), engine=engine)
        with pytest.raises(ValueError, match="state: expected a state"):
            imm.step(None, 1.0, np.zeros(3), engine=engine)
    with pytest.raises(ValueError, match="engine: expected one of"):
        imm.step(start(imm), 1.0, np.zeros(3), engine="quick")
    with pytest.raises(ValueError, match="measurement: expected one in 2 dimensions"):
        imm.step(start(imm), 1.0, np.zeros(3), measurement=Position(1.0, dims=3), engine="compiled")


def test_no_kind_of_value_has_the_step_compiled_anew(imm):
    z = scans()[1][0]
    known = len(machine.step.signatures), len(machine._run.signatures)
    locked = z.copy()
    locked.setflags(write=False)
    unaligned = np.frombuffer(b"x" + z.tobytes(), offset=1, count=3)
    kinds = (z, locked, unaligned, np.repeat(z, 2)[::2], z.tolist(), z.astype(">f8"), z * 0 == 0)
    for values in (*kinds, np.zeros(3, dtype=np.int32)):
        imm.step(start(imm), 1, values, engine="compiled")
    for time in (np.float32(1.0), np.array(1.0), np.int64(1), True):
        imm.step(start(imm), time, z, engine="compiled")
    imm.step(start(imm, (4,)), 1.0, locked, engine="compiled")
    for robust in (None, "gate", "student-t"):
        own = IMM(BANK, MEASUREMENT, robust=robust)
        for batch in ((2,), (12,)):
            for time in (1.0, np.full(batch, 1.0)):
                state = own.step(start(own, batch), time, locked, engine="compiled")
                own.step(state, 2.0, np.broadcast_to(locked, (*batch, 3)), engine="compiled")
    assert (len(machine.step.signatures), len(machine._run.signatures)) == known

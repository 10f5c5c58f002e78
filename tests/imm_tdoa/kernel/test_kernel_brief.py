"""Few targets, few scans: the quick way gives what the longer way gives, to the last bit."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from kernel_cases import FEW, SPEED, cases, station_array

from imm_tdoa import IMM, Bank
from imm_tdoa.kernel import running
from imm_tdoa.kernel.brief import Runner
from imm_tdoa.kernel.machine import machine
from imm_tdoa.models import TDOA, ConstantAcceleration, ConstantVelocity, Position, Static

LONGER = {"threads": 2}  # with which the quick way is not taken
STATIONS = station_array(2, np.random.default_rng(1), count=4, moving=False)
BANK = Bank(
    [Static(psd=1.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)], mean_sojourn=20.0
)
TIMES = np.array([0.5, 1.0, 1.0, 2.5, 4.0])


@pytest.fixture
def imm():
    return IMM(BANK, TDOA(STATIONS, toa_sigma=3.0 / SPEED))


def begun(imm, batch=(3,), time=0.0):
    return imm.start(time, np.zeros((*batch, 2)), 900.0 * np.eye(2))


def heard(batch=(3,)):
    return 1e-8 * np.random.default_rng(2).normal(size=(*batch, len(TIMES), 3))


def result(imm, *given, **more):
    """The track's arrays by name, or what is said to be wrong."""
    try:
        track = imm.run(*given, engine="compiled", **more)
    except ValueError as error:
        return str(error)
    fields = (a.name for a in attrs.fields(type(track)))
    return {name: getattr(track, name) for name in fields}


def assert_same(got, want):
    assert type(got) is type(want)
    if isinstance(want, str):
        assert got == want
        return
    for name, value in want.items():
        if isinstance(value, np.ndarray | tuple) and name != "modes":
            parts = value if isinstance(value, tuple) else (value,)
            own = got[name] if isinstance(value, tuple) else (got[name],)
            for a, b in zip(own, parts, strict=True):
                assert (a.dtype, a.shape) == (b.dtype, b.shape), name
                np.testing.assert_array_equal(a, b, err_msg=name)
        else:
            assert got[name] == value, name


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True
)
@given(cases(batches=FEW))
def test_both_ways_give_the_same_bits(case):
    given_ = case.times, case.values, case.start
    assert_same(result(case.imm, *given_), result(case.imm, *given_, **LONGER))


def test_the_quick_way_is_taken(imm, monkeypatch):
    imm.run(TIMES, heard(), start=begun(imm), engine="compiled")
    monkeypatch.setattr(running, "run", None)
    for engine in ("compiled", "auto"):
        for threads in (None, 1):
            track = imm.run(TIMES, heard(), start=begun(imm), engine=engine, threads=threads)
            assert track.engine == "compiled"
    with pytest.raises(TypeError):
        imm.run(TIMES, heard(), start=begun(imm), engine="compiled", **LONGER)


def test_auto_does_not_wait_for_the_compiler(imm, monkeypatch):
    monkeypatch.setattr(machine, "_ready", set())
    track = imm.run(TIMES, heard(), start=begun(imm))
    assert track.engine == "numpy"


WRONG = {
    "backwards": {"times": TIMES[::-1]},
    "before the start": {"times": TIMES - 1.0},
    "no number among the times": {"times": [0.5, 1.0, np.nan, 2.5, 4.0]},
    "infinite time": {"times": [0.5, 1.0, 1.0, 2.5, np.inf]},
    "two infinite times": {"times": [0.5, 1.0, 1.0, np.inf, np.inf]},
    "infinite": {"values": np.full((3, 5, 3), np.inf)},
    "negative infinite": {"values": np.full((3, 5, 3), -np.inf)},
    "too few rows": {"values": np.zeros((3, 5, 2))},
    "too many scans": {"values": np.zeros((3, 6, 3))},
    "one number": {"values": 0.0},
    "words": {"values": [["a", "b", "c"]] * 5},
    "no time": {"times": ["soon"] * 5},
    "none": {"times": None},
    "no scans": {"times": [], "values": np.zeros((3, 0, 3))},
    "impossible": {"values": np.full((3, 5, 3), 1e200)},
    "batches": {"values": np.zeros((2, 5, 3))},
    "no state": {"start": 3.0},
    "kept": {"keep": "some"},
    "threads": {"threads": 0},
    "engine": {"engine": "quick"},
}


@pytest.mark.parametrize("name", list(WRONG))
def test_what_is_wrong_is_said_alike(imm, name):
    usual = {"times": TIMES, "values": heard(), "start": begun(imm)}
    usual = {**usual, "engine": "compiled", "keep": "all", "threads": None, **WRONG[name]}
    messages = []
    for how in ({}, {"engine": "numpy"} if name != "engine" else {}):
        with pytest.raises(ValueError) as caught:
            imm.run(**{**usual, **how})
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


def test_a_foreign_start(imm):
    foreign = IMM(Bank([Static(psd=1.0)]), Position(1.0))
    state = foreign.start(0.0, [0.0, 0.0], np.eye(2))
    with pytest.raises(ValueError, match="start: expected a state of this bank's modes"):
        imm.run(TIMES, heard(()), start=state, engine="compiled")


def test_starts_at_times_of_their_own(imm):
    start = begun(imm, time=np.array([0.0, 0.1, 0.5]))
    assert_same(result(imm, TIMES, heard(), start), result(imm, TIMES, heard(), start, **LONGER))


def test_more_than_is_few(imm):
    for batch, times in (((20,), TIMES), ((2,), np.arange(1.0, 1500.0))):
        values = np.zeros((*batch, len(times), 3))
        quick = Runner(imm)
        assert quick.take(times, values, begun(imm, batch), wait=True) is None
        given_ = times, values, begun(imm, batch)
        assert_same(result(imm, *given_), result(imm, *given_, **LONGER))


def test_what_is_given_is_left_alone_and_what_comes_back_is_its_own(imm):
    times, values, start = TIMES.copy(), heard(), begun(imm)
    track = imm.run(times, values, start=start, engine="compiled")
    assert_same({"times": times, "values": values}, {"times": TIMES, "values": heard()})
    assert track.times is not times
    assert not track.times.flags.writeable
    again = imm.run(times, values, start=start, engine="compiled")
    np.testing.assert_array_equal(track.mean, again.mean)


def test_no_kind_of_value_has_it_compiled_anew(imm):
    z = heard()
    imm.run(TIMES, z, start=begun(imm), engine="compiled")
    known = len(machine._run.signatures)
    locked = z.copy()
    locked.setflags(write=False)
    unaligned = np.frombuffer(b"x" + z.tobytes(), offset=1).reshape(z.shape)
    kinds = (locked, unaligned, np.repeat(z, 2, 0)[::2], np.asfortranarray(z), z.tolist())
    for values in (*kinds, z.astype(">f8"), z.astype(np.float32), z * 0 == 0):
        for more in ({}, LONGER):
            imm.run(TIMES, values, start=begun(imm), engine="compiled", **more)
    assert len(machine._run.signatures) == known

"""Which engine runs, what the compiled one refuses, and how it is kept on disk."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numba.core.caching as caching
import numpy as np
import pytest
from kernel_cases import SPEED, assert_alike, station_array

import imm_tdoa
from imm_tdoa import IMM, Bank, Stations, engine
from imm_tdoa.kernel import machine as module
from imm_tdoa.kernel.machine import Machine, machine
from imm_tdoa.kernel.vectors import LANES, ONE
from imm_tdoa.models import (
    TDOA,
    ConstantVelocity,
    CoordinatedTurn,
    PhaseDifference,
    Position,
    Stack,
    Static,
)

STATIONS = station_array(2, np.random.default_rng(1), count=4, moving=False)
BANK = Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)], mean_sojourn=20.0)
MEASUREMENT = TDOA(STATIONS, toa_sigma=3.0 / SPEED)
AT = np.array([400.0, -300.0])


class Slanted(TDOA):
    """A stranger's: differences that are all a metre long."""

    def predict(self, position, velocity, time):
        return super().predict(position, velocity, time) + 1.0


class Drifting(ConstantVelocity):
    """A stranger's: its axes are coupled."""

    def transition(self, dt, dims):
        F = np.array(super().transition(dt, dims))
        F[..., 0, -1] += 0.1 * np.asarray(dt)
        return F


def run(imm, which, T=3, targets=(), **more):
    m = imm.measurement.size
    clean = imm.measurement.predict(AT, np.zeros(2), 0.0) / imm.measurement.scale
    start = imm.start(0.0, np.broadcast_to(AT, (*targets, 2)), 900.0 * np.eye(2))
    values = np.broadcast_to(clean, (*targets, T, m))
    return imm.run(np.arange(1.0, T + 1.0), values, start=start, engine=which, **more)


def uncertain():
    return Stations(STATIONS.positions, position_covariance=np.tile(np.eye(2), (4, 1, 1)))


UNSUPPORTED = {
    "update='ukf'": IMM(BANK, MEASUREMENT, update="ukf"),
    "update='iekf'": IMM(BANK, MEASUREMENT, update="iekf"),
    "merging='gpb1'": IMM(BANK, MEASUREMENT, merging="gpb1"),
    "merging='gpb2'": IMM(BANK, MEASUREMENT, merging="gpb2"),
    "the motion model 'coordinated-turn'": IMM(
        Bank([Static(psd=1.0), CoordinatedTurn(psd=1.0)]), MEASUREMENT
    ),
    "the motion model 'drift', whose axes are coupled": IMM(
        Bank([Drifting(psd=1.0)], names=["drift"]), MEASUREMENT
    ),
    "the measurement model TDOA": IMM(BANK, TDOA(uncertain(), toa_sigma=3.0 / SPEED)),
    "the measurement model Slanted": IMM(BANK, Slanted(STATIONS, toa_sigma=3.0 / SPEED)),
    "the measurement model Stack": IMM(
        BANK, Stack(Position(10.0), Slanted(STATIONS, toa_sigma=3.0 / SPEED))
    ),
}


@pytest.mark.parametrize("what", list(UNSUPPORTED))
def test_what_is_not_supported_is_named_and_runs_by_numpy(what, monkeypatch):
    imm = UNSUPPORTED[what]
    state = imm.start(0.0, AT, np.eye(2))
    with pytest.raises(ValueError) as caught:
        run(imm, "compiled")
    assert str(caught.value) == (
        f"engine: the compiled engine does not support {what}; use 'auto' or 'numpy'"
    )
    for refuses in (imm.compile, lambda: imm.step(state, 1.0, np.zeros(imm.measurement.size),
                                                  engine="compiled")):  # fmt: skip
        with pytest.raises(ValueError, match="the compiled engine does not support"):
            refuses()
    monkeypatch.setattr(engine, "WORTH_LOADING", 0.0)
    monkeypatch.setattr(engine, "WORTH_COMPILING", 0.0)
    track = run(imm, "auto")
    assert track.engine == "numpy"
    assert_alike(track, run(imm, "numpy"))


def test_a_phase_difference_is_not_supported():
    one = Stations(np.zeros((1, 2)))
    phase = PhaseDifference(one, baseline=1.0, frequency=1e9, sigma_phase=0.1, sigma_rate=0.1)
    with pytest.raises(ValueError, match="does not support the measurement model PhaseDifference"):
        IMM(BANK, phase).compile()


@pytest.mark.parametrize("what", ["fast", None, "NumPy", ""])
def test_an_unknown_engine(what):
    with pytest.raises(ValueError, match="engine: expected one of 'auto', 'numpy', 'compiled'"):
        run(IMM(BANK, MEASUREMENT), what)


@pytest.mark.parametrize("keep", ["every", "every 0", "every -1", "last", 3, None, "every 1.5"])
def test_an_unknown_share_of_the_track(keep):
    for which in ("numpy", "compiled"):
        with pytest.raises(ValueError, match="keep: expected 'all', 'final' or 'every k'"):
            run(IMM(BANK, MEASUREMENT), which, keep=keep)


@pytest.mark.parametrize("threads", [0, -1, 1.5, "two"])
def test_an_impossible_number_of_threads(threads):
    with pytest.raises(ValueError, match="threads: expected a number, 1 or more"):
        run(IMM(BANK, MEASUREMENT), "compiled", threads=threads)


# --- "auto" --------------------------------------------------------------------------------------


def test_auto_takes_the_compiled_engine_where_it_is_ready():
    assert machine.ready(ONE, False)
    imm = IMM(BANK, MEASUREMENT)
    track = run(imm, "auto")
    assert track.engine == "compiled"
    assert_alike(track, run(imm, "numpy"))


def test_auto_loads_what_is_on_disk_for_a_job_that_is_long_enough(monkeypatch):
    monkeypatch.setattr(machine, "_ready", set())
    imm = IMM(BANK, MEASUREMENT, robust="gate")
    assert machine.on_disk(LANES, True) == machine.keeps
    assert engine.choose(imm, 20, 3, "auto") == "numpy"
    assert engine.choose(imm, 20_000, 300, "auto") == "compiled"
    monkeypatch.setattr(machine, "keeps", False)
    assert engine.choose(imm, 20, 300, "auto") == "numpy"
    assert engine.choose(imm, 1_000_000, 300, "auto") == "compiled"


def python(code: str, **environment: str) -> str:
    """Run a program in a process of its own; what it prints."""
    source = textwrap.dedent(code)
    env = {**os.environ, **environment}
    env.pop("COVERAGE_PROCESS_START", None)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", source],
        capture_output=True, text=True, env=env, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


SMALL = """
    import sys
    import numpy as np
    from imm_tdoa import IMM, Bank
    from imm_tdoa.models import ConstantVelocity, Position
    imm = IMM(Bank([ConstantVelocity(psd=1.0)]), Position(1.0))
    start = imm.start(0.0, [0.0, 0.0], np.eye(2))
    """


def test_a_small_job_never_loads_the_compiler():
    code = (
        SMALL
        + """
    track = imm.run(np.arange(1.0, 9.0), np.zeros((8, 2)), start=start)
    state = imm.step(start, 1.0, [0.0, 0.0])
    print(track.engine, type(state).__name__, "numba" in sys.modules)
    """
    )
    assert python(code) == "numpy State False"


@pytest.mark.skipif(not machine.keeps, reason="no folder for compiled code can be written to")
def test_a_later_process_takes_what_is_on_disk():
    """The job has to be long enough to be worth the loading, but nothing is compiled for it."""
    code = (
        SMALL
        + """
    T = 3000
    track = imm.run(np.arange(1.0, T + 1.0), np.zeros((T, 2)), start=start, keep="final")
    from imm_tdoa.kernel.machine import machine
    state = imm.step(start, 1.0, [0.0, 0.0])
    stats = machine._run.stats
    print(track.engine, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
    """
    )
    assert python(code) == "compiled 1 0"


# --- on disk -------------------------------------------------------------------------------------


def nowhere(self):
    raise OSError(30, "Read-only file system")


def test_no_folder_to_write_to_is_no_error(monkeypatch):
    monkeypatch.setattr(caching._CacheLocator, "ensure_cache_path", nowhere)
    own = Machine()
    assert not own.keeps
    assert not own.on_disk(ONE, False)
    assert not own.ready(ONE, False)


@pytest.mark.parametrize("stage", ["run", "mark"])
def test_a_folder_that_becomes_unwritable_is_no_error(monkeypatch, stage):
    """Full, or taken away, between the import and the first use."""

    def fails(*given):
        if stage == "run":
            raise OSError(28, "No space left on device")
        return "done"

    own = Machine()
    monkeypatch.setattr(own, "_run", fails)
    monkeypatch.setattr(own, "_mark", lambda *kind: Path("/proc/nowhere/mark"))
    monkeypatch.setattr(module, "_entry", lambda digest, cache: lambda *given: "done")
    if not own.keeps:
        pytest.skip("no folder for compiled code can be written to")
    assert own(ONE, None, None, None, None) == "done"
    assert not own.keeps
    assert own.ready(ONE, False)


def test_what_is_compiled_but_cannot_be_kept_is_used(monkeypatch):
    """Numba compiles, then fails to save: the machine code is there all the same."""
    calls = []

    def once(*given):
        calls.append(given)
        if len(calls) == 1:
            raise OSError(28, "No space left on device")
        return 0

    own = Machine()
    monkeypatch.setattr(own, "_run", once)
    monkeypatch.setattr(own, "_mark", lambda *kind: Path("/proc/nowhere/mark"))
    assert own(ONE, None, None, None, None) == 0
    assert own._run is once
    calls.clear()
    monkeypatch.setattr(machine, "step", once)
    imm = IMM(BANK, MEASUREMENT)
    imm.step(imm.start(0.0, AT, np.eye(2)), 1.0, np.zeros(3), engine="compiled")
    assert len(calls) == 2


def test_the_key_of_compiled_code_changes_with_every_source(tmp_path, monkeypatch):
    """Numba itself would look at one file only."""
    package = Path(imm_tdoa.__file__).parent
    copy = tmp_path / "imm_tdoa"
    shutil.copytree(package / "kernel", copy / "kernel", ignore=shutil.ignore_patterns("*.nb?"))
    for name in ("robust", "makeup"):
        shutil.copy(package / f"{name}.py", copy)
    monkeypatch.setattr(module, "__file__", str(copy / "kernel" / "machine.py"))
    digests = {module._digest()}
    assert digests == {module.DIGEST}
    called = {
        path
        for path in (copy / "kernel").glob("*.py")
        if "@compiled" in path.read_text() or "@allocating" in path.read_text()
    }
    for path in (*sorted(called), copy / "robust.py", copy / "makeup.py"):
        path.write_text(path.read_text() + "# changed\n")
        digests.add(module._digest())
    assert len(digests) == len(called) + 3
    assert len(called) >= 8

"""With Numba's compilation switched off the kernel's Python source gives the same numbers."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from kernel_cases import SPEED, Case, assert_alike, station_array

from imm_tdoa import IMM, Bank
from imm_tdoa.models import (
    FDOA,
    TDOA,
    TOA,
    ConstantAcceleration,
    ConstantVelocity,
    Position,
    Stack,
    Static,
)


def golden() -> Case:
    """ALGORITHMS §14.1."""
    bank = Bank(
        [ConstantVelocity(std=0.1), ConstantVelocity(std=2.0)],
        transition=[[0.95, 0.05], [0.1, 0.9]],
        prior=[0.8, 0.2],
    )
    imm = IMM(bank, Position(1.0, dims=1))
    start = imm.start(0.0, [0.0, 0.0], np.diag([10.0, 1.0]))
    return Case(imm, np.arange(1.0, 5.0), np.array([0.5, 1.1, 1.8, 2.4])[:, None], start)


def several(robust: str | None, rule: str = "birth") -> Case:
    """Some targets, three modes, three kinds of rows with gaps and a gross error."""
    targets = 2 if robust else 5
    stations = station_array(2, np.random.default_rng(1), count=4, moving=False)
    measurement = Stack(
        TOA(stations, sigma=3.0 / SPEED),
        FDOA(stations, range_rate_sigma=0.5, pairs=[[1, 0], [2, 1], [2, 0]]),
        TDOA(stations, tdoa_sigma=9.0 / SPEED, pairs=[[3, 1]]),
    )
    bank = Bank(
        [Static(psd=1.0), ConstantVelocity(psd=1.0), ConstantAcceleration(psd=0.1)],
        mean_sojourn=20.0,
        mixing=rule,  # type: ignore[arg-type]
    )
    rng = np.random.default_rng(2)
    at = rng.uniform(-2e3, 2e3, (targets, 1, 2)) + np.zeros((1, 3, 1))
    clean = measurement.predict(at, np.zeros_like(at), 0.0)
    sigma = np.sqrt(np.diag(measurement.noise_covariance(at[0, 0], at[0, 0], 0.0)))
    values = clean + sigma * rng.normal(size=clean.shape)
    values[rng.random(values.shape) < 0.1] = np.nan
    values[1, 1] = np.nan
    if robust:
        values[:, 2, 2] += 500.0
    imm = IMM(bank, measurement, robust=robust)  # type: ignore[arg-type]
    start = imm.start(0.0, at[:, 0], 900.0 * np.eye(2))
    return Case(imm, np.array([1.0, 1.0, 3.5]), values / measurement.scale, start)


CASES = {
    "golden": golden(),
    "plain": several(None),
    "unbiased": several(None, "unbiased"),
    "zero": several(None, "zero"),
    "gate": several("gate"),
    "student-t": several("student-t"),
}


@pytest.fixture(scope="module")
def tracks(tmp_path_factory):
    """What a process without compilation makes of each case, and of the golden one by steps."""
    path = tmp_path_factory.mktemp("switched-off") / "tracks.pickle"
    env = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    code += f"import {Path(__file__).stem} as cases; cases.write({str(path)!r})"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, env=env
    )
    assert done.returncode == 0, done.stderr
    return pickle.loads(path.read_bytes())


def write(path: str) -> None:
    """Run all cases in this process, by the compiled engine's source."""
    from imm_tdoa.kernel.compiling import SWITCHED_OFF

    assert SWITCHED_OFF
    with np.errstate(all="ignore"):  # a mode of no probability: what is compiled does not warn
        tracks = {name: case.run("compiled", threads=1) for name, case in CASES.items()}
        assert all(track.engine == "compiled" for track in tracks.values())
        imm, times, values, state, _ = CASES["golden"]
        for time, value in zip(times, values, strict=True):
            state = imm.step(state, time, value, engine="compiled")
    assert CASES["plain"].run("auto").engine == "numpy"  # which is quicker then
    Path(path).write_bytes(pickle.dumps({**tracks, "steps": state}))


@pytest.mark.parametrize("name", list(CASES))
def test_the_same_numbers(tracks, name):
    case = CASES[name]
    want = case.run("numpy")
    assert_alike(tracks[name], want)
    assert_alike(case.run("compiled"), want)


def test_the_same_steps(tracks):
    case = CASES["golden"]
    state = case.start
    for time, value in zip(case.times, case.values, strict=True):
        state = case.imm.step(state, time, value, engine="numpy")
    assert_alike(tracks["steps"], state)
    np.testing.assert_allclose(state.mode_probability[0], 0.8714552665, atol=1e-10)

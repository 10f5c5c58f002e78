"""exp and log of vectors against NumPy's, compiled and not."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from imm_tdoa.kernel.elementary import exp, finite, log
from imm_tdoa.kernel.vectors import LANES, anywhere, choose, get, put, scatter

ULPS = 2.0  # both are right to one
EDGES = [
    0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 5e-324, -5e-324, 1e-310, 2.0**-1022,
    -(2.0**-1022), 1.7976931348623157e308, -1.7976931348623157e308, 709.782712893384,
    709.7827128933841, 710.0, 1e4, -708.3964185322641, -708.4, -745.1332191019411, -745.14,
    -746.0, -1e4, -1e300, np.sqrt(0.5), np.nextafter(np.sqrt(0.5), 0.0), np.sqrt(2.0),
    np.nextafter(np.sqrt(2.0), 0.0), np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0), 2.0**54,
]  # fmt: skip


def arguments() -> np.ndarray:
    """Numbers of all sizes and both signs, those around 1 and 0 the more often, and the edges."""
    rng = np.random.default_rng(5)
    n = 4000 * len(LANES)
    size = 2.0 ** rng.uniform(-1074.0, 1024.0, n)
    parts = [
        size,
        -size,
        rng.uniform(-750.0, 712.0, n),
        rng.uniform(-40.0, 2.0, n),
        rng.uniform(0.4, 2.5, n),
        1.0 + 1e-6 * rng.uniform(-1.0, 1.0, n),
        1e-3 * rng.uniform(-1.0, 1.0, n),
        np.array(EDGES),
    ]
    return np.concatenate(parts).reshape(-1, len(LANES))


@numba.njit
def both(lanes, M, exps, logs):
    for i in range(len(M)):
        put(lanes, exps, i, exp(get(lanes, M, i)))
        put(lanes, logs, i, log(get(lanes, M, i)))


def computed() -> tuple[np.ndarray, np.ndarray]:
    M = arguments()
    exps, logs = np.empty_like(M), np.empty_like(M)
    both(LANES, M, exps, logs)
    return exps, logs


def write(path: str) -> None:
    """Compute in this process, whose compilation is switched off."""
    from imm_tdoa.kernel.compiling import SWITCHED_OFF

    assert SWITCHED_OFF
    with np.errstate(all="ignore"):
        np.save(path, computed())


@pytest.fixture(scope="module", params=["compiled", "switched off"])
def results(request, tmp_path_factory):
    if request.param == "compiled":
        return computed()
    path = tmp_path_factory.mktemp("switched-off") / "results.npy"
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
    code += f"import {Path(__file__).stem} as own; own.write({str(path)!r})"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True, text=True, env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return np.load(path)


@pytest.mark.parametrize(("which", "function"), [(0, np.exp), (1, np.log)])
def test_right_to_the_last_place(results, which, function):
    with np.errstate(all="ignore"):
        want = function(arguments())
        size = np.spacing(np.abs(np.where(np.isfinite(want), want, 0.0)))
        got = results[which]
        same = (got == want) | (np.isnan(got) & np.isnan(want))
        away = np.where(same, 0.0, np.abs(got - want) / size)
    worst = np.unravel_index(np.argmax(away), away.shape)
    assert away[worst] <= ULPS, f"{function.__name__}({arguments()[worst]!r}) is {got[worst]!r}"


# --- the other operations of vectors ----------------------------------------------------------


@numba.njit
def where_finite(lanes, M, out):
    for i in range(len(M)):
        known = finite(get(lanes, M, i))
        put(lanes, out, i, choose(known, 1.0, 0.0))
        out[i, 0] += 10.0 if anywhere(choose(known, 0.0, 1.0)) else 0.0


def test_what_is_finite_and_whether_any_is_not():
    M = np.zeros((3, len(LANES)))
    M[1, 3], M[1, 5], M[1, 7], M[2] = np.nan, np.inf, -np.inf, np.finfo(float).max
    out = np.empty_like(M)
    where_finite(LANES, M, out)
    want = np.isfinite(M).astype(float)
    want[1, 0] += 10.0
    np.testing.assert_array_equal(out, want)


@numba.njit
def write_eight(lanes, M, out, begin, stride, last):
    scatter(lanes, M, 2, out, begin, stride, last)


@pytest.mark.parametrize("width", [1, 4, 16])
@pytest.mark.parametrize("share", [0.25, 0.75, 1.0])
def test_rows_are_written_side_by_side(width, share):
    rng = np.random.default_rng(3)
    M = rng.normal(size=(12, width))
    last = max(int(share * width) - 1, 0)
    out = np.zeros(5 + 11 * width)
    want = out.copy()
    for lane in range(last + 1):
        want[5 + 11 * lane : 13 + 11 * lane] = M[2:10, lane]
    write_eight((0,) * width, M, out, 5, 11, last)
    np.testing.assert_array_equal(out, want)

"""Small recordings for the tests: as files, and as objects that hypothesis makes up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from imm_tdoa import Stations, recording
from imm_tdoa.frames import EastNorthUp
from imm_tdoa.recording import Noise, Recording, Table, TruthScoring

GOOD = {
    "recording.toml": """
format = 1
title = "three stations on a plain"
speed_mps = 343.0
dims = 2
labelled = true

[frame]
kind = "local"

[noise]
toa_sigma_s = 1e-4
range_rate_sigma_mps = 0.1
""",
    "stations.csv": "station,x_m,y_m\na,0,0\nb,1000,0\nc,0,1000\n",
    "tdoa.csv": """time_s,station,reference,tdoa_s,sigma_s
1.0,b,a,0.1,1e-4
1.0,c,a,-0.2,
2.0,b,a,0.11,2e-4
2.0,c,a,-0.21,2e-4
""",
    "toa.csv": """time_s,emission,station,toa_s
1.0,m0,a,0.5
1.0,m0,b,0.6
3.0,m1,a,0.5
3.0,m1,b,0.6
3.0,m1,c,0.3
""",
    "truth.csv": "time_s,target,x_m,y_m\n0,car,100,200\n4,car,140,200\n",
}


def put(folder: Path, files: dict[str, str]) -> Path:
    """Write the files of a recording; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def refusal(folder: Path) -> str:
    """Return the one line with which the recording in `folder` is refused."""
    with pytest.raises(ValueError) as caught:
        recording.read(folder)
    message = str(caught.value)
    assert "\n" not in message
    return message


def assert_same(a: Recording, b: Recording) -> None:
    """Every number of two recordings is the same, bit for bit."""
    for field in ("title", "speed_mps", "labelled", "frame", "noise", "truth_scoring"):
        assert getattr(a, field) == getattr(b, field), field
    assert dict(a.source) == dict(b.source)
    assert dict(a.notes) == dict(b.notes)
    assert a.stations.names == b.stations.names
    for field in ("positions", "velocities", "times"):
        _assert_same_array(getattr(a.stations, field), getattr(b.stations, field), field)
    for name in ("tdoa", "toa", "fdoa", "range_rate", "height", "truth"):
        left, right = getattr(a, name), getattr(b, name)
        assert (left is None) == (right is None), name
        if left is not None:
            assert list(left) == list(right)
            for column in left:
                _assert_same_array(left[column], right[column], f"{name}.{column}")


def _assert_same_array(a: Any, b: Any, what: str) -> None:
    assert (a is None) == (b is None), what
    if a is not None:
        assert a.shape == b.shape, what
        assert a.dtype.kind == b.dtype.kind, what
        if a.dtype.kind == "f":
            np.testing.assert_array_equal(a, b, err_msg=what)
            np.testing.assert_array_equal(np.signbit(a), np.signbit(b), err_msg=what)
        else:
            assert a.tolist() == b.tolist(), what


# Names as files may hold them: commas, quotes, digits and umlauts, but no blanks around them.
NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=6
).filter(str.isprintable)
NUMBERS = st.floats(-1e9, 1e9)
SIGMAS = st.floats(1e-12, 1e3) | st.just(np.nan)
FREE = st.recursive(
    st.text(max_size=20) | st.integers(-(2**63), 2**63 - 1) | st.booleans() | NUMBERS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=5,
)


@st.composite
def recordings(draw: Any) -> Recording:
    """Small recordings of every kind that the format can hold."""
    d = draw(st.sampled_from((2, 3)))
    names = draw(st.lists(NAMES, min_size=2, max_size=4, unique=True))
    targets = draw(st.lists(NAMES, min_size=1, max_size=2, unique=True))
    tables = {
        "tdoa": _pairs(draw, names, "tdoa_s", "sigma_s"),
        "toa": _single(draw, names, "toa_s", "sigma_s"),
        "fdoa": _pairs(draw, names, "range_rate_difference_mps", "sigma_mps"),
        "range_rate": _single(draw, names, "range_rate_mps", "sigma_mps"),
    }
    if len(targets) > 1 or draw(st.booleans()):
        tables = {name: _labelled(draw, table, targets) for name, table in tables.items()}
    kept = draw(st.sets(st.sampled_from(sorted(tables)), min_size=1))
    return Recording(
        _stations(draw, d, names),
        title=draw(st.text(max_size=20)),
        speed_mps=draw(st.floats(1.0, 3e8)),
        labelled=draw(st.booleans()),
        frame=draw(st.none() | st.builds(EastNorthUp, st.floats(-90, 90), st.floats(-180, 180))),
        noise=draw(st.builds(Noise, toa_sigma_s=st.none() | st.floats(1e-9, 1.0))),
        truth_scoring=draw(
            st.builds(TruthScoring, axes=st.sampled_from((None, ("x",), ("y", "x"))))
        ),
        truth=draw(st.none() | st.just(_truth(draw, d, targets))),
        source=draw(st.dictionaries(st.text(max_size=5), FREE, max_size=3)),
        notes=draw(st.dictionaries(st.text(max_size=5), FREE, max_size=3)),
        **{name: table for name, table in tables.items() if name in kept},
    )


def _array(draw: Any, size: Any, elements: Any = NUMBERS) -> Any:
    return draw(hnp.arrays(float, size, elements=elements))


def _times(draw: Any, size: int) -> Any:
    return draw(hnp.arrays(float, size, elements=NUMBERS, unique=True).map(np.sort))


def _stations(draw: Any, d: int, names: list[str]) -> Stations:
    S = len(names)
    unique = hnp.arrays(float, S, elements=NUMBERS, unique=True)
    if draw(st.booleans()):
        positions = np.column_stack([draw(unique), *(_array(draw, S) for _ in range(d - 1))])
        return Stations(positions, names=tuple(names))
    K = draw(st.integers(1, 3))
    positions = _array(draw, (K, S, d))
    velocities = draw(st.none() | hnp.arrays(float, (K, S, d), elements=NUMBERS))
    if K > 1:  # the last station was not sampled the second time
        positions[1, -1] = np.nan
        if velocities is not None:
            velocities[1, -1] = np.nan
    return Stations(positions, velocities=velocities, times=_times(draw, K), names=tuple(names))


def _pairs(draw: Any, names: list[str], value: str, sigma: str) -> Table:
    T = draw(st.integers(1, 3))
    times = np.repeat(_times(draw, T), len(names) - 1)
    columns = {
        "time_s": times,
        "station": np.array(names[1:] * T),
        "reference": np.array(names[:1] * len(times)),
        value: _array(draw, len(times), NUMBERS | st.just(np.nan)),
    }
    return _maybe_sigma(draw, columns, sigma)


def _single(draw: Any, names: list[str], value: str, sigma: str) -> Table:
    T = draw(st.integers(1, 3))
    times = np.repeat(_times(draw, T), len(names))
    columns = {
        "time_s": times,
        "emission": np.repeat([f"{k}" for k in range(T)], len(names)),
        "station": np.array(names * T),
        value: _array(draw, len(times), NUMBERS | st.just(np.nan)),
    }
    return _maybe_sigma(draw, columns, sigma)


def _maybe_sigma(draw: Any, columns: dict[str, Any], sigma: str) -> Table:
    if draw(st.booleans()):
        columns[sigma] = _array(draw, len(columns["time_s"]), SIGMAS)
    return Table(columns)


def _labelled(draw: Any, table: Table, targets: list[str]) -> Table:
    names = draw(st.lists(st.sampled_from(targets), min_size=len(table), max_size=len(table)))
    return Table({**table.columns, "target": np.array(names)})


def _truth(draw: Any, d: int, targets: list[str]) -> Table:
    T = draw(st.integers(1, 3))
    place = {f"{axis}_m": _array(draw, T * len(targets)) for axis in "xyz"[:d]}
    speed = {f"v{axis}_mps": _array(draw, T * len(targets)) for axis in "xyz"[:d]}
    return Table(
        {
            "time_s": np.tile(_times(draw, T), len(targets)),
            "target": np.repeat(targets, T),
            **place,
            **(speed if draw(st.booleans()) else {}),
        }
    )

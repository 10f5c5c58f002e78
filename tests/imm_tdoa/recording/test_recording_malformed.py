"""What breaks the format is refused, and the message says exactly where and what."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_cases import GOOD, put, refusal

from imm_tdoa import Stations, recording
from imm_tdoa.recording import Noise, Recording, Table, TruthScoring

TDOA_HEAD = "time_s,station,reference,tdoa_s"
TOA_HEAD = "time_s,emission,station,toa_s"
TOA = "expected time_s, emission, station, toa_s, [sigma_s], [target]"
TWICE = "duplicate row: the same time, pair of stations and target appeared before in line 2"
NAME = "expected a name of printable characters without blanks around it, got"

TABLES = {
    # case: (file, text, message); text None removes the file
    "missing column": (
        "toa.csv",
        "time_s,emission,toa_s\n1,m,2\n",
        f"toa.csv:1: station: missing column; {TOA}",
    ),
    "unknown column": (
        "toa.csv",
        f"{TOA_HEAD},snr\n1,m,a,2,3\n",
        f"toa.csv:1: 'snr': unknown column; {TOA}",
    ),
    "blank in header": (
        "toa.csv",
        "time_s, emission,station,toa_s\n1,m,a,2\n",
        f"toa.csv:1: ' emission': unknown column; {TOA}",
    ),
    "column twice": (
        "toa.csv",
        f"{TOA_HEAD},toa_s\n1,m,a,2,2\n",
        "toa.csv:1: toa_s: this column appears twice",
    ),
    "wrong type": (
        "toa.csv",
        f"{TOA_HEAD}\n1,m,a,2\n1,m,b,soon\n",
        "toa.csv:3: toa_s: expected a number, got 'soon'",
    ),
    "underscore": (
        "toa.csv",
        f"{TOA_HEAD}\n1_0,m,a,2\n",
        "toa.csv:2: time_s: expected a number, got '1_0'",
    ),
    "empty time": (
        "toa.csv",
        f"{TOA_HEAD}\n,m,a,2\n",
        "toa.csv:2: time_s: expected a number, got an empty cell",
    ),
    "line after blank": (
        "toa.csv",
        f"{TOA_HEAD}\n1,m,a,2\n\n\n1,m,b,x\n",
        "toa.csv:5: toa_s: expected a number, got 'x'",
    ),
    "line after quoted": (
        "toa.csv",
        f'{TOA_HEAD}\n1,"m","a",2\n1,m,b,x\n',
        "toa.csv:3: toa_s: expected a number, got 'x'",
    ),
    "infinite value": (
        "toa.csv",
        f"{TOA_HEAD}\n1,m,a,inf\n",
        "toa.csv:2: toa_s: expected a finite number (empty where it is missing), got inf",
    ),
    "infinite time": (
        "toa.csv",
        f"{TOA_HEAD}\nnan,m,a,1\n",
        "toa.csv:2: time_s: expected a finite number, got nan",
    ),
    "unknown station": (
        "toa.csv",
        f"{TOA_HEAD}\n1,m,a,2\n1,m,d,2\n",
        "toa.csv:3: station: unknown station 'd'; there are a, b, c",
    ),
    "unknown reference": (
        "tdoa.csv",
        f"{TDOA_HEAD}\n1,a,d,2\n",
        "tdoa.csv:2: reference: unknown station 'd'; there are a, b, c",
    ),
    "blank name": ("toa.csv", f"{TOA_HEAD}\n1,m, a,2\n", f"toa.csv:2: station: {NAME} ' a'"),
    "no name": ("toa.csv", f"{TOA_HEAD}\n1,,a,2\n", f"toa.csv:2: emission: {NAME} ''"),
    "duplicate arrival": (
        "toa.csv",
        f"{TOA_HEAD}\n1,m,a,2\n1,m,b,2\n1,m,a,3\n",
        "toa.csv:4: station: duplicate row: the same emission, station and target appeared "
        "before in line 2",
    ),
    "duplicate difference": (
        "tdoa.csv",
        f"{TDOA_HEAD}\n1,b,a,2\n1,b,a,2\n",
        f"tdoa.csv:3: station: {TWICE}",
    ),
    "difference read backwards": (
        "tdoa.csv",
        f"{TDOA_HEAD}\n1,b,a,2\n1,a,b,-2\n",
        f"tdoa.csv:3: station: {TWICE}",
    ),
    "duplicate of a target": (
        "tdoa.csv",
        f"{TDOA_HEAD},target\n1,b,a,2,x\n1,b,a,2,y\n1,b,a,2,x\n",
        f"tdoa.csv:4: station: {TWICE}",
    ),
    "unsorted differences": (
        "tdoa.csv",
        f"{TDOA_HEAD}\n1,b,a,2\n0.5,c,a,2\n",
        "tdoa.csv:3: time_s: expected times that do not decrease, got 0.5 after 1.0",
    ),
    "unsorted arrivals": (
        "toa.csv",
        f"{TOA_HEAD}\n2,m,a,2\n2,m,b,2\n1,n,b,2\n",
        "toa.csv:4: time_s: expected times that do not decrease, got 1.0 after 2.0",
    ),
    "empty file": (
        "toa.csv",
        "",
        "toa.csv:1: the file is empty; expected a header of column names",
    ),
    "header alone": (
        "toa.csv",
        f"{TOA_HEAD}\n",
        "toa.csv: no rows; leave the table out where it has none",
    ),
    "truncated": (
        "toa.csv",
        f"{TOA_HEAD}\n1,m,a,2\n1,m,b",
        "toa.csv:3: toa_s: the row ends before this column, after 3 of 4 fields; is the file "
        "cut off?",
    ),
    "too long": ("toa.csv", f"{TOA_HEAD}\n1,m,a,2,3\n", "toa.csv:2: expected 4 fields, got 5"),
    "cut in quotes": (
        "toa.csv",
        f'{TOA_HEAD}\n1,m,"a',
        "toa.csv:2: no CSV: unexpected end of data",
    ),
    "sigma zero": (
        "tdoa.csv",
        f"{TDOA_HEAD},sigma_s\n1,b,a,2,0\n",
        "tdoa.csv:2: sigma_s: expected a number above 0, got 0.0",
    ),
    "sigma negative": (
        "tdoa.csv",
        f"{TDOA_HEAD},sigma_s\n1,b,a,2,1\n2,b,a,2,-1e-9\n",
        "tdoa.csv:3: sigma_s: expected a number above 0, got -1e-09",
    ),
    "sigma infinite": (
        "tdoa.csv",
        f"{TDOA_HEAD},sigma_s\n1,b,a,2,inf\n",
        "tdoa.csv:2: sigma_s: expected a number above 0, got inf",
    ),
    "self pair": (
        "tdoa.csv",
        f"{TDOA_HEAD}\n1,b,a,2\n1,c,c,2\n",
        "tdoa.csv:3: reference: expected another station than 'c', which cannot be paired "
        "with itself",
    ),
    "height in a plane": (
        "height.csv",
        "time_s,emission,height_m\n1,m0,5\n",
        "height.csv: a height needs dims = 3",
    ),
    "half labelled": (
        "toa.csv",
        f"{TOA_HEAD},target\n1,m,a,2,x\n1,m,b,2,y\n",
        "tdoa.csv: target: missing column, where toa.csv names several targets",
    ),
    "no stations": ("stations.csv", None, "stations.csv: missing in"),
    "duplicate station": (
        "stations.csv",
        "station,x_m,y_m\na,0,0\nb,1,0\na,2,0\n",
        "stations.csv:4: station: duplicate row: this station appeared before in line 2",
    ),
    "stations in one place": (
        "stations.csv",
        "station,x_m,y_m\na,0,0\nb,1,0\nc,0,0\n",
        "stations.csv: positions: stations 'a' and 'c' are in the same place [0.0, 0.0]",
    ),
    "coordinate not a number": (
        "stations.csv",
        "station,x_m,y_m\na,0,nan\n",
        "stations.csv:2: y_m: expected a finite number, got nan",
    ),
    "coordinate infinite": (
        "stations.csv",
        "station,x_m,y_m\na,0,0\nb,-inf,1\n",
        "stations.csv:3: x_m: expected a finite number, got -inf",
    ),
    "too many dimensions": (
        "stations.csv",
        "station,x_m,y_m,z_m\na,0,0,0\n",
        "stations.csv: z_m: a column, where recording.toml says dims = 2",
    ),
    "velocity without time": (
        "stations.csv",
        "station,x_m,y_m,vx_mps,vy_mps\na,0,0,1,1\n",
        "stations.csv:1: 'vx_mps': unknown column; expected station, x_m, y_m",
    ),
    "half a velocity": (
        "stations.csv",
        "time_s,station,x_m,y_m,vx_mps\n0,a,0,0,1\n",
        "stations.csv:1: vy_mps: expected the velocities vx_mps, vy_mps or none",
    ),
    "station twice at a time": (
        "stations.csv",
        "time_s,station,x_m,y_m\n0,a,0,0\n0,a,0,0\n",
        "stations.csv:3: time_s: expected increasing times of station 'a', got 0.0; this "
        "time appears twice",
    ),
    "station back in time": (
        "stations.csv",
        "time_s,station,x_m,y_m\n1,a,0,0\n0,b,0,0\n0,a,0,0\n",
        "stations.csv:4: time_s: expected increasing times of station 'a', got 0.0; it follows 1.0",
    ),
    "latitude without frame": (
        "stations.csv",
        "station,lat_deg,lon_deg,height_m\na,48,9,0\n",
        "stations.csv: lat_deg: latitudes need an ENU frame; recording.toml has none",
    ),
    "two kinds of place": (
        "stations.csv",
        "station,x_m,y_m,lat_deg\na,0,0,48\n",
        "stations.csv:1: 'lat_deg': unknown column; expected station, x_m, y_m",
    ),
    "truth without target": (
        "truth.csv",
        "time_s,x_m,y_m\n0,1,2\n",
        "truth.csv:1: target: missing column; expected time_s, target, x_m, y_m, [vx_mps], "
        "[vy_mps]",
    ),
    "truth in a plane": (
        "truth.csv",
        "time_s,target,x_m,y_m,z_m\n0,car,1,2,3\n",
        "truth.csv:1: 'z_m': unknown column",
    ),
    "truth not finite": (
        "truth.csv",
        "time_s,target,x_m,y_m\n0,car,1,inf\n",
        "truth.csv:2: y_m: expected a finite number, got inf",
    ),
    "truth twice": (
        "truth.csv",
        "time_s,target,x_m,y_m\n0,car,1,2\n0,bus,1,2\n0,car,1,2\n",
        "truth.csv:4: time_s: expected increasing times of target 'car', got 0.0; this time "
        "appears twice",
    ),
}


def test_the_good_one_is_good(tmp_path: Path) -> None:
    assert recording.read(put(tmp_path, GOOD)).dims == 2


@pytest.mark.parametrize("case", TABLES)
def test_tables(tmp_path: Path, case: str) -> None:
    name, text, message = TABLES[case]
    files = (
        GOOD | {name: text} if text is not None else {k: v for k, v in GOOD.items() if k != name}
    )
    assert refusal(put(tmp_path, files)).startswith(message)


def test_missing_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="folder: expected a recording folder, there is none at"):
        recording.read(tmp_path / "nowhere")
    assert refusal(put(tmp_path / "a", {})).startswith("recording.toml: missing in ")
    measured = ("tdoa.csv", "toa.csv")
    put(tmp_path / "b", {k: v for k, v in GOOD.items() if k not in measured})
    assert refusal(tmp_path / "b").startswith("recording: nothing measured in ")
    assert refusal(tmp_path / "b").endswith("one of tdoa.csv, toa.csv, fdoa.csv, range_rate.csv")


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    put(tmp_path, GOOD)
    (tmp_path / "toa.csv").write_bytes(b"time_s,emission,station,toa_s\n1,\xff,a,2\n")
    assert refusal(tmp_path).startswith("toa.csv: expected text in UTF-8")
    (tmp_path / "recording.toml").write_bytes(b'format = 1\ntitle = "\xff"')
    assert refusal(tmp_path).startswith("recording.toml:2: expected UTF-8 text: ")


def test_a_folder_in_place_of_a_table(tmp_path: Path) -> None:
    put(tmp_path, {k: v for k, v in GOOD.items() if k != "toa.csv"})
    (tmp_path / "toa.csv").mkdir()
    assert refusal(tmp_path) == "toa.csv: cannot be read: Is a directory"


def test_byte_order_mark_and_windows_lines(tmp_path: Path) -> None:
    put(tmp_path, GOOD)
    text = GOOD["toa.csv"].replace("\n", "\r\n")
    (tmp_path / "toa.csv").write_bytes(b"\xef\xbb\xbf" + text.encode())
    made = recording.read(tmp_path)
    assert made.toa is not None
    assert made.toa["station"].tolist() == ["a", "b", "a", "b", "c"]


def test_both_kinds_of_one_table(tmp_path: Path) -> None:
    made = recording.read(put(tmp_path / "r", GOOD))
    recording.write(made, tmp_path / "p", tables="parquet")
    (tmp_path / "r" / "toa.parquet").write_bytes((tmp_path / "p" / "toa.parquet").read_bytes())
    assert refusal(tmp_path / "r") == "toa.csv and toa.parquet: expected one of them, not both"


PARQUET: dict[str, tuple[dict[str, Any], str]] = {
    "unknown station": ({"station": ["a", "d"]}, "toa.parquet:2: station: unknown station 'd'"),
    "truth for number": (
        {"toa_s": [True, False]},
        "toa.parquet:1: toa_s: expected numbers, got a column of bool",
    ),
    "text for number": (
        {"toa_s": ["1", "2"]},
        "toa.parquet:1: toa_s: expected numbers, got a column of string",
    ),
    "number for name": (
        {"station": [1.0, 2.0]},
        "toa.parquet:1: station: expected names, got a column of double",
    ),
    "no time": ({"time_s": [1.0, None]}, "toa.parquet:2: time_s: expected a number, got null"),
    "no name": ({"emission": [None, "m"]}, "toa.parquet:1: emission: expected a name, got null"),
    "unknown column": ({"snr": [1.0, 2.0]}, "toa.parquet: 'snr': unknown column"),
}


@pytest.mark.parametrize("case", PARQUET)
def test_parquet(tmp_path: Path, case: str) -> None:
    import pyarrow
    import pyarrow.parquet

    changed, message = PARQUET[case]
    data = {"time_s": [1, 1], "emission": ["m", "m"], "station": ["a", "b"], "toa_s": [0.5, 0.6]}
    put(tmp_path, {k: v for k, v in GOOD.items() if k != "toa.csv"})
    pyarrow.parquet.write_table(pyarrow.table(data | changed), tmp_path / "toa.parquet")
    assert refusal(tmp_path).startswith(message)


def test_no_parquet(tmp_path: Path) -> None:
    put(tmp_path, {k: v for k, v in GOOD.items() if k != "toa.csv"} | {"toa.parquet": "PAR"})
    assert refusal(tmp_path).startswith("toa.parquet: no Parquet: ")


def test_objects_are_checked_like_files() -> None:
    stations = Stations(np.eye(3)[:, :2] * 1000.0, names=("a", "b", "c"))
    toa = {"time_s": [1.0, 1.0], "emission": ["m", "m"], "station": ["a", "d"], "toa_s": [0.5, 1.0]}
    good = Table(toa | {"station": ["a", "b"]})

    def refused(message: str, **changes: Any) -> None:
        arguments: dict[str, Any] = {"stations": stations, "toa": good} | changes
        with pytest.raises(ValueError, match=message):
            Recording(**arguments)

    refused(r"^toa\[1\]: station: unknown station 'd'; there are a, b, c$", toa=Table(toa))
    refused("^toa: station: expected names, got", toa=Table(toa | {"station": [1, 2]}))
    refused("^toa: expected a Table, got", toa=toa)
    refused("^toa: 'snr': unknown column", toa=Table(toa | {"snr": [1, 2]}))
    refused("^recording: nothing measured; expected at least one of", toa=None)
    refused(
        "^stations: expected 2 or 3 dimensions, got 1", stations=Stations(np.array([[0.0], [1.0]]))
    )
    refused("^labelled: expected bool, got 1", labelled=1)
    refused("^title: expected str, got None", title=None)
    refused("^speed_mps: expected a number above 0", speed_mps=-1.0)
    refused("^frame: expected EastNorthUp, got 'enu'", frame="enu")
    refused("^truth.axes: expected x and y alone", truth_scoring=TruthScoring(axes=("z",)))
    with pytest.raises(ValueError, match=r"^toa_sigma_s: expected a number above 0, got -1.0"):
        Noise(toa_sigma_s=-1.0)
    with pytest.raises(ValueError, match=r"^axes: expected different ones of x, y, z"):
        TruthScoring(axes=("x", "x"))
    with pytest.raises(ValueError, match=r"^columns: expected columns of one length"):
        Table({"a": [1, 2], "b": [1]})
    with pytest.raises(ValueError, match=r"^a: expected numbers or names, got object"):
        Table({"a": ["x", None]})
    with pytest.raises(ValueError, match=r"^a: expected one column of values"):
        Table({"a": [[1.0]]})

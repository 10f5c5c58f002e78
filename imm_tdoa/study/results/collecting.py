"""What a study found, as one xarray Dataset, and the files that hold it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from imm_tdoa.contract import Array
from imm_tdoa.recording import _atomic
from imm_tdoa.study.results import tables
from imm_tdoa.study.results.dataset import dataset, name_units
from imm_tdoa.study.results.figures import padded
from imm_tdoa.study.results.gather import PER_RUN, gather

if TYPE_CHECKING:
    from imm_tdoa.study.plan import Study
    from imm_tdoa.study.store import Store

FILE = "results.nc"
KEPT_RUNS = 200_000  # single figures of this many runs x banks x scenarios go into the Dataset


def collect(study: Study, store: Store) -> xr.Dataset:
    """Add up all finished chunks of a study.

    One chunk is in memory at a time, whatever the number of runs.

    Parameters
    ----------
    study : Study
        What was asked.
    store : Store
        Where the chunks lie.

    Returns
    -------
    Dataset
        Over ``scenario`` and ``bank``: each figure with its interval (``position_rmse``,
        ``position_rmse_low``, ``position_rmse_high``, ...), the order of the banks (``place``,
        ``letters``), computing time; with ``other``: paired comparisons; with ``time``: errors,
        NEES and mode probabilities per scan, NaN after a scenario's last scan; with ``mode`` and
        ``criterion``, ``candidate``: what was selected; with ``run``: single figures, where they
        are few.

    Raises
    ------
    ValueError
        No finished chunk of a scenario.
    """
    names = [case.name for case in study.scenarios]
    most = max((len(criterion.banks) for criterion in study.criteria), default=0)
    ranked = "velocity" if study.metrics[:1] == ("velocity",) else "position"
    found = []
    for name in names:
        one = gather((store.load(path) for path in store.chunks(name)), most, ranked)
        if one is None:
            raise ValueError(f"study: no finished run of scenario {name!r}")
        found.append(one)
    bounds = [_bound(store, name, len(one.times)) for name, one in zip(names, found, strict=True)]
    data = dataset(study, found, bounds, ranked)
    data["seconds_per_step"] = (
        ("scenario", "bank"),
        np.stack([_cost(store, name) for name in names]),
    )
    if study.runs * len(names) * len(study.banks) <= KEPT_RUNS:
        _add_runs(data, store, names, study.runs)
    name_units(data)
    return data


def _bound(store: Store, scenario: str, scans: int) -> dict[str, Any]:
    """The bound of a scenario; of a study interrupted before it was there, that there is none."""
    if store.has_bound(scenario):
        return store.bound(scenario)
    nothing = np.full(scans, np.nan)
    return {"position_bound": nothing, "gdop": nothing, "reason": "not computed yet"}


def _cost(store: Store, scenario: str) -> Array:
    """Seconds of each bank (B,) for one step of one run."""
    paths = store.chunks(scenario)
    seconds = sum(store.cost(path) for path in paths)
    return np.asarray(seconds / sum(store.steps(path) for path in paths))


def _add_runs(data: xr.Dataset, store: Store, names: list[str], runs: int) -> None:
    for name in PER_RUN:
        rows = []
        for scenario in names:
            parts = [np.asarray(store.load(path)[name]) for path in store.chunks(scenario)]
            rows.append(np.concatenate(parts, axis=1))
        data[f"run_{name}"] = ("scenario", "bank", "run"), padded(rows, runs)


def write(data: xr.Dataset, study: Study, store: Store, folder: str | Path) -> list[str]:
    """Write the Dataset as NetCDF, and everything in it and every run as tidy tables.

    Computing times go into ``cost.csv`` alone, so that all other files are the same to the last
    byte however the study was run.

    Parameters
    ----------
    data : Dataset
        From `collect`.
    study, store
        As for `collect`; the runs are streamed from the store.
    folder : path
        Where to write; files of the same names are replaced, each whole or not at all.

    Returns
    -------
    list of str
        Names of the files written.
    """
    folder = Path(folder)
    empty = [name for name, values in data.variables.items() if 0 in values.shape]
    lasting = data.drop_vars(["seconds_per_step", *empty])  # no axis of length 0 in NetCDF 3
    with _atomic.file(folder / FILE) as draft:
        lasting.to_netcdf(draft, engine="scipy")
    written = [FILE]
    for name, columns in tables.tables(data).items():
        written += tables.write(folder, name, columns)
    written += tables.stream(folder, "runs", run_rows(study, store))
    if study.criteria:
        written += tables.stream(folder, "choices_by_run", choice_rows(study, store))
    return written


def run_rows(study: Study, store: Store) -> Iterator[tables.Columns]:
    """Yield the rows of every run and bank, one chunk at a time."""
    banks = np.array([bank.name for bank in study.banks])
    for scenario, first, chunk in _chunks(study, store):
        n = len(chunk["seeds"])
        rows: dict[str, NDArray[Any]] = {
            "scenario": np.full(n * len(banks), scenario),
            "run": np.repeat(np.arange(first, first + n), len(banks)),
            "seed": np.repeat(np.asarray(chunk["seeds"]).astype(str), len(banks)),
            "bank": np.tile(banks, n),
            "position_rmse_m": np.sqrt(_flat(chunk["position_mse"])),
            "velocity_rmse_mps": np.sqrt(_flat(chunk["velocity_mse"])),
            "position_error_m": _flat(chunk["position_error"]),
        }
        for name in PER_RUN[3:]:
            rows[name] = _flat(chunk[name]).astype(float)
        modes = [np.array([*bank.modes, ""]) for bank in study.banks]
        selected = np.asarray(chunk["selected"])
        rows["selected"] = _flat(
            np.stack([names[row] for names, row in zip(modes, selected, strict=True)])
        )
        rows["failed"] = _flat(chunk["failed"]).astype(np.int64)
        rows["reason"] = _flat(chunk["reason"]).astype(str)
        yield rows


def choice_rows(study: Study, store: Store) -> Iterator[tables.Columns]:
    """Yield which model each criterion chose in every run, one chunk at a time."""
    criteria = [criterion.name for criterion in study.criteria]
    banks = [np.array([*criterion.banks, ""]) for criterion in study.criteria]
    for scenario, first, chunk in _chunks(study, store):
        n = len(chunk["seeds"])
        chosen = np.asarray(chunk["selected_model"])
        yield {
            "scenario": np.full(n * len(criteria), scenario),
            "run": np.repeat(np.arange(first, first + n), len(criteria)),
            "criterion": np.tile(criteria, n),
            "chosen": _flat(
                np.stack([names[row] for names, row in zip(banks, chosen, strict=True)])
            ),
        }


def _chunks(study: Study, store: Store) -> Iterator[tuple[str, int, Mapping[str, NDArray[Any]]]]:
    for case in study.scenarios:
        for path in store.chunks(case.name):
            yield case.name, int(path.stem.rpartition("-")[2]), store.load(path)


def _flat(values: Any) -> NDArray[Any]:
    """(B, n) -> run by run."""
    return np.asarray(values).T.ravel()

"""The Dataset of a study, put together from what the runs of each scenario come to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from imm_tdoa.contract import Array
from imm_tdoa.study.results import figures
from imm_tdoa.study.results.figures import padded
from imm_tdoa.study.results.gather import Gathered
from imm_tdoa.study.results.statistics import Interval

if TYPE_CHECKING:
    from imm_tdoa.study.plan import Study

UNITS = {
    "position_rmse": ("m", "root mean square position error"),
    "position_error": ("m", "mean length of the position error"),
    "velocity_rmse": ("m/s", "root mean square velocity error"),
    "nees_ratio": ("1", "normalised estimation error squared over its expectation"),
    "nis_ratio": ("1", "normalised innovation squared over its expectation"),
    "recognition": ("1", "share of scans in which the true form of motion is the most probable"),
    "recognition_delay": ("s", "time from a switch until the true form of motion leads"),
    "failed": ("1", "share of runs that failed"),
    "evidence_wins": ("1", "share of runs in which this bank has the largest likelihood"),
    "evidence_gap": ("nat", "mean log-likelihood behind the best bank"),
    "bound_ratio": ("1", "position RMSE over the Cramér-Rao bound"),
    "gdop": ("1", "geometric dilution of precision, mean over the scans"),
    "nees_inside": ("1", "share of scans whose average NEES is where it should be"),
    "runs_used": ("1", "runs behind the errors"),
    "effective_runs": ("1", "equal runs that would make up the squared error"),
    "seconds_per_step": ("s", "computing time of one step of one run"),
    "selected": ("1", "share of runs in which this mode has most of the probability"),
    "chosen": ("1", "share of runs in which the criterion chooses this bank"),
    "rmse_ratio": ("1", "RMSE of bank over that of other, same runs"),
    "evidence_margin": ("nat", "log-likelihood of a run's best bank over its second"),
}


def dataset(
    study: Study, found: list[Gathered], bounds: Sequence[Mapping[str, Any]], ranked_by: str
) -> xr.Dataset:
    """Return all figures of a study but computing times and single runs.

    Parameters
    ----------
    study : Study
        What was asked.
    found : list of Gathered
        One for each scenario.
    bounds : sequence of mapping
        Of each scenario: ``position_bound`` (T,), least possible mean squared position errors,
        m², and ``gdop`` (T,), NaN where there is none; ``reason``, why there is none.
    ranked_by : "position" or "velocity"
        The error by which banks were compared.
    """
    data = _coordinates(study, found)
    data.attrs["ranked_by"] = ranked_by
    least = [np.asarray(bound["position_bound"], dtype=float) for bound in bounds]
    _add_banks(data, found, least, study.confidence)
    _add_pairs(data, found, study.confidence)
    _add_scans(data, found, study.confidence)
    _add_bounds(data, least, bounds)
    _add_choices(data, found, study)
    return data


def name_units(data: xr.Dataset) -> None:
    """Say of each figure what it is and in which unit."""
    for name, (unit, text) in UNITS.items():
        for key in (name, f"{name}_low", f"{name}_high", f"{name}_by_time"):
            if key in data:
                data[key].attrs.update(units=unit, long_name=text)


def _coordinates(study: Study, found: list[Gathered]) -> xr.Dataset:
    banks = [bank.name for bank in study.banks]
    data = xr.Dataset(
        coords={
            "scenario": [case.name for case in study.scenarios],
            "bank": banks,
            "other": banks,
            "criterion": np.array([criterion.name for criterion in study.criteria], dtype=str),
        },
        attrs={
            "title": study.title,
            "question": study.question,
            "reading": study.reading,
            "notes": study.notes,
            "seed": str(study.seed),
            "runs": study.runs,
            "confidence": study.confidence,
            "metrics": " ".join(study.metrics),
        },
    )
    data["base"] = "scenario", np.array([case.base for case in study.scenarios], dtype=str)
    _add_points(data, "scenario", [dict(case.point) for case in study.scenarios])
    _add_points(data, "bank", [dict(bank.point) for bank in study.banks])
    _add_names(data, "mode_name", ("bank", "mode"), [bank.modes for bank in study.banks])
    candidates = [criterion.banks for criterion in study.criteria]
    _add_names(data, "candidate_name", ("criterion", "candidate"), candidates)
    scans = max(len(one.times) for one in found)
    times = [padded([one.times[None]], scans)[0] for one in found]
    data["time_s"] = ("scenario", "time"), np.concatenate(times)
    data["dims"] = "scenario", np.array([one.dims for one in found])
    data["runs_done"] = "scenario", np.array([one.runs for one in found])
    return data


def _add_names(
    data: xr.Dataset, name: str, dims: tuple[str, str], names: Sequence[Sequence[str]]
) -> None:
    """Add rows of names, shorter ones filled up with nothing."""
    most = max((len(row) for row in names), default=0)
    rows = [[*row, *[""] * (most - len(row))] for row in names]
    data[name] = dims, np.array(rows, dtype=str).reshape(len(names), most)


def _add_points(data: xr.Dataset, of: str, points: list[dict[str, Any]]) -> None:
    """Add the swept parameters of scenarios or banks, as text and, where they are, as numbers."""
    parameters = list(dict.fromkeys(key for point in points for key in point))
    size, dims = (len(points), len(parameters)), (of, f"{of}_parameter")
    text = [[_text(point.get(key, "")) for key in parameters] for point in points]
    value = [[_number(point.get(key)) for key in parameters] for point in points]
    data[f"{of}_parameter"] = f"{of}_parameter", np.array(parameters, dtype=str)
    data[f"{of}_point"] = dims, np.array(text, dtype=str).reshape(size)
    data[f"{of}_value"] = dims, np.array(value, dtype=float).reshape(size)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def _number(value: Any) -> float:
    known = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if known else np.nan


def _put(data: xr.Dataset, name: str, dims: tuple[str, ...], found: list[Interval]) -> None:
    for suffix, part in zip(("", "_low", "_high"), zip(*found, strict=True), strict=True):
        data[name + suffix] = dims, np.stack(part)


def _add_banks(
    data: xr.Dataset, found: list[Gathered], bounds: list[Array], confidence: float
) -> None:
    each = [
        figures.per_bank(one, bound, confidence) for one, bound in zip(found, bounds, strict=True)
    ]
    for name in each[0]:
        _put(data, name, ("scenario", "bank"), [one[name] for one in each])
    shape = ("scenario", "bank")
    data["nees_inside"] = shape, np.stack([figures.nees_inside(one, confidence) for one in found])
    errors = [one.moments["position_mse"] for one in found]
    data["runs_used"] = shape, np.stack([m.count for m in errors])
    data["effective_runs"] = shape, np.stack([m.effective for m in errors])
    margins = [one.margin for one in found]
    data["evidence_margin"] = "scenario", np.array([float(m.average) for m in margins])


def _add_pairs(data: xr.Dataset, found: list[Gathered], confidence: float) -> None:
    rmse = data[f"{data.attrs['ranked_by']}_rmse"].values
    compared = [figures.compare(one, confidence) for one in found]
    ranked = [
        figures.rank(row, adjusted, confidence)
        for row, (*_, adjusted) in zip(rmse, compared, strict=True)
    ]
    shape = ("scenario", "bank", "other")
    _put(data, "rmse_ratio", shape, [ratio for ratio, *_ in compared])
    data["p"] = shape, np.stack([p for _, p, _ in compared])
    data["p_holm"] = shape, np.stack([adjusted for *_, adjusted in compared])
    data["different"] = shape, np.stack([different for _, different, _ in ranked])
    data["place"] = ("scenario", "bank"), np.stack([place for place, *_ in ranked])
    data["letters"] = ("scenario", "bank"), np.array([names for *_, names in ranked], dtype=str)


def _add_scans(data: xr.Dataset, found: list[Gathered], confidence: float) -> None:
    scans = data.sizes["time"]
    each = [figures.per_scan(one, confidence) for one in found]
    for name in each[0]:
        for suffix, part in (("", "value"), ("_low", "low"), ("_high", "high")):
            rows = [getattr(one[name], part) for one in each]
            data[f"{name}_by_time{suffix}"] = ("scenario", "bank", "time"), padded(rows, scans)
    data["mode_probability"] = (
        ("scenario", "bank", "time", "mode"),
        padded([one.scans["mode_probability"].mean for one in found], scans),
    )


def _add_bounds(data: xr.Dataset, least: list[Array], bounds: Sequence[Mapping[str, Any]]) -> None:
    scans, shape = data.sizes["time"], ("scenario", "time")
    data["position_bound_by_time"] = shape, np.sqrt(padded([b[None] for b in least], scans)[:, 0])
    gdop = padded([np.asarray(bound["gdop"], dtype=float)[None] for bound in bounds], scans)[:, 0]
    data["gdop_by_time"] = shape, gdop
    known = np.isfinite(gdop)
    total = np.sum(np.where(known, gdop, 0.0), axis=-1)
    count = known.sum(axis=-1)
    data["gdop"] = "scenario", np.where(count > 0, total / np.maximum(count, 1), np.nan)
    data["no_bound"] = "scenario", np.array([str(bound["reason"]) for bound in bounds], dtype=str)


def _add_choices(data: xr.Dataset, found: list[Gathered], study: Study) -> None:
    some = np.array([len(bank.modes) for bank in study.banks])[:, None] > 1
    chosen = [figures.shares(np.where(some, one.selected, 0.0), study.confidence) for one in found]
    _put(data, "selected", ("scenario", "bank", "mode"), chosen)
    if study.criteria:
        rows = [figures.shares(one.chosen, study.confidence) for one in found]
        _put(data, "chosen", ("scenario", "criterion", "candidate"), rows)

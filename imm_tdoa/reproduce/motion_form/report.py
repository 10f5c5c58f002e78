"""The figures of a reproduction as tables and as a summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa.reproduce.motion_form.interacting import RULES, SOJOURN_S
from imm_tdoa.reproduce.motion_form.sample import Sample
from imm_tdoa.reproduce.motion_form.scenario import BIRTH_STD, KM, MODELS, RECONSTRUCTION, SWITCHING
from imm_tdoa.reproduce.motion_form.switching_target import STAY
from imm_tdoa.reproduce.motion_form.table_one import Row
from imm_tdoa.reproduce.motion_form.whole import MotionForm

Columns = dict[str, NDArray[Any]]


def tables(result: MotionForm) -> dict[str, Columns]:
    """Return the columns of every table, by file name."""
    return {
        "table1.csv": _columns([_row(row) for row in result.table.rows]),
        "imm.csv": _columns(_rivals(result)),
        "switching.csv": _over_time(result),
        "sweep.csv": _columns(
            [
                {
                    "model": single.model,
                    "process_noise": single.process_noise,
                    **_figures(single.sample),
                }
                for single in result.sweep.singles
            ]
        ),
    }


def summary(result: MotionForm) -> dict[str, Any]:
    """Return what ``summary.json`` holds; lengths in km."""
    best, chosen = result.sweep.best, result.switches.mixing
    ratio, error = result.switching.imms[chosen].ratio(best.sample)
    return {
        "source": "Li, Liu & Li 2024, doi 10.7654/j.issn.2097-1974.20240501",
        "reconstruction": RECONSTRUCTION,
        "runs": result.table.runs,
        "seed": result.table.seed,
        "switches": attrs.asdict(result.switches),
        "table1": {row.name: _row(row) for row in result.table.rows},
        "iterates_km": _listed(result.table.iterates_km),
        "imm": {
            "mean_sojourn_s": SOJOURN_S,
            "birth_std_kmps": BIRTH_STD["velocity"] / KM,
            "birth_std_kmps2": BIRTH_STD["acceleration"] / KM,
            "rows": _rivals(result),
        },
        "switching": {
            "probability_to_stay": STAY,
            "imm": {rule: _figures(s) for rule, s in result.switching.imms.items()},
            "bound_km": float(result.switching.bound_km.mean()),
            "best_single": {
                "model": best.model,
                "process_noise": best.process_noise,
                **_figures(best.sample),
            },
            "ratio_to_best_single": ratio,
            "ratio_standard_error": error,
        },
    }


def _figures(sample: Sample | None) -> dict[str, float]:
    if sample is None:
        return {"mean_km": np.nan, "standard_error_km": np.nan, "last_km": np.nan}
    return {
        "mean_km": sample.mean_km,
        "standard_error_km": sample.standard_error_km,
        "last_km": sample.last_km,
    }


def _row(row: Row) -> dict[str, Any]:
    return {
        "row": row.name,
        "paper_km": np.nan if row.paper_km is None else row.paper_km,
        **_figures(row.sample),
        "predicted_km": _mean(row.predicted_km),
        "bound_km": _mean(row.bound_km),
    }


def _rivals(result: MotionForm) -> list[dict[str, Any]]:
    rows = []
    for rivals in result.rivals:
        every: Mapping[str, Sample] = {
            **rivals.singles,
            **{f"imm-{rule}": sample for rule, sample in rivals.imms.items()},
        }
        for name, sample in every.items():
            ratio, error = sample.ratio(rivals.matched)
            rows.append(
                {
                    "motion": rivals.motion,
                    "estimator": name,
                    **_figures(sample),
                    "ratio_to_matched": ratio,
                    "ratio_standard_error": error,
                    "last_true_mode_probability": {
                        f"imm-{rule}": p for rule, p in rivals.true_mode_probability.items()
                    }.get(name, np.nan),
                }
            )
    return rows


def _over_time(result: MotionForm) -> Columns:
    columns: Columns = {"time_s": SWITCHING.times[1:]}
    for rule in RULES:
        columns[f"imm_{rule}_km"] = result.switching.imms[rule].over_time_km
    columns["best_single_km"] = result.sweep.best.sample.over_time_km
    columns["bound_km"] = result.switching.bound_km
    for rule in RULES:
        for j, mode in enumerate(MODELS):
            columns[f"p_{mode}_{rule}"] = result.switching.mode_probability[rule][:, j]
    return columns


def _columns(rows: Sequence[Mapping[str, Any]]) -> Columns:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def _mean(values: NDArray[Any] | None) -> float:
    return np.nan if values is None else float(values.mean())


def _listed(values: NDArray[Any] | None) -> list[float] | None:
    return None if values is None else [float(v) for v in values]

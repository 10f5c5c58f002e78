"""The figures of the reproduction as tables and as a summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.receiver_errors.coordinate import COMPARED
from imm_tdoa.reproduce.receiver_errors.levels import Curve
from imm_tdoa.reproduce.receiver_errors.points import Point
from imm_tdoa.reproduce.receiver_errors.sample import ESTIMATORS, Sample
from imm_tdoa.reproduce.receiver_errors.scenario import RECONSTRUCTION
from imm_tdoa.reproduce.receiver_errors.whole import ReceiverErrors

Columns = dict[str, NDArray[Any]]


def tables(result: ReceiverErrors) -> dict[str, Columns]:
    """Return the columns of every table, by file name."""
    rows = [_row(point, name) for point in result.table.points for name in ESTIMATORS]
    return {
        "table.csv": {key: np.array([row[key] for row in rows]) for key in rows[0]},
        "noise.csv": _curves(result.curves),
        "shared_coordinate.csv": {
            "away_m": result.coordinate.away,
            **_pair("bound", result.coordinate.bound),
            **{
                column: values
                for name in COMPARED
                for column, values in _pair(_key(name), result.coordinate.rmse(name)).items()
            },
            **{
                f"{_key(name)}_median_mps": result.coordinate.median(name)
                for name in ("squared", "error-correction")
            },
        },
    }


def summary(result: ReceiverErrors) -> dict[str, Any]:
    """Return what ``summary.json`` holds; m and m/s."""
    nearest = int(np.argmin(np.abs(np.log(result.coordinate.away / 0.01))))
    return {
        "source": "Xiong et al. 2021, CN112444776A",
        "reconstruction": RECONSTRUCTION,
        "runs": result.table.runs,
        "seed": result.table.seed,
        "receiver_weights": result.table.weights,
        "points": [_point(point) for point in result.table.points],
        "shared_coordinate": {
            "away_m": float(result.coordinate.away[nearest]),
            "bound_mps": float(result.coordinate.bound[nearest, 1]),
            **{
                f"{_key(name)}_mps": float(result.coordinate.rmse(name)[nearest, 1])
                for name in COMPARED
            },
        },
    }


def _point(point: Point) -> dict[str, Any]:
    return {
        "source": point.source,
        "range_variance_m2": point.case.range_variance,
        "receiver_variance_m2": point.case.receiver_variance,
        "low_or_moderate_noise": point.efficient,
        "bound_m": point.bound[0],
        "bound_mps": point.bound[1],
        "trusting_theory_m": point.trusting[0],
        "trusting_theory_mps": point.trusting[1],
        "receiver_error_ratio": point.receiver_gain,
        "estimators": {name: _figures(sample) for name, sample in point.samples.items()},
    }


def _figures(sample: Sample) -> dict[str, float]:
    return {
        "rmse_m": sample.position_rmse_m,
        "standard_error_m": sample.standard_error_m,
        "rmse_mps": sample.velocity_rmse_mps,
        "bias_m": sample.bias_m,
        "fallback_share": sample.fallback_share,
    }


def _row(point: Point, name: str) -> dict[str, Any]:
    return {
        "emitter": point.source,
        "range_variance_m2": point.case.range_variance,
        "receiver_variance_m2": point.case.receiver_variance,
        "estimator": name,
        "bound_m": point.bound[0],
        "bound_mps": point.bound[1],
        **_figures(point.samples[name]),
        "theory_m": point.trusting[0] if name == "trusted" else np.nan,
        "theory_mps": point.trusting[1] if name == "trusted" else np.nan,
        "reference_m": point.reference_m.get(name, np.nan),
        "reference_mps": point.reference_mps.get(name, np.nan),
    }


def _curves(curves: tuple[Curve, ...]) -> Columns:
    parts: list[Mapping[str, NDArray[Any]]] = [
        {
            "emitter": np.repeat(curve.source, len(curve.levels)),
            "varied": np.repeat(curve.varied, len(curve.levels)),
            "variance_m2": curve.levels,
            **_pair("bound", curve.bound),
            **_pair("trusting_theory", curve.trusting),
            **{
                column: values
                for name in ESTIMATORS
                for column, values in _pair(_key(name), curve.rmse(name)).items()
            },
            "joint_fallback_share": np.array([s["joint"].fallback_share for s in curve.samples]),
        }
        for curve in curves
    ]
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}


def _pair(name: str, values: Array) -> dict[str, Array]:
    return {f"{name}_m": values[:, 0], f"{name}_mps": values[:, 1]}


def _key(name: str) -> str:
    return name.replace("-", "_")

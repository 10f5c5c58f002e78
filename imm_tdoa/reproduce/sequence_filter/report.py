"""The figures of the reproduction as tables and as a summary; the claims beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np
from numpy.typing import NDArray

from imm_tdoa.reproduce.sequence_filter import geometries, moving
from imm_tdoa.reproduce.sequence_filter.cases import FIRST, Outcome
from imm_tdoa.reproduce.sequence_filter.geometries import Geometry
from imm_tdoa.reproduce.sequence_filter.moving import Band
from imm_tdoa.reproduce.sequence_filter.scenario import RECONSTRUCTION
from imm_tdoa.reproduce.sequence_filter.spots import together
from imm_tdoa.reproduce.sequence_filter.whole import Reproduction

Columns = dict[str, NDArray[Any]]
SOURCE = "Xu & Hua 2020, patent of CAAC's Second Research Institute and Sichuan University"


@attrs.frozen
class Claim:
    """What the source claims, and what came out."""

    claim: str
    ours: str


def claims(result: Reproduction) -> list[Claim]:
    """Return the source's claims beside our findings."""
    spot, bound, outside = (result.outcome(name) for name in (FIRST, "bound", "outside"))
    slow, fast = (
        next(b for b in result.bands if b.weights == "full" and b.speed_mps == v)
        for v in (moving.SPEEDS_MPS[0], moving.SPEEDS_MPS[-1])
    )
    return [
        Claim(
            "the spot of a target that stands shrinks to a point",
            f"yes, {spot.spots.shrink:.0f}-fold, with iso inside the ring (kappa "
            f"{spot.kappa:.2f}); {bound.spots.shrink:.1f}-fold with bound ({bound.kappa:.1f}), "
            f"{outside.spots.shrink:.1f}-fold outside ({outside.kappa:.1f})",
        ),
        Claim(
            "the position is more accurate",
            f"for a target that stands: {spot.spots.gain:.0f} times; the point is "
            f"{together(spot.spots.error_m):.3f} m off, {_over(spot)} times its own radius",
        ),
        Claim(
            "the band of a slow target shrinks to a line",
            f"at {slow.speed_mps:g} m/s {slow.raw_width_m / slow.width_m:.2f} times narrower, paid "
            f"with a lag of {slow.lag_m:.2f} m: rms error {slow.raw_error_m:.2f} before, "
            f"{slow.error_m:.2f} m after; at {fast.speed_mps:g} m/s "
            f"{fast.raw_width_m / fast.width_m:.2f} times",
        ),
        Claim(
            "the gate avoids errors when the motion changes suddenly",
            _jumped(result),
        ),
    ]


def _over(outcome: Outcome) -> str:
    spots = outcome.spots
    return f"{together(spots.error_m) / together(spots.radius_m):.1f}"


def _jumped(result: Reproduction) -> str:
    own, without = (
        next(j for j in result.jumps if j.label == label)
        for label in ("gate, no reset (the source)", "no gate")
    )
    return (
        f"yes: {own.told[0]:.1f} m off at once after a jump of {moving.JUMP_M:g} m, "
        f"{without.told[0]:.0f} m without the gate"
    )


def tables(result: Reproduction) -> dict[str, Columns]:
    """Return the columns of every table, by file name."""
    return {
        "cases.csv": _columns([case_row(o) for o in result.outcomes]),
        "moving.csv": _columns([band_row(b) for b in result.bands]),
        "jump.csv": _columns(
            [
                {"filter": j.label, "raw_error_m": j.raw_error_m}
                | {f"error_after_{k}_m": error for k, error in j.told.items()}
                for j in result.jumps
            ]
        ),
        "geometries.csv": _columns([geometry_row(g) for g in result.geometries]),
    }


def summary(result: Reproduction) -> dict[str, Any]:
    """Return what ``summary.json`` holds."""
    return {
        "source": SOURCE,
        "reconstruction": RECONSTRUCTION,
        "runs": result.runs,
        "seed": result.seed,
        "switches": attrs.asdict(result.switches),
        "claims": [attrs.asdict(claim) for claim in claims(result)],
        "cases": [case_row(o) for o in result.outcomes],
        "moving": [band_row(b) for b in result.bands],
        "jump": {j.label: j.told for j in result.jumps},
        "kappa": {
            "geometries": len(result.geometries),
            "predicted_right": result.right,
            "shrunk_from_ratio": geometries.SHRUNK,
            "rows": [geometry_row(g) for g in result.geometries],
        },
    }


def case_row(outcome: Outcome) -> dict[str, Any]:
    """Return a case as a row of a table."""
    spots, (kappa, shrink, gain) = outcome.spots, outcome.case.reference
    known = outcome.weights == "diagonal"
    return {
        "case": outcome.case.name,
        "weights": outcome.weights,
        "kappa": outcome.kappa,
        "reference_kappa": kappa if known else np.nan,
        "raw_radius_m": together(spots.raw_radius_m),
        "radius_m": together(spots.radius_m),
        "radius_ratio": spots.shrink,
        "reference_radius_ratio": shrink if known else np.nan,
        "raw_error_m": together(spots.raw_error_m),
        "error_m": together(spots.error_m),
        "error_ratio": spots.gain,
        "reference_error_ratio": gain if known else np.nan,
        "gate_failures": outcome.gated,
    }


def band_row(band: Band) -> dict[str, Any]:
    """Return a moving target as a row of a table."""
    ratio, lag, raw, after = band.reference
    return {
        "speed_mps": band.speed_mps,
        "weights": band.weights,
        "raw_width_m": band.raw_width_m,
        "width_m": band.width_m,
        "width_ratio": band.raw_width_m / band.width_m,
        "reference_width_ratio": ratio,
        "lag_m": band.lag_m,
        "reference_lag_m": lag,
        "raw_error_m": band.raw_error_m,
        "reference_raw_error_m": raw,
        "error_m": band.error_m,
        "reference_error_m": after,
        "mean_gain": band.gain,
        "gate_failures": band.gated,
    }


def geometry_row(geometry: Geometry) -> dict[str, Any]:
    """Return a random geometry as a row of a table."""
    return {
        "dims": str(geometry.dims),
        "stations": str(geometry.stations),
        "kappa": geometry.kappa,
        "radius_ratio": geometry.spots.shrink,
        "error_ratio": geometry.spots.gain,
        "mean_gain": geometry.mean_gain,
        "predicted": "shrinks" if geometry.predicted else "stays",
        "found": "shrinks" if geometry.shrunk else "stays",
    }


def _columns(rows: Sequence[Mapping[str, Any]]) -> Columns:
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}

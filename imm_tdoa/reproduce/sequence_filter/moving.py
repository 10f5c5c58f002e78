"""Targets that move, slowly: what the line that the band becomes is paid with (ALGORITHMS §6.3)."""

from __future__ import annotations

from typing import Any

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.sequence_filter import scenario
from imm_tdoa.reproduce.sequence_filter.cases import check_runs
from imm_tdoa.reproduce.sequence_filter.switches import Switches
from imm_tdoa.sequence_filter.loop_gain import Weights

SPEEDS_MPS = (1.0, 5.0, 20.0)
MIDDLE = np.array([200.0, -300.0])  # half-way, m
COURSE = np.radians(30.0)
EPOCHS = 200
REFERENCE = {1.0: (1.55, 0.81, 0.906, 1.028), 5.0: (1.06, np.nan, np.nan, np.nan)}
TURN_RADIUS_M = 12.0  # of the slow turn that is drawn
TURN_SPEED_MPS = 1.0
JUMP_M = 30.0
JUMP_EPOCH = 150
JUMP_EPOCHS = 200
AFTER = (0, 1, 2, 5, 20)  # epochs after the jump that are told


@attrs.frozen(eq=False)
class Band:
    """The band of fixes of a target on a straight line, before and after, over the last epochs.

    Attributes
    ----------
    speed_mps : float
        How fast it goes.
    raw_width_m, width_m : float
        Rms distance of the fixes from the line.
    raw_lag_m, lag_m : float
        How far the fixes trail the target, on average.
    raw_error_m, error_m : float
        Rms distance from the target: what counts.
    gain : float
        Mean Kalman gain.
    gated : float
        Share of the differences at which the gate failed.
    reference : tuple of float
        Ratio of widths, lag, raw and filtered error that another program found; NaN: none.
    """

    weights: Weights
    speed_mps: float
    raw_width_m: float
    width_m: float
    raw_lag_m: float
    lag_m: float
    raw_error_m: float
    error_m: float
    gain: float
    gated: float
    reference: tuple[float, float, float, float]


def band(
    speed_mps: float,
    weights: Weights = "full",
    runs: int = 50,
    seed: int = 1,
    switches: Switches | None = None,
    **arguments: Any,
) -> Band:
    """Filter a target that goes straight on at `speed_mps`; `arguments` go to the filter."""
    switches = Switches() if switches is None else switches
    along = np.array([np.cos(COURSE), np.sin(COURSE)])
    across = np.array([-along[1], along[0]])
    times = np.arange(float(EPOCHS))
    truth = MIDDLE + speed_mps * (times - EPOCHS / 2)[:, None] * along
    stations = scenario.ring()
    generator = np.random.default_rng([seed, 100])
    values = scenario.measured(stations, truth, check_runs(runs), generator)
    result = switches.stage(stations, weights, **arguments).run(times, values)

    def judged(position: Array) -> tuple[float, float, float]:
        error = (position - truth)[:, -scenario.LAST :]
        width = np.sqrt(np.mean((error @ across) ** 2))
        total = np.sqrt(np.mean(np.einsum("rtd,rtd->rt", error, error)))
        return float(width), float(-np.mean(error @ along)), float(total)

    raw, after = judged(result.raw_position), judged(result.position)
    nothing = (np.nan, np.nan, np.nan, np.nan)
    known = switches == Switches() and weights == "diagonal" and not arguments
    return Band(
        weights=weights,
        speed_mps=speed_mps,
        raw_width_m=raw[0],
        width_m=after[0],
        raw_lag_m=raw[1],
        lag_m=after[1],
        raw_error_m=raw[2],
        error_m=after[2],
        gain=float(np.mean(result.gain[:, -scenario.LAST :])),
        gated=float(np.mean(result.gated[:, -scenario.LAST :])),
        reference=REFERENCE.get(speed_mps, nothing) if known else nothing,
    )


@attrs.frozen(eq=False)
class Turn:
    """Fixes (T, 2) of one run of a slow turn, before and after, and the true path, m.

    Attributes
    ----------
    truth : (T, 2)
        The true path, m.
    raw_fixes, fixes : (T, 2)
        Of the measured and of the filtered differences, m.
    """

    truth: Array
    raw_fixes: Array
    fixes: Array


def turn(seed: int = 1, switches: Switches | None = None) -> Turn:
    """Filter a target that goes straight, turns about and comes back, slowly."""
    switches = Switches() if switches is None else switches
    arc = np.pi * TURN_RADIUS_M
    s = np.arange(0.0, 60.0 + arc, TURN_SPEED_MPS) - 30.0
    angle = np.clip(s / TURN_RADIUS_M, 0.0, np.pi)
    there, back = np.minimum(s, 0.0), np.maximum(s - arc, 0.0)
    x = there + TURN_RADIUS_M * np.sin(angle) - back
    y = TURN_RADIUS_M * (1.0 - np.cos(angle))
    truth = MIDDLE + np.stack([x, y], axis=-1)
    stations = scenario.ring()
    values = scenario.measured(stations, truth, 1, np.random.default_rng([seed, 101]))
    result = switches.stage(stations).run(np.arange(float(len(truth))), values)
    return Turn(truth, result.raw_position[0], result.position[0])


@attrs.frozen(eq=False)
class Jump:
    """Rms error (T,), m, of a target that is suddenly elsewhere, and what the filter was.

    Attributes
    ----------
    label : str
        What the filter was, one of `JUMPS`.
    error_m : (T,)
        Rms error at each epoch, m.
    raw_error_m : float
        That of unfiltered fixes, m.
    """

    label: str
    error_m: Array
    raw_error_m: float

    @property
    def told(self) -> dict[int, float]:
        """Errors some epochs after the jump."""
        return {k: float(self.error_m[JUMP_EPOCH + k]) for k in AFTER}


JUMPS: dict[str, dict[str, Any]] = {
    "gate, no reset (the source)": {"reset_on_gate": False},
    "gate, reset": {"reset_on_gate": True},
    "no gate": {"gate": None},
    "Q = 0, gate, no reset": {"multiplier": 0.0, "reset_on_gate": False},
    "Q = 0, gate, reset": {"multiplier": 0.0, "reset_on_gate": True},
    "Q = 0, no gate": {"multiplier": 0.0, "gate": None},
}


def jump(label: str, runs: int = 50, seed: int = 1, switches: Switches | None = None) -> Jump:
    """Filter a target that stands and is then 30 m further east, by one of `JUMPS`."""
    switches = Switches() if switches is None else switches
    times = np.arange(float(JUMP_EPOCHS))
    east = np.where(times < JUMP_EPOCH, 0.0, JUMP_M)
    truth = scenario.INSIDE + east[:, None] * np.array([1.0, 0.0])
    stations = scenario.ring()
    generator = np.random.default_rng([seed, 102])
    values = scenario.measured(stations, truth, check_runs(runs), generator)
    result = switches.stage(stations, **JUMPS[label]).run(times, values)
    square = [
        np.einsum("rtd,rtd->rt", p - truth, p - truth)
        for p in (result.position, result.raw_position)
    ]
    return Jump(label, np.sqrt(square[0].mean(axis=0)), float(np.sqrt(square[1].mean())))

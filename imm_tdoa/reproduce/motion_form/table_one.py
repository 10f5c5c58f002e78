"""Source A's Table 1: three targets, one motion model each (ALGORITHMS §5.3)."""

from __future__ import annotations

from collections.abc import Mapping

import attrs
import numpy as np

from imm_tdoa.contract import Array
from imm_tdoa.reproduce.motion_form import expected, faithful, scenario, tracking
from imm_tdoa.reproduce.motion_form.sample import Sample
from imm_tdoa.reproduce.motion_form.scenario import (
    CONSTANT_ACCELERATION,
    CONSTANT_VELOCITY,
    KM,
    MODELS,
    MOTIONS,
    STATIC,
    Motion,
)
from imm_tdoa.reproduce.motion_form.switches import Switches
from imm_tdoa.reproduce.motion_form.tracking import Data

PAPER_STATIC_KM = 0.982
PAPER_KM = {"scenario-1": 0.591, "scenario-2": 10.618, "scenario-3": 0.781}
GUESS_KM = 1.0  # how far off the paper's iteration starts where it is shown to diverge
ITERATIONS = 6


@attrs.frozen(eq=False)
class Row:
    """One line of Table 1.

    Attributes
    ----------
    name, label : str
        Short name, and what tables say.
    motion : Motion
        How the targets move.
    paper_km : float or None
        The paper's mean error.
    sample : Sample or None
        Ours; None where the estimator diverges.
    predicted_km : (3, K) or None
        Mean error of each target at each epoch by theory: the bias of a run without noise and
        the covariance along the truth. None where there is no theory.
    bound_km : (3, K) or None
        Mean error at the posterior Cramér-Rao bound of the right model, for an estimator that
        uses it.
    estimate : (3, K + 1, 2) or None
        Positions of the first run, m.
    """

    name: str
    label: str
    motion: Motion
    paper_km: float | None
    sample: Sample | None
    predicted_km: Array | None
    bound_km: Array | None
    estimate: Array | None


@attrs.frozen(eq=False)
class Table:
    """Table 1.

    Attributes
    ----------
    rows : tuple of Row
        In the paper's order; the static estimators first.
    runs, seed : int
        How many runs, from which seed.
    switches : Switches
        What was taken as printed.
    iterates_km : (ITERATIONS + 1,) or None
        With ``tdoa_sign="eq8"``: mean error of the static iteration after each step, without
        noise, from a guess 1 km off.
    """

    rows: tuple[Row, ...]
    runs: int
    seed: int
    switches: Switches
    iterates_km: Array | None

    def row(self, name: str) -> Row:
        """Return the row called `name`."""
        return next(row for row in self.rows if row.name == name)


def table(runs: int = 100, seed: int = 1, switches: Switches | None = None) -> Table:
    """Compute Table 1.

    Parameters
    ----------
    runs : int
        Monte-Carlo runs of the three targets, at least 2.
    seed : int
        Seed of the noise; every row sees the same.
    switches : Switches, optional
        What to take as printed; default nothing.
    """
    switches = Switches() if switches is None else switches
    wrong_sign = switches.tdoa_sign == "eq8"
    data = {m.name: Data.drawn(seed, runs, m, switches) for m in MOTIONS}
    beside: Mapping[str, float] = {f"static-{switches.static}": PAPER_STATIC_KM, **PAPER_KM}

    def filtered(name: str, label: str, model: str, motion: Motion) -> Row:
        sign = -1.0 if wrong_sign and model == "static" else 1.0
        return _filtered(name, label, model, data[motion.name], beside.get(name), sign)

    rows = (
        _per_epoch(data["static"], beside.get("static-per-epoch")),
        filtered("static-recursive", "static target, recursive", MODELS[0], STATIC),
        filtered("scenario-1", "scenario 1: CV filter, CV target", MODELS[1], CONSTANT_VELOCITY),
        filtered(
            "scenario-2", "scenario 2: CV filter, CA target", MODELS[1], CONSTANT_ACCELERATION
        ),
        filtered(
            "scenario-3", "scenario 3: CA filter, CA target", MODELS[2], CONSTANT_ACCELERATION
        ),
    )
    return Table(rows, runs, seed, switches, _diverging(switches) if wrong_sign else None)


def _filtered(
    name: str, label: str, model: str, data: Data, paper_km: float | None, sign: float
) -> Row:
    motion, switches = data.motion, data.switches
    positions = tracking.model_positions(model, data, switches.process_noise, sign)
    right = motion.name == model and switches.jacobian == "zeros" and sign == 1.0
    return Row(
        name=name,
        label=label,
        motion=motion,
        paper_km=paper_km,
        sample=Sample.of(positions, motion.truth()),
        predicted_km=expected.of_filter(model, motion, switches) if sign == 1.0 else None,
        bound_km=expected.bound_of_filter(motion, switches) if right else None,
        estimate=positions[0],
    )


def _per_epoch(data: Data, paper_km: float | None) -> Row:
    switches, positions = data.switches, None
    if switches.tdoa_sign == "slave-master":
        later = tracking.fixes(data.values[..., 1:, :], switches).position
        positions = np.concatenate([data.first.position[..., None, :], later], axis=-2)
    return Row(
        name="static-per-epoch",
        label="static target, each epoch alone",
        motion=data.motion,
        paper_km=paper_km,
        sample=None if positions is None else Sample.of(positions, data.motion.truth()),
        predicted_km=None if positions is None else expected.of_fixes(data.motion, switches),
        bound_km=expected.bound_of_fixes(data.motion, switches),
        estimate=None if positions is None else positions[0],
    )


def _diverging(switches: Switches) -> Array:
    measurement, truth = scenario.measurement(switches), STATIC.truth()[:, 0]
    guess = truth[:, :2] + np.array([GUESS_KM * KM, 0.0])
    places = faithful.iterates(
        measurement, scenario.ideal(STATIC)[:, 0], guess, ITERATIONS, sign=-1.0
    )
    away = np.linalg.norm(places - truth[:, None, :2], axis=-1)
    return np.asarray(away.mean(axis=0) / KM)

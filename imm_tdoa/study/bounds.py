"""The least error of a tracker that is told which motion was when, and knows no more of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imm_tdoa import bounds, registry
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array
from imm_tdoa.study.draw import Drawn, clock, draw, stations_of
from imm_tdoa.study.plan import Study
from imm_tdoa.study.scenarios import ScenarioCase
from imm_tdoa.study.ways import Ways, form_of

SAMPLE = 32  # runs averaged over, where the way or the rows that arrive are drawn


def bound(study: Study, case: ScenarioCase) -> dict[str, Any]:
    """Return the posterior Cramér-Rao bound of the position and the dilution of precision.

    The bound is of an estimator that is told when the motion changes, and to what; what each
    motion brings has the widest birth law of the study's banks (of a random way, its own). A bank
    that is told more, by a narrower law or by a motion of fewer components, may err less.
    Where way, target or losses differ from run to run it is the mean over the first runs.

    Returns
    -------
    dict
        ``position_bound`` (T,), least mean square position error, m², NaN where there is none;
        ``gdop`` (T,), geometric dilution of precision; ``reason``, why there is no bound.
    """
    count = min(study.runs, SAMPLE) if _varies(case) else 1
    drawn = draw(case, study.seed, 0, max(count, min(len(case.plan.targets), study.runs)))
    T = drawn.values.shape[1]
    stations = stations_of(case.plan, clock(case.plan))
    where = drawn.ways.position
    moments = np.broadcast_to(drawn.times, where.shape[:2])[0]
    gdop = [bounds.gdop(stations, where[:, k], time=float(moments[k])).mean() for k in range(T)]
    try:
        squares = [_of_run(study, case, drawn, i) for i in range(len(drawn.seeds))]
        result, reason = np.mean(squares, axis=0), ""
    except ValueError as error:
        result, reason = np.full(T, np.nan), str(error)
    return {
        "position_bound": np.asarray(result),
        "gdop": np.array(gdop),
        "reason": np.array(reason),
    }


def _varies(case: ScenarioCase) -> bool:
    plan, drop = case.plan, case.plan.dropouts
    lost = drop.row or drop.scan or any(drop.station.values())
    return bool(
        case.random is not None
        or lost
        or plan.sampling.jitter_s
        or plan.sampling.rows == "tdoa-one-pair"
    )


def _of_run(study: Study, case: ScenarioCase, drawn: Drawn, i: int) -> Array:
    ways = drawn.ways
    bank = _told(study, case, ways)
    names = [form.name for form in ways.forms]
    covariance, components = _start(case, ways)
    found = bounds.pcrlb(
        bank,
        drawn.measurement,
        drawn.times if drawn.times.ndim == 1 else drawn.times[i],
        ways.state[i][..., _columns(bank, ways)],
        modes=[names[k] for k in ways.form[i]],
        covariance=covariance,
        components=None if covariance is None else components,
        present=drawn.values[i],
        pairs=None if drawn.pairs is None else drawn.pairs[i],
    )
    return found.position_rms**2


def _told(study: Study, case: ScenarioCase, ways: Ways) -> Bank:
    """The motions themselves; that of legs without noise, but for their white acceleration."""
    if case.random is not None:
        return case.random
    widest: dict[str, float] = {}
    for each in study.banks:
        for kind, std in each.bank.birth_std.items():
            widest[kind] = max(std, widest.get(kind, 0.0))
    noise: dict[str, set[float]] = {form.name: set() for form in ways.forms}
    for target in case.plan.targets:
        for leg in target.legs:
            noise.setdefault(form_of(leg).name, set()).add(leg.acceleration_psd)
    models = []
    for form in ways.forms:
        levels = noise.get(form.name) or {0.0}
        if len(levels) > 1:
            raise ValueError(f"legs of {form.name} differ in their acceleration_psd")
        psd = levels.pop()
        if psd > 0.0 and form.model == "constant-acceleration":
            raise ValueError("no motion model has constant acceleration and a white one on top")
        turning = form.model == "coordinated-turn"
        extra: Mapping[str, float] = {"turn_rate_psd": 0.0} if turning else {}
        models.append(registry.load(form.model)(psd=psd, **extra))
    return Bank(models, birth_std=widest, names=tuple(form.name for form in ways.forms))


def _columns(bank: Bank, ways: Ways) -> list[int]:
    return [ways.components.index(name) for name in bank.space(ways.dims).components]


def _start(case: ScenarioCase, ways: Ways) -> tuple[Array | None, Sequence[str]]:
    """What is known before the first scan: nothing, or what filters are told."""
    if case.start is None:
        return None, ()
    d = ways.dims
    std = [case.start.position_std_m] * d
    if case.start.velocity_std_mps is not None:
        std += [case.start.velocity_std_mps] * d
    return np.diag(np.square(std)), ways.components[: len(std)]

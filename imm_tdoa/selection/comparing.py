"""Motion models side by side on the same measurements (ALGORITHMS §11)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate
from imm_tdoa.bank import Bank
from imm_tdoa.contract import Array, Index, MeasurementModel, MotionModel
from imm_tdoa.cycle import RobustRule, UpdateRule
from imm_tdoa.imm import IMM
from imm_tdoa.scans import Scans
from imm_tdoa.selection import begin, evidence, verdict
from imm_tdoa.selection.best_fit import MaximumLikelihood, maximise, weighted
from imm_tdoa.selection.comparison import Comparison, Text
from imm_tdoa.selection.consistency import Consistency, consistency
from imm_tdoa.selection.surprise import surprising
from imm_tdoa.state import State
from imm_tdoa.statespace import KIND_OF
from imm_tdoa.track import Track

WIDTH = 20  # scans of the window that is drawn where none is asked for


def compare(
    models: Bank | Sequence[MotionModel],
    measurement: MeasurementModel,
    times: Any,
    values: Any,
    *,
    pairs: Any = None,
    start: State | None = None,
    names: Sequence[str] | None = None,
    prior: Any = None,
    birth_std: Mapping[str, float] | None = None,
    update: UpdateRule = "ekf",
    robust: RobustRule | None = None,
    window: int | None = None,
    criteria: bool = True,
    threshold: float = 3.0,
    significance: float = 1e-3,
    tolerance: float = 0.25,
) -> Comparison:
    """Decide which motion model explains the measurements of a whole track.

    Every model runs alone, all from one start and on the same rows, so that their likelihoods
    compare. The posterior probability decides, innovations that are too large veto, and where the
    margin is small the verdict is ``"imm"`` (`imm_tdoa.selection.verdict` has the rule).

    The mode probabilities of an IMM are something else: how probable each motion is *now*, for an
    emitter that switches. They forget, and say nothing about a track as a whole.

    Parameters
    ----------
    models : Bank or sequence of MotionModel
        The r candidates; of a bank its models, names, prior and birth law.
    measurement : MeasurementModel
        What is measured.
    times : (T,) or (..., T)
        Times of the scans, s.
    values : (..., T, m)
        What was measured; NaN is missing. Leading axes are targets or runs.
    pairs : (T, m, 2) or (..., T, m, 2), optional
        Station pairs of each row, where they change from scan to scan.
    start : State, optional
        Where the filters start (`IMM.start` of a bank of the same models); then the first scan
        counts as evidence too. Default: a fix made of the first scans, which is none.
    names : sequence of str, optional
        What to call the models.
    prior : (r,), optional
        Their probabilities before the data; default equal.
    birth_std : mapping, optional
        What is believed of velocity (m/s) and acceleration (m/s²) before the data, as for `Bank`.
        The evidence depends on it (Lindley's paradox); AIC and BIC do not.
    update, robust
        As for `IMM`. What a robust filter distrusts is distrusted for every model alike, in AIC
        and BIC too.
    window : int, optional
        Judge by the last so many scans only, for an emitter that may have switched before; the
        filters have then learned from the scans before them. Default: by all scans.
    criteria : bool
        Whether to work out AIC and BIC as well; NaN otherwise. The verdict needs neither, and
        the batch maximum likelihood behind them takes most of the time.
    threshold : float
        Least margin, nats, that decides; 3 is "strong".
    significance : float
        Probability that the veto rejects a model that is right.
    tolerance : float
        The veto also asks that the innovations squared exceed their expectation by this share: no
        sigma is known better, and thousands of scans make any excess significant.

    Returns
    -------
    Comparison
        Arrays with one entry per model, batch axes first; ``print`` shows a table.

    Raises
    ------
    ValueError
        What `Bank` and `IMM.run` refuse; a window or a significance that makes no sense.

    References
    ----------
    ALGORITHMS §11; Kass & Raftery, Bayes factors, JASA 90 (1995) 773-795.
    """
    bank = _bank(models, names, prior, birth_std)
    if window is not None and (isinstance(window, bool) or int(window) != window or window < 1):
        raise ValueError(f"window: expected a number of scans, 1 or more, got {window!r}")
    window = None if window is None else int(window)
    if not 0.0 < _validate.positive("significance", significance) < 1.0:
        raise ValueError(f"significance: expected a probability below 1, got {significance!r}")
    threshold = _validate.non_negative("threshold", threshold)
    tolerance = _validate.non_negative("tolerance", tolerance)
    imm = IMM(bank, measurement, update=update, merging="autonomous", robust=robust)
    scans = Scans.checked(measurement, times, values, pairs)
    track = imm.run(times, values, start=start, pairs=pairs)
    judged = slice(0 if window is None else -window, None)
    increments = track.mode_log_likelihood
    total = np.nansum(increments[..., judged, :], axis=-2)
    log_p = evidence.posterior(total, bank.prior)
    nis, dof = track.mode_nis[..., judged, :], track.nis_dof[..., judged]
    test = consistency(nis, dof, significance, tolerance)
    ruling = verdict.rule(log_p, test.rejected, threshold)
    fits = _fits(bank.models, track, scans, window, robust is not None) if criteria else None
    surprises = None
    if fits is not None and start is None and window is None:
        surprises = surprising(fits, track.space, bank.birth_std)
    verdicts, reasons = _words(bank.names, ruling, test, surprises)
    aic, bic, why, rows = _criteria(fits, total.shape, dof)
    width = window if window is not None else min(WIDTH, max(increments.shape[-2] // 4, 1))
    return Comparison(
        names=bank.names,
        prior=bank.prior,
        birth_std=_used(bank, measurement.dims),
        log_evidence=total,
        log_probability=log_p,
        aic=aic,
        bic=bic,
        reason_aic=why,
        rows=rows,
        parameters=np.array([len(components) for components in track.space.modes]),
        nis_p=test.p,
        nis_ratio=test.ratio,
        accepted=~test.rejected,
        best=ruling.best,
        runner_up=ruling.runner_up,
        margin=ruling.margin,
        threshold=threshold,
        verdict=verdicts,
        reason=reasons,
        times=track.times,
        evidence=evidence.cumulative(increments),
        windowed_evidence=evidence.windowed(increments, width),
        width=width,
        window=window,
        track=track,
    )


def _bank(
    models: Bank | Sequence[MotionModel],
    names: Sequence[str] | None,
    prior: Any,
    birth_std: Mapping[str, float] | None,
) -> Bank:
    if not isinstance(models, Bank):
        return Bank(models, names=tuple(names or ()), prior=prior, birth_std=birth_std or {})
    changes: dict[str, Any] = {}
    if names is not None:
        changes["names"] = tuple(names)
    if prior is not None:
        changes["prior"] = prior
    if birth_std is not None:
        changes["birth_std"] = {**models.birth_std, **birth_std}
    return attrs.evolve(models, **changes) if changes else models


def _used(bank: Bank, dims: int) -> dict[str, float]:
    """The birth law's standard deviations of the components that the models have."""
    space = bank.space(dims)
    kinds = {c: KIND_OF.get(c, c) for c in space.components}
    wanted = [k for c in space.components for k in (c, kinds[c])]
    return {k: bank.birth_std[k] for k in dict.fromkeys(wanted) if k in bank.birth_std}


def _words(
    names: Sequence[str],
    ruling: verdict.Ruling,
    test: Consistency,
    surprises: Text | None,
) -> tuple[Any, Any]:
    """Verdict and reason for every target, plain strings for a single one."""
    labels = np.where(ruling.decided, np.array(names)[ruling.best], verdict.IMM)
    p, ratio, rejected, small = test.p, test.ratio, test.rejected, test.small
    reasons = np.empty(labels.shape, dtype=object)
    for i in np.ndindex(labels.shape):
        best = int(ruling.best[i])
        reasons[i] = verdict.reason(
            names,
            best,
            int(ruling.runner_up[i]),
            float(ruling.margin[i]),
            bool(ruling.decided[i]),
            p[i].tolist(),
            ratio[i].tolist(),
            rejected[i].tolist(),
            small[i].tolist(),
            "" if surprises is None else str(surprises[(*i, best)]),
        )
    if labels.ndim == 0:
        return str(labels), str(reasons[()])
    return labels, reasons.astype(np.str_)


def _fits(
    models: Sequence[MotionModel], track: Track, scans: Scans, window: int | None, robust: bool
) -> list[MaximumLikelihood]:
    """Each model's batch maximum likelihood of the scans judged, rows as the track weighed them.

    Scans before the track's start nobody has judged: a robust comparison does without them.
    """
    batch = np.broadcast_shapes(scans.batch, track.row_weight.shape[:-2])
    weight = np.ones((*batch, *scans.values.shape[-2:]))
    rows = slice(scans.count - track.row_weight.shape[-2], None)
    known = track.row_weight
    weight[..., rows, :] = np.where(np.isfinite(known), known, 1.0)
    if robust:
        begun = np.zeros(weight.shape[:-1], dtype=bool)
        begun[..., rows] = np.isfinite(track.mean).all(axis=-1)
        weight = np.where(begun[..., None], weight, 0.0)
    if window is not None:
        last = slice(max(scans.count - window, 0), None)
        scans, weight = scans.part(last), weight[..., last, :]
    return [
        maximise(weighted(model, scans, weight), begin.initial_states(model, track, j, scans))
        for j, model in enumerate(models)
    ]


def _criteria(
    fits: Sequence[MaximumLikelihood] | None, shape: tuple[int, ...], dof: Index
) -> tuple[Array, Array, Text, Index]:
    """AIC and BIC (..., r), why there is none, and the rows (...) behind them."""
    if fits is None:
        nothing = np.full(shape, np.nan)
        return nothing, nothing, np.full(shape, "not asked for"), dof.sum(axis=-1)
    return (
        np.stack([f.aic for f in fits], axis=-1),
        np.stack([f.bic for f in fits], axis=-1),
        np.stack([f.reason for f in fits], axis=-1),
        fits[0].rows,
    )

"""What a comparison of motion models found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import attrs
import numpy as np

from imm_tdoa.contract import Array, Index, Mask
from imm_tdoa.selection.evidence import strength
from imm_tdoa.selection.verdict import IMM
from imm_tdoa.track import Track

Text = np.ndarray[Any, np.dtype[np.str_]]
Criterion = Literal["probability", "evidence", "aic", "bic"]

HEADS = (
    *("model", "log evidence", "Pr", "2 dL", "against"),
    *("AIC", "BIC", "NIS/dof", "NIS p", "verdict"),
)
WORDY = (0, 4, 9)  # columns of words


@attrs.frozen(eq=False)
class Comparison:
    """Motion models weighed against each other on the same measurements; made by `compare`.

    Batch axes (...) are targets or runs; r models; T rows of the track.

    Attributes
    ----------
    names : tuple of str
        The models.
    prior : (r,)
        Their probabilities before the data.
    birth_std : mapping
        Standard deviations of the components that a position fix does not give (velocity m/s,
        acceleration m/s²): the evidence depends on them, a richer model pays about the log of
        its own per axis (Lindley 1957). Never quote a Bayes factor without them.
    log_evidence : (..., r)
        Log-likelihood of the scans judged, as each model's own filter foresaw them, in internal
        units (metres): the log marginal likelihood.
    log_probability, probability : (..., r)
        Posterior probability Pr(model | data).
    aic, bic : (..., r)
        Criteria on the batch maximum likelihood of the scans judged, which knows no prior; the
        least is the best. NaN where the scans determine no maximum, and `reason_aic` says why.
    reason_aic : (..., r) str
        Why there is no AIC and BIC; empty where there is.
    rows : (...) int
        Scalar measurements in AIC and BIC, shared offsets eliminated: n of the BIC.
    parameters : (r,) int
        Unknowns of each model: p of AIC and BIC.
    nis_p : (..., r)
        Two-sided p-value of each model's normalised innovations squared, summed over the scans
        judged.
    nis_ratio : (..., r)
        The same sum over its expectation; 1 is ideal.
    accepted : (..., r) bool
        Whether the innovations are not too large to be the model's own (the veto).
    best, runner_up : (...) int
        Most probable accepted model, and the most probable of the others.
    margin : (...)
        Log posterior odds of `best` against `runner_up`, nats.
    threshold : float
        Least margin that decides.
    verdict : str, or (...) str
        Name of the model that was chosen, or ``"imm"``: keep them all. A plain string for a
        single target.
    reason : str, or (...) str
        Why, in words.
    times : (T,) or (..., T)
        Times of the rows, s.
    evidence : (..., T, r)
        Cumulative log-evidence after each scan.
    windowed_evidence : (..., T, r)
        Log-evidence of the last `width` scans, at each scan.
    width : int
        Scans in a window of `windowed_evidence`.
    window : int or None
        How many last scans were judged; None: all of them.
    track : Track
        What the models' filters made of the measurements, side by side.
    """

    names: tuple[str, ...]
    prior: Array
    birth_std: Mapping[str, float]
    log_evidence: Array
    log_probability: Array
    aic: Array
    bic: Array
    reason_aic: Text
    rows: Index
    parameters: Index
    nis_p: Array
    nis_ratio: Array
    accepted: Mask
    best: Index
    runner_up: Index
    margin: Array
    threshold: float
    verdict: str | Text
    reason: str | Text
    times: Array
    evidence: Array
    windowed_evidence: Array
    width: int
    window: int | None
    track: Track

    @property
    def probability(self) -> Array:
        """Posterior probability (..., r) of each model."""
        result: Array = np.exp(self.log_probability)
        return result

    @property
    def bayes_factor(self) -> Array:
        """Twice the log-evidence of the best model over each (..., r): 2 (max L - L_j)."""
        return np.asarray(2.0 * (self.log_evidence.max(axis=-1, keepdims=True) - self.log_evidence))

    @property
    def span(self) -> str:
        """Which scans were judged, in words."""
        return "all scans" if self.window is None else f"the last {self.window} scans"

    def choice_by(self, criterion: Criterion = "probability") -> str | Text:
        """Return the name (...) that one criterion alone would choose.

        Empty where the criterion is known for no model.

        Parameters
        ----------
        criterion : "probability", "evidence", "aic" or "bic"
            ``"evidence"`` is ``"probability"`` with equal priors.

        Raises
        ------
        ValueError
            Another criterion.
        """
        score = {
            "probability": self.log_probability,
            "evidence": self.log_evidence,
            "aic": -self.aic,
            "bic": -self.bic,
        }.get(criterion)
        if score is None:
            raise ValueError(
                f"criterion: expected 'probability', 'evidence', 'aic' or 'bic', got {criterion!r}"
            )
        known = ~np.isnan(score)
        chosen = np.array(self.names)[np.argmax(np.where(known, score, -np.inf), axis=-1)]
        chosen = np.where(known.any(axis=-1), chosen, "")
        return str(chosen) if chosen.ndim == 0 else chosen

    def of(self, *index: int) -> Comparison:
        """Return the comparison of one target of the batch.

        Parameters
        ----------
        *index : int
            Which one, a number for each batch axis.

        Raises
        ------
        ValueError
            Not one number for each batch axis.
        """
        if len(index) != self.margin.ndim:
            raise ValueError(
                f"index: expected one number for each of the batch axes {self.margin.shape}, "
                f"got {index}"
            )
        per_target = (
            *("log_evidence", "log_probability", "aic", "bic", "reason_aic", "rows", "nis_p"),
            *("nis_ratio", "accepted", "best", "runner_up", "margin"),
            *("evidence", "windowed_evidence"),
        )
        parts = {name: getattr(self, name)[index] for name in per_target}
        times = self.times if self.times.ndim == 1 else self.times[index]
        if not index:
            return self
        verdict, reason = np.asarray(self.verdict)[index], np.asarray(self.reason)[index]
        return attrs.evolve(
            self,
            **parts,
            verdict=str(verdict),
            reason=str(reason),
            times=times,
            track=_of_track(self.track, index),
        )

    def table(self, *index: int) -> list[dict[str, Any]]:
        """Return one row per model of one target: every figure by name, and the verdict.

        Parameters
        ----------
        *index : int
            Which target of a batch (`of`).
        """
        one = self.of(*index)
        return [
            {
                "model": name,
                "log_evidence": float(one.log_evidence[j]),
                "probability": float(one.probability[j]),
                "bayes_factor": float(one.bayes_factor[j]),
                "aic": float(one.aic[j]),
                "bic": float(one.bic[j]),
                "nis_ratio": float(one.nis_ratio[j]),
                "nis_p": float(one.nis_p[j]),
                "accepted": bool(one.accepted[j]),
                "verdict": one.verdict == name,
                "reason_aic": str(one.reason_aic[j]),
            }
            for j, name in enumerate(self.names)
        ]

    def __str__(self) -> str:
        """Return the table of a single target, or how often each verdict fell in a batch."""
        prior = ", ".join(f"{k} {v:g}" for k, v in self.birth_std.items())
        foot = f"judged by {self.span}; birth standard deviations: {prior}"
        if self.margin.ndim:
            names, counts = np.unique(np.asarray(self.verdict), return_counts=True)
            lines = [f"{count:6d}  {name}" for name, count in zip(names, counts, strict=True)]
            return "\n".join([f"verdicts of {self.margin.size}:", *lines, foot])
        rows = [HEADS, *(self.cells(row) for row in self.table())]
        width = [max(len(row[i]) for row in rows) for i in range(len(HEADS))]
        lines = [
            "  ".join(
                cell.ljust(w) if i in WORDY else cell.rjust(w)
                for i, (cell, w) in enumerate(zip(row, width, strict=True))
            ).rstrip()
            for row in rows
        ]
        return "\n".join([*lines, f"verdict: {self.verdict}. {self.reason}.", foot])

    @staticmethod
    def cells(row: Mapping[str, Any]) -> tuple[str, ...]:
        """Return a row of `table` as text, under the headings `HEADS`.

        Parameters
        ----------
        row : mapping
            The row.
        """

        def number(key: str, form: str) -> str:
            value = row[key]
            if np.isnan(value):
                return "-"
            if key in ("probability", "nis_p"):
                return "< 1e-6" if value < 1e-6 else format(value, form)
            return format(value, ",.0f" if abs(value) >= 1e5 else form)

        factor = row["bayes_factor"]
        return (
            str(row["model"]),
            number("log_evidence", ".1f"),
            number("probability", ".3g"),
            number("bayes_factor", ".1f"),
            str(strength(0.5 * factor)) if factor > 2.0 else "",
            number("aic", ".1f"),
            number("bic", ".1f"),
            number("nis_ratio", ".2f"),
            number("nis_p", ".2g"),
            "chosen" if row["verdict"] else "" if row["accepted"] else "rejected",
        )

    @property
    def counts(self) -> dict[str, int]:
        """How often each model, and ``"imm"``, is the verdict."""
        verdicts = np.asarray(self.verdict).ravel()
        return {name: int(np.sum(verdicts == name)) for name in (*self.names, IMM)}


def _of_track(track: Track, index: tuple[int, ...]) -> Track:
    """Return one target's track out of a batch."""
    fields = (
        *("log_mode_probability", "log_likelihood", "nis", "nis_dof"),
        *("mode_log_likelihood", "mode_nis", "row_weight", "lost", "reopened"),
    )
    return attrs.evolve(
        track,
        **{name: getattr(track, name)[index] for name in fields},
        mode_means=tuple(x[index] for x in track.mode_means),
        mode_covariances=tuple(P[index] for P in track.mode_covariances),
        times=track.times if track.times.ndim == 1 else track.times[index],
    )

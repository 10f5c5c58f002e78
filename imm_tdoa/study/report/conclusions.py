"""What a user should conclude from a study, in sentences made of its figures."""

from __future__ import annotations

import numpy as np
import xarray as xr

from imm_tdoa.study.report import lessons, words
from imm_tdoa.study.report.words import (
    figure,
    has,
    listed,
    measured,
    number,
    percent,
    some,
    strings,
)

TOLERANCE = 0.1  # a NEES this far from its expectation is worth a sentence, if it is significant
FAR_WORSE = 1.5  # times the error of the best
FEW = 0.2  # a mean resting on less than this share of its runs is one of rare disasters


def conclude(data: xr.Dataset) -> dict[str, list[str]]:
    """Return sentences by the name of the scenario, and those on the whole study under "".

    Parameters
    ----------
    data : Dataset
        What `results.collect` found.
    """
    whole = {"": lessons.of(data)}
    return whole | {str(s): of_scenario(data, i) for i, s in enumerate(data["scenario"].values)}


def of_scenario(data: xr.Dataset, i: int) -> list[str]:
    """Return what to conclude from scenario number `i`."""
    order = lessons.order(data, i)
    if not order:
        return ["No bank came through this scenario with an error to judge it by.", *_lost(data, i)]
    found = [_ranking(data, i, order), _cost(data, i), _worst(data, i, order)]
    found += [_bound(data, i, order), _consistency(data, i, order), _recognition(data, i, order)]
    found += [_evidence(data, i, order), _criteria(data, i)]
    return [sentence for sentence in found if sentence] + _rare(data, i) + _lost(data, i)


def _ranking(data: xr.Dataset, i: int, order: list[int]) -> str:
    names, kind = strings(data["bank"].values), data.attrs["ranked_by"]
    best = order[0]
    value, ends = measured(*figure(data, f"{kind}_rmse", i, best), words.UNIT[kind])
    own = f"{value} ({100 * data.attrs['confidence']:g} % interval {ends})"
    if len(order) == 1:
        return f"{names[best]} has a {kind} RMSE of {own}."
    tied = lessons.undefeated(data, i)
    if len(tied) == 1:
        second = order[1]
        ratio, low, high = figure(data, "rmse_ratio", i, best, second)
        p = words.p_value(float(data["p_holm"].values[i, best, second]))
        return (
            f"{names[best]} is the most accurate: its {kind} RMSE is {own}, {percent(1.0 - ratio)} "
            f"({percent(1.0 - high)} to {percent(1.0 - low)}) below that of {names[second]}, the "
            f"next ({p}, all pairs allowed for)."
        )
    last = max(tied, key=order.index)
    ratio, low, high = figure(data, "rmse_ratio", i, last, best)
    runs = words.count(int(data["runs_done"].values[i]), "run")
    many = len(tied) > 2
    alone = ", were it the only comparison" if low > 1.0 else ""
    return (
        f"{some([names[b] for b in tied])} cannot be told apart by {runs}: {names[best]} has a "
        f"{kind} RMSE of {own}, and the other{'s lie at most' if many else ' lies'} "
        f"{percent(ratio - 1.0)} above it; for {names[last]} anything from {number(low)} to "
        f"{number(high)} times its error is possible{alone}."
    )


def _worst(data: xr.Dataset, i: int, order: list[int]) -> str:
    best, worst = order[0], order[-1]
    ratio, low, high = figure(data, "rmse_ratio", i, worst, best)
    if len(order) < 3 or not ratio > FAR_WORSE or not low > 1.0:
        return ""
    value, ends = measured(ratio, low, high)
    return f"{data['bank'].values[worst]} errs most, {value} times as much ({ends})."


def _bound(data: xr.Dataset, i: int, order: list[int]) -> str:
    best = order[0]
    if not has(data, "bound_ratio", i, best):
        reason = str(data["no_bound"].values[i])
        return f"There is no Cramér-Rao bound to compare with: {reason}." if reason else ""
    ratio, low, high = figure(data, "bound_ratio", i, best)
    name, (value, ends) = data["bank"].values[best], measured(ratio, low, high)
    if high < 1.0:
        return (
            f"{name} errs less than the Cramér-Rao bound, {value} times it ({ends}): it knows "
            f"more of the motion than the bound grants."
        )
    if low <= 1.0:
        return f"{name} reaches the Cramér-Rao bound: {value} times it ({ends})."
    tail = "little is left to gain" if high < 1.1 else "no estimator can gain more than that"
    return f"{name} errs {value} times the Cramér-Rao bound ({ends}): {tail}."


def _consistency(data: xr.Dataset, i: int, order: list[int]) -> str:
    """Who knows how large its errors are."""
    names = strings(data["bank"].values)
    bold, shy, honest = [], [], []
    for b in order:
        if not has(data, "nees_ratio", i, b):
            continue
        value, low, high = figure(data, "nees_ratio", i, b)
        said = f"{names[b]} ({number(value, 2) if value < 1000.0 else 'over 1000'})"
        if low > 1.0 and value > 1.0 + TOLERANCE:
            bold.append(said)
        elif high < 1.0 and value < 1.0 - TOLERANCE:
            shy.append(said)
        else:
            honest.append(names[b])
    parts = []
    if bold:
        parts.append(f"{some(bold)} {_is(bold)} too sure of {_self(bold)}")
    if shy:
        parts.append(f"{some(shy)} {_is(shy)} more careful than needed")
    if honest:
        all_of_them = len(honest) > 2 and not bold and not shy
        parts.append(f"{'All banks' if all_of_them else some(honest)} {_know(honest)}")
    if not parts:
        return ""
    tail = " (squared error over what the covariance promises in brackets)" if bold or shy else ""
    return f"{'; '.join(parts)}{tail}."


def _is(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _self(names: list[str]) -> str:
    return "itself" if len(names) == 1 else "themselves"


def _know(names: list[str]) -> str:
    return "states its errors rightly" if len(names) == 1 else "state their errors rightly"


def _recognition(data: xr.Dataset, i: int, order: list[int]) -> str:
    told = []
    for b in order:
        if not has(data, "recognition", i, b):
            continue
        share, low, high = figure(data, "recognition", i, b)
        told.append(
            (share, b, f"{percent(share)} of the scans ({percent(low)} to {percent(high)})")
        )
    if not told:
        return ""
    names = strings(data["bank"].values)
    _, b, text = max(told)
    late = ""
    if has(data, "recognition_delay", i, b):
        value, low, high = figure(data, "recognition_delay", i, b)
        after, ends = measured(value, low, high, "s")
        late = f", {after} ({ends}) after a switch"
    least, worst, _ = min(told)
    rest = f"; {names[worst]} in {percent(least)}" if worst != b else ""
    return f"{names[b]} gives the true form of motion the most probability in {text}{late}{rest}."


def _evidence(data: xr.Dataset, i: int, order: list[int]) -> str:
    if len(order) < 2:
        return ""
    gap = data["evidence_gap"].values[i]
    rivals = [b for b in np.argsort(-np.where(np.isnan(gap), -np.inf, gap)) if np.isfinite(gap[b])]
    if len(rivals) < 2:
        return ""
    names = strings(data["bank"].values)
    top, next_ = int(rivals[0]), int(rivals[1])
    value, low, high = figure(data, "evidence_gap", i, next_)
    wins = percent(float(data["evidence_wins"].values[i, top]))
    if high >= 0.0:
        return (
            f"Their likelihoods do not separate {names[top]} and {names[next_]} "
            f"({number(-value, 2)} nats apart on average)."
        )
    text = (
        f"{names[top]} explains the measurements best: the largest likelihood in {wins} of the "
        f"runs, {number(-value, 2)} nats ({number(-high, 2)} to {number(-low, 2)}) ahead of "
        f"{names[next_]} on average"
    )
    if top not in lessons.undefeated(data, i):
        text += f", though {names[order[0]]} is the more accurate"
    return f"{text}."


def _criteria(data: xr.Dataset, i: int) -> str:
    """Of two candidates how often the richer is chosen, of more which one mostly is."""
    told = []
    for c, criterion in enumerate(data["criterion"].values if "chosen" in data else ()):
        candidates = [name for name in strings(data["candidate_name"].values[c]) if name]
        k = len(candidates) - 1
        if not has(data, "chosen", i, c, k):
            continue
        if k > 1:
            k = int(np.argmax(data["chosen"].values[i, c, : k + 1]))
        share, low, high = figure(data, "chosen", i, c, k)
        ends = f"({percent(low)} to {percent(high)})"
        told.append(f"{criterion} chooses {candidates[k]} in {percent(share)} {ends}")
    return f"Of the runs, {listed(told)}." if told else ""


def _cost(data: xr.Dataset, i: int) -> str:
    if "seconds_per_step" not in data:
        return ""
    cost = data["seconds_per_step"].values[i]
    tied = [b for b in lessons.undefeated(data, i) if np.isfinite(cost[b]) and cost[b] > 0.0]
    names = strings(data["bank"].values)
    if len(tied) > 1:
        least, most = min(tied, key=lambda b: cost[b]), max(tied, key=lambda b: cost[b])
        if cost[most] > 1.2 * cost[least]:
            return (
                f"Of those, {names[least]} costs least: {words.seconds(cost[least])} a step, "
                f"{names[most]} {number(cost[most] / cost[least], 2)} times that."
            )
    return ""


def _rare(data: xr.Dataset, i: int) -> list[str]:
    found = []
    for b, name in enumerate(strings(data["bank"].values)):
        used, equal = (float(data[k].values[i, b]) for k in ("runs_used", "effective_runs"))
        if used >= 20 and equal < FEW * used:
            found.append(
                f"The error of {name} rests on few runs: they weigh as much as {number(equal, 2)} "
                f"of {used:.0f} would if all were alike. Mostly it is better than its RMSE, now "
                f"and then it is lost."
            )
    return found


def _lost(data: xr.Dataset, i: int) -> list[str]:
    runs = int(data["runs_done"].values[i])
    found = []
    for b, name in enumerate(strings(data["bank"].values)):
        share, low, high = figure(data, "failed", i, b)
        if share > 0.0:
            found.append(
                f"{name} failed in {round(share * runs)} of {words.count(runs, 'run')} "
                f"({percent(low)} to {percent(high)}); its error does not count them."
            )
    return found

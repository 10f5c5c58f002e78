"""What a study says over all its scenarios: which bank to use, and where that changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from imm_tdoa.contract import Array
from imm_tdoa.study.report import words
from imm_tdoa.study.report.words import listed, number, percent, strings


def order(data: xr.Dataset, i: int) -> list[int]:
    """Return the banks of a scenario that have an error, the smallest first."""
    rmse = data[f"{data.attrs['ranked_by']}_rmse"].values[i]
    return [int(b) for b in np.argsort(data["place"].values[i]) if np.isfinite(rmse[b])]


def undefeated(data: xr.Dataset, i: int) -> list[int]:
    """Return the banks that are the best or cannot be told apart from it, the best first."""
    ranked = order(data, i)
    apart = data["different"].values[i]
    return [b for b in ranked if not apart[ranked[0], b]]


def regret(data: xr.Dataset) -> Array:
    """Return the error of each bank over the smallest of the scenario (S, B)."""
    rmse = data[f"{data.attrs['ranked_by']}_rmse"].values
    least = np.min(np.where(np.isfinite(rmse), rmse, np.inf), axis=1, keepdims=True)
    return np.asarray(rmse / np.where(np.isfinite(least), least, np.nan))


def swept(data: xr.Dataset, of: str, members: Sequence[int]) -> list[int]:
    """Return the parameters that are numbers and take several values among scenarios or banks.

    Parameters
    ----------
    data : Dataset
        A study.
    of : "scenario" or "bank"
        Whose parameters.
    members : sequence of int
        Which of them.
    """
    value = data[f"{of}_value"].values[list(members)]
    known = np.isfinite(value).all(axis=0)
    return [k for k in np.flatnonzero(known).tolist() if len(np.unique(value[:, k])) > 1]


def changing(data: xr.Dataset, members: Sequence[int]) -> list[int]:
    """Return the parameters that take several values among scenarios, numbers or names."""
    text = data["scenario_point"].values[list(members)]
    return [k for k in range(text.shape[1]) if len(set(text[:, k].tolist())) > 1]


def groups(data: xr.Dataset) -> dict[str, list[int]]:
    """Return the scenarios that one sweep made, by the name they share."""
    result: dict[str, list[int]] = {}
    for i, base in enumerate(strings(data["base"].values)):
        result.setdefault(base, []).append(i)
    return result


def of(data: xr.Dataset) -> list[str]:
    """Return the sentences on the whole study."""
    found = [*_choice(data)]
    several = len(groups(data)) > 1
    for base, members in groups(data).items():
        where = f"In {base}: " if several else ""
        parameters, numeric = changing(data, members), swept(data, "scenario", members)
        told: list[str] = []
        if len(parameters) > 1:
            told = [_over(data, members, parameters)]
        elif numeric:
            told = [_along(data, members, numeric[0]), *_criteria_along(data, members, numeric[0])]
        found += [where + sentence for sentence in told if sentence]
    return found + _tuning(data)


def _choice(data: xr.Dataset) -> list[str]:
    """Which bank to use where the scenario is not known."""
    names, scenarios = strings(data["bank"].values), data.sizes["scenario"]
    ahead = [undefeated(data, i) if order(data, i) else [] for i in range(scenarios)]
    if len(names) < 2 or scenarios < 2:
        return []
    wins = {b: sum(b in best for best in ahead) for b in range(len(names))}
    ranked = sorted((b for b in wins if wins[b]), key=lambda b: -wins[b])
    if not ranked:
        return ["No bank came through any scenario with an error to judge it by."]
    told = [f"{names[b]} in {wins[b]}" for b in ranked]
    counted = (
        f"Of {scenarios} scenarios, the most accurate bank, or one that cannot be told apart from "
        f"it, is {words.some(told, 6)}."
    )
    over = regret(data)
    whole = np.isfinite(over).all(axis=0)
    if not whole.any():
        return [counted]
    worst = np.where(whole, over.max(axis=0), np.inf)
    safe = int(np.argmin(worst))
    at = words.scenario(data, int(np.argmax(over[:, safe])))
    if worst[safe] <= 1.005:
        return [counted, f"{names[safe]} can be used throughout: nowhere is another better."]
    mean = float(np.exp(np.mean(np.log(over[:, safe]))))
    return [
        counted,
        f"If it must be one bank for all of them, {names[safe]} risks least: its error is at worst "
        f"{number(float(worst[safe]))} times that of the best (at {at}), {number(mean)} times on "
        f"average.",
    ]


def _along(data: xr.Dataset, members: Sequence[int], k: int) -> str:
    """Where the best bank changes as one parameter grows."""
    key = str(data["scenario_parameter"].values[k])
    value = data["scenario_value"].values[:, k]
    members = [i for i in sorted(members, key=lambda i: value[i]) if order(data, i)]
    if len(members) < 2 or data.sizes["bank"] < 2:
        return ""
    stretches: list[tuple[list[int], int, int]] = []  # banks ahead all along, first, last
    for i in members:
        best = undefeated(data, i)
        if stretches:
            both = [b for b in stretches[-1][0] if b in best]
            if both:
                stretches[-1] = (both, stretches[-1][1], i)
                continue
        stretches.append((best, i, i))
    names = strings(data["bank"].values)
    least, most = words.plain(key, value[members[0]]), words.amount(key, value[members[-1]])
    span = f"{words.quantity(key)} from {least} to {most}"
    told = [words.some([names[b] for b in best]) for best, *_ in stretches]
    if len(stretches) == 1:
        return f"Over {span}, {told[0]} {_are(stretches[0][0])} nowhere beaten."
    changes = [
        f"from {words.amount(key, value[first])} on {text}"
        for text, (_, first, _) in zip(told[1:], stretches[1:], strict=True)
    ]
    return (
        f"Over {span}, {told[0]} {_are(stretches[0][0])} not beaten at first, {', '.join(changes)}."
    )


def _are(many: Sequence[int]) -> str:
    return "is" if len(many) == 1 else "are"


def _criteria_along(data: xr.Dataset, members: Sequence[int], k: int) -> list[str]:
    """From where on each criterion mostly chooses its richest candidate, and whether that helps."""
    if "chosen" not in data:
        return []
    key = str(data["scenario_parameter"].values[k])
    value = data["scenario_value"].values[:, k]
    members = sorted(members, key=lambda i: value[i])
    names = strings(data["bank"].values)
    criteria = strings(data["criterion"].values)
    onsets: dict[float, list[str]] = {}  # from which value on: which criteria
    firsts, rivals = [], {}
    for c, criterion in enumerate(criteria):
        candidates = [n for n in strings(data["candidate_name"].values[c]) if n]
        share = data["chosen"].values[members, c, len(candidates) - 1]
        rest = [i for n, i in enumerate(members) if np.all(share[n:] > 0.5)]
        onsets.setdefault(value[rest[0]] if rest else np.inf, []).append(criterion)
        firsts.append(f"{criterion} {percent(float(share[0]))}")
        rivals[candidates[-1]] = (names.index(candidates[-1]), names.index(candidates[0]))
    rich = listed(list(rivals), "or")
    quantity = words.quantity(key)
    told = [
        f"by {listed(who)} "
        + (f"from {words.amount(key, v)} on" if np.isfinite(v) else "nowhere for good")
        for v, who in sorted(onsets.items())
    ]
    first = words.amount(key, value[members[0]])
    return [
        f"As {quantity} grows, {rich} is chosen in most runs {listed(told)}.",
        f"At {quantity} {first} it is chosen in these shares of the runs: {listed(firsts)}.",
        *(_helps(data, members, value, key, *pair) for pair in rivals.values()),
    ]


def _helps(
    data: xr.Dataset, members: Sequence[int], value: Array, key: str, rich: int, plain: int
) -> str:
    """From where on the richer of two banks is also the more accurate."""
    names = strings(data["bank"].values)
    apart = data["different"].values[:, rich, plain]
    ratio = data["rmse_ratio"].values[:, rich, plain]
    better = [n for n, i in enumerate(members) if apart[i] and ratio[i] < 1.0]
    if not better:
        return f"Nowhere here is {names[rich]} more accurate than {names[plain]}."
    if better[0] == 0:
        return f"{names[rich]} is more accurate than {names[plain]} from the beginning."
    before = "worse" if all(apart[i] for i in members[: better[0]]) else "no better"
    return (
        f"{names[rich]} is more accurate than {names[plain]} only from "
        f"{words.amount(key, value[members[better[0]]])} on; below it is {before}."
    )


def _over(data: xr.Dataset, members: Sequence[int], parameters: Sequence[int]) -> str:
    """Where each bank wins over several parameters."""
    names = strings(data["bank"].values)
    if len(names) < 2:
        return ""
    ahead = {i: undefeated(data, i) for i in members if order(data, i)}
    alone = {b: [i for i in ahead if ahead[i] == [b]] for b in range(len(names))}
    undecided = [i for i in ahead if len(ahead[i]) > 1]
    shown = listed([words.quantity(str(data["scenario_parameter"].values[k])) for k in parameters])
    told = [
        f"{names[b]} is the best alone in {len(cells)}{_where(data, cells, members)}"
        for b, cells in sorted(alone.items(), key=lambda item: -len(item[1]))
        if cells
    ]
    if undecided:
        told.append(f"in {len(undecided)} the best cannot be told apart from another")
    return f"Of {len(ahead)} points over {shown}: {'; '.join(told)}."


def _where(data: xr.Dataset, cells: Sequence[int], members: Sequence[int]) -> str:
    """The range of a parameter outside of which a bank never wins, where that says something."""
    told = []
    for k in swept(data, "scenario", members):
        value = data["scenario_value"].values[:, k]
        low, high = min(value[i] for i in cells), max(value[i] for i in cells)
        least, most = min(value[i] for i in members), max(value[i] for i in members)
        key = str(data["scenario_parameter"].values[k])
        name, begin, end = words.quantity(key), words.amount(key, low), words.amount(key, high)
        if low > least and high == most:
            told.append(f"{name} of {begin} and more")
        elif high < most and low == least:
            told.append(f"{name} of {end} and less")
        elif low > least and high < most:
            told.append(f"{name} of {begin}" + (f" to {end}" if low < high else ""))
    return f" ({listed(told)})" if told else ""


def _tuning(data: xr.Dataset) -> list[str]:
    """What a swept parameter of the banks costs, the other parameters at their best."""
    found = []
    over = regret(data)
    value = data["bank_value"].values
    for k in swept(data, "bank", _tuned(data)):
        key = str(data["bank_parameter"].values[k])
        cost = {}
        for v in np.unique(value[:, k][np.isfinite(value[:, k])]):
            mean = np.exp(np.mean(np.log(over[:, value[:, k] == v]), axis=0))
            if np.isfinite(mean).any():
                cost[float(v)] = float(np.nanmin(mean))
        if len(cost) < 2:
            continue
        best = min(cost, key=lambda v: cost[v])
        told = [
            f"{percent(cost[v] / cost[best] - 1.0)} at {words.amount(key, v)}"
            for v in (min(cost), max(cost))
            if v != best
        ]
        found.append(
            f"The {words.quantity(key)} is best at {words.amount(key, best)} on average over the "
            f"scenarios; the error is larger by {listed(told)}."
        )
    return found


def _tuned(data: xr.Dataset) -> list[int]:
    """Return the banks that a sweep made."""
    value = data["bank_value"].values
    return [b for b in range(len(value)) if np.isfinite(value[b]).any()]

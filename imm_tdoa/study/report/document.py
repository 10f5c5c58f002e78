"""The report of a study: one page with words, tables and pictures that opens offline."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from imm_tdoa.recording import _atomic
from imm_tdoa.study.report import conclusions, lessons, page, pictures, words
from imm_tdoa.study.report.page import Node, element
from imm_tdoa.study.report.paper import Picture
from imm_tdoa.study.report.words import figure, has, strings

if TYPE_CHECKING:
    from imm_tdoa.study.plan import Study

WIDE = 6  # columns that a table has on a desk
FILE, PICTURES = "report.html", "pictures"
Cell = tuple[str, str, bool]
COLUMNS = {
    "position": (
        ("position_rmse", "position RMSE", "m"),
        ("position_error", "mean error", "m"),
        ("bound_ratio", "over the bound", ""),
    ),
    "velocity": (("velocity_rmse", "velocity RMSE", "m/s"),),
    "nees": (("nees_ratio", "NEES / expected", ""), ("nees_inside", "scans consistent", "%")),
    "nis": (("nis_ratio", "NIS / expected", ""),),
    "modes": (
        ("recognition", "form recognised", "%"),
        ("recognition_delay", "after a switch", "s"),
    ),
}
ALWAYS = (
    ("evidence_gap", "evidence, nats", ""),
    ("failed", "failed", "%"),
    ("seconds_per_step", "time per step", "time"),
)
METHODS = (
    (
        "Errors",
        "Root mean square over all scored scans and runs. Every bank meets the same targets and "
        "the same measurements in run i. Intervals take the skewness of squared errors into "
        "account (Hall's transformation, 1992); those over time hold at each scan by itself.",
    ),
    (
        "Ranking",
        "Paired t tests of the mean squared errors over the same runs, with Fieller's intervals of "
        "their ratio, corrected for all pairs of a scenario (Holm 1979). Banks that share a letter "
        "cannot be told apart (Piepho 2004).",
    ),
    (
        "Consistency",
        "NEES and NIS over their expectation: 1 is right, more says that a filter is too sure of "
        "itself. 'Scans consistent': share of scans whose average NEES over the runs lies in the "
        "chi-square region of a right filter; it should be the confidence stated.",
    ),
    (
        "Shares",
        "Wilson's intervals. Where every run has a share of its own, with as many trials as "
        "would give the same standard error.",
    ),
    (
        "Evidence",
        "Mean log-likelihood behind the best bank over the same runs. Banks that judged other "
        "measurements than the best (gates that left some out) are not compared.",
    ),
    (
        "Bound",
        "The Cramér-Rao bound given the true motions, root mean square over the scored scans, for "
        "what the widest birth law of the banks grants. A filter that is told more of the motion, "
        "rightly or by luck, can err less.",
    ),
)


def write(data: xr.Dataset, study: Study, folder: str | Path) -> list[str]:
    """Draw all pictures and write ``report.html``, which holds them, to a folder.

    Parameters
    ----------
    data : Dataset
        What `results.collect` found.
    study : Study
        What was asked; the page ends with its file.
    folder : path
        Where to; pictures go into ``pictures/`` as well.

    Returns
    -------
    list of str
        Names of the files written.
    """
    folder = Path(folder)
    names: list[str] = []

    def kept(drawn: Iterable[Picture]) -> Iterator[Node]:
        for picture in drawn:
            name = f"{PICTURES}/{picture.name}.png"
            with _atomic.file(folder / name) as draft:
                draft.write_bytes(picture.png)
            names.append(name)
            yield page.picture(picture)

    said = conclusions.conclude(data)
    parts = [_short(data, said), _overview(data), *kept(pictures.whole(data))]
    main = [element("section", *parts, id="results")]
    for i, name in enumerate(strings(data["scenario"].values)):
        heading = element("h2", words.scenario(data, i))
        inside = [heading, page.bullets(said[name]), _figures(data, i)]
        inside += [*kept(pictures.of_scenario(data, i)), *_choices(data, i)]
        main.append(element("section", *inside, id=_anchor(i)))
    main += [_methods(data), _file(study)]
    header = [element("h1", study.title)]
    if study.question:
        header.append(element("p", study.question, class_="question"))
    header.append(_contents(data))
    text = page.write(
        study.title,
        element("header", *header),
        element("main", *main),
        element("footer", element("p", _made(data))),
    )
    with _atomic.file(folder / FILE) as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")
    return [FILE, *names]


def _anchor(i: int) -> str:
    return f"scenario-{i + 1}"


def _contents(data: xr.Dataset) -> Node:
    entries = [("results", "In short")]
    entries += [(_anchor(i), words.scenario(data, i)) for i in range(data.sizes["scenario"])]
    entries += [("methods", "How it was done"), ("study", "The study file")]
    links = [element("li", element("a", text, href=f"#{at}")) for at, text in entries]
    return element("nav", element("ol", *links), **{"aria-label": "Contents"})


def _short(data: xr.Dataset, said: dict[str, list[str]]) -> Node:
    """What to conclude; of a single scenario its own sentences."""
    sentences = said[""]
    if not sentences:
        sentences = said[str(data["scenario"].values[0])]
    return element(
        "div", element("h2", "In short"), page.bullets(sentences), class_="short", id="short"
    )


def _overview(data: xr.Dataset) -> Node:
    """Every bank in every scenario at a glance."""
    kind = data.attrs["ranked_by"]
    banks = strings(data["bank"].values)
    gdop = data["gdop"].values
    dilution = np.isfinite(gdop).any() and np.nanmax(gdop) > 1.05 * np.nanmin(gdop)
    links: list[str | Node] = []
    rows: list[list[str | Node | Cell]] = []
    for i in range(data.sizes["scenario"]):
        ahead = lessons.undefeated(data, i) if lessons.order(data, i) else []
        links.append(element("a", words.scenario(data, i), href=f"#{_anchor(i)}"))
        row: list[str | Node | Cell] = []
        for b in range(len(banks)):
            value = float(data[f"{kind}_rmse"].values[i, b])
            text = words.length(value, words.UNIT[kind]) if np.isfinite(value) else "-"
            row.append((text, str(data["letters"].values[i, b]), b in ahead))
        if dilution:
            row.append(words.number(float(gdop[i])))
        rows.append(row)
    heads: list[str | Node] = [*banks, *(["GDOP"] if dilution else [])]
    corner = "scenario"
    if len(heads) > max(len(rows), WIDE):  # long and narrow is easier to read than wide
        corner, links, heads = "bank", heads, links
        rows = [list(column) for column in zip(*rows, strict=True)]
    beside = [[link, *row] for link, row in zip(links, rows, strict=True)]
    inner = page.table([corner, *heads], beside)
    caption = element(
        "p",
        f"{kind.capitalize()} RMSE. Green: the best of the scenario and those that cannot be told "
        f"apart from it; letters say the same of every pair.",
    )
    return element("div", element("h3", f"{kind.capitalize()} error"), inner, caption)


def _columns(data: xr.Dataset, i: int) -> list[tuple[str, str, str]]:
    wanted = [c for metric in data.attrs["metrics"].split() for c in COLUMNS.get(metric, ())]
    return [
        column
        for column in (*wanted, *ALWAYS)
        if column[0] in data and np.isfinite(data[column[0]].values[i]).any()
    ]


def _figures(data: xr.Dataset, i: int) -> Node:
    """All figures of one scenario, the best bank first."""
    names, order = strings(data["bank"].values), lessons.order(data, i)
    ahead = lessons.undefeated(data, i) if order else []
    columns = _columns(data, i)
    rows: list[list[str | Node | Cell]] = []
    for b in (*order, *(b for b in range(len(names)) if b not in order)):
        letters = str(data["letters"].values[i, b])
        row: list[str | Node | Cell] = [(names[b], letters, b in ahead)]
        row += [_cell(data, i, b, *column) for column in columns]
        rows.append(row)
    return page.table(["bank", *(heading for _, heading, _ in columns)], rows)


def _cell(data: xr.Dataset, i: int, b: int, name: str, _: str, unit: str) -> Cell:
    if not has(data, name, i, b):
        return "-", "", False
    if unit == "time":
        return words.seconds(float(data[name].values[i, b])), "", False
    if f"{name}_low" not in data:
        return words.percent(float(data[name].values[i, b])), "", False
    value, low, high = figure(data, name, i, b)
    if unit == "%":
        return words.percent(value), f"{words.percent(low)} to {words.percent(high)}", False
    text, ends = words.measured(value, low, high, unit)
    return text, "" if ends == "-" else ends, False


def _choices(data: xr.Dataset, i: int) -> list[Node]:
    """How often each mode of a bank led, and how often each criterion chose which bank."""
    tables = (
        ("selected", "bank", "mode_name", "Which mode had most of the probability over the run"),
        ("chosen", "criterion", "candidate_name", "What criteria chose"),
    )
    found: list[Node] = []
    for name, by, whom, title in tables:
        if name not in data or not np.isfinite(data[name].values[i]).any():
            continue
        options = data[whom].values
        columns = list(dict.fromkeys(option for option in strings(options.ravel()) if option))
        rows: list[list[str | Node | Cell]] = []
        for b, label in enumerate(strings(data[by].values)):
            if not np.isfinite(data[name].values[i, b]).any():
                continue
            own = strings(options[b])
            at = [own.index(column) if column in own else None for column in columns]
            shares = [("", "", False) if k is None else _share(data, name, i, b, k) for k in at]
            rows.append([label, *shares])
        found += [element("h3", f"{title} (share of the runs)"), page.table([by, *columns], rows)]
    return found


def _share(data: xr.Dataset, name: str, i: int, b: int, k: int) -> Cell:
    share, low, high = figure(data, name, i, b, k)
    return words.percent(share), f"{words.percent(low)} to {words.percent(high)}", False


def _methods(data: xr.Dataset) -> Node:
    parts = [element("h2", "How it was done"), element("p", _made(data))]
    parts += [element("p", data.attrs[key]) for key in ("reading", "notes") if data.attrs[key]]
    terms = [part for name, text in METHODS for part in (element("dt", name), element("dd", text))]
    return element("section", *parts, element("dl", *terms), id="methods")


def _made(data: xr.Dataset) -> str:
    runs = data["runs_done"].values
    done = f"{runs.min()}" if runs.min() == runs.max() else f"{runs.min()} to {runs.max()}"
    return (
        f"{words.count(data.sizes['scenario'], 'scenario')}, "
        f"{words.count(data.sizes['bank'], 'bank')}, {done} of {data.attrs['runs']} runs each, "
        f"seed {data.attrs['seed']}; intervals at {100 * data.attrs['confidence']:g} %."
    )


def _file(study: Study) -> Node:
    return element(
        "section",
        element("h2", "The study file"),
        element("p", "Everything that is needed to run it again."),
        element("pre", element("code", study.text), tabindex="0"),
        id="study",
    )

"""Results with known answers: chunks made of random numbers instead of filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

SCANS, DIMS = 12, 2


def bank(name: str, *modes: str, **point: Any) -> SimpleNamespace:
    return SimpleNamespace(name=name, modes=modes or (name,), point=point)


def study(
    points: Mapping[str, Mapping[str, Any]],
    banks: Sequence[SimpleNamespace],
    *,
    runs: int,
    criteria: Sequence[str] = (),
    candidates: Sequence[str] = (),
    base: str = "",
) -> Any:
    return SimpleNamespace(
        title="A <small> study",
        question="Which of them is the best?",
        reading="Small is good.",
        notes="Made of random numbers & nothing else.",
        text='title = "A <small> study"\n',
        seed=2**63 + 5,
        runs=runs,
        confidence=0.95,
        scenarios=tuple(
            SimpleNamespace(name=n, base=base or n, point=dict(p)) for n, p in points.items()
        ),
        banks=tuple(banks),
        metrics=("position", "velocity", "nees", "nis", "modes"),
        criteria=tuple(SimpleNamespace(name=c, banks=tuple(candidates)) for c in criteria),
    )


class Shelf:
    """A store that holds its chunks in memory."""

    def __init__(self) -> None:
        self.chunks_of: dict[str, list[Path]] = {}
        self.content: dict[Path, dict[str, NDArray[Any]]] = {}
        self.bounds: dict[str, dict[str, Any]] = {}
        self.loaded = 0

    def add(self, scenario: str, first: int, chunk: dict[str, NDArray[Any]]) -> None:
        path = Path("chunks") / f"{scenario.replace('/', '_')}-{first:08d}.npz"
        self.chunks_of.setdefault(scenario, []).append(path)
        self.content[path] = chunk

    def chunks(self, scenario: str) -> list[Path]:
        return self.chunks_of.get(scenario, [])

    def load(self, path: Path) -> dict[str, NDArray[Any]]:
        self.loaded += 1
        return self.content[path]

    def has_bound(self, scenario: str) -> bool:
        return scenario in self.bounds

    def bound(self, scenario: str) -> dict[str, Any]:
        return {"gdop": np.full(SCANS, 2.0), "reason": "", **self.bounds[scenario]}

    def steps(self, path: Path) -> int:
        return int(self.content[path]["position_mse"].shape[1] * SCANS)

    def cost(self, path: Path) -> NDArray[Any]:
        return 1e-5 * np.arange(1, len(self.content[path]["position_mse"]) + 1) * self.steps(path)


def chunk(
    rng: np.random.Generator,
    n: int,
    variance: Sequence[float],
    *,
    modes: int = 1,
    lead: Sequence[float] | None = None,
    hit: float = 0.9,
    choice: Sequence[float] = (),
) -> dict[str, NDArray[Any]]:
    """Runs whose errors per axis have these variances; banks share part of their errors.

    `lead` are mean log-likelihoods; `choice` the share in which each criterion chooses its second
    candidate.
    """
    scale = np.sqrt(np.asarray(variance, dtype=float))[:, None, None, None]
    B = len(scale)
    common = rng.standard_normal((n, SCANS, DIMS))
    own = rng.standard_normal((B, n, SCANS, DIMS))
    unit = np.sqrt(0.8) * common + np.sqrt(0.2) * own
    square = np.sum((scale * unit) ** 2, axis=-1)
    nees = np.sum(unit**2, axis=-1)
    probability = rng.dirichlet(np.ones(modes), (B, n, SCANS))
    evidence = rng.normal(0.0, 1.0, (B, n)) + np.asarray(lead or [0.0] * B)[:, None]
    per_scan = {
        "position_square": square,
        "velocity_square": 0.01 * square,
        "nees": nees,
        "mode_probability": probability,
    }
    result: dict[str, NDArray[Any]] = {
        "times": 2.0 * np.arange(SCANS),
        "dims": np.array(DIMS),
        "seeds": np.array([f"seed {i}" for i in range(n)]),
        "reason": np.full((B, n), "", dtype="U40"),
        "failed": np.zeros((B, n), dtype=bool),
        "position_mse": square.mean(axis=-1),
        "velocity_mse": 0.01 * square.mean(axis=-1),
        "position_error": np.sqrt(square).mean(axis=-1),
        "nees": nees.mean(axis=-1),
        "nis": rng.chisquare(3 * SCANS, (B, n)),
        "nis_dof": np.full((B, n), 3.0 * SCANS),
        "log_likelihood": evidence,
        "mode_hit": rng.binomial(SCANS, hit, (B, n)) / SCANS,
        "recognition_delay_s": rng.gamma(2.0, 2.0, (B, n)),
        "selected": np.argmax(probability.mean(axis=2), axis=-1),
    }
    for name, values in per_scan.items():
        result[f"count_{name}"] = np.full((B, SCANS), float(n))
        result[f"sum_{name}"] = values.sum(axis=1)
        result[f"sum2_{name}"] = (values**2).sum(axis=1)
    if choice:
        share = np.asarray(choice)[:, None]
        result["selected_model"] = (rng.random((len(choice), n)) < share).astype(np.int64)
    return result


def sweep(runs: int = 120, chunks: int = 3) -> tuple[Any, Shelf]:
    """One swept parameter, three banks, two criteria; the banks change places on the way."""
    values = (0.0, 1.0, 2.0, 4.0)
    given = study(
        {f"turn a={a:g} m/s²": {"acceleration_mps2": a} for a in values},
        [bank("cv"), bank("ca"), bank("imm", "cv", "ca")],
        runs=runs,
        criteria=("aic", "bic"),
        candidates=("cv", "ca"),
        base="turn",
    )
    shelf, rng = Shelf(), np.random.default_rng(5)
    for case, a in zip(given.scenarios, values, strict=True):
        for k in range(chunks):
            part = chunk(
                rng,
                runs // chunks,
                [100.0 * (1.0 + a**2), 300.0, 310.0],
                modes=2,
                lead=[-(a**2), -2.0, -2.5],
                choice=[min(0.2 + 0.3 * a, 1.0), min(0.3 * a, 1.0)],
            )
            part["mode_hit"][:2] = np.nan
            part["recognition_delay_s"][:2] = np.nan
            for kind in ("sum", "sum2"):
                part[f"{kind}_mode_probability"][:2, :, 1] = np.nan
            part["selected"][:2] = 0
            shelf.add(case.name, k * (runs // chunks), part)
        shelf.bounds[case.name] = {"position_bound": np.full(SCANS, 150.0)}
    return given, shelf


def grid(runs: int = 90) -> tuple[Any, Shelf]:
    """Two swept parameters, three banks, the third as good as the first."""
    points = {
        f"grid noise×{s:g} every {t:g} s": {"noise_factor": s, "interval_s": t}
        for s in (0.5, 1.0, 2.0)
        for t in (1.0, 2.0, 4.0, 8.0)
    }
    given = study(points, [bank("slow"), bank("fast"), bank("twin")], runs=runs, base="grid")
    shelf, rng = Shelf(), np.random.default_rng(6)
    for case in given.scenarios:
        s, t = case.point["noise_factor"], case.point["interval_s"]
        slow = 100.0 * s**2 * (1.0 + 0.1 * t)
        shelf.add(case.name, 0, chunk(rng, runs, [slow, 200.0 * s, slow * 1.002]))
    return given, shelf


def tuned(runs: int = 60, two: bool = True) -> tuple[Any, Shelf]:
    """Banks that a sweep made, best at a factor of 1."""
    factors = [(q, t) for q in (0.1, 1.0, 10.0) for t in ((0.5, 1.0, 2.0) if two else (1.0,))]
    banks = [
        bank(f"imm q×{q:g} sojourn×{t:g}", process_noise_factor=q, sojourn_factor=t)
        for q, t in factors
    ]
    given = study({"one": {}, "two": {}}, banks, runs=runs)
    shelf, rng = Shelf(), np.random.default_rng(7)
    variance = [100.0 * (1.0 + np.log10(q) ** 2 + 0.1 * np.log(t) ** 2) for q, t in factors]
    for case in given.scenarios:
        shelf.add(case.name, 0, chunk(rng, runs, variance))
    return given, shelf

"""What computes a bank's filter: decided once, so that a study never mixes engines."""

from __future__ import annotations

from typing import Literal

from imm_tdoa.study.draw import draw
from imm_tdoa.study.plan import Study

Engine = Literal["numpy", "compiled"]
LARGE = 50_000  # filter steps of each bank, from which on compiling pays


def choose(study: Study) -> tuple[Engine, ...]:
    """Return the engine of every bank: compiled where that supports it and the study is large.

    `IMM.run` chooses by what is loaded already, too, which would make the last bits depend on
    the machine's past; here the study alone decides.
    """
    if study.runs * sum(case.scans for case in study.scenarios) < LARGE:
        return tuple("numpy" for _ in study.banks)
    drawn = [draw(case, study.seed, 0, 1).measurement for case in study.scenarios]
    return tuple(
        "compiled" if all(bank.imm(m).cannot_compile is None for m in drawn) else "numpy"
        for bank in study.banks
    )

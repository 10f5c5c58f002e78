"""Model-selection studies: which bank for these targets, this geometry, this noise; how sure?

>>> plan = load("discrimination", runs=200)
>>> store = run(plan, "out")  # resumes where it was interrupted
>>> found = collect(plan, store)  # an xarray Dataset
>>> conclude(found)[""]  # in words
>>> write(found, plan, store, "out")  # tables, results.nc, report.html
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from imm_tdoa.study.plan import Study
from imm_tdoa.study.planfile import load, parse, shipped
from imm_tdoa.study.running import Progress, run
from imm_tdoa.study.store import Store

if TYPE_CHECKING:
    from imm_tdoa.study.outcome import write
    from imm_tdoa.study.report.conclusions import conclude
    from imm_tdoa.study.results import collect

_LATER = {"collect": "results", "conclude": "report.conclusions", "write": "outcome"}

__all__ = [
    "Progress",
    "Store",
    "Study",
    "collect",
    "conclude",
    "load",
    "parse",
    "run",
    "shipped",
    "write",
]


def __getattr__(name: str) -> Any:
    """Import what needs xarray or matplotlib when it is asked for."""
    if name in _LATER:
        return getattr(import_module(f"imm_tdoa.study.{_LATER[name]}"), name)
    raise AttributeError(f"module 'imm_tdoa.study' has no attribute {name!r}")

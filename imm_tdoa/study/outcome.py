"""Everything that a study writes in the end."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from imm_tdoa.study import report, results

if TYPE_CHECKING:
    import xarray as xr

    from imm_tdoa.study.plan import Study
    from imm_tdoa.study.store import Store


def write(data: xr.Dataset, study: Study, store: Store, folder: str | Path) -> list[str]:
    """Write ``results.nc``, the tables, the pictures and ``report.html``.

    Parameters
    ----------
    data : Dataset
        From `collect`.
    study : Study
        What was run.
    store : Store
        Where its chunks lie.
    folder : path
        Where to write.

    Returns
    -------
    list of str
        Names of the files written.
    """
    return sorted([*results.write(data, study, store, folder), *report.write(data, study, folder)])

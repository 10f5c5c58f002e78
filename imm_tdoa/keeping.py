"""Which scans of a run a track keeps."""

from __future__ import annotations

import re

import numpy as np

from imm_tdoa.contract import Index


def kept_rows(keep: str, rows: int) -> Index:
    """Return the indices of the rows that are kept, of so many.

    Parameters
    ----------
    keep : "all", "final" or "every k"
        All; the last; every k-th from the first on, and the last.

    Raises
    ------
    ValueError
        Anything else.
    """
    if keep == "all":
        return np.arange(rows)
    if keep == "final":
        return np.array([rows - 1])
    every = re.fullmatch(r"every\s+([1-9]\d*)", keep) if isinstance(keep, str) else None
    if every is None:
        raise ValueError(f"keep: expected 'all', 'final' or 'every k' (every 10), got {keep!r}")
    chosen = np.arange(0, rows, int(every[1]))
    return chosen if chosen[-1] == rows - 1 else np.append(chosen, rows - 1)

"""How objects full of arrays show themselves: by shapes, not by thousands of numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs
import numpy as np

FEW = 24  # numbers of an array that are still shown


def brief(self: Any) -> str:
    """Return an attrs object as ``Name(times=<60>, nis=<60 x 3>, …)``; serves as `__repr__`."""
    parts = (
        f"{a.name}={_shown(getattr(self, a.name))}" for a in attrs.fields(type(self)) if a.repr
    )
    return f"{type(self).__name__}({', '.join(parts)})"


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray):
        if value.size > FEW:
            return f"<{' x '.join(str(n) for n in value.shape)}>"
        return " ".join(np.array2string(value, precision=6, separator=", ").split())
    if isinstance(value, tuple) and any(isinstance(item, np.ndarray) for item in value):
        return f"({', '.join(_shown(item) for item in value)})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_shown(item)}' for key, item in value.items())}}}"
    return repr(value)

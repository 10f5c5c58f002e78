"""What `GaussianSum` refuses: batch axes that do not fit together, and time running backwards."""

from __future__ import annotations

import numpy as np

from imm_tdoa.contract import Array


def fitting(**shapes: tuple[int, ...]) -> tuple[int, ...]:
    """Return what the batch axes of the named arguments broadcast to, or raise."""
    try:
        return np.broadcast_shapes(*shapes.values())
    except ValueError:
        text = ", ".join(f"{name.replace('_', ' ')} {shape}" for name, shape in shapes.items())
        raise ValueError(f"batch axes do not fit together: {text}") from None


def refuse_backwards(name: str, of: str, before: Array, after: Array) -> None:
    """Raise if a time `after` (...) lies before the time `before` (...)."""
    before, after = np.broadcast_arrays(before, after)
    back = after < before
    if np.any(back):
        raise ValueError(
            f"{name}: expected a time at or after the {of}'s, {before[back][0]:g} s, "
            f"got {after[back][0]:g} s"
        )

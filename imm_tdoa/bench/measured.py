"""What a measurement of speed found: figures, some with a goal, and points of curves."""

from __future__ import annotations

from typing import Literal

import attrs

from imm_tdoa.bench.clock import Timing


@attrs.frozen
class Goal:
    """What a figure is to be.

    Attributes
    ----------
    limit : float
        In the figure's unit.
    sense : "at most" or "at least"
        On which side of the limit it is to lie.
    """

    limit: float
    sense: Literal["at most", "at least"] = "at most"

    def met(self, value: float) -> bool:
        """Whether a value is what it is to be."""
        return value <= self.limit if self.sense == "at most" else value >= self.limit


@attrs.frozen
class Figure:
    """One number that was measured.

    Attributes
    ----------
    what : str
        What it says.
    value : float
        Median over the repetitions.
    unit : str
        Its unit; empty for ratios.
    low, high : float
        Smallest and largest of the repetitions.
    repetitions : int
        How often it was measured.
    goal : Goal, optional
        What it is to be.
    again : int
        How many timings were set aside, as the host had taken the processors away meanwhile.
    """

    what: str
    value: float
    unit: str
    low: float
    high: float
    repetitions: int
    goal: Goal | None = None
    again: int = 0

    @classmethod
    def of(
        cls,
        what: str,
        timing: Timing,
        unit: str = "",
        factor: float = 1.0,
        goal: Goal | None = None,
    ) -> Figure:
        """Return what was timed, times `factor`, as a figure in `unit`."""
        return cls(
            what,
            factor * timing.median,
            unit,
            factor * timing.low,
            factor * timing.high,
            len(timing.values),
            goal,
            timing.again,
        )

    @property
    def verdict(self) -> str:
        """``met`` or ``missed``; empty where there is no goal."""
        if self.goal is None:
            return ""
        return "met" if self.goal.met(self.value) else "missed"


@attrs.frozen
class Point:
    """A point of a curve: what one target and step costs when something is varied.

    Attributes
    ----------
    against : str
        What is varied.
    x : float
        Its value.
    cost, low, high : float
        Median, smallest and largest cost per target and step, µs.
    curve : str
        Which curve of the panel.
    """

    against: str
    x: float
    cost: float
    low: float
    high: float
    curve: str

    @classmethod
    def of(cls, against: str, x: float, timing: Timing, steps: int, curve: str) -> Point:
        """Return the point of so many target-steps that took `timing`."""
        scale = 1e6 / steps
        return cls(
            against, x, scale * timing.median, scale * timing.low, scale * timing.high, curve
        )


@attrs.frozen
class Measured:
    """All that one measurement found.

    Attributes
    ----------
    name, title : str
        What `run` calls it, and what it is about.
    figures : tuple of Figure
        Its numbers.
    points : tuple of Point
        Its curves.
    notes : tuple of str
        What else a reader should know, and what was left out.
    """

    name: str
    title: str
    figures: tuple[Figure, ...]
    points: tuple[Point, ...] = ()
    notes: tuple[str, ...] = ()

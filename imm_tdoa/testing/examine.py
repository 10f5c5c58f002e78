"""Trying a law on values that hypothesis draws, and telling the simplest that breaks it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from traceback import extract_tb
from typing import Any, TypeVar

import numpy as np
from hypothesis import HealthCheck, Phase, Verbosity, configuration, errors, given, settings
from hypothesis import strategies as st

from imm_tdoa.testing.compare import show
from imm_tdoa.testing.laws import BrokenLaw, Law, Verdict, ViolationError

T = TypeVar("T")


class Draw:
    """Draws the values of one example and remembers them for the report."""

    def __init__(self, data: st.DataObject) -> None:
        self._data = data
        self._drawn: dict[str, Any] = {}

    def __call__(self, label: str, strategy: st.SearchStrategy[T]) -> T:
        """Return a value from `strategy`, which the report calls `label`."""
        value = self._data.draw(strategy)
        self._drawn[label] = value
        return value

    def __str__(self) -> str:
        parts = []
        for label, value in self._drawn.items():
            if hasattr(value, "_asdict"):
                parts += [f"{name} = {show(part)}" for name, part in value._asdict().items()]
            else:
                parts.append(f"{label} = {show(value)}")
        return ", ".join(parts)


class _CounterexampleError(Exception):
    pass


def verdicts(
    laws: Sequence[Law], subject: Any, *, examples: int, without: Sequence[str] = ()
) -> list[Verdict]:
    """Try every law on `subject`, in order.

    Parameters
    ----------
    laws : sequence of Law
        Gates first.
    subject : object
        What the laws' functions take: a model and where to try it.
    examples : int
        How many examples each law is tried on.
    without : sequence of str
        Laws the model is not meant to obey.

    Raises
    ------
    ValueError
        `examples` is no positive number, or `without` names no law.
    """
    if isinstance(examples, bool) or not isinstance(examples, int) or examples < 1:
        raise ValueError(f"examples: expected a whole number above 0, got {examples!r}")
    known = [law.name for law in laws]
    for name in without:
        if name not in known:
            raise ValueError(f"without: there is no law {name!r}; there are: {', '.join(known)}")
    found: list[Verdict] = []
    closed = ""
    with _no_traces():
        for law in laws:
            outcome, message = "not tried", f"the law {closed!r} is broken"
            if law.name in without:
                outcome, message = "exempt", "the caller left it out"
            elif not closed:
                outcome, message = _verdict(law, subject, examples)
            if outcome == "broken" and law.gate:
                closed = law.name
            found.append(Verdict(law.name, law.statement, outcome, message))
    return found


def broken(found: Sequence[Verdict]) -> list[BrokenLaw]:
    """Return the broken laws among verdicts."""
    return [BrokenLaw(v.law, v.statement, v.message) for v in found if v.outcome == "broken"]


def _verdict(law: Law, subject: Any, examples: int) -> tuple[str, str]:
    reason = law.exempt(subject)
    if reason:
        return "exempt", reason
    message = counterexample(law, subject, examples)
    return ("holds", "") if message is None else ("broken", message)


def counterexample(law: Law, subject: Any, examples: int) -> str | None:
    """Return what the simplest example found that breaks `law` says, or None."""

    @settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        print_blob=False,
        report_multiple_bugs=False,
        verbosity=Verbosity.quiet,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def run(data: st.DataObject) -> None:
        draw = Draw(data)
        try:
            with np.errstate(all="ignore"):
                law.holds(subject, draw)
        except errors.HypothesisException:
            raise
        except Exception as error:
            values = str(draw)
            raise _CounterexampleError(
                _tell(error) + (f"\nfor {values}" if values else "")
            ) from error

    try:
        run()
    except _CounterexampleError as error:
        return str(error)
    except errors.Flaky:
        return "the model does not give the same for the same arguments"
    except errors.Unsatisfiable:
        return "no values could be drawn for which everything is measured"
    return None


def _tell(error: Exception) -> str:
    if isinstance(error, ViolationError):
        return str(error)
    here = Path(__file__).parent
    outside = [f for f in extract_tb(error.__traceback__) if Path(f.filename).parent != here]
    who = f"{outside[0].name} " if outside else ""
    return f"{who}raised {type(error).__name__}: {error}"


@contextmanager
def _no_traces() -> Iterator[None]:
    """Keep hypothesis from leaving a ``.hypothesis`` folder where the user works."""
    before = getattr(configuration, "__hypothesis_home_directory", None)
    with tempfile.TemporaryDirectory() as folder:
        configuration.set_hypothesis_home_dir(folder)
        try:
            yield
        finally:
            configuration.set_hypothesis_home_dir(before)

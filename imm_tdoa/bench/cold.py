"""What a user waits for the first time: importing, the shipped sample, compiling."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import attrs

from imm_tdoa.bench import fresh, jobs
from imm_tdoa.bench.clock import Timing
from imm_tdoa.bench.measured import Figure, Goal, Measured

IMPORT, SAMPLE, COMPILE, WARM = Goal(0.3), Goal(10.0), Goal(15.0), Goal(1.0)
TIMED_IMPORT = (
    "from time import perf_counter as now; begun = now(); import imm_tdoa; spent = now() - begun; "
    "from imm_tdoa.bench import fresh; fresh.report(seconds=spent)"
)
TIMED_RUN = "from imm_tdoa.bench import cold; cold.child()"
COMMAND = "from imm_tdoa.cli import main; main()"
SAMPLE_COMMAND = ("-c", COMMAND, "track", "--out", "out")
SHAPE = 1000, 20


@attrs.frozen
class Size:
    """How often each is timed, in a fresh process each time."""

    imports: int = 9
    samples: int = 5
    compilations: int = 5
    later: int = 7


FULL, QUICK = Size(), Size(imports=5, samples=1, compilations=0, later=3)


def measure(size: Size, tell: Callable[[str], None]) -> Measured:
    """Measure; `tell` is told what comes next."""
    tell("cold start: import imm_tdoa")
    imports = [fresh.python(["-c", TIMED_IMPORT])[1]["seconds"] for _ in range(size.imports)]
    samples = []
    for k in range(size.samples):
        tell(f"cold start: the sample, {k + 1} of {size.samples}")
        with TemporaryDirectory() as place:
            samples.append(fresh.python(SAMPLE_COMMAND, nothing_yet(place), cwd=place)[0])
    firsts = []
    with TemporaryDirectory() as kept:
        for k in range(size.compilations):
            tell(f"cold start: compiling, {k + 1} of {size.compilations}")
            with TemporaryDirectory() as place:
                empty = nothing_yet(place if k else kept)
                firsts.append(fresh.python(["-c", TIMED_RUN], empty)[1]["seconds"])
        tell("cold start: a later process")
        warm = nothing_yet(kept) if size.compilations else {}
        if size.later and not warm:
            fresh.python(["-c", TIMED_RUN])
        laters = [fresh.python(["-c", TIMED_RUN], warm)[1]["seconds"] for _ in range(size.later)]
    rows = (
        ("import imm_tdoa", imports, IMPORT),
        ("imm-tdoa track, from start to end", samples, SAMPLE),
        ("first compiled run", firsts, COMPILE),
        ("first compiled run of a later process", laters, WARM),
    )
    figures = tuple(
        Figure.of(what, Timing(tuple(values)), "s", goal=goal)
        for what, values, goal in rows
        if values
    )
    notes = [
        "Each in a fresh process; the sample and the compilation with empty folders for what is "
        "compiled and for fonts. The imports of Numba are part of both runs."
    ]
    if not size.compilations:
        notes.append("The first compiled run: left out by --quick.")
    return Measured("cold-start", "cold start", figures, notes=tuple(notes))


def nothing_yet(place: str) -> dict[str, str]:
    """Return the environment of a user who never compiled or drew anything."""
    folder = Path(place)
    return {
        "NUMBA_CACHE_DIR": str(folder / "numba"),
        "MPLCONFIGDIR": str(folder / "matplotlib"),
        "MPLBACKEND": "Agg",
    }


def child() -> None:
    """Report how long the compiled engine takes for a small batch, in this fresh process."""
    job = jobs.job(*SHAPE)
    begun = perf_counter()
    track = job.run(engine="compiled")
    fresh.report(seconds=perf_counter() - begun, engine=track.engine)

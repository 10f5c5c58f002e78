"""A whole study, and the same runs through the same banks in a loop over filterpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import attrs
import numpy as np
from threadpoolctl import threadpool_limits

from imm_tdoa._processors import processors
from imm_tdoa.bench import fresh, peers
from imm_tdoa.bench.clock import Timing, side_by_side
from imm_tdoa.bench.cold import COMMAND
from imm_tdoa.bench.jobs import Job
from imm_tdoa.bench.measured import Figure, Goal, Measured
from imm_tdoa.contract import Array
from imm_tdoa.imm import IMM
from imm_tdoa.study import Study, parse
from imm_tdoa.study import run as run_study
from imm_tdoa.study.draw import Drawn, draw
from imm_tdoa.study.filtering import estimate, told
from imm_tdoa.study.fixes import Begin

SECONDS, TIMES_FILTERPY = Goal(60.0), Goal(200.0, "at least")
SAME = Goal(1e-6)  # of a standard deviation: that both compute the same
STUDY = """\
title = "Four banks, three levels of noise"
seed = 1
runs = {runs}

[[scenarios]]
name = "flight"
scenario = "source-a"
start = {{ position_std_m = 1000.0, velocity_std_mps = 100.0 }}
replace.targets = [
    {{ name = "1", position_m = [300e3, 400e3], legs = [
        {{ motion = "static", duration_s = 40.0 }},
        {{ motion = "constant-velocity", velocity_mps = [0.0, 1000.0], duration_s = 38.0 }},
        {{ motion = "constant-acceleration", acceleration_mps2 = [-1e2, 0.0], duration_s = 40.0 }},
    ] }},
]
sweep.noise_factor = [0.5, 1.0, 2.0]

[[banks]]
name = "all motions"
modes = [
    {{ model = "static", psd = 1.0 }},
    {{ model = "constant-velocity", psd = 1.0 }},
    {{ model = "constant-acceleration", psd = 1.0 }},
]
mean_sojourn_s = 60.0
birth_std = {{ velocity = 1000.0, acceleration = 100.0 }}
sweep.sojourn_factor = [0.5, 1.0, 2.0]

[[banks]]
name = "moving"
modes = [
    {{ model = "constant-velocity", psd = 1.0 }},
    {{ model = "constant-acceleration", psd = 1.0 }},
]
mean_sojourn_s = 60.0
birth_std = {{ velocity = 1000.0, acceleration = 100.0 }}
"""


@attrs.frozen
class Size:
    """How much is computed.

    Attributes
    ----------
    runs : int
        Of each scenario of the study.
    peer_runs : int
        How many of them filterpy does in each repetition.
    repetitions : int
        How often each is timed.
    commands : int
        How often the command is timed from its start to its end.
    """

    runs: int = 1000
    peer_runs: int = 20
    repetitions: int = 5
    commands: int = 3


FULL, QUICK = Size(), Size(peer_runs=2, repetitions=3, commands=1)


def measure(size: Size, tell: Callable[[str], None]) -> Measured:
    """Measure; `tell` is told what comes next."""
    tell("filterpy's answers to a study")
    text = STUDY.format(runs=size.runs)
    study = parse(text)
    loop = Loop(study, size.peer_runs)
    with threadpool_limits(1):
        apart = loop.disagreement()
    tell("a study, and filterpy")

    def ours() -> None:
        with TemporaryDirectory() as folder:
            run_study(study, folder)

    with threadpool_limits(1):
        spent = side_by_side({"filterpy": loop.follow, "ours": ours}, size.repetitions)
    whole = spent["filterpy"] / (size.peer_runs / size.runs)
    steps = len(study.banks) * size.runs * sum(case.scans for case in study.scenarios)
    figures = [
        Figure.of("filterpy, scaled to the whole study", whole, "s"),
        Figure("largest difference between the answers", apart, "σ", apart, apart, 1, SAME),
        Figure.of("the study: drawn, filtered, scored, bounded, saved", spent["ours"], "s"),
        Figure.of("times filterpy", whole / spent["ours"], goal=TIMES_FILTERPY),
    ]
    if size.commands:
        tell("the study by its command, in fresh processes")
        command = _command(text, size.commands)
        values = tuple(whole.median / seconds for seconds in command.values)
        ratio = Timing(values, whole.again)
        figures += [
            Figure.of("imm-tdoa study, from start to end", command, "s", goal=SECONDS),
            Figure.of("times filterpy, the command with tables and report", ratio),
        ]
    shape = f"{len(study.banks)} banks x {len(study.scenarios)} scenarios x {size.runs} runs"
    notes = (
        f"filterpy does {size.peer_runs} runs of each scenario by each bank, which is scaled to "
        f"{size.runs}. It is given what was drawn; it filters and scores one run after the other, "
        f"in one process. Its members: {loop.member.__name__}, the quicker way of "
        f"{len(peers.MEMBERS)}.",
        f"The study uses {processors()} processors and was run in this process before: nothing "
        "is loaded meanwhile. The command is a fresh process, with tables, pictures and report.",
    )
    title = f"{shape} x {study.scenarios[0].scans} scans, {steps} filter steps"
    return Measured("study", title, tuple(figures), notes=notes)


def _command(text: str, times: int) -> Timing:
    """Time the command from its start to its end."""
    found = []
    with TemporaryDirectory() as place:
        path = Path(place) / "study.toml"
        path.write_text(text, "utf-8")
        for k in range(times):
            arguments = ["-c", COMMAND, "study", str(path), "--out", str(Path(place) / str(k))]
            found.append(fresh.python(arguments, {"MPLBACKEND": "Agg"})[0])
    return Timing(tuple(found))


class Loop:
    """A study in a loop over filterpy, one run after the other.

    Parameters
    ----------
    study : Study
        The study; its filters are told where to start.
    runs : int
        How many runs of each scenario.
    """

    def __init__(self, study: Study, runs: int) -> None:
        self.study = study
        self.drawn = [draw(case, study.seed, 0, runs) for case in study.scenarios]
        self.member = peers.fastest(self._job(study.banks[0].imm(self.drawn[0].measurement), 0, 0))

    def _job(self, imm: IMM, scenario: int, run: int) -> Job:
        """Return one run as a job: from its start, at the first scan, the scans after it."""
        drawn, start = self.drawn[scenario], self.study.scenarios[scenario].start
        assert start is not None
        state = told(imm, drawn.part([run]), start)
        alone = attrs.evolve(
            state,
            time=np.asarray(drawn.times[0]),
            means=tuple(x[0] for x in state.means),
            covariances=tuple(P[0] for P in state.covariances),
            log_mode_probability=state.log_mode_probability.reshape(-1),
        )
        return Job(imm, drawn.times[1:], drawn.values[[run], 1:], alone)

    def follow(self) -> None:
        """Filter and score every run by every bank."""
        for bank in self.study.banks:
            for scenario, drawn in enumerate(self.drawn):
                imm = bank.imm(drawn.measurement)
                for run in range(len(drawn.seeds)):
                    self.one(imm, scenario, run)

    def one(self, imm: IMM, scenario: int, run: int) -> tuple[Array, Array, Array]:
        """Return position (T, d), its covariance and the mode probabilities of one run; score."""
        drawn, d = self.drawn[scenario], imm.space.dims
        theirs = peers.filterpy_imm(self._job(imm, scenario, run), self.member)
        T = len(drawn.times)
        position, covariance = np.empty((T, d)), np.empty((T, d, d))
        probability = np.empty((T, len(theirs.filters)))
        for k, z in enumerate(drawn.values[run] * imm.measurement.scale):
            if k:
                theirs.predict(0)
            theirs.update(z[:, None])
            position[k], covariance[k] = theirs.x[:d, 0], theirs.P[:d, :d]
            probability[k] = theirs.mu
        _score(drawn, run, position, covariance)
        return position, covariance, probability

    def disagreement(self) -> float:
        """Return by how much filterpy's answers differ from the study's own, at most.

        Of the position and its covariance, in standard deviations, and of the mode probabilities.
        """
        worst = 0.0
        for bank in self.study.banks:
            for scenario, drawn in enumerate(self.drawn):
                start = self.study.scenarios[scenario].start
                ours = estimate(bank, Begin(drawn), start, "numpy")
                theirs = self.one(bank.imm(drawn.measurement), scenario, 0)
                std = np.sqrt(np.diagonal(theirs[1], axis1=-2, axis2=-1))
                scale = std[:, :, None] * std[:, None, :]
                differences = (
                    (ours.position[0] - theirs[0]) / std,
                    (ours.covariance[0] - theirs[1]) / scale,
                    ours.mode_probability[0] - theirs[2],
                )
                worst = max(worst, *(float(np.abs(x).max()) for x in differences))
        return worst


def _score(drawn: Drawn, run: int, position: Array, covariance: Array) -> tuple[float, float]:
    """Mean squared error and mean NEES of a run, as a user writes them."""
    error = position - drawn.ways.position[run]
    nees = np.einsum("ti,ti->t", error, np.linalg.solve(covariance, error[..., None])[..., 0])
    return float(np.mean(np.sum(error**2, axis=-1))), float(np.mean(nees))

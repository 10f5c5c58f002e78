"""The interacting multiple model estimator (Blom & Bar-Shalom 1988; ALGORITHMS §9)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import attrs
import numpy as np

from imm_tdoa import _validate, initiation, starting
from imm_tdoa.bank import Bank
from imm_tdoa.compiled import Compiled
from imm_tdoa.contract import Array, MeasurementModel
from imm_tdoa.cycle import ROBUST, UPDATES, Cycle, RobustRule, UpdateRule
from imm_tdoa.engine import ENGINES, Engine, choose
from imm_tdoa.keeping import kept_rows
from imm_tdoa.kernel.plan import Plan
from imm_tdoa.mixing import MERGING, Merging
from imm_tdoa.passage import through
from imm_tdoa.scans import Scans
from imm_tdoa.state import State
from imm_tdoa.statespace import StateSpace
from imm_tdoa.track import Track


@attrs.frozen(eq=False)
class IMM:
    """Motion models in parallel on one measurement model, weighed and mixed.

    Parameters
    ----------
    bank : Bank
        The motion models and the chain between them.
    measurement : MeasurementModel
        What is measured; its stations fix the number of space dimensions.
    update : "ekf", "iekf", "ukf" or "ckf"
        How a mode predicts and takes in a measurement: extended Kalman filter; iterated:
        linearised where the posterior is, for predictions so diffuse that the measurement bends
        over them; unscented or cubature: linearised over sigma points.
    merging : "imm", "gpb1", "gpb2" or "autonomous"
        How what the modes know is merged (§9): interacting; generalised pseudo-Bayes of first or
        second order; not at all, models in parallel between which the emitter never switches.
    robust : None, "gate" or "student-t"
        What to do about gross errors; both judge the sources of error (an arrival that
        differences share is one) against the mixture innovation, alike in every mode.
        ``"gate"``: sources that contradict the bank's prediction in a chi-square test are left
        out (data snooping); they enter the log-likelihood as if they lay on the gate.
        ``"student-t"``: errors have heavy tails, and gross ones are trusted less; the
        log-likelihood is a variational lower bound.
    gate_probability : float
        Probability that a good source passes the gate.
    degrees_of_freedom : float
        Of Student's t: the smaller, the heavier the tails.
    reopen_after : int
        Robust filters only: after so many scans rejected on end (half or more of their rows
        distrusted) the track is lost, until it could use as many on end. While it is lost and
        rejects scans it opens: it is predicted from the last scan that can be trusted, widened
        by all that the birth law allows since then.

    Examples
    --------
    >>> imm = IMM(bank, TDOA(stations, toa_sigma=70e-9))
    >>> track = imm.run(times, values)
    """

    bank: Bank
    measurement: MeasurementModel
    update: UpdateRule = attrs.field(default="ekf", kw_only=True)
    merging: Merging = attrs.field(default="imm", kw_only=True)
    robust: RobustRule | None = attrs.field(default=None, kw_only=True)
    gate_probability: float = attrs.field(default=0.999, kw_only=True)
    degrees_of_freedom: float = attrs.field(default=4.0, kw_only=True)
    reopen_after: int = attrs.field(default=5, kw_only=True)
    _cycle: Cycle = attrs.field(init=False, repr=False)
    _compiled: Compiled = attrs.field(init=False, repr=False)

    def __attrs_post_init__(self) -> None:
        if not isinstance(self.bank, Bank):
            raise ValueError(f"bank: expected a Bank, got {self.bank!r}")
        if isinstance(self.measurement, type) or not isinstance(self.measurement, MeasurementModel):
            raise ValueError(f"measurement: no measurement model: {self.measurement!r}")
        _validate.one_of("update", self.update, UPDATES)
        _validate.one_of("merging", self.merging, MERGING)
        _validate.one_of("robust", self.robust, (None, *ROBUST))
        if not _validate.positive("gate_probability", self.gate_probability) < 1.0:
            raise ValueError(
                f"gate_probability: expected a probability between 0 and 1, "
                f"got {self.gate_probability!r}"
            )
        _validate.positive("degrees_of_freedom", self.degrees_of_freedom)
        if not isinstance(self.reopen_after, int) or self.reopen_after < 1:
            raise ValueError(
                f"reopen_after: expected a number of scans, 1 or more, got {self.reopen_after!r}"
            )
        bank = self.bank
        if self.merging == "autonomous":
            bank = attrs.evolve(bank, transition=np.eye(len(bank)), mean_sojourn=None)
        cycle = Cycle(
            bank,
            self.update,
            self.merging,
            self.robust,
            self.gate_probability,
            self.degrees_of_freedom,
            self.reopen_after,
        )
        object.__setattr__(self, "_cycle", cycle)
        object.__setattr__(self, "_compiled", Compiled(self))

    @property
    def space(self) -> StateSpace:
        """How the modes' states fit together."""
        return self.bank.space(self.measurement.dims)

    def start(
        self,
        time: float | Array,
        mean: Any,
        covariance: Any,
        components: Sequence[str] | None = None,
    ) -> State:
        """Return the state before any measurement.

        Parameters
        ----------
        time : float or (...)
            Time, s.
        mean : (..., n)
            Mean of all the bank's components (`space.components`), or of the position only; or
            of the given `components`. What a mode has beyond it comes from the birth law.
        covariance : (..., n, n)
            Covariance of `mean`.
        components : sequence of str, optional
            Names of the components given, in their order; the position must be among them.

        Raises
        ------
        ValueError
            Wrong lengths, unknown or repeated components, numbers that are not finite, a
            covariance that is not symmetric positive semi-definite.
        """
        return starting.start(self, time, mean, covariance, components)

    def step(
        self,
        state: State,
        time: float | Array,
        values: Any,
        pairs: Any = None,
        measurement: MeasurementModel | None = None,
        engine: Engine = "auto",
    ) -> State:
        """Return the state after a scan: mix, predict, update, weigh (§9.1).

        Parameters
        ----------
        state : State
            What `start` or the last step returned.
        time : float or (...)
            Time of the scan, s; at the state's own time nothing mixes and no mode switches.
        values : (..., m)
            What was measured; NaN is missing.
        pairs : (..., m, 2) int, optional
            Station pairs of this scan's rows, for a measurement of pairs.
        measurement : MeasurementModel, optional
            What was measured this time, where it is not what the IMM was made with.
        engine : "auto", "numpy" or "compiled"
            What computes. ``"auto"`` takes the compiled engine only where it is ready: a stream
            never waits for it (`compile` makes it ready).

        Raises
        ------
        ValueError
            A time before the state's, infinite values, a wrong number of rows.
        """
        if engine != "numpy" and pairs is None and measurement is None:
            _validate.one_of("engine", engine, ENGINES)
            quick = self._compiled.stepper(engine)
            done = None if quick is None else quick.take(state, time, values)
            if done is not None:
                return done
        state = self._own("state", state)
        own = measurement is None
        measurement = self.measurement if measurement is None else measurement
        if pairs is not None:
            measurement = measurement.with_pairs(pairs)
        if measurement.dims != state.space.dims:
            raise ValueError(
                f"measurement: expected one in {state.space.dims} dimensions, "
                f"got {measurement.dims}"
            )
        z = _validate.array("values", values, (None, measurement.size), finite=False)
        time = _validate.array("time", time)
        batch = _validate.fitting(
            state=state.log_likelihood.shape, time=time.shape, values=z.shape[:-1]
        )
        _validate.refuse_backwards("time", "state", state.time, time)
        dt = time - state.time
        fits = own and measurement.size == self.measurement.size
        by = self if fits or engine == "numpy" else self._compiled.on(measurement)
        if choose(by, math.prod(batch), 1, engine) == "compiled":
            from imm_tdoa.kernel.stepping import step

            return step(by, state, time, dt, z, measurement)
        return self._cycle(state, time, dt, self.chain(dt), z, measurement)

    def compile(self) -> IMM:
        """Make the compiled engine ready for a stream of steps; return this IMM.

        The first process that does so waits for the compiler, some ten seconds; later ones load
        its work from disk within a second.

        Raises
        ------
        ValueError
            A bank or measurement that the compiled engine does not support.
        """
        choose(self, 1, 1, "compiled")
        self._compiled.stepper("compiled")
        state = self.start(0.0, np.zeros(self.space.dims), np.eye(self.space.dims))
        self.step(state, 0.0, np.full(self.measurement.size, np.nan), engine="compiled")
        return self

    def _own(self, name: str, state: State) -> State:
        """Return the state as one of this IMM; another that made it may have another birth law."""
        if not isinstance(state, State) or state.space.modes != self.space.modes:
            raise ValueError(
                f"{name}: expected a state of this bank's modes, as IMM.start makes it"
            )
        return state if state.space is self.space else attrs.evolve(state, space=self.space)

    def run(
        self,
        times: Any,
        values: Any,
        start: State | None = None,
        pairs: Any = None,
        engine: Engine = "auto",
        keep: str = "all",
        threads: int | None = None,
    ) -> Track:
        """Track through a whole recording.

        Parameters
        ----------
        times : (T,) or (..., T)
            Times of the scans, s, not decreasing.
        values : (..., T, m)
            Rows of each scan; NaN is missing. Leading axes are targets that share the
            measurement model.
        start : State, optional
            Where to start; then every scan is an update. Without it the track starts from a fix
            made of as many first scans as a position takes (one, where it is complete): the fix
            is row 0 of the track and uses those scans up, updates begin with the next.
        pairs : (T, m, 2) or (..., T, m, 2) int, optional
            Station pairs of each row, where they change from scan to scan.
        engine : "auto", "numpy" or "compiled"
            What computes; both give the same numbers. ``"auto"`` takes the compiled engine where
            it supports the bank and is ready, or where the job is long enough to be worth the
            wait (`imm_tdoa.engine`).
        keep : "all", "final" or "every k"
            Which scans the track keeps; with many targets the whole track may not fit in memory.
        threads : int, optional
            How many threads the compiled engine computes in; default all processors.

        Returns
        -------
        Track
            One row per scan kept, from the first that has a state. In a batch the rows of a
            target that starts later than others are NaN until then.

        Raises
        ------
        ValueError
            Decreasing times, shapes that do not fit, values that determine no position, a bank
            that the compiled engine does not support where it is demanded.
        """
        if start is not None and pairs is None and keep == "all" and threads in (None, 1):
            quick = self._compiled.runner(engine)
            done = None if quick is None else quick.take(times, values, start, engine != "auto")
            if done is not None:
                return done
        scans = Scans.checked(self.measurement, times, values, pairs)
        if threads is not None and (not isinstance(threads, int) or threads < 1):
            raise ValueError(f"threads: expected a number, 1 or more, got {threads!r}")
        kept_rows(keep, scans.count)  # refused before a fix is sought
        targets = math.prod(scans.batch)
        chosen = choose(self, targets, scans.count, engine)
        if start is None:
            state, first = initiation.start_from_scans(self, scans)
        else:
            start = self._own("start", start)
            own = start.log_likelihood.shape
            batch = _validate.fitting(start=own, times_and_values=scans.batch)
            _validate.refuse_backwards("times", "start", start.time, scans.times[..., 0])
            state, first = start, np.full(batch, -1)
        return through(self, scans, state, first, chosen, keep, threads)

    def chain(self, dt: Array) -> Array:
        """Return the transition matrices (..., r, r) of the modes over `dt` (...) s."""
        return self._cycle.bank.chain(dt)

    @property
    def cycle(self) -> Cycle:
        """One cycle of the recursion by NumPy."""
        return self._cycle

    @property
    def plan(self) -> Plan:
        """What the compiled engine is told of this IMM."""
        return self._compiled.plan

    @property
    def cannot_compile(self) -> str | None:
        """What of this IMM the compiled engine does not support; None where it supports all."""
        return self._compiled.why_not

"""Recordings that never happened: scenarios, and what stations would have measured of them.

>>> scenario = load("sample")
>>> recording = simulate(scenario, seed=1)
>>> measurement, times, values, pairs = recording.scans()
"""

from imm_tdoa.simulate.make import simulate
from imm_tdoa.simulate.path import Leg, Target, Trajectory, trajectory
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.shelf import load, read, scenarios

__all__ = [
    "Leg",
    "Scenario",
    "Target",
    "Trajectory",
    "load",
    "read",
    "scenarios",
    "simulate",
    "trajectory",
]

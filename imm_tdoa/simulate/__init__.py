"""Recordings that never happened: scenarios, and what stations would have measured of them.

>>> scenario = load("sample")
>>> recording = simulate(scenario, seed=1)
>>> measurement, times, values, pairs = recording.scans()

Where ``labelled = false`` the recording does not say whose its rows are; `simulate_labelled` does:

>>> made = simulate_labelled(load("three-emitters"), seed=1)
>>> made.origins["tdoa"].count(())  # false alarms
341
>>> sorted(made.told_apart().targets)
['1', '2', '3']
"""

from imm_tdoa.simulate.make import Simulated, simulate, simulate_labelled
from imm_tdoa.simulate.path import Leg, Target, Trajectory, trajectory
from imm_tdoa.simulate.scenario import Scenario
from imm_tdoa.simulate.shelf import load, read, scenarios
from imm_tdoa.simulate.swarm import Swarm

__all__ = [
    "Leg",
    "Scenario",
    "Simulated",
    "Swarm",
    "Target",
    "Trajectory",
    "load",
    "read",
    "scenarios",
    "simulate",
    "simulate_labelled",
    "trajectory",
]

"""Random numbers come from the seed alone, and what is added to a scenario changes nothing else."""

from __future__ import annotations

import attrs
import numpy as np
from simulate_cases import SIGMA, rows_of, same, scenario, standing, with_rows

from imm_tdoa.simulate import Leg, Scenario, Target, simulate
from imm_tdoa.simulate.faults import Dropouts, NoiseLevel, Outliers
from imm_tdoa.simulate.measuring import Sampling, Station

ALL = ("toa", "tdoa", "fdoa", "range_rate", "height", "truth")


def test_seeds() -> None:
    made = with_rows(scenario(targets=[standing(scans=50)], seed=3), "toa", jitter_s=0.5)
    assert same(simulate(made, seed=1), simulate(made, seed=1), *ALL)
    assert not same(simulate(made, seed=1), simulate(made, seed=2), "toa")
    assert same(simulate(made), simulate(made, seed=3), *ALL)
    assert simulate(made).source["seed"] == 3
    rng = np.random.default_rng(1)
    one, two = simulate(made, rng), simulate(made, rng)
    assert not same(one, two, "toa")
    assert same(one, simulate(made, np.random.default_rng(1)), *ALL)
    assert "seed" not in one.source
    assert same(simulate(scenario()), simulate(scenario(), seed=0), *ALL)


def test_what_is_added_leaves_the_rest_as_it_was() -> None:
    noise = NoiseLevel(toa_sigma_s=SIGMA, bias_sigma_s=1e-8, bias_time_s=9.0)
    sampling = Sampling(interval_s=1.0, jitter_s=0.3, rows="toa")
    shaken = Leg(motion="constant-velocity", duration_s=40.0, acceleration_psd=0.1)
    x = Target(name="x", position_m=(3e3, 2.5e3), legs=[shaken])
    dropouts = Dropouts(row=0.1, scan=0.1)
    made = scenario(noise=noise, sampling=sampling, targets=[x], dropouts=dropouts)
    alone = simulate(made, seed=1)
    assert alone.toa is not None
    before = rows_of(alone.toa)

    def unchanged(other: Scenario, stations: str = "abcd") -> None:
        table = simulate(other, seed=1).toa
        assert table is not None
        mine = rows_of(table, "x")
        keep = np.isin(mine["station"], list(stations))
        for name, column in before.items():
            np.testing.assert_array_equal(mine[name][keep], column)

    unchanged(attrs.evolve(made, targets=[standing("y", scans=90), x]))
    unchanged(attrs.evolve(made, targets=[x, standing("y", (0.0, 9.0), scans=20)]))
    new = Station(name="e", position_m=(-5e3, 9e3))
    unchanged(attrs.evolve(made, stations=[new, *made.stations]))
    rates = attrs.evolve(noise, range_rate_sigma_mps=1.0)
    rated = attrs.evolve(sampling, range_rate=True)
    unchanged(attrs.evolve(made, noise=rates, sampling=rated))
    unchanged(attrs.evolve(made, outliers=Outliers(station={"d": 0.0}, size_s=1.0)))

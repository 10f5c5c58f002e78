"""What study files may say, and what they come to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from study_cases import BANKS, HEAD, SCENARIOS, small

from imm_tdoa import bankfile, simulate, study
from imm_tdoa.study.draw import draw
from imm_tdoa.study.plan import differences
from imm_tdoa.study.sweep import points


def test_every_combination_the_last_fastest() -> None:
    assert points({}) == [{}]
    assert points({"a": [1, 2], "b": ["x", "y"]}) == [
        {"a": 1, "b": "x"},
        {"a": 1, "b": "y"},
        {"a": 2, "b": "x"},
        {"a": 2, "b": "y"},
    ]


def test_a_small_study() -> None:
    plan = small()
    assert [case.name for case in plan.scenarios] == ["drive noise×1", "drive noise×3"]
    assert [dict(case.point) for case in plan.scenarios] == [
        {"noise_factor": 1.0},
        {"noise_factor": 3.0},
    ]
    assert [case.plan.noise.toa_sigma_s for case in plan.scenarios] == [30e-9, pytest.approx(90e-9)]
    assert [bank.name for bank in plan.banks] == ["IMM", "CV", "static"]
    assert plan.banks[0].modes == bankfile.load("static-cv-ca").names
    assert [case.scans for case in plan.scenarios] == [9, 9]
    assert plan.chunks(plan.scenarios[0]) == [(0, 6), (6, 12), (12, 18), (18, 20)]
    assert plan.confidence == 0.95


def test_chunks_depend_on_the_study_alone() -> None:
    plan = small(("chunk = 6\n", ""), ("runs = 20", "runs = 600"))
    assert plan.chunks(plan.scenarios[0]) == [(0, 250), (250, 500), (500, 600)]
    longer = small(("chunk = 6\n", ""), ("interval_s = 2.0", "interval_s = 0.01"))
    assert longer.chunk_of(longer.scenarios[0]) == 30_000 // 1601


def test_the_resolved_study_is_a_study_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(
        'mean_sojourn_s = 7.0\n[[modes]]\nmodel = "static"\npsd = 0.5\n', "utf-8"
    )
    scene = SCENARIOS.replace("[scenarios.scenario]", "[scenarios.replace]").replace(
        'name = "drive"\n', 'name = "drive"\nscenario = "sample"\n'
    )
    banks = BANKS + '\n[[banks]]\nname = "mine"\nbank = "mine.toml"\nsojourn_factor = 2.0\n'
    plan = study.parse(HEAD + scene + banks, folder=tmp_path)
    (tmp_path / "mine.toml").unlink()
    again = study.parse(plan.text)
    assert not differences(plan.table, again.table)
    assert again.scenarios[0].plan == plan.scenarios[0].plan
    assert again.banks[3].bank.mean_sojourn == pytest.approx([14.0])
    assert "bank =" not in plan.text


def test_a_bank_file_of_its_own_goes_before_what_it_refers_to() -> None:
    plan = small(('bank = "static-cv-ca"', 'bank = "static-cv-ca"\nmixing = "zero"'))
    assert plan.banks[0].bank.mixing == "zero"
    assert plan.banks[0].bank.birth_std == bankfile.load("static-cv-ca").birth_std


def test_sweeps_of_a_bank() -> None:
    sweep = "sweep = { process_noise_factor = [1.0, 4.0], mixing = ['birth', 'zero'] }"
    plan = small(('bank = "static-cv-ca"', f'bank = "static-cv-ca"\nsojourn_factor = 0.5\n{sweep}'))
    names = [bank.name for bank in plan.banks[:4]]
    assert names == ["IMM q×1 birth", "IMM q×1 zero", "IMM q×4 birth", "IMM q×4 zero"]
    usual = bankfile.load("static-cv-ca")
    dt = 3.0
    for bank in plan.banks[:4]:
        factor = bank.point["process_noise_factor"]
        assert bank.bank.mixing == bank.point["mixing"]
        assert np.allclose(bank.bank.mean_sojourn, 0.5 * usual.mean_sojourn)
        for model, before in zip(bank.bank.models, usual.models, strict=True):
            Q = before.process_noise(dt, 2)
            assert np.allclose(model.process_noise(dt, 2), factor * Q)


def test_a_factor_on_process_noise_given_as_std_is_one_on_the_variance() -> None:
    plan = small(
        ("psd = 1.0 }]\n\n[[banks]]", "std = 0.5 }]\nprocess_noise_factor = 9.0\n[[banks]]")
    )
    assert plan.banks[1].bank.models[0].std == pytest.approx(1.5)  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("key", "value", "look"),
    [
        ("acceleration_mps2", 4.0, lambda s: s.targets[0].legs[1].acceleration_mps2),
        ("toa_sigma_s", 1e-8, lambda s: s.noise.toa_sigma_s),
        ("tdoa_sigma_s", 1e-8, lambda s: (s.noise.tdoa_sigma_s, s.noise.toa_sigma_s)),
        ("interval_s", 0.5, lambda s: s.sampling.interval_s),
        ("dropout", 0.25, lambda s: s.dropouts.row),
        ("sojourn_s", 3.0, lambda s: [leg.duration_s for leg in s.targets[0].legs]),
        ("station_scale", 2.0, lambda s: s.stations[0].position_m),
        ("layout", '"far"', lambda s: [station.position_m[0] for station in s.stations]),
    ],
)
def test_what_may_be_changed(key: str, value: object, look: object) -> None:
    expected = {
        "acceleration_mps2": (pytest.approx(2.4), pytest.approx(3.2)),
        "toa_sigma_s": 1e-8,
        "tdoa_sigma_s": (1e-8, None),
        "interval_s": 0.5,
        "dropout": 0.25,
        "sojourn_s": [3.0, 3.0],
        "station_scale": (-2500.0, -3750.0),  # the middle is (2500, 3750)
        "layout": [1.0, 2.0, 3.0],
    }
    plan = small(
        (
            'motion = "static", dur',
            'motion = "constant-acceleration", acceleration_mps2 = [3, 4], dur',
        ),
        ("[scenarios.sweep]\n", f"[scenarios.change]\n{key} = {value}\n[scenarios.sweep]\n"),
        ("chunk = 6\n", "chunk = 6\n[layouts]\nfar = [[1, 0], [2, 5], [3, 0]]\n"),
    )
    assert look(plan.scenarios[0].plan) == expected[key]  # type: ignore[operator]


def test_more_noise_is_more_noise_of_every_kind() -> None:
    scenario = 'scenario = "two-ships"\ntarget = "ferry"\n'
    body = SCENARIOS.partition("[scenarios.scenario]")[0]
    sweep = "[scenarios.sweep]\nnoise_factor = [2.0]\n"
    plan = study.parse(HEAD + body + scenario + sweep + BANKS).scenarios[0].plan
    before = simulate.load("two-ships").noise
    assert before.toa_sigma_s is not None
    assert before.bias_sigma_s is not None
    assert plan.noise.toa_sigma_s == 2.0 * before.toa_sigma_s
    assert plan.noise.bias_sigma_s == 2.0 * before.bias_sigma_s
    assert plan.noise.bias_time_s == before.bias_time_s


@pytest.mark.parametrize(
    "scenario", ["drone-3d", "fdoa", "outliers", "sample", "source-a", "two-ships"]
)
def test_shipped_scenarios_can_be_drawn(scenario: str) -> None:
    target = 'target = "ferry"\n' if scenario == "two-ships" else ""
    plan = study.parse(HEAD + f'[[scenarios]]\nscenario = "{scenario}"\n{target}' + BANKS)
    assert plan.scenarios[0].name == scenario
    drawn = draw(plan.scenarios[0], 1, 0, 2)
    assert drawn.values.shape[:2] == (2, plan.scenarios[0].scans)
    assert np.isfinite(drawn.values).mean() > 0.7


def test_differences_are_named() -> None:
    old, new = small().table, small(("psd = 1.0 }]\n\n[[banks]]", "psd = 2.0 }]\n[[banks]]")).table
    assert differences(old, new) == ["banks[1].modes[0].psd: was 1.0, is 2.0"]
    assert differences(old, small(("A small one", "Another")).table) == []
    assert differences(old, small(("seed = 4", "seed = 5")).table) == ["seed: was 4, is 5"]
    assert differences(old, small(("chunk = 6\n", "")).table) == ["chunk: was 6, is absent"]

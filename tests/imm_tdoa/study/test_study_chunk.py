"""A chunk holds what one gets by filtering its runs one by one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from study_cases import BANKS, CRITERIA, HEAD, SCENARIOS, TEXT, small

from imm_tdoa import IMM, metrics, selection, study
from imm_tdoa.study import score
from imm_tdoa.study.chunk import Task, work
from imm_tdoa.study.draw import draw
from imm_tdoa.study.filtering import Estimates
from imm_tdoa.study.ways import Form, Ways


def computed(plan: study.Study, scenario: int = 0, first: int = 0, last: int = 6) -> dict[str, Any]:
    """Return the arrays of one chunk."""
    engines: Any = ("numpy",) * len(plan.banks)
    return work(Task(plan.text, scenario, first, last, engines)).arrays


def test_figures_are_those_of_runs_filtered_one_by_one() -> None:
    plan = small()
    case = plan.scenarios[1]
    arrays = computed(plan, 1, 6, 12)
    drawn = draw(case, plan.seed, 6, 12)
    for b, bank in enumerate(plan.banks):
        for i in range(6):
            imm = IMM(bank.bank, drawn.measurement)
            track = imm.run(drawn.times, drawn.values[i])
            error = (track.position - drawn.ways.position[i])[1:]
            off = (track.velocity - drawn.ways.velocity[i])[1:]
            nees = metrics.nees(error, track.position_covariance[1:])
            expected = {
                "position_mse": metrics.rmse(error) ** 2,
                "position_error": np.linalg.norm(error, axis=-1).mean(),
                "velocity_mse": metrics.rmse(off) ** 2,
                "nees": nees.mean(),
                "nis": track.nis[1:].sum(),
                "nis_dof": track.nis_dof[1:].sum(),
                "log_likelihood": track.log_likelihood[-1],
                "selected": np.argmax(track.mode_probability[1:].sum(axis=0)),
            }
            for name, value in expected.items():
                assert arrays[name][b, i] == pytest.approx(value, rel=1e-9), name
            assert not arrays["failed"][b, i]


def test_sums_are_over_the_runs() -> None:
    plan = small()
    arrays = computed(plan)
    assert arrays["sum_position_square"].shape == (3, 9)
    assert np.all(arrays["count_position_square"] == [0, 6, 6, 6, 6, 6, 6, 6, 6])  # the fix: not
    assert np.all(arrays["count_mode_probability"] == 6)
    total = arrays["sum_position_square"].sum(axis=-1)
    assert total == pytest.approx(8.0 * arrays["position_mse"].sum(axis=-1))
    assert arrays["sum_nees"].sum(axis=-1) == pytest.approx(8.0 * arrays["nees"].sum(axis=-1))
    probability = arrays["sum_mode_probability"]
    assert probability.shape == (3, 9, 3)
    assert probability[0].sum(axis=-1) == pytest.approx(np.full(9, 6.0))
    assert np.all(probability[1, :, 0] == 6.0)
    assert np.isnan(probability[1, :, 1:]).all()
    assert np.all(arrays["sum2_nees"] * 6.0 >= arrays["sum_nees"] ** 2 - 1e-9)
    assert arrays["times"].tolist() == [2.0 * k for k in range(9)]
    assert arrays["dims"] == 2
    assert arrays["runs"].tolist() == [0, 6]
    assert arrays["seeds"][2] == "4/drive noise×1/2"


def test_chunks_do_not_matter_but_for_the_last_bits_of_sums() -> None:
    plan = small()
    whole, part = computed(plan, 0, 0, 12), computed(plan, 0, 4, 9)
    for name in ("position_mse", "log_likelihood", "nees", "seeds"):
        assert np.array_equal(whole[name][..., 4:9], part[name]), name


def test_runs_that_cannot_be_filtered_are_recorded_and_left_out() -> None:
    """So many rows are lost that some runs never have a position: those alone fail."""
    lossy = "dims = 2\ndropouts = { row = 0.82 }\n"
    plan = small(("dims = 2\n", lossy), ("chunk = 6", "chunk = 10"))
    arrays = computed(plan, 0, 0, 10)
    drawn = draw(plan.scenarios[0], plan.seed, 0, 10)
    began = set()
    for b, bank in enumerate(plan.banks):
        for i in range(10):
            imm = IMM(bank.bank, drawn.measurement)
            if arrays["failed"][b, i]:
                with pytest.raises(ValueError) as caught:
                    imm.run(drawn.times, drawn.values[i])
                assert str(caught.value) in arrays["reason"][b, i]
                continue
            track = imm.run(drawn.times, drawn.values[i])
            assert arrays["reason"][b, i] == ""
            assert arrays["log_likelihood"][b, i] == pytest.approx(track.log_likelihood[-1])
            late = 9 - len(track.times)  # scans without an estimate; the very first never counts
            error = track.position - drawn.ways.position[i, late:]
            square = metrics.rmse(error[1 if late == 0 else 0 :]) ** 2
            assert arrays["position_mse"][b, i] == pytest.approx(square)
            began.add(late)
    assert len(began) > 1
    failed = arrays["failed"]
    assert 0 < np.count_nonzero(failed) < failed.size
    assert np.all(arrays["seeds"] != "")
    assert np.all(np.isnan(arrays["position_mse"][failed]))
    assert np.all(arrays["selected"][failed] == -1)
    assert np.all(np.isfinite(arrays["log_likelihood"][~failed]))
    most = arrays["count_mode_probability"].max(axis=-1)
    assert np.all(most <= np.count_nonzero(~failed, axis=-1))


def test_started_filters_are_told_the_truth_with_an_error() -> None:
    start = "[scenarios.start]\nposition_std_m = 50.0\nvelocity_std_mps = 2.0\n"
    sweep = "[scenarios.sweep]\n"
    plan = small((sweep, start + sweep), ("runs = 20", "runs = 300"), ("chunk = 6", "chunk = 300"))
    arrays = computed(plan, 0, 0, 300)
    assert np.all(arrays["count_position_square"] == 300)  # every scan is an update
    nees = arrays["sum_nees"][1, 0] / 300
    assert abs(nees - 2.0) < 4.5 * np.sqrt(4.0 / 300)


def test_scores_from_later_on() -> None:
    plan = small(('name = "drive"\n', 'name = "drive"\nscore_from_s = 9.0\n'))
    late, all_of_it = computed(plan), computed(small())
    assert np.all(late["count_nees"] == [0, 0, 0, 0, 0, 6, 6, 6, 6])
    total = all_of_it["sum_position_square"][:, 5:].sum(axis=-1)
    assert 4.0 * late["position_mse"].sum(axis=-1) == pytest.approx(total)


def test_criteria_choose_as_compare_does() -> None:
    criteria = CRITERIA + "".join(
        f'\n[[criteria]]\nname = "{by}"\nby = "{by}"\nbanks = ["static", "CV"]\n'
        for by in ("aic", "bic", "nis")
    )
    text = TEXT.replace("12.0, 5.0", "1.0, 0.5").replace("psd = 1.0", "psd = 0.0")
    plan = study.parse(text + criteria)
    arrays = computed(plan, 1, 0, 20)
    drawn = draw(plan.scenarios[1], plan.seed, 0, 20)
    models = [plan.banks[k].bank.models[0] for k in (2, 1)]
    found = selection.compare(models, drawn.measurement, drawn.times, drawn.values, update="ekf")
    assert np.array_equal(arrays["selected_model"][0], np.argmax(found.log_evidence, axis=-1))
    assert np.array_equal(arrays["selected_model"][1], np.argmin(found.aic, axis=-1))
    assert np.array_equal(arrays["selected_model"][2], np.argmin(found.bic, axis=-1))
    rejected = (found.nis_p[:, 0] < 0.1) & (found.nis_ratio[:, 0] > 1.0)
    assert np.array_equal(arrays["selected_model"][3], rejected)
    assert len(set(arrays["selected_model"][1])) == 2


def test_recognition_by_hand() -> None:
    bank = small().banks[0]  # static, constant velocity, constant acceleration
    forms = (Form("static", "static"), Form("turn", "turn"), Form("x", "constant-velocity"))
    form = np.array([[0, 0, 2, 2, 2, 1, 0, 0]])
    since = np.array([[0.0, 0.0, 3.0, 3.0, 3.0, 9.0, 11.0, 11.0]])
    leading = np.array([[0, 1, 0, 0, 1, 1, 2, 1]])
    truth = np.zeros((1, 8, 4))
    found = Estimates(
        position=np.zeros((1, 8, 2)),
        velocity=np.zeros((1, 8, 2)),
        covariance=np.broadcast_to(np.eye(2), (1, 8, 2, 2)),
        mode_probability=np.eye(3)[leading],
        nis=np.ones((1, 8)),
        nis_dof=np.ones((1, 8)),
        log_likelihood=np.zeros(1),
        reason=np.array([""], dtype=object),
    )
    ways = Ways(truth, ("x", "y", "vx", "vy"), forms, form, since)
    times = 2.0 * np.arange(8)
    every = np.ones(8, dtype=bool)
    result = score.per_run(bank, found, score.over_time(found, ways), ways, times, every)
    # standing is led at 0 s, not at 2, 12, 14 s; driving on at 8 s of 4, 6, 8 s; no mode turns
    assert result["mode_hit"][0] == pytest.approx(2.0 / 7.0)
    # driving on began at 3 s and leads at 8 s; standing again began at 11 s, never led until 14 s
    assert result["recognition_delay_s"][0] == pytest.approx((5.0 + 3.0) / 2.0)
    assert result["selected"][0] == 1
    single = small().banks[1]
    alone = found._replace(mode_probability=np.ones((1, 8, 1)))
    series = score.over_time(alone, ways)
    assert np.isnan(score.per_run(single, alone, series, ways, times, every)["mode_hit"])


@pytest.mark.parametrize("d", [1, 2, 3])
def test_nees_in_small_and_where_the_covariance_is_none(d: int) -> None:
    rng = np.random.default_rng(d)
    root = rng.normal(size=(4, 5, d, d))
    P, e = root @ np.swapaxes(root, -1, -2), rng.normal(size=(4, 5, d))
    P[0, 0, -1, -1] *= -1.0
    P[1, 2, 0, 0] = 0.0
    P[2, 1], e[3, 3] = np.nan, np.nan
    value = score.nees(e, P)
    lost = np.zeros((4, 5), dtype=bool)
    lost[[0, 1, 2, 3], [0, 2, 1, 3]] = True
    assert np.array_equal(np.isnan(value), lost)
    assert value[~lost] == pytest.approx(metrics.nees(e[~lost], P[~lost]), rel=1e-9)


def test_banks_go_by_modes_of_that_name_before_the_model() -> None:
    plan = study.parse(HEAD + SCENARIOS + BANKS.replace("static-cv-ca", "vehicle"))
    forms = (
        Form("manoeuvring", "constant-velocity"),
        Form("constant-velocity", "constant-velocity"),
    )
    match = score.matching(plan.banks[0], forms)
    assert plan.banks[0].modes == ("standing", "cruising", "manoeuvring", "accelerating")
    assert match.tolist() == [[False, False, True, False], [False, True, True, False]]

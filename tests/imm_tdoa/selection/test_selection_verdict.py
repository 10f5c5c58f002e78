"""From figures to a decision, and to words."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from imm_tdoa.selection import evidence, strength, verdict
from imm_tdoa.selection.consistency import consistency

NAMES = ("static", "cv", "ca")


def test_evidence_adds_up() -> None:
    """Cumulative and windowed sums, by hand; what has not begun stays empty."""
    increments = np.array([[np.nan, np.nan], [1.0, 2.0], [0.5, -1.0], [4.0, 4.0]])
    np.testing.assert_array_equal(
        evidence.cumulative(increments), [[np.nan, np.nan], [1.0, 2.0], [1.5, 1.0], [5.5, 5.0]]
    )
    np.testing.assert_array_equal(
        evidence.windowed(increments, 2), [[np.nan, np.nan], [1.0, 2.0], [1.5, 1.0], [4.5, 3.0]]
    )
    np.testing.assert_array_equal(evidence.windowed(increments, 4), evidence.cumulative(increments))


def test_posterior_is_bayes() -> None:
    """Prior times likelihood over their sum; far below what exp can hold; a prior of zero."""
    L = np.array([-1e5, -1e5 - 2.0, -1e5 + 1.0])
    prior = np.array([0.5, 0.5, 0.0])
    expected = np.array([1.0, np.exp(-2.0), 0.0]) / (1.0 + np.exp(-2.0))
    np.testing.assert_allclose(np.exp(evidence.posterior(L, prior)), expected, rtol=1e-12)


def test_words() -> None:
    """Twice the margin above 2, 6 and 10."""
    words = strength(np.array([0.9, 1.1, 2.9, 3.1, 4.9, 5.1, np.inf]))
    few, some, much, most = "barely worth mentioning", "positive", "strong", "very strong"
    assert words.tolist() == [few, some, some, much, much, most, most]


def test_consistency_is_a_chi_square_test() -> None:
    """Two-sided p-values as SciPy has them; missing scans count for nothing."""
    rng = np.random.default_rng(0)
    nis = rng.chisquare(3.0, (4, 30, 2)) * np.array([1.0, 2.5])
    nis[0, 5] = np.nan
    dof = np.full((4, 30), 3)
    test = consistency(nis, dof, 1e-3, 0.25)
    total = np.nansum(nis, axis=1)
    n = np.array([87, 90, 90, 90])
    np.testing.assert_array_equal(test.dof, n)
    expected = 2.0 * np.minimum(chi2.cdf(total, n[:, None]), chi2.sf(total, n[:, None]))
    np.testing.assert_allclose(test.p, expected, rtol=1e-9)
    np.testing.assert_allclose(test.ratio, total / n[:, None])
    assert test.rejected[:, 1].all()
    assert not test.rejected[:, 0].any()
    assert not test.small.any()


def test_the_veto_false_alarm_rate() -> None:
    """A right model is rejected as often as its significance says, at the most."""
    rng = np.random.default_rng(1)
    test = consistency(rng.chisquare(3.0, (40000, 20, 1)), np.full((40000, 20), 3), 0.01, 0.0)
    count = np.count_nonzero(test.rejected)
    assert abs(count - 400) < 4.0 * np.sqrt(400.0)


def test_too_small_is_remarked_and_too_large_within_the_tolerance_passes() -> None:
    """A hundred thousand rows: 10 % too large is significant, not material; small never vetoes."""
    nis = np.array([1.1, 0.3, 1.4]) * np.full((1000, 3), 100.0)
    test = consistency(nis, np.full(1000, 100), 1e-3, 0.25)
    assert test.p[0] < 1e-6
    assert test.rejected.tolist() == [False, False, True]
    assert test.small.tolist() == [False, True, False]


def test_nothing_to_judge_by() -> None:
    test = consistency(np.full((3, 2), np.nan), np.zeros(3, dtype=int), 1e-3, 0.25)
    assert np.all(np.isnan(test.p))
    assert not test.rejected.any()


RULES = [
    # log-probabilities, rejected, best, margin, decided
    ([0.0, -5.0, -9.0], [0, 0, 0], 0, 5.0, True),
    ([0.0, -2.0, -9.0], [0, 0, 0], 0, 2.0, False),
    ([0.0, -5.0, -9.0], [1, 0, 0], 1, -5.0, False),  # the tests disagree
    ([-5.0, 0.0, -9.0], [1, 0, 1], 1, 5.0, True),  # what is out need not be feared
    ([-5.0, 0.0, -9.0], [1, 1, 1], 1, 5.0, False),  # nobody is left
    ([0.0, -np.inf, -np.inf], [0, 0, 0], 0, np.inf, True),
]


@pytest.mark.parametrize(("log_p", "rejected", "best", "margin", "decided"), RULES)
def test_the_rule(
    log_p: list[float], rejected: list[int], best: int, margin: float, decided: bool
) -> None:
    ruling = verdict.rule(np.array(log_p), np.array(rejected, dtype=bool), 3.0)
    assert (int(ruling.best), float(ruling.margin), bool(ruling.decided)) == (best, margin, decided)
    together = verdict.rule(
        np.array([log_p, log_p[::-1]]), np.array([rejected, rejected[::-1]], dtype=bool), 3.0
    )
    assert together.best.tolist() == [best, 2 - best]


def test_one_model_alone() -> None:
    ruling = verdict.rule(np.zeros((2, 1)), np.array([[False], [True]]), 3.0)
    assert ruling.decided.tolist() == [True, False]
    assert np.all(np.isinf(ruling.margin))


def say(**changes: object) -> str:
    given: dict[str, object] = {
        "names": NAMES,
        "best": 1,
        "runner_up": 2,
        "margin": 12.3,
        "decided": True,
        "p": [1e-9, 0.41, 0.4],
        "ratio": [300.0, 1.02, 1.01],
        "rejected": [True, False, False],
        "small": [False] * 3,
    }
    return verdict.reason(**{**given, **changes})  # type: ignore[arg-type]


def test_reasons() -> None:
    assert say() == (
        "cv explains the data best: 12.3 nats ahead of ca (very strong), and its innovations are "
        "consistent (p = 0.41)"
    )
    assert say(margin=1.2, decided=False) == (
        "cv and ca explain the data almost alike: 1.2 nats apart (positive), too little to decide"
    )
    assert say(best=2, runner_up=0, margin=-4.0, decided=False) == (
        "the tests disagree: static is the most probable, 4.0 nats ahead of ca, but its squared "
        "innovations are 300 times their expected size (p < 1e-6)"
    )
    assert say(rejected=[True] * 3, decided=False).startswith("no model foresees the data: even")
    assert "only 0.5 times" in say(ratio=[1, 0.5, 1], small=[False, True, False], p=[1, 1e-9, 1])
    assert "nearly right, 1.1 times" in say(ratio=[1, 1.1, 1], p=[1, 1e-9, 1])
    assert say(surprise="and more").endswith("(p = 0.41); and more")
    alone = {"names": ("cv",), "best": 0, "runner_up": 0, "margin": np.inf}
    one = {**alone, "p": [0.4], "ratio": [1.0], "rejected": [False], "small": [False]}
    assert say(**one).startswith("cv is the only model compared, and its innovations are")
    assert say(**{**one, "rejected": [True], "decided": False}).startswith("cv does not foresee")
    nothing = {"p": [np.nan] * 3, "ratio": [np.nan] * 3, "rejected": [False] * 3}
    assert "no scan after the first fix" in say(**nothing, margin=0.0, decided=False)

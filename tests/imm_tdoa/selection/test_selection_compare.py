"""Which motion was it: the evidence against a dense oracle, and the published cases."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from selection_cases import BIRTH, FORMS, TIMES, measured, models, path, star
from test_selection_best_fit import dense

from imm_tdoa import IMM, Bank, selection
from imm_tdoa.models import ConstantAcceleration, ConstantVelocity, Position, Static
from imm_tdoa.selection import compare


def test_evidence_is_the_marginal_likelihood() -> None:
    """Joint Gaussian of all fixes under prior and process noise, for each model; Bayes' rule."""
    times = np.array([1.0, 2.0, 2.5, 4.0, 7.0])
    candidates = [Static(psd=2.0), ConstantVelocity(psd=0.5), ConstantAcceleration(psd=0.1)]
    bank = Bank(candidates, birth_std={"velocity": 20.0, "acceleration": 3.0})
    measurement = Position(10.0)
    start = IMM(bank, measurement).start(1.0, [5.0, 5.0], 400.0 * np.eye(2))
    z = np.random.default_rng(2).normal(0.0, 30.0, (5, 2))
    prior = [0.2, 0.3, 0.5]
    found = compare(bank, measurement, times, z, start=start, prior=prior)
    expected = []
    for model, std in zip(candidates, (20.0, 20.0, 20.0), strict=True):
        A, C = dense(model, times, 10.0)
        P0 = np.diag(np.repeat([std, 20.0, 3.0], 2)[: A.shape[1]] ** 2)
        m0 = np.array([5.0, 5.0, 0, 0, 0, 0])[: A.shape[1]]
        expected.append(multivariate_normal.logpdf(z.ravel(), A @ m0, A @ P0 @ A.T + C))
    np.testing.assert_allclose(found.log_evidence, expected, atol=1e-8)
    weight = np.array(prior) * np.exp(expected - np.max(expected))
    np.testing.assert_allclose(found.probability, weight / weight.sum(), rtol=1e-8)
    np.testing.assert_allclose(found.evidence[-1], found.log_evidence)
    np.testing.assert_allclose(found.bayes_factor, 2.0 * (np.max(expected) - expected), atol=1e-8)


@pytest.mark.parametrize("form", [0, 1, 2])
def test_source_a(form: int) -> None:
    """At least 299 of 300 tracks of each motion form (§5.4), and the published margins."""
    measurement = star()
    z = measured(measurement, path(form), np.random.default_rng(10 + form))
    found = compare(models(), measurement, TIMES, z, birth_std=BIRTH, criteria=False)
    assert found.names == FORMS
    assert np.count_nonzero(found.best == form) >= 299
    assert found.counts[FORMS[form]] >= 299
    margin = found.margin.mean()
    if form < 2:  # mean of 300 margins, each with the spread of half a chi-square of 2 degrees
        assert margin == pytest.approx((12.3, 11.0)[form], abs=0.05 + 4.0 / np.sqrt(300.0))
    else:
        assert margin > 1000.0
    assert np.all(found.accepted[..., form].mean() > 0.98)
    assert not found.accepted[..., :form].any()


TABLE = np.array(  # §11: AIC, BIC, Bayes with 5, 50 and 500 m/s², NIS rejects CV
    [
        [0.17, 0.02, 0.03, 0.00, 0.00, 0.02],
        [0.29, 0.06, 0.11, 0.00, 0.00, 0.06],
        [0.67, 0.31, 0.42, 0.08, 0.00, 0.09],
        [0.99, 0.91, 0.95, 0.65, 0.30, 0.39],
        [1.00, 1.00, 1.00, 0.98, 0.88, 0.85],
        [1.00, 1.00, 1.00, 1.00, 1.00, 1.00],
    ]
)


def test_discrimination_table() -> None:
    """Every cell within 0.10 of §11, 300 runs; AIC without acceleration as theory has it."""
    found = selection.discrimination(seed=0)
    assert found.criteria == ("AIC", "BIC", "Bayes 5", "Bayes 50", "Bayes 500")
    np.testing.assert_allclose(found.fraction, TABLE[:, :5], atol=0.10)
    np.testing.assert_allclose(found.nis_rejects, TABLE[:, 5], atol=0.10)
    p = 0.1353  # Pr(chi-square of 2 degrees > 4)
    assert found.fraction[0, 0] == pytest.approx(p, abs=4.0 * np.sqrt(p * (1.0 - p) / 300))
    assert "0.00" in str(found)
    assert found.error[0] == pytest.approx([592.0, 615.0], rel=0.08)


def test_lindley() -> None:
    """Doubling what is believed of the acceleration costs log 2 per axis; AIC does not move."""
    measurement = star()
    z = measured(measurement, path(1)[0], np.random.default_rng(0), runs=20)
    wide, wider = (
        compare(
            models()[1:],
            measurement,
            TIMES,
            z,
            birth_std={"velocity": 5000.0, "acceleration": std},
        )
        for std in (500.0, 1000.0)
    )
    assert np.mean(wider.margin - wide.margin) == pytest.approx(2.0 * np.log(2.0), abs=0.02)
    np.testing.assert_allclose(wide.aic, wider.aic, atol=1e-4)
    assert wide.birth_std == {"velocity": 5000.0, "acceleration": 500.0}


def test_a_batch_is_its_targets() -> None:
    """One target of a batch, judged in it and alone; missing rows and a late start among them."""
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(1), runs=1)[0]
    z[0, 4:9, 1] = np.nan
    z[1, :3] = np.nan
    found = compare(models(), measurement, TIMES, z, birth_std=BIRTH)
    assert isinstance(found.verdict, np.ndarray)
    for i in range(3):
        alone = compare(models(), measurement, TIMES, z[i], birth_std=BIRTH)
        inside = found.of(i)
        assert isinstance(alone.verdict, str)
        assert inside.verdict == alone.verdict == "constant-velocity"
        assert inside.rows == alone.rows == (63, 63, 63)[i] - (5, 9, 0)[i]
        for name in ("log_evidence", "aic", "bic", "nis_p", "nis_ratio", "margin"):
            np.testing.assert_allclose(
                getattr(inside, name), getattr(alone, name), rtol=1e-6, atol=1e-4, err_msg=name
            )
    assert np.all(np.isnan(found.evidence[1, :3]))
    assert np.all(np.isfinite(found.evidence[1, 3:]))


def test_criteria_choose_by_themselves() -> None:
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(5), runs=2)
    found = compare(models(), measurement, TIMES, z, birth_std=BIRTH)
    for criterion, score in (("aic", found.aic), ("bic", found.bic)):
        expected = np.array(FORMS)[np.argmin(score, axis=-1)]
        np.testing.assert_array_equal(found.choice_by(criterion), expected)
    assert np.all(found.choice_by() == "constant-velocity")
    quick = compare(models(), measurement, TIMES, z, birth_std=BIRTH, criteria=False)
    assert np.all(quick.choice_by("aic") == "")
    assert np.all(quick.reason_aic == "not asked for")
    np.testing.assert_array_equal(quick.verdict, found.verdict)
    with pytest.raises(ValueError, match=r"criterion: expected 'probability'"):
        found.choice_by("dic")  # type: ignore[arg-type]


def test_models_that_cannot_be_told_apart() -> None:
    """The same model twice: even odds, and the verdict is to keep both."""
    measurement = star()
    z = measured(measurement, path(1)[0], np.random.default_rng(0), runs=1)[0]
    found = compare(
        [ConstantVelocity(psd=0.0)] * 2, measurement, TIMES, z, names=("a", "b"), birth_std=BIRTH
    )
    assert found.verdict == "imm"
    assert found.margin == pytest.approx(0.0, abs=1e-9)
    assert "a and b explain the data almost alike" in str(found.reason)
    told = compare(
        [ConstantVelocity(psd=0.0)] * 2,
        measurement,
        TIMES,
        z,
        names=("a", "b"),
        birth_std=BIRTH,
        prior=[0.001, 0.999],
    )
    assert told.verdict == "b"
    assert told.margin == pytest.approx(np.log(999.0))


def test_a_target_that_changes_its_motion() -> None:
    """Static, then straight on: no simple model as a whole; the last scans say which it is now."""
    times = 2.0 * np.arange(41)
    t = np.maximum(times - 40.0, 0.0)
    p = np.stack([np.full(41, 300e3), 400e3 + 1000.0 * t], axis=-1)
    measurement = star()
    z = measured(measurement, p, np.random.default_rng(3), runs=1)[0]
    bank = Bank([Static(psd=0.0), ConstantVelocity(psd=3e3)], birth_std=BIRTH)
    whole = compare(bank, measurement, times, z)
    assert whole.evidence[19].argmax() == 0
    assert not whole.accepted[0]
    last = compare(bank, measurement, times, z, window=8)
    assert last.verdict == "constant-velocity"
    assert last.window == last.width == 8
    assert last.span == "the last 8 scans"
    np.testing.assert_allclose(
        last.log_evidence, whole.track.mode_log_likelihood[-8:].sum(axis=0), rtol=1e-12
    )
    assert last.rows == 24
    before = compare(bank, measurement, times[:20], z[:20])
    assert before.verdict == "static"


def test_outliers_do_not_decide() -> None:
    """A tenth of the rows off by 100 sigma: with a robust filter the verdict stays."""
    measurement = star()
    rng = np.random.default_rng(4)
    z = measured(measurement, path(1), rng, runs=5)
    gross = rng.random(z.shape) < 0.1
    gross[..., 0, :] = False
    z = z + gross * rng.choice([-1e-5, 1e-5], z.shape)
    plain = compare(models(), measurement, TIMES, z, birth_std=BIRTH, criteria=False)
    assert np.count_nonzero(np.asarray(plain.verdict) == "constant-velocity") == 0
    found = compare(models(), measurement, TIMES, z, birth_std=BIRTH, robust="gate")
    assert np.count_nonzero(np.asarray(found.verdict) == "constant-velocity") >= 13
    chosen = np.asarray(found.choice_by("bic"))
    assert np.count_nonzero(chosen == "constant-velocity") >= 12
    assert np.all(found.rows < 63)


def test_a_belief_that_the_data_contradict_is_named() -> None:
    """1000 m/s where 100 m/s are believed: the reason says so, and what to do."""
    measurement = star()
    z = measured(measurement, path(1)[0], np.random.default_rng(0), runs=1)[0]
    found = compare(models()[:2], measurement, TIMES, z)
    assert found.verdict == "imm"
    assert "most likely velocity is" in str(found.reason)
    assert "where birth_std believes in 100" in str(found.reason)
    wide = compare(models()[:2], measurement, TIMES, z, birth_std=BIRTH)
    assert "birth" not in str(wide.reason)


def test_printed() -> None:
    measurement = star()
    z = measured(measurement, path(1), np.random.default_rng(0), runs=1)[0]
    found = compare(models(), measurement, TIMES, z, birth_std=BIRTH)
    text = str(found.of(0))
    assert "velocity 5000, acceleration 500" in text
    assert "verdict: constant-velocity. constant-velocity explains the data best" in text
    assert [row["model"] for row in found.table(0)] == list(FORMS)
    assert "verdicts of 3:" in str(found)
    with pytest.raises(ValueError, match=r"index: expected one number for each of the batch"):
        found.table()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"window": 0}, r"window: expected a number of scans, 1 or more, got 0"),
        ({"window": 2.5}, r"window: expected"),
        ({"significance": 1.0}, r"significance: expected a probability below 1"),
        ({"threshold": -1.0}, r"threshold: expected a number of at least 0"),
        ({"tolerance": -1.0}, r"tolerance: expected"),
        ({"prior": [1.0]}, r"prior: expected shape"),
        ({"names": ("a",)}, r"names: expected 3 different names"),
        ({"update": "magic"}, r"update: expected"),
    ],
)
def test_refusals(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compare(models(), star(), TIMES, np.zeros((21, 3)), **options)  # type: ignore[arg-type]

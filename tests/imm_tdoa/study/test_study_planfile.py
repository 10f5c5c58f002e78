"""Where study files are wrong, and how they are told."""

from __future__ import annotations

import pytest
from study_cases import BANKS, CRITERIA, HEAD, SCENARIOS, TEXT, small

from imm_tdoa import study

WRONG = [
    ("title = ", "titel = ", "small.toml: titel: unknown key (did you mean 'title'?)"),
    ("runs = 20", "runs = 0", "small.toml: runs: expected a number above 0, got 0"),
    ("runs = 20", "runs = 2.5", "small.toml: runs: expected a whole number, got 2.5"),
    ("seed = 4", "seed = -4", "small.toml: seed: expected a whole number of at least 0"),
    ("seed = 4", "seed = ", "small.toml:5:"),
    ("chunk = 6", "confidence = 1.0", "small.toml: confidence: expected a probability between"),
    ("chunk = 6", 'metrics = ["speed"]', "small.toml: metrics[0]: expected one of position"),
    (
        "noise_factor = [1.0, 3.0]",
        "noise_factor = [1.0, -3.0]",
        "small.toml: scenarios[0].sweep.noise_factor[1]: expected a number above 0, got -3",
    ),
    (
        "noise_factor = [1.0, 3.0]",
        "noise_factr = [1.0]",
        "small.toml: scenarios[0].sweep.noise_factr: no parameter of a scenario (did you mean "
        "'noise_factor'?)",
    ),
    ("noise_factor = [1.0, 3.0]", "noise_factor = []", "scenarios[0].sweep.noise_factor: expected"),
    (
        "noise_factor = [1.0, 3.0]",
        "noise_factor = [1.0, 1.0]",
        "small.toml: scenarios: two of them are called 'drive_noise_1'",
    ),
    (
        "noise_factor = [1.0, 3.0]",
        'layout = ["ring"]',
        "small.toml: scenarios[0].sweep.layout[0]: there is no layout 'ring'; there are: none",
    ),
    (
        "noise_factor = [1.0, 3.0]",
        "acceleration_mps2 = [1.0]",
        "small.toml: scenarios[0].sweep.acceleration_mps2[0]: the scenario has no leg with",
    ),
    (
        "duration_s = 8.0 },\n    ]",
        "duration_s = -8.0 },\n    ]",
        "small.toml: scenarios[0].scenario: targets[0].legs[1].duration_s: expected a number above",
    ),
    (
        'name = "drive"\n',
        'name = "drive"\ntarget = "lorry"\n',
        "small.toml: scenarios[0].target: there is no target 'lorry'; there are: car",
    ),
    (
        'name = "drive"\n',
        'name = "drive"\nreplace = { clok = 1 }\n',
        "small.toml: scenarios[0].replace.clok: a scenario has no such table (did you mean",
    ),
    (
        'name = "drive"\n',
        'name = "drive"\nstart = { position_std_m = 0.0 }\n',
        "small.toml: scenarios[0].start.position_std_m: expected a number above 0, got 0",
    ),
    (
        'name = "drive"\n',
        'name = "drive"\nrandom = { bank = "nothing" }\n',
        "small.toml: scenarios[0].random.bank: no preset and no file is called 'nothing'",
    ),
    (
        'bank = "static-cv-ca"',
        'bank = "static-cv"',
        "small.toml: banks[0].bank: no preset and no file is called 'static-cv' (did you mean",
    ),
    ('bank = "static-cv-ca"\n', "", "small.toml: banks[0].bank: missing; expected a preset"),
    (
        'bank = "static-cv-ca"',
        'bank = "static-cv-ca"\nrobust = "gates"',
        "small.toml: banks[0].robust: expected one of 'none', 'gate', 'student-t', got 'gates'",
    ),
    (
        'bank = "static-cv-ca"',
        'bank = "static-cv-ca"\ngate_probability = 2.0',
        "small.toml: banks[0].gate_probability: expected a probability between 0 and 1, got 2",
    ),
    (
        'bank = "static-cv-ca"',
        'bank = "static-cv-ca"\nsweep = { sojourn_factor = [0.0] }',
        "small.toml: banks[0].sweep.sojourn_factor: expected a number above 0, got 0.0",
    ),
    (
        'bank = "static-cv-ca"',
        'bank = "static-cv-ca"\nsweep = { sojourn = [1.0] }',
        "small.toml: banks[0].sweep.sojourn: no parameter of a bank (did you mean 'sojourn_factor'",
    ),
    (
        'model = "static", psd = 1.0',
        'model = "static", psd = -1.0',
        "small.toml: banks[2].modes[0].psd: expected a number of at least 0, got -1",
    ),
    (
        'model = "static", psd = 1.0',
        'model = "statik", psd = 1.0',
        "small.toml: banks[2].modes[0].model: no plug-in provides 'statik' (did you mean",
    ),
    ('name = "static"\n', 'name = "CV"\n', "small.toml: banks: two of them are called 'CV'"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG, ids=[w[2][:50] for w in WRONG])
def test_errors_say_where(old: str, new: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        small((old, new))
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"static", "CV"]', '"static", "CA"]', "criteria[0].banks: there is no bank 'CA'"),
        ('"static", "CV"]', '"static"]', "criteria[0].banks: expected at least two banks"),
        ('"static", "CV"]', '"static", "IMM"]', "criteria[0].banks: 'IMM' has 3 modes"),
        ('by = "log_evidence"', 'by = "dic"', "criteria[0].by: expected one of 'aic'"),
    ],
)
def test_errors_of_criteria(old: str, new: str, message: str) -> None:
    assert old in CRITERIA
    with pytest.raises(ValueError) as caught:
        study.parse(TEXT + CRITERIA.replace(old, new), "small.toml")
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "discriminaton",
            "study: no shipped study and no file is called 'discriminaton' (did you mean",
        ),
        ("nowhere/study.toml", "study: there is no file 'nowhere/study.toml'"),
        (".", "is a folder; expected a TOML file"),
    ],
)
def test_no_such_study(name: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:
        study.load(name)
    assert message in str(caught.value)


def test_what_a_study_cannot_draw_is_refused() -> None:
    body = SCENARIOS.replace("dims = 2\n", "dims = 3\nheight = { sigma_m = 3.0 }\n")
    body = body.replace("0.0] }", "0.0, 1.0] }").replace("00.0]", "00.0, 9.0]")
    body = body.replace("[12.0, 5.0]", "[12.0, 5.0, 0.0]")
    with pytest.raises(ValueError, match=r"scenarios\[0\]\.scenario\.height: a study cannot draw"):
        study.parse(HEAD + body + BANKS)

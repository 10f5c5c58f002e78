"""Bank files: what they give, and that every fault is named with its place."""

from pathlib import Path

import numpy as np
import pytest

from imm_tdoa import bankfile, registry

STATIC = '[[modes]]\nmodel = "static"\npsd = 0.0\n'
CV = '[[modes]]\nmodel = "constant-velocity"\npsd = 1.0\n'
MOTIONS = "constant-acceleration, constant-velocity, coordinated-turn, singer, static"


def test_reads_everything_a_bank_takes() -> None:
    bank = bankfile.parse(
        """
        mean_sojourn_s = [20, 40.0]
        prior = [0.25, 0.75]
        mixing = "unbiased"
        [birth_std]
        velocity = 7
        [[modes]]
        model = "static"
        psd = 0.5
        [[modes]]
        model = "singer"
        name = "swerving"
        std = 3.0
        time_constant = 12.0
        """
    )
    assert bank.names == ("static", "swerving")
    np.testing.assert_array_equal(bank.mean_sojourn, [20.0, 40.0])
    np.testing.assert_array_equal(bank.prior, [0.25, 0.75])
    assert bank.mixing == "unbiased"
    assert bank.birth_std["velocity"] == 7.0
    assert bank.models[0] == registry.load("static")(psd=0.5)
    assert bank.models[1] == registry.load("singer")(std=3.0, time_constant=12.0)


def test_transition_matrix_instead_of_sojourn_times() -> None:
    bank = bankfile.parse("transition = [[0.9, 0.1], [0.2, 0.8]]\n" + STATIC + CV)
    np.testing.assert_array_equal(bank.transition, [[0.9, 0.1], [0.2, 0.8]])
    assert bank.mean_sojourn is None


def test_default_sojourn_is_the_banks() -> None:
    np.testing.assert_array_equal(bankfile.parse(STATIC + CV).mean_sojourn, [60.0, 60.0])


def test_unnamed_repeats_are_numbered_and_names_kept() -> None:
    bank = bankfile.parse(STATIC + CV + 'name = "fast"\n' + CV + CV)
    assert bank.names == ("static", "fast", "constant-velocity-1", "constant-velocity-2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a =\n", "bank.toml:1:4: Invalid value"),
        ("", "bank.toml: modes: expected at least one [[modes]] table, got none"),
        ("modes = []", "bank.toml: modes: expected at least one [[modes]] table, got none"),
        ("modes = 3", "bank.toml: modes: expected tables in double brackets, got 3"),
        ("modes = [1]", "bank.toml: modes[0]: expected a table, got 1"),
        (
            "[[modes]]\npsd = 1.0",
            "bank.toml: modes[0].model: missing; expected the name of a motion model",
        ),
        (
            STATIC + '[[modes]]\nmodel = "constant-velocty"',
            "bank.toml: modes[1].model: no plug-in provides 'constant-velocty' (did you mean "
            f"'constant-velocity'?); there are: {MOTIONS}",
        ),
        (
            '[[modes]]\nmodel = "tdoa"',
            "bank.toml: modes[0].model: 'tdoa' is a measurement model, not a motion model; "
            f"there are: {MOTIONS}",
        ),
        (
            "[[modes]]\nmodel = 3",
            "bank.toml: modes[0].model: expected text in quotes, got 3",
        ),
        (
            CV + "psb = 1.0",
            "bank.toml: modes[0].psb: the model 'constant-velocity' has no such parameter (did "
            "you mean 'psd'?); it takes: psd, std",
        ),
        (
            STATIC + CV.replace("1.0", "'fast'"),
            "bank.toml: modes[1].psd: expected one number, got 'fast'",
        ),
        (
            CV.replace("1.0", "-1.0"),
            "bank.toml: modes[0].psd: expected a number of at least 0, got -1.0",
        ),
        (
            CV.replace("psd = 1.0", ""),
            "bank.toml: modes[0]: ConstantVelocity: give exactly one of psd (continuous white "
            "noise) and std (piecewise constant), got psd=None, std=None",
        ),
        (
            CV + 'name = "a"\n' + STATIC + 'name = "a"',
            "bank.toml: modes[0].name: the name 'a' appears twice",
        ),
        (
            "mean_sojourn_s = 'long'\n" + CV,
            "bank.toml: mean_sojourn_s: expected a number or a list of numbers, s, got 'long'",
        ),
        (
            "mean_sojourn_s = [1, 'a']\n" + CV,
            "bank.toml: mean_sojourn_s[1]: expected a number, s, got 'a'",
        ),
        (
            "mean_sojourn_s = [1, 2]\n" + CV,
            "bank.toml: mean_sojourn_s: expected one time or 1 of them, s, got [1, 2]",
        ),
        (
            "mean_sojourn_s = -5\n" + CV,
            "bank.toml: mean_sojourn_s: expected times above 0 s, got -5",
        ),
        (
            "mean_sojourn_s = 5\ntransition = [[1.0]]\n" + CV,
            "bank.toml: give mean_sojourn_s or transition, not both",
        ),
        (
            "transition = [[0.9, 0.2], [0.1, 0.8]]\n" + STATIC + CV,
            "bank.toml: transition: expected rows that sum to 1, row 0 sums to 1.1; its columns "
            "do: is it transposed?",
        ),
        ("prior = [1.0, 'a']\n" + CV, "bank.toml: prior[1]: expected a number, got 'a'"),
        (
            "mixing = 'average'\n" + CV,
            "bank.toml: mixing: expected one of birth, unbiased, zero, got 'average'",
        ),
        (
            "birth_std = {velocity = '9'}\n" + CV,
            "bank.toml: birth_std.velocity: expected a number, got '9'",
        ),
        (
            "birth_std = {speed = 9.0}\n" + CV,
            "bank.toml: birth_std: unknown key 'speed'; expected a kind (acceleration, "
            "turn_rate, velocity) or a component (vx, vy, vz, x, y, z)",
        ),
        (
            "mean_sojourn = 5\n" + CV,
            "bank.toml: mean_sojourn: unknown key (did you mean 'mean_sojourn_s'?); there are: "
            "modes, mean_sojourn_s, transition, prior, mixing, birth_std",
        ),
    ],
)
def test_every_fault_has_its_place(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "bank.toml"
    file.write_text(text, "utf-8")
    with pytest.raises(ValueError) as caught:
        bankfile.load(file)
    assert str(caught.value) == message


def test_what_is_neither_preset_nor_file(tmp_path: Path) -> None:
    every = ", ".join(bankfile.presets())
    for name, message in {
        "drnoe": "bank: no preset and no file is called 'drnoe' (did you mean 'drone'?); there "
        f"are: {every}",
        "missing.toml": "bank: there is no file 'missing.toml'",
        str(tmp_path): f"bank: {str(tmp_path)!r} is a folder; expected a TOML file",
    }.items():
        with pytest.raises(ValueError) as caught:
            bankfile.load(name)
        assert str(caught.value) == message
    (tmp_path / "latin.toml").write_bytes(b"# \xe9\n")
    with pytest.raises(ValueError, match=r"latin\.toml:1: expected UTF-8 text"):
        bankfile.load(tmp_path / "latin.toml")


def test_presets_are_the_kinds_of_targets_we_promise() -> None:
    kinds = {"aircraft", "drone", "pedestrian", "rocket", "ship", "vehicle"}
    assert set(bankfile.presets()) == {"static-cv-ca", *kinds}


@pytest.mark.parametrize("name", bankfile.presets())
@pytest.mark.parametrize("dims", [2, 3])
def test_preset_is_a_bank_in_the_plane_and_in_space(name: str, dims: int) -> None:
    bank = bankfile.load(name)
    assert len(bank) >= 3
    space = bank.space(dims)
    assert len(space.modes) == len(bank)
    np.testing.assert_allclose(bank.chain(1.0).sum(axis=-1), 1.0, rtol=1e-12)

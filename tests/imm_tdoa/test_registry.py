"""Models are plug-ins: ours and a stranger's are found the same way."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from imm_tdoa import registry
from imm_tdoa.models import TDOA, ConstantVelocity

PLUG_IN = '''\
import attrs
from imm_tdoa.models import ConstantVelocity


@attrs.frozen
class Jittery(ConstantVelocity):
    """A stranger's motion model."""
'''


def stranger(folder: Path, name: str = "jittery") -> dict[str, str]:
    """Lay a distribution with one plug-in into `folder`; return an environment that sees it."""
    (folder / "strangers.py").write_text(PLUG_IN)
    info = folder / "strangers-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: strangers\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[imm_tdoa.models]\n{name} = strangers:Jittery\n")
    return {**os.environ, "PYTHONPATH": str(folder)}


def run(code: str, env: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True)


def test_the_built_in_models_are_registered_by_kind() -> None:
    motion = {"static", "constant-velocity", "constant-acceleration", "singer", "coordinated-turn"}
    measurement = {"position", "tdoa", "toa", "fdoa", "range-rate", "height", "stack"}
    assert motion <= set(registry.names("motion"))
    assert measurement <= set(registry.names("measurement"))
    assert set(registry.names()) == set(registry.names("motion")) | set(
        registry.names("measurement")
    )


def test_a_name_leads_to_its_class_and_back() -> None:
    assert registry.load("tdoa") is TDOA
    assert registry.name_of(ConstantVelocity(psd=1.0)) == "constant-velocity"
    assert registry.name_of(object()) == "object"


def test_an_unknown_name_lists_what_there_is() -> None:
    with pytest.raises(ValueError, match=r"'constant-velocty'.*did you mean 'constant-velocity'"):
        registry.load("constant-velocty")
    with pytest.raises(ValueError, match=r"there are: .*coordinated-turn.*tdoa"):
        registry.load("warp-drive")


def test_a_strangers_model_is_found_and_goes_into_a_bank_file(tmp_path: Path) -> None:
    env = stranger(tmp_path)
    bank = tmp_path / "bank.toml"
    bank.write_text('[[modes]]\nmodel = "jittery"\npsd = 2.0\n')
    done = run(
        f"from imm_tdoa import bankfile, registry\n"
        f"print(bankfile.load({str(bank)!r}).models, registry.origin('jittery'))",
        env,
    )
    assert done.returncode == 0, done.stderr
    assert "Jittery(psd=2.0" in done.stdout
    assert "strangers" in done.stdout


def test_two_plug_ins_of_one_name_are_refused(tmp_path: Path) -> None:
    env = stranger(tmp_path, name="static")
    done = run("from imm_tdoa import registry; registry.names()", env)
    assert "two plug-ins provide the model 'static'" in done.stderr

"""`import imm_tdoa` is light, and the public names are there."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = (
    "matplotlib",
    "numba",
    "xarray",
    "filterpy",
    "hypothesis",
    "pandas",
    "pyarrow",
    "typer",
    "rich",
)


def loaded_after(statement: str) -> set[str]:
    """Top-level modules in a fresh interpreter after `statement`."""
    code = f"{statement}\nimport sys\nprint(*{{m.partition('.')[0] for m in sys.modules}})"
    result = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    )
    return set(result.stdout.split())


def test_importing_the_package_loads_nothing_heavy():
    loaded = loaded_after("import imm_tdoa")
    assert "numpy" in loaded
    assert loaded.isdisjoint(HEAVY), loaded & set(HEAVY)


def test_tracking_loads_nothing_heavy():
    loaded = loaded_after(
        "import numpy as np\n"
        "from imm_tdoa import IMM, Bank, Stations\n"
        "from imm_tdoa.models import TDOA, ConstantVelocity, Static\n"
        "stations = Stations([[0, 0], [1e3, 0], [0, 1e3], [1e3, 1.1e3]])\n"
        "imm = IMM(Bank([Static(psd=1.0), ConstantVelocity(psd=1.0)]),"
        " TDOA(stations, toa_sigma=1e-8))\n"
        "r = np.linalg.norm(stations.positions - [400.0, 300.0], axis=1) / 299792458.0\n"
        "imm.run([0.0, 1.0], np.tile(r[1:] - r[0], (2, 1)))\n"
    )
    assert loaded.isdisjoint(HEAVY), loaded & set(HEAVY)


@pytest.mark.parametrize(
    "name", ["Bank", "IMM", "Stations", "Track", "locate", "metrics", "models"]
)
def test_public_names(name):
    import imm_tdoa

    assert getattr(imm_tdoa, name) is not None


def test_an_unknown_name_is_an_attribute_error():
    import imm_tdoa

    with pytest.raises(AttributeError, match="has no attribute 'Immm'"):
        imm_tdoa.Immm  # noqa: B018

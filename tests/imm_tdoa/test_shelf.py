"""TOML files by name: which goes before which, and where a study's own are looked for."""

from __future__ import annotations

from pathlib import Path

import pytest

from imm_tdoa import bankfile, simulate, study
from imm_tdoa._shelf import Shelf

SHELF = Shelf("bank", "preset", "presets")


def test_every_shelf_has_what_its_folder_holds() -> None:
    root = Path(bankfile.__file__).parent
    for names, folder in (
        (bankfile.presets(), "presets"),
        (simulate.scenarios(), "simulate/scenarios"),
        (study.shipped(), "study/studies"),
    ):
        assert names == tuple(sorted(path.stem for path in (root / folder).glob("*.toml")))


def test_what_ships_goes_first_and_a_neighbour_before_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, beside = tmp_path / "here", tmp_path / "beside"
    for folder in (here, beside):
        folder.mkdir()
        for name in ("drone", "mine", "mine.toml"):
            (folder / name).write_text(f"# {folder.name}", "utf-8")
    monkeypatch.chdir(here)
    assert SHELF.find("drone").folder is None
    assert SHELF.find("drone").file == "drone.toml"
    assert SHELF.find("./drone").text == "# here"
    assert SHELF.find("mine") == ("# here", "mine", Path())
    assert SHELF.find("mine.toml", beside) == ("# beside", "mine.toml", beside)
    (beside / "mine.toml").unlink()
    assert SHELF.find("mine.toml", beside).text == "# here"
    assert SHELF.find(beside / "mine", here).text == "# beside"
    with pytest.raises(ValueError, match="bank: there is no file 'other'"):
        SHELF.find(Path("other"))

"""A study's folder: what it refuses, what it goes on from, what survives a full disk."""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from study_cases import contents, drafts, tiny

from imm_tdoa.study import Store, Study, run
from imm_tdoa.study.plan import differences


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What the small study comes to when nothing happens to it."""
    folder = tmp_path_factory.mktemp("whole")
    run(tiny(), folder, workers=1)
    return contents(folder)


def test_what_lies_there(tmp_path: Path) -> None:
    plan = tiny()
    store = run(plan, tmp_path, workers=1)
    assert not differences(store.study.table, plan.table)
    assert store.engines == ("numpy",) * 2
    for case in plan.scenarios:
        paths = store.chunks(case.name)
        assert [path.name[-12:] for path in paths] == [
            f"{first:08d}.npz" for first in (0, 6, 12, 18)
        ]
        runs = [store.load(path)["runs"].tolist() for path in paths]
        assert runs == [[0, 6], [6, 12], [12, 18], [18, 20]]
        assert [store.steps(path) for path in paths] == [30, 30, 30, 10]
        assert all(store.cost(path).shape == (2,) for path in paths)
        assert all(np.all(store.cost(path) > 0.0) for path in paths)
        bound = store.bound(case.name)
        assert bound["position_bound"].shape == bound["gdop"].shape == (case.scans,)
        assert np.all(np.isfinite(bound["position_bound"]))
        assert str(bound["reason"]) == ""
    assert not store.chunks("drive")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("seed = 4", "seed = 5"), "seed: was 4, is 5"),
        (("psd = 1.0 }]\n\n", "psd = 2.0 }]\n\n"), "banks[0].modes[0].psd: was 1.0, is 2.0"),
        (("30e-9", "40e-9"), "scenarios[0].scenario.noise.toa_sigma_s: was 3e-08, is 4e-08"),
        (("[1.0, 3.0]", "[1.0]"), "scenarios[0].sweep.noise_factor: was [1.0, 3.0], is [1.0]"),
        (("runs = 20", "runs = 10"), "runs: was 20, is 10"),
        (("chunk = 6", "chunk = 5"), "chunk: was 6, is 5"),
    ],
)
def test_another_study_is_refused(tmp_path: Path, change: tuple[str, str], message: str) -> None:
    store = Store(tmp_path)
    store.open(tiny())
    with pytest.raises(ValueError) as caught:
        run(tiny(change), tmp_path, workers=1)
    assert message in str(caught.value)
    assert "--restart" in str(caught.value)
    assert not differences(store.study.table, tiny().table)


def test_restart_deletes_what_a_study_wrote_and_nothing_else(tmp_path: Path) -> None:
    run(tiny(), tmp_path, workers=1)
    (tmp_path / "mine.txt").write_text("mine", "utf-8")
    other = tiny(("seed = 4", "seed = 5"), ("[1.0, 3.0]", "[2.0]"))
    store = run(other, tmp_path, workers=1, restart=True)
    assert (tmp_path / "mine.txt").read_text("utf-8") == "mine"
    assert len(list((tmp_path / "chunks").glob("*.npz"))) == 4
    assert store.study.seed == 5


def test_words_may_change_and_more_runs_go_on(tmp_path: Path, whole: dict[str, bytes]) -> None:
    told: list[int] = []
    run(tiny(("runs = 20", "runs = 14"), ("A small one", "Another")), tmp_path, workers=1)
    run(tiny(), tmp_path, workers=1, tell=lambda p: told.append(p.done))
    assert told[0] == 24  # two whole chunks of each scenario are kept, the broken one is not
    assert contents(tmp_path) == whole


@pytest.mark.parametrize("damage", ["truncated", "empty", "gone", "no cost", "other runs"])
def test_a_damaged_chunk_is_done_again(
    tmp_path: Path, damage: str, whole: dict[str, bytes]
) -> None:
    store = run(tiny(), tmp_path, workers=1)
    first, second = store.chunks("drive noise×1")[:2]
    if damage == "gone":
        first.unlink()
    elif damage == "no cost":
        first.with_name(f"{first.stem}-cost.json").unlink()
    elif damage == "other runs":
        first.write_bytes(second.read_bytes())
    else:
        first.write_bytes(first.read_bytes()[: 900 if damage == "truncated" else 0])
    told: list[int] = []
    run(tiny(), tmp_path, workers=1, tell=lambda p: told.append(p.done))
    assert told[:2] == [34, 40]
    assert contents(tmp_path) == whole


def test_drafts_of_a_killed_process_are_swept_up(tmp_path: Path, whole: dict[str, bytes]) -> None:
    Store(tmp_path).open(tiny())
    (tmp_path / "chunks" / ".draft-123-drive.npz").write_bytes(b"half")
    run(tiny(), tmp_path, workers=1)
    assert not drafts(tmp_path)
    assert contents(tmp_path) == whole


@pytest.mark.parametrize("room", [0, 1, 3, 7])
def test_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int, whole: dict[str, bytes]
) -> None:
    """The error is told, what was written is whole, and with room again the study goes on."""
    savez, count = np.savez, 0

    def full(file: Any, **arrays: Any) -> None:
        nonlocal count
        count += 1
        if count > room:
            file.write(b"PK half of a file")
            raise OSError(errno.ENOSPC, "No space left on device")
        savez(file, **arrays)

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space left") as caught:
        run(tiny(), tmp_path, workers=1)
    assert str(caught.value.filename).startswith(str(tmp_path / "chunks" / "drive_noise_"))
    assert not drafts(tmp_path)
    there = contents(tmp_path)
    assert len(there) == room
    assert there.items() <= whole.items()
    monkeypatch.setattr(np, "savez", savez)
    run(tiny(), tmp_path, workers=1)
    assert contents(tmp_path) == whole


def test_a_file_in_the_place_of_the_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("", "utf-8")
    with pytest.raises(ValueError, match=r"--out: expected a folder, .* is a file"):
        run(tiny(), tmp_path / "out")
    with pytest.raises(ValueError, match="holds no study"):
        _ = Store(tmp_path).study


def test_a_store_of_nothing_has_no_chunks(tmp_path: Path) -> None:
    plan: Study = tiny()
    store = Store(tmp_path / "nowhere")
    assert store.chunks("drive noise×1") == []
    assert store.missing(plan, plan.scenarios[0]) == plan.chunks(plan.scenarios[0])
    assert store.engines == ()

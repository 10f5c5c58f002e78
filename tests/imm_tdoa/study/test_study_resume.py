"""Killed at any moment, a study goes on and ends as if nothing had happened."""

from __future__ import annotations

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from study_cases import TEXT, contents, drafts, go, tiny

from imm_tdoa.study import Store, Study, run

KILLS = 20


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What the study comes to when nothing happens to it."""
    folder = tmp_path_factory.mktemp("whole")
    run(many(), folder, workers=1)
    return contents(folder)


def many() -> Study:
    """A smaller study with more chunks."""
    return tiny(("chunk = 6", "chunk = 1"), ("runs = 20", "runs = 8"))


def test_killed_twenty_times_it_is_the_same_to_the_last_bit(
    tmp_path: Path, whole: dict[str, bytes]
) -> None:
    """SIGKILL at random moments between the start of the work and what was its end."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pytest", "imm_tdoa.study", "imm_tdoa.models"])
    for folder in ("0", "1"):  # the first starts the server, too
        begun = time.perf_counter()
        process = context.Process(target=go, args=(many().text, str(tmp_path / folder)))
        process.start()
        process.join()
        once = time.perf_counter() - begun
    rng, killed, number = random.Random(1), 0, 2
    cut = []
    for _ in range(10 * KILLS):
        folder = tmp_path / str(number)
        process = context.Process(target=go, args=(many().text, str(folder)))
        process.start()
        process.join(rng.uniform(0.0, 0.7 * once))
        alive = process.exitcode is None
        process.kill()
        process.join()
        killed += alive
        cut.append(len(contents(folder)))
        assert contents(folder).items() <= whole.items()  # what is there is whole
        if not alive:
            assert contents(folder) == whole
            number += 1
        if killed == KILLS:
            break
    assert killed == KILLS
    assert sum(0 < n < len(whole) for n in cut) > 0  # some kills hit the work itself
    for folder in tmp_path.iterdir():
        run(many(), folder, workers=1)
        assert contents(folder) == whole
        assert not drafts(folder)


def ended(process: subprocess.Popen[str], number: signal.Signals) -> str:
    """Ask a process to end, as a person does: again, if nothing happens.

    Python drops an interruption that comes while it tidies up an object.
    """
    for _ in range(3):
        os.kill(process.pid, number)
        try:
            return process.communicate(timeout=15)[1]
        except subprocess.TimeoutExpired:
            continue
    process.kill()
    raise AssertionError(f"asked three times to end by {number!r}, it goes on")


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_asked_to_end_the_command_says_what_is_kept(
    tmp_path: Path, number: signal.Signals, code: int
) -> None:
    (tmp_path / "long.toml").write_text(TEXT.replace("runs = 20", "runs = 2700"), "utf-8")
    out = tmp_path / "out"
    command = [sys.executable, "-c", "import imm_tdoa.cli; imm_tdoa.cli.main()", "study"]
    arguments = [str(tmp_path / "long.toml"), "--out", str(out), "--workers", "1"]
    with subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        until = time.monotonic() + 60.0
        while len(Store(out).chunks("drive noise×1")) < 3 and time.monotonic() < until:
            time.sleep(0.02)
        said = ended(process, number)
    assert process.returncode == code, said
    assert "imm-tdoa: interrupted: " in said
    assert "of 900 chunks are kept in" in said
    assert "the same command goes on from there" in said
    assert "Traceback" not in said
    assert not drafts(out)

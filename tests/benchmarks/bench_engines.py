"""Speed, by pytest-benchmark (extra ``bench``); no test asserts a time.

These files are not collected unless they are named:

    pytest -n 0 tests/benchmarks/bench_*.py --benchmark-autosave --benchmark-compare

keeps the figures in ``.benchmarks`` and shows them beside those of the last time. `imm-tdoa bench`
is the larger programme, with goals.
"""

from __future__ import annotations

import pytest

from imm_tdoa.bench import jobs, peers, small, streaming


@pytest.mark.benchmark(group="batch of 1024 targets, 20 scans")
@pytest.mark.parametrize("keep", ["final", "all"])
@pytest.mark.parametrize("threads", [1, 2])
def test_batch_compiled(benchmark, keep, threads):
    job = jobs.job(1024, 20)
    track = benchmark(lambda: job.run(engine="compiled", keep=keep, threads=threads))
    assert track.engine == "compiled"


@pytest.mark.benchmark(group="batch of 1024 targets, 20 scans")
def test_batch_numpy(benchmark):
    job = jobs.job(1024, 20)
    assert benchmark(lambda: job.run(engine="numpy")).engine == "numpy"


@pytest.mark.benchmark(group="batch of 1024 targets, 20 scans, robust")
@pytest.mark.parametrize("robust", ["gate", "student-t"])
def test_batch_robust(benchmark, robust):
    job = jobs.job(1024, 20, robust=robust)
    benchmark(lambda: job.run(engine="compiled", keep="final", threads=1))


@pytest.mark.benchmark(group="batch of 1024 targets, 20 scans, by modes")
@pytest.mark.parametrize("modes", [1, 2, 3, 6])
def test_modes(benchmark, modes):
    job = jobs.job(1024, 20, modes=modes)
    benchmark(lambda: job.run(engine="compiled", keep="final", threads=1))


@pytest.mark.benchmark(group="batch of 1024 targets, 20 scans, by stations")
@pytest.mark.parametrize("stations", [3, 4, 8, 16])
def test_stations(benchmark, stations):
    job = jobs.job(1024, 20, stations=stations)
    benchmark(lambda: job.run(engine="compiled", keep="final", threads=1))


@pytest.mark.benchmark(group="Source A's run")
def test_source_a(benchmark):
    job = small.source_a()
    benchmark(lambda: job.run(engine="compiled", threads=1))


@pytest.mark.benchmark(group="one pair at a time, 3000 differences in 3-D")
def test_single_rows(benchmark):
    job = jobs.one_pair_at_a_time(3000)
    benchmark(lambda: job.run(engine="compiled"))


@pytest.mark.benchmark(group="one target, 100 scans")
def test_stream_compiled(benchmark):
    job = jobs.job(1, 100)
    job.imm.compile()
    benchmark(lambda: streaming.stream(job, "compiled"))


@pytest.mark.benchmark(group="one target, 100 scans")
@pytest.mark.parametrize("member", peers.MEMBERS)
def test_stream_filterpy(benchmark, member):
    job = jobs.job(1, 100)
    benchmark(lambda: peers.follow(job, 1, member))


@pytest.mark.benchmark(group="one target, 100 scans, one model")
def test_stream_stone_soup(benchmark):
    pytest.importorskip("stonesoup", reason="Stone Soup is not installed (extra 'bench')")
    job = jobs.job(1, 100, modes=1)
    peer = peers.StoneSoup(job, jobs.MODES[1][1]["psd"])
    benchmark(lambda: peer.follow(1))

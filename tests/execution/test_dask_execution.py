"""Tasks on a Dask cluster: as on local processes, and what only a cluster can do to them."""

from __future__ import annotations

import contextlib
import os
import random
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import click
import executed_tasks as functions
import pytest
from click.testing import CliRunner
from places import ROOT, SUPPORT
from waiting import LONG_S, wait_for

from benchmarks.cases import JsonResults, collect
from thermoforce_mpc.cli.options import execution_options
from thermoforce_mpc.errors import ConfigError, EngineError
from thermoforce_mpc.execution import DaskEngine, LocalEngine, Task, cluster, execute, open_engine
from thermoforce_mpc.execution.cluster import Patience

pytest.importorskip("distributed", reason="needs the extra [fleet]: pip install distributed")


@pytest.fixture(scope="module")
def dask_cluster():
    """Two workers of one thread, each a process that a nanny starts again."""
    import dask
    from distributed import LocalCluster

    # A busy machine may take longer than the default of 15 s to start a worker again; then it would not be any more.
    patient = {"distributed.deploy.lost-worker-timeout": "1h"}
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0, **patient}),
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0", silence_logs=60) as made,
    ):
        yield made.scheduler_address


@pytest.fixture
def engine(dask_cluster):
    from distributed import Client

    with Client(dask_cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=LONG_S)  # a test before may have killed one
    with DaskEngine(dask_cluster) as made:
        yield made


def task(n: int, folder: Path, function=functions.total, needs=(), **inputs) -> Task:
    return Task(f"key{n}", f"task {n}", function, {"n": n, "log": str(folder / "log"), **inputs}, tuple(needs))


def stored(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow
def test_a_worker_that_is_killed_costs_no_result(engine, tmp_path):
    """The same bytes as local processes give undisturbed, each task done once."""
    local, dask = JsonResults(tmp_path / "local"), JsonResults(tmp_path / "dask")
    (tmp_path / "calm").mkdir()

    def tasks(folder: Path, function) -> list[Task]:
        first, calm = task(0, folder), functions.total
        # It dies half a second after it began: what its worker did before is known at the scheduler by then.
        second = task(2, folder, function, needs=(first,), times=1, seconds=0.5)
        return [second if n == 2 else task(n, folder, calm, needs=(first,), times=1) for n in range(1, 5)]

    with LocalEngine(1) as calm:
        list(execute(tasks(tmp_path / "calm", functions.total), calm, local))
    outcomes = list(execute(tasks(tmp_path, functions.die_at_first), engine, dask))
    assert stored(dask.folder) == stored(local.folder)
    assert {o.task.key: o.attempts for o in outcomes}["key2"] == 2
    assert sorted(functions.begun(tmp_path / "log")) == ["0", "1", "2", "2", "3", "4"]
    assert all(o.attempts == 0 for o in execute(tasks(tmp_path, functions.die), engine, dask))


@pytest.mark.slow
def test_a_worker_that_is_lost_is_mentioned_while_others_work(dask_cluster, engine, tmp_path):
    said: list[str] = []
    with DaskEngine(dask_cluster, patience=Patience(look_s=0.2), say=said.append) as telling:
        tasks = [task(1, tmp_path, functions.die_at_first, times=1), *(task(n, tmp_path, seconds=0.4) for n in (2, 3))]
        assert len(list(execute(tasks, telling))) == 3
    assert re.fullmatch(rf"Dask scheduler {dask_cluster}: \d workers?", said[0])
    lines = [line for line in said if "gone" in line]
    assert len(lines) == 1
    assert re.match(r"1 worker gone \(tcp://[^,]*\), \d workers? left; what was under way there is begun", lines[0])


@pytest.mark.slow
def test_a_poisoned_task_is_left_out_and_the_others_are_done(engine, tmp_path):
    tasks = [task(1, tmp_path, functions.die), *(task(n, tmp_path) for n in range(2, 6))]
    outcomes = {o.task.key: o for o in execute(tasks, engine)}
    assert [key for key, o in outcomes.items() if o.poisoned] == ["key1"]
    assert [outcomes[f"key{n}"].value for n in range(2, 6)] == [2, 3, 4, 5]
    began = functions.begun(tmp_path / "log")
    assert sorted(began) == ["1", "1", "1", "2", "3", "4", "5"]
    assert began[-1] == "1", "again only after the rest"


@pytest.mark.slow
def test_a_task_tells_how_far_it_is_and_can_be_ended(engine, tmp_path):
    shares = []

    class Watcher:
        planned = begun = ended = staticmethod(lambda of: None)
        told = staticmethod(lambda task, share: shares.append(share))

    collect([Task("t", "t", functions.tell_all, {})], engine, watcher=Watcher)
    assert shares
    outcomes = execute([task(1, tmp_path, functions.tell_for_ever), task(2, tmp_path)], engine)
    assert next(outcomes).task.key == "key2"
    outcomes.close()
    wait_for("the task ends", (tmp_path / "released").exists)


def test_a_worker_of_another_version_is_refused(dask_cluster, engine, monkeypatch):
    here = cluster.environment()
    monkeypatch.setattr(cluster, "environment", lambda: here | {"casadi": "0.1"})
    with pytest.raises(ConfigError, match=r"worker tcp://.* has casadi .* instead of 0\.1"):
        open_engine(scheduler=dask_cluster)
    with pytest.raises(EngineError, match=r"instead of 0\.1"):  # as of a worker that came later
        collect([Task("t", "t", functions.threads, {})], engine)


@pytest.mark.slow
@pytest.mark.parametrize(("threads", "omp"), [(2, "1"), (1, "4")])
def test_a_worker_that_does_not_fit_and_comes_later_gets_no_tasks(dask_cluster, tmp_path, threads, omp):
    """Others do what it was given; who opens a cluster that has it is refused."""
    said: list[str] = []
    with DaskEngine(dask_cluster, patience=Patience(look_s=0.2), warn=said.append) as engine:
        late = _dask("worker", dask_cluster, "--nthreads", str(threads), OMP_NUM_THREADS=omp)
        try:
            wait_for("the third worker is there", lambda: _workers(dask_cluster) == 3)
            outcomes = list(execute([task(n, tmp_path, seconds=0.2) for n in range(12)], engine))
            with pytest.raises(ConfigError, match=f"computes on {threads} threads"):
                DaskEngine(dask_cluster)
        finally:
            late.kill()
            late.wait()
            wait_for("it is gone", lambda: _workers(dask_cluster) == 2)
    assert sorted(outcome.value for outcome in outcomes) == list(range(12))
    assert [line for line in said if "gone" not in line] == [next(line for line in said if "gets no tasks" in line)]
    assert re.search(rf"worker tcp://\S+ computes on {threads} threads with OMP_NUM_THREADS '{omp}'", said[0])


def test_a_scheduler_that_does_not_answer_is_refused(monkeypatch):
    patience, before = Patience(connect_s=0.5), _loops()
    with socket.socket() as mute:  # bound, so that nobody else gets the port, and not listening
        mute.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{mute.getsockname()[1]}"
        with pytest.raises(ConfigError, match=f"{address}: no Dask scheduler answers"):
            DaskEngine(address, patience=patience)
    with pytest.raises(ConfigError, match="nowhere"):
        DaskEngine("what://nowhere", patience=patience)
    wait_for("no client's thread is left", lambda: _loops() <= before)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"extra \[fleet\]"):
        open_engine(scheduler=address)


def test_the_address_of_a_worker_is_refused(dask_cluster, engine):
    from distributed import Client

    with Client(dask_cluster, set_as_default=False) as client:
        workers = client.scheduler_info(n_workers=-1)["workers"]
    worker, nanny = next((address, of["nanny"]) for address, of in workers.items())
    for address, kind in ((worker, "worker"), (nanny, "nanny")):
        with pytest.raises(ConfigError, match=f"{address}: no Dask scheduler answers .* the address of a {kind}"):
            open_engine(scheduler=address)


@pytest.mark.slow
def test_a_port_that_accepts_and_stays_silent_is_refused():
    """The limit of the connection alone does not end it, and no signal did."""
    before = _loops()
    with _silent(0) as port, _within(5.0), pytest.raises(ConfigError, match=r"no Dask scheduler answers .* 0\.5 s"):
        DaskEngine(f"tcp://127.0.0.1:{port}", patience=Patience(connect_s=0.5))
    ended = signal.signal(signal.SIGALRM, _interrupt)
    try:
        with _silent(0) as port, _within(5.0):
            signal.setitimer(signal.ITIMER_REAL, 0.3)
            with pytest.raises(KeyboardInterrupt):
                DaskEngine(f"tcp://127.0.0.1:{port}", patience=Patience(connect_s=60.0))
    finally:
        signal.signal(signal.SIGALRM, ended)
    wait_for("no client's thread is left", lambda: _loops() <= before)


@pytest.mark.slow
def test_why_nothing_goes_on_is_told_on_stderr_also_where_all_else_is_silent(monkeypatch):
    from distributed import LocalCluster

    impatient = partial(DaskEngine, patience=Patience(look_s=0.05, repeat_s=0.1))
    monkeypatch.setattr(cluster, "DaskEngine", impatient)
    ended = signal.signal(signal.SIGALRM, _interrupt)

    @click.command
    @execution_options()
    def command(engine):
        with engine(lambda line: None) as where:
            signal.setitimer(signal.ITIMER_REAL, 1.0, 1.0)  # again: one that comes in a callback of the client is lost
            try:
                where.wait()
            finally:
                signal.setitimer(signal.ITIMER_REAL, 0.0)

    try:
        with LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=60) as made:
            done = CliRunner().invoke(command, ["--scheduler", made.scheduler_address])
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, ended)
    assert done.stderr.count(f"no worker is connected to {made.scheduler_address}; waiting for one") > 1
    assert done.stdout == ""


@pytest.mark.slow
def test_a_silent_port_in_the_place_of_the_scheduler_is_not_waited_for_without_end():
    port, said, warned = _free_port(), [], []
    scheduler = _dask("scheduler", "--port", str(port), "--no-dashboard")
    try:
        patience = Patience(connect_s=LONG_S, back_s=2.0)  # until it has started, and for its return
        with DaskEngine(f"tcp://127.0.0.1:{port}", patience=patience, say=said.append, warn=warned.append) as engine:
            scheduler.kill()
            scheduler.wait()
            with _silent(port), _within(60.0), pytest.raises(EngineError, match="did not come back in 2 s"):
                engine.wait()
    finally:
        scheduler.kill()
        scheduler.wait()
    assert any("is gone; waiting 2 s" in line for line in warned)
    assert said == [f"Dask scheduler tcp://127.0.0.1:{port}: 0 workers"]


@pytest.mark.slow
def test_a_scheduler_that_stands_still_is_asked_no_longer_than_its_return_is_waited_for():
    port, patience = _free_port(), Patience(connect_s=LONG_S, back_s=2.0, look_s=0.0)
    scheduler = _dask("scheduler", "--port", str(port), "--no-dashboard")
    try:
        with DaskEngine(f"tcp://127.0.0.1:{port}", patience=patience) as engine, _within(60.0):
            scheduler.send_signal(signal.SIGSTOP)
            assert engine.width == 0
            scheduler.send_signal(signal.SIGCONT)
    finally:
        scheduler.kill()
        scheduler.wait()


@pytest.mark.slow
def test_a_scheduler_may_restart(tmp_path):
    """Workers without a nanny end with their scheduler; others take over, and nothing that had ended runs again."""
    port = _free_port()
    address = f"tcp://127.0.0.1:{port}"
    tasks = [task(n, tmp_path, seconds=0.0 if n < 2 else 1.0) for n in range(5)]
    kept = JsonResults(tmp_path / "kept")
    said: list[str] = []
    running = [_dask("scheduler", "--port", str(port), "--no-dashboard"), _dask("worker", address, "--nthreads", "1")]
    try:
        _wait_for_worker(address)
        with DaskEngine(address, say=said.append) as engine:
            ended = []
            for outcome in execute(tasks, engine, kept):
                ended.append(outcome)
                if len(ended) == 2:
                    running[0].kill()
                    running[0].wait()
                    running.append(_dask("scheduler", "--port", str(port), "--no-dashboard"))
                    running.append(_dask("worker", address, "--nthreads", "1"))
    finally:
        for process in running:
            process.kill()
            process.wait()
    assert sorted(o.value for o in ended) == [0, 1, 2, 3, 4]
    began = functions.begun(tmp_path / "log")
    assert [began.count(str(o.value)) for o in ended[:2]] == [1, 1]
    assert any("is gone; waiting" in line for line in said)
    assert any("is back" in line for line in said)


def _dask(*words: str, **variables: str) -> subprocess.Popen[bytes]:
    more = ["--no-nanny"] if words[0] == "worker" else []
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)])}
    call = [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1", *more]
    return subprocess.Popen(call, env={**env, "OMP_NUM_THREADS": "1", **variables}, stderr=subprocess.DEVNULL)


def _wait_for_worker(address: str) -> None:
    """The scheduler has one worker, of one thread."""
    from distributed import Client

    with Client(address, timeout=LONG_S, set_as_default=False) as client:
        wait_for("the worker is there", lambda: list(client.nthreads().values()) == [1])


def _workers(address: str) -> int:
    from distributed import Client

    with Client(address, timeout=LONG_S, set_as_default=False) as client:
        return len(client.nthreads())


@contextlib.contextmanager
def _silent(port: int) -> Iterator[int]:
    """A port that accepts and says nothing for 90 s, and then hangs up, so that who waits without end fails."""
    with socket.socket() as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind(("127.0.0.1", port))
        made.listen()
        hangs_up = threading.Timer(90.0, made.close)
        hangs_up.start()
        try:
            yield made.getsockname()[1]
        finally:
            hangs_up.cancel()


@contextlib.contextmanager
def _within(seconds: float) -> Iterator[None]:
    began = time.monotonic()
    yield
    assert time.monotonic() - began < seconds


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _loops() -> set[threading.Thread]:
    """Threads of Dask's clients and clusters; its other threads come and go."""
    return {thread for thread in threading.enumerate() if thread.name.startswith("IO loop")}


def _free_port() -> int:
    """A port that nobody listens on, outside the range from which the system takes those of connections."""
    for port in random.Random(os.getpid()).sample(range(20_000, 32_000), 1000):
        with contextlib.suppress(OSError), socket.socket() as made:
            made.bind(("127.0.0.1", port))
            return port
    raise AssertionError

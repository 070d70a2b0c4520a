"""Tasks on local processes: each once, in the order of their needs, whatever happens to the processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import executed_tasks as functions
import pytest
from places import ROOT, SUPPORT
from waiting import LONG_S, wait_for

from benchmarks.cases import JsonResults, TaskFailed, collect
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import LocalEngine, Task, TaskOutcome, execute, local
from thermoforce_mpc.execution.execute import Begun


class Watched:
    """Keeps what a watcher is told."""

    def __init__(self) -> None:
        self.n, self.shares, self.outcomes = 0, [], []

    def planned(self, n: int) -> None:
        self.n = n

    def begun(self, task: Task) -> None:
        pass

    def told(self, task: Task, share: float) -> None:
        self.shares.append(share)

    def ended(self, outcome: TaskOutcome) -> None:
        self.outcomes.append(outcome)


@pytest.fixture
def log(tmp_path) -> Path:
    return tmp_path / "log"


@pytest.fixture(scope="module")
def engine():
    with LocalEngine(2) as made:
        yield made


def task(n: int, log: Path, function=functions.total, needs=(), **inputs) -> Task:
    return Task(f"key{n}", f"task {n}", function, {"n": n, "log": str(log), **inputs}, tuple(needs))


def stored(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_needs_come_first_each_once_and_are_handed_on(engine, log):
    first, second = task(1, log), task(2, log)
    both = [task(n, log, needs=(first, second)) for n in (10, 20)]
    last = task(100, log, needs=both)
    outcomes = {outcome.task.key: outcome for outcome in execute([last, both[0]], engine)}
    assert outcomes["key100"].value == 100 + (10 + 3) + (20 + 3)
    order = functions.begun(log)
    assert sorted(order) == sorted(["1", "2", "10", "20", "100"])
    assert set(order[:2]) == {"1", "2"}
    assert order[-1] == "100"


def test_a_failure_is_not_repeated_and_takes_only_its_dependants_with_it(engine, log):
    bad = task(1, log, functions.refuse)
    after, beyond = task(2, log, needs=(bad,)), task(4, log, needs=(task(3, log, needs=(bad,)),))
    outcomes = {o.task.key: o for o in execute([bad, after, beyond, task(5, log)], engine)}
    assert outcomes["key1"].reason == "no draws of heat in these data"
    assert outcomes["key1"].error is DataError
    for key in ("key2", "key4"):
        assert "no draws of heat" in outcomes[key].reason
        assert outcomes[key].attempts == 0
    assert outcomes["key5"].value == 5
    assert sorted(functions.begun(log)) == ["1", "5"]


def test_an_unexpected_error_says_where(engine):
    with pytest.raises(TaskFailed, match=r"(?s)ratio: ZeroDivisionError.*executed_tasks.py"):
        collect([Task("k", "ratio", functions.divide, {"n": 0})], engine)
    with pytest.raises(DataError, match="no draws"):
        collect([Task("k", "data", functions.refuse, {"n": 0, "log": os.devnull})], engine)


def test_what_cannot_travel_is_a_failure_with_a_name(engine):
    local = Task("a", "a", lambda inputs: 1, {})
    back = Task("b", "b", functions.unsendable, {})
    reasons = {o.task.key: o.reason for o in execute([local, back, Task("c", "c", functions.process_id, {})], engine)}
    assert "cannot be sent to a worker" in reasons["a"]
    assert "unsendable" in reasons["b"]
    assert reasons["c"] == ""


def test_results_are_kept_as_they_come_and_nothing_is_run_twice(engine, log, tmp_path):
    results = JsonResults(tmp_path / "kept")
    tasks = [task(n, log, needs=(task(0, log),)) for n in (1, 2, 3)]
    for outcome in execute(tasks, engine, results):
        assert results.get(outcome.task) == outcome.value
    (tmp_path / "kept" / "key3.json").unlink()
    again = {o.task.key: o for o in execute(tasks, engine, results)}
    assert [again[f"key{n}"].attempts for n in (1, 2, 3)] == [0, 0, 1], "only what is missing, by the need that is kept"
    assert "key0" not in again
    assert all(o.attempts == 0 for o in execute(tasks, engine, results))
    assert sorted(functions.begun(log)) == ["0", "1", "2", "3", "3"]


@pytest.mark.slow
def test_a_worker_that_dies_costs_no_result(engine, log, tmp_path):
    """A task whose process is killed by SIGKILL half-way is begun again; the results are the same bytes."""
    calm, rough = JsonResults(tmp_path / "calm"), JsonResults(tmp_path / "rough")
    list(execute([task(n, tmp_path / "calm_log") for n in range(6)], engine, calm))
    tasks = [task(n, log, functions.die_at_first if n in (1, 4) else functions.total, times=2) for n in range(6)]
    outcomes = {o.task.key: o for o in execute(tasks, engine, rough)}
    assert stored(rough.folder) == stored(calm.folder)
    assert [outcomes[f"key{n}"].attempts for n in range(6)] == [1, 3, 1, 1, 3, 1], "no neighbour is begun again"


def test_a_process_killed_while_idle_costs_nothing(log):
    with LocalEngine(1) as engine:
        (pid,) = collect([Task("a", "a", functions.process_id, {})], engine)
        os.kill(pid, signal.SIGKILL)
        (other,) = collect([Task("b", "b", functions.process_id, {})], engine)
    assert other != pid


@pytest.mark.slow
def test_a_poisoned_task_is_left_out_and_the_others_are_done(engine, log):
    bad = task(1, log, functions.die)
    tasks = [bad, *(task(n, log) for n in (2, 3, 4)), task(5, log, needs=(bad,))]
    outcomes = {o.task.key: o for o in execute(tasks, engine)}
    assert [key for key, o in outcomes.items() if o.poisoned] == ["key1"]
    assert "each of 3 attempts (signal SIGKILL)" in outcomes["key1"].reason
    assert "task 1" in outcomes["key5"].reason
    assert [outcomes[f"key{n}"].value for n in (2, 3, 4)] == [2, 3, 4]
    began = functions.begun(log)
    assert began.count("1") == 3
    assert began[-2:] == ["1", "1"], "again only after the rest, alone"


def test_processes_are_used_again_and_compute_on_one_thread(engine):
    tasks = [Task(f"k{n}", "pid", functions.process_id, {}) for n in range(6)]
    assert len(set(collect(tasks, engine))) <= 2
    assert collect([Task("t", "t", functions.threads, {})], engine) == [["1", "1"]]


@pytest.mark.slow
def test_a_task_tells_how_far_it_is(engine):
    watched = Watched()
    collect([Task("t", "t", functions.tell_all, {})], engine, watcher=watched)
    assert watched.n == 1
    assert watched.shares
    assert all(0 < share <= 1 for share in watched.shares)
    assert [o.reason for o in watched.outcomes] == [""]


@pytest.mark.slow
def test_what_is_under_way_is_ended_and_released_when_nobody_wants_more(log):
    engine = LocalEngine(1, leave_s=LONG_S)
    engine.submit("k", "k", functions_payload(log))
    assert engine.wait() == Begun("k")
    wait_for("the task begins", lambda: functions.begun(log))
    engine.cancel()
    assert (log.parent / "released").exists(), "SIGTERM came first"
    assert engine.room == 1
    assert collect([Task("p", "p", functions.process_id, {})], engine)
    engine.__exit__()


def functions_payload(log: Path) -> bytes:
    from thermoforce_mpc.execution.execute import payload_of

    return payload_of(functions.hold, {"n": 0, "log": str(log)}, ())


@pytest.mark.slow
def test_an_interrupt_while_a_task_is_handed_over_ends_its_worker(tmp_path, log, monkeypatch):
    def interrupted(key):
        wait_for("the task begins", lambda: "1" in functions.begun(log))
        raise KeyboardInterrupt

    monkeypatch.setattr(local, "Begun", interrupted)  # which is told as soon as the process has its task
    with LocalEngine(1, leave_s=LONG_S) as engine:
        with pytest.raises(KeyboardInterrupt):
            list(execute([task(1, log, functions.hold)], engine))
        assert (tmp_path / "released").exists()
        assert engine.room == 1


_CAMPAIGN = """
import signal
import sys
from pathlib import Path
import executed_tasks as functions
from benchmarks.cases import JsonResults
from thermoforce_mpc.execution import LocalEngine, Task, execute

if __name__ == "__main__":
    # A shell ignores it for what it starts in the background, and that is inherited.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder, hold = Path(sys.argv[1]), sys.argv[2] == "hold"
    log = str(folder / "log")
    tasks = [Task(f"key{n}", f"task {n}", functions.total, {"n": n, "log": log}) for n in range(3)]
    last = functions.hold if hold else functions.total
    tasks.append(Task("key3", "task 3", last, {"n": 3, "log": log}))
    try:
        with LocalEngine(1, leave_s=120.0) as engine:
            for outcome in execute(tasks, engine, JsonResults(folder / "kept")):
                print(outcome.task.key, outcome.attempts, flush=True)
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.slow
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_campaign_is_taken_up(tmp_path, sent):
    """Ctrl-C ends the workers by SIGTERM and keeps what was finished; SIGKILL of the whole does so too."""
    script, log = tmp_path / "campaign.py", tmp_path / "log"
    script.write_text(_CAMPAIGN, encoding="utf-8")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)])}
    call = [sys.executable, str(script), str(tmp_path)]
    running = subprocess.Popen([*call, "hold"], env=env, stdout=subprocess.PIPE)
    try:
        wait_for("the last task begins", lambda: "3" in functions.begun(log) or running.poll() is not None)
        running.send_signal(sent)
        code = running.wait(LONG_S)
    finally:
        running.kill()
        running.stdout.close()
    assert code == (130 if sent == signal.SIGINT else -signal.SIGKILL)
    wait_for("no worker outlives its parent", (tmp_path / "released").exists)
    told = subprocess.run([*call, "on"], env=env, capture_output=True, text=True, timeout=LONG_S, check=True).stdout
    assert told.split() == ["key0", "0", "key1", "0", "key2", "0", "key3", "1"]


_UNGUARDED = """
from pathlib import Path
import executed_tasks as functions
from benchmarks.cases import JsonResults
from thermoforce_mpc.execution import LocalEngine, Task, execute

with open("begun", "a") as file:
    file.write(".")
tasks = [Task(f"key{n}", f"task {n}", functions.total, {"n": n, "log": "log"}) for n in range(8)]
with LocalEngine(1) as engine:
    list(execute(tasks, engine, JsonResults(Path("kept"))))
"""


@pytest.mark.slow
def test_a_program_that_starts_processes_as_it_is_imported_is_told_so_once(tmp_path):
    script = tmp_path / "campaign.py"
    script.write_text(_UNGUARDED, encoding="utf-8")
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(SUPPORT)])}
    ended = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        timeout=LONG_S,
        check=False,
    )
    assert ended.returncode == 1
    assert ended.stderr.splitlines()[-1].startswith(
        "thermoforce_mpc.errors.EngineError: task 'key0': its process ended"
    )
    assert ended.stderr.count("EngineError: a process that is being started would start processes in turn") == 1
    assert (tmp_path / "begun").read_text(encoding="utf-8") == ".."


class EndsWhoeverReadsIt:
    """By a signal, as it is unpickled."""

    def __init__(self, number: int) -> None:
        self.number = number

    def __reduce__(self):
        return signal.raise_signal, (self.number,)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "told"), [(signal.SIGTERM, "its process ended as it started"), (signal.SIGKILL, "")]
)
def test_what_is_left_of_a_process_that_ends_as_it_starts_is_ended_by_its_pool(number, told):
    """By SIGTERM, which is no reason to start another one; SIGKILL is that of a machine short of memory."""
    process = local.OneProcess(print, EndsWhoeverReadsIt(number))
    with pytest.raises(BrokenProcessPool):
        process.submit(abs, -1).result(LONG_S)
    assert process.never_began()[:31] == told

"""`tf-mpc compare --scheduler`: the records of a cluster whose worker is killed are those of undisturbed processes."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner
from here import Here
from simple_house import simple_model

from thermoforce_mpc.cli import cli
from thermoforce_mpc.comparison.store import Identified, Store
from thermoforce_mpc.comparison.tasks import tasks_of
from thermoforce_mpc.errors import ConfigError, StorageError
from thermoforce_mpc.execution import DaskEngine, cluster
from thermoforce_mpc.execution.cluster import Patience

TESTCASE = "bestest_hydronic_heat_pump"
CALL = ("compare", "--testcase", TESTCASE, "--controllers", "native,thermostat", "--windows", "44", "--days", "0.25")
PRICES = ("--prices", "highly_dynamic", "--tariff-file", "prices.csv")


def records(folder: Path) -> dict[str, dict]:
    found = {path.name: json.loads(path.read_text(encoding="utf-8")) for path in (folder / "runs").rglob("*.json")}
    return {name: {key: of[key] for key in of if key != "seconds"} for name, of in found.items()}


@pytest.mark.slow
def test_a_killed_worker_changes_no_record(tmp_path, monkeypatch):
    """Nor does it matter that workers have no such file as the tariff."""
    pytest.importorskip("distributed", reason="needs the extra [fleet]: pip install distributed")
    import dask
    from distributed import Client, LocalCluster

    # A busy machine may take longer than the default of 15 s to start a worker again; then it would not be any more.
    patient = dask.config.set({"distributed.deploy.lost-worker-timeout": "1h"})
    options = {"threads_per_worker": 1, "dashboard_address": ":0", "silence_logs": 60}
    with patient, LocalCluster(n_workers=2, **options) as made, Client(made, set_as_default=False) as client:
        monkeypatch.chdir(tmp_path)
        (tmp_path / "prices.csv").write_text("time,price\n0,0.1\n43200,0.3\n31536000,0.2\n", encoding="utf-8")
        with monkeypatch.context() as patch:
            patch.setattr("thermoforce_mpc.execution.open_engine", lambda *_, **options: Here())
            here = CliRunner().invoke(cli, [*CALL, *PRICES, "--jobs", "1", "--out", str(tmp_path / "here")])
        assert here.exit_code == 0, here.output
        killed = []

        def kill_a_busy_worker() -> None:
            while not killed:
                for nanny in made.workers.values():
                    if client.processing().get(nanny.worker_address):
                        killed.append(nanny.pid)
                        os.kill(nanny.pid, signal.SIGKILL)
                        return
                time.sleep(0.05)

        killing = threading.Thread(target=kill_a_busy_worker, daemon=True)
        killing.start()
        words = ("--scheduler", made.scheduler_address, "--out", str(tmp_path / "there"))
        there = CliRunner().invoke(cli, [*CALL, *PRICES, *words])
        killing.join(1.0)
    assert there.exit_code == 0, there.output
    assert killed
    assert f"Dask scheduler {made.scheduler_address}: 2 workers" in there.output
    assert records(tmp_path / "there") == records(tmp_path / "here")
    words = ("--scheduler", "tcp://nowhere:1", "--out", str(tmp_path / "there"))
    again = CliRunner().invoke(cli, [*CALL, *PRICES, *words])
    assert again.exit_code == 0, "nothing is left to run, so nobody is asked"


@pytest.mark.slow
def test_a_cluster_that_cannot_be_used_leaves_no_folder_and_a_folder_that_cannot_be_made_no_run(tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="needs the extra [fleet]: pip install distributed")
    monkeypatch.setattr(cluster, "DaskEngine", partial(DaskEngine, patience=Patience(connect_s=0.3)))
    (tmp_path / "file").touch()
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "buildings: [{generated: {seed: 5, count: 1}}]\nwindows: [44]\ndays: 0.25\nreference: native\n"
        "variants: {native: {controller: native}}\n"
    )
    for call in (CALL, ("fleet", str(fleet))):
        for out, options, error in (
            (tmp_path / "out", ("--scheduler", "tcp://127.0.0.1:1"), ConfigError),
            (tmp_path / "file" / "out", ("--jobs", "1"), StorageError),
        ):
            done = CliRunner().invoke(cli, [*call, *options, "--out", str(out)])
            assert isinstance(done.exception, error), done.output
            assert "started" not in done.output
    assert {path.name for path in tmp_path.iterdir()} == {"file", "fleet.yaml"}


def test_an_identification_is_kept_whole_or_as_the_reason_why_there_is_none(tmp_path):
    from thermoforce_mpc.comparison.cells import Variant, expand
    from thermoforce_mpc.scenario.scenario import Scenario

    cells = expand(
        Scenario(testcase=TESTCASE), {"v": Variant(controller="rc_mpc")}, ["44", "45"], ["constant", "dynamic"]
    )
    tasks = tasks_of(cells)
    needs = {need.key: need for task in tasks for need in task.needs}
    assert len(tasks) == 4
    assert len(needs) == 2, "tariffs learn together"
    store, (first, second) = Store(tmp_path), needs.values()
    store.create()
    for need in (first, second):
        with pytest.raises(KeyError):
            store.get(need)
    model = Identified.of(simple_model())
    store.put(first, model)
    store.put(second, Identified(refused="too short"))
    assert store.get(first) == model
    assert store.get(second) == Identified(refused="too short")
    store.put(second, Identified(refused="too short"))
    store.put(first, model)
    assert sorted(path.name for path in (tmp_path / "models").glob("*/*")) == sorted(needs)
    # What is damaged does not count, and is replaced, be it by what is of the other kind.
    (store.model_path(first.key) / "model.json").write_bytes(b"")
    store.model_path(second.key).write_bytes(b"")
    for need in (first, second):
        with pytest.raises(KeyError):
            store.get(need)
    store.put(first, Identified(refused="too short"))
    store.put(second, model)
    assert (store.get(first), store.get(second)) == (Identified(refused="too short"), model)

"""Many independent tasks on the cores of this machine or on a Dask cluster: one layer for everything that is many."""

from thermoforce_mpc.execution.cluster import DaskEngine, open_engine
from thermoforce_mpc.execution.execute import Engine, Results, Task, TaskOutcome, Watcher, execute, tell
from thermoforce_mpc.execution.keys import content_key, source_fingerprint
from thermoforce_mpc.execution.local import LocalEngine
from thermoforce_mpc.execution.progress import TaskProgress

__all__ = [
    "DaskEngine",
    "Engine",
    "LocalEngine",
    "Results",
    "Task",
    "TaskOutcome",
    "TaskProgress",
    "Watcher",
    "content_key",
    "execute",
    "open_engine",
    "source_fingerprint",
    "tell",
]

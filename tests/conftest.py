"""Fixtures shared by all tests."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import cache, partial
from importlib import import_module
from pathlib import Path

# Bytecode is kept also where the environment says not to: without it every process of the run compiles all sources, and
# every worker rewrites all tests, half a minute of a core. Before the imports below, which are kept too.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest  # noqa: E402
from here import Here  # noqa: E402
from hypothesis import HealthCheck, settings  # noqa: E402
from places import SHARED  # noqa: E402

# A shell that runs tests in the background has interrupts ignored, which processes inherit: those that tests interrupt
# would go on.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# One thread per process: the processes of pytest-xdist use all cores. Read when torch is imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# Compiled functions are kept from run to run, by their sources. Read when numba is imported.
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(__file__).parents[1] / ".pytest_cache" / "compiled"))

# A million objects are there when all tests are collected. Walking over them took 6 of the 19 s of a core of the first
# collecting, 2 s where they were compiled before (2026-11-28).
gc.set_threshold(50_000, 20, 20)

TESTS = Path(__file__).parent

# Every run tries the same examples, and none fails for being slow on a busy machine. To look for new ones:
# `--hypothesis-profile=default`.
settings.register_profile(
    "same", derandomize=True, database=None, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """One more than cores, unless the environment says how many: many tests wait, for deadlines and for services."""
    return None if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ else len(os.sched_getaffinity(0)) + 1


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Files that load torch (`later`) go to one process, as one file: each that runs any of them waits for it."""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # the order is that of `pytest_collection_modifyitems`

    class ByWhatIsLoaded(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            file = super()._split_scope(nodeid)
            return "torch" if needs_torch(config.rootpath / file) else file

    return ByWhatIsLoaded(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Where processes share the tests, files with most slow ones begin, and small ones are left to end with.

    A long file that begins last keeps one process busy while the others have nothing left.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
        all_of = Counter(item.path for item in items)
        items.sort(key=lambda item: (not needs_torch(item.path), -slow[item.path], -all_of[item.path]))


@cache
def needs_torch(file: Path) -> bool:
    return "\nfrom later import " in file.read_text()


@pytest.hookimpl(wrapper=True, trylast=True)
def pytest_collection(session: pytest.Session) -> Iterator[None]:
    """Of tests that nobody has compiled, each process of a whole run compiles its own part, and finds the others'."""
    number = os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")
    if [Path(folder).resolve() for folder in session.config.args] == [TESTS]:
        files = sorted(TESTS.rglob("test_*.py"))
        first = int(number) * len(files) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 1))
        for file in files[first:] if first else ():
            sys.path.insert(0, str(file.parent))  # as pytest does
            with suppress(Exception, pytest.skip.Exception):  # which pytest meets again, and tells
                import_module(file.stem)
    return (yield)


def pytest_collection_finish() -> None:
    """What was imported and collected stays until the end: the collector need not look at it again."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def own_folders(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What is built is kept in a folder of the run, not among the user's; so are logs of Stable-Baselines3."""
    run = tmp_path_factory.getbasetemp().parent
    os.environ |= {"XDG_CACHE_HOME": str(run / "cache"), "SB3_LOGDIR": str(run / "agents")}


@pytest.fixture
def computed_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks of commands run in this process: a new one imports everything first, for seconds."""
    monkeypatch.setattr("thermoforce_mpc.execution.open_engine", lambda *_, **options: Here())


@pytest.fixture(scope="module")
def identified_once() -> Iterator[None]:
    """What tests of a module identify alike is identified once; what differs in anything is identified anew."""
    from remembered import remember_identification

    with pytest.MonkeyPatch.context() as patch:
        remember_identification(patch)
        yield


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A service that is away is asked again at once: pauses are asked for and not slept."""
    from boptest_client import TransportConfig

    for place in ("boptest_client", "boptest_client.client"):
        monkeypatch.setattr(f"{place}.TransportConfig", partial(TransportConfig, sleep=lambda seconds: None))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Reference data kept beside the project, where a developer has it; tests that need it skip where it is absent."""
    if not (SHARED / "boptest_hp").is_dir():
        pytest.skip(f"reference data not found at {SHARED}")
    return SHARED

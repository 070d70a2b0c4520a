"""Functions that tests let workers execute; `log` counts how often they were begun."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from thermoforce_mpc.errors import DataError
from thermoforce_mpc.execution import tell


def total(inputs: dict, *results: int) -> int:
    _log(inputs)
    time.sleep(inputs.get("seconds", 0.0))
    return inputs["n"] + sum(results)


def refuse(inputs: dict, *results: int) -> int:
    _log(inputs)
    raise DataError("no draws of heat in these data")


def divide(inputs: dict) -> float:
    return 1 / inputs["n"]


def die(inputs: dict, *results: int) -> int:
    _log(inputs)
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def die_at_first(inputs: dict, *results: int) -> int:
    began = _log(inputs)
    if began < inputs["times"]:
        time.sleep(inputs.get("seconds", 0.0))
        os.kill(os.getpid(), signal.SIGKILL)
    return inputs["n"] + sum(results)


def die_once_for(what: object, grave: str) -> object:
    """`what`, but that the first process to ask for it dies, and makes the file `grave`."""
    try:
        Path(grave).touch(exist_ok=False)
    except FileExistsError:
        return what
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError


def hold(inputs: dict) -> int:
    """Hold something for long, and say when it was released."""
    try:
        _log(inputs)  # who sees it may end this at once
        time.sleep(600)
    finally:
        time.sleep(0.2)
        (Path(inputs["log"]).parent / "released").write_text("released", encoding="utf-8")
    return 0


def tell_all(inputs: dict) -> int:
    for n in range(4):
        time.sleep(0.3)
        tell((n + 1) / 4)
    return 0


def tell_for_ever(inputs: dict) -> int:
    """As `hold`, where a cluster can reach it."""
    try:
        while True:
            time.sleep(0.1)
            tell(0.5)
    finally:
        (Path(inputs["log"]).parent / "released").write_text("released", encoding="utf-8")


def threads(inputs: dict) -> list[str | None]:
    return [os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")]


def process_id(inputs: dict) -> int:
    return os.getpid()


def unsendable(inputs: dict) -> object:
    return lambda: None


def identified_at_once(*inputs: object) -> object:
    """In the place of an identification: a model that needs no time."""
    from simple_house import simple_model  # others need none of it

    from thermoforce_mpc.comparison.store import Identified

    return Identified.of(simple_model())


def begun(log: Path | str) -> list[str]:
    """Names of the tasks in the order of their beginnings."""
    return Path(log).read_text(encoding="utf-8").split() if Path(log).exists() else []


def _log(inputs: dict) -> int:
    """Note a beginning; returns how many there were of this task before."""
    before = begun(inputs["log"]).count(str(inputs["n"]))
    with open(inputs["log"], "a", encoding="utf-8") as file:
        file.write(f"{inputs['n']}\n")
    return before

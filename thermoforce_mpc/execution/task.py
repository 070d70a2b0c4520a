"""What is executed, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from thermoforce_mpc.errors import ThermoForceError


@dataclass(frozen=True)
class Task:
    """One pure computation, `function(inputs, *results_of_needs)`.

    `function` is found by name in another process, or on another machine; it writes no files, so that running it twice
    does no harm. `key` is the address of the result, the same wherever the same would be computed: by `content_key`,
    or by the caller's own hash of all inputs. `title` names the task for people. A task whose result is stored needs
    none of its `needs`.
    """

    key: str
    title: str
    function: Callable[..., Any]
    inputs: Any
    needs: tuple[Task, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """The end of a task: its `value`, or the `reason` why there is none (empty on success).

    `seconds`: computing time. `attempts`: how often it was begun; 0 if its result was stored, or if a need of it
    failed. `poisoned`: its worker died at every attempt. `error`: the kind of the error that the function raised.
    `details`: the traceback of an unexpected error.
    """

    task: Task
    value: Any = None
    reason: str = ""
    seconds: float = 0.0
    attempts: int = 0
    poisoned: bool = False
    error: type[ThermoForceError] | None = None
    details: str = ""

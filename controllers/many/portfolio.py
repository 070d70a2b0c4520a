"""Many buildings planned at one instant, on all cores: `plan_many`, and `Portfolio` to do it again and again.

Solvers and much of a forecast hold the interpreter's lock, so cores are used by processes. Each has buildings of its
own, whose controllers it keeps and whose forecasts it makes together.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from types import TracebackType

from controllers.checks import ControllerConfigError, message_of
from controllers.many.batch import AT_A_TIME, BatchPlanner, Planned, PlanRequest, buildings_of
from controllers.many.worker import Answer, PlanningProcess, Plans
from controllers.mpc.config import MPCConfig
from thermoforce_mpc.data import Observation
from thermoforce_mpc.errors import DataError, check_kind
from thermoforce_mpc.execution.local import refuse_while_starting
from thermoforce_mpc.model.thermal_model import ThermalModel


def plan_many(
    models: Mapping[str, ThermalModel],
    observations: Mapping[str, Observation],
    states: Mapping[str, object] | None = None,
    *,
    config: MPCConfig | Mapping[str, MPCConfig] | None = None,
    workers: int = 1,
) -> dict[str, Planned]:
    """Plan for many buildings at one instant; to do it again, keep a `Portfolio` (this builds all controllers anew).

    Bad data, a failed solve or a model that is not competent cost the building itself its plan, with the reason.

    Args:
        models: the identified model of each building, by name.
        observations: record and forecast of each building to plan for, by name.
        states: `Planned.state` of each building's last plan; a building that is not named begins a run.
        config: options of all controllers, or of each building by name.
        workers: processes to plan in; 1: this one.

    Raises:
        ControllerConfigError: `workers` is no number of processes, `config` names a building without a model, or what
            is given for a building is no model or no options.
        DataError: what is given is no observation, or not by name.
        EngineError: `workers` is above 1 in a process that is itself being started.
    """
    with Portfolio(models, config, workers=workers) as portfolio:
        return portfolio.plan(observations, states)


class Portfolio:
    """Controllers of many buildings, and the processes they run in; a context manager.

    It keeps no state of a run: the same input gives the same plans. `deadline_s` may be changed between plans.
    """

    def __init__(
        self,
        models: Mapping[str, ThermalModel],
        config: MPCConfig | Mapping[str, MPCConfig] | None = None,
        *,
        workers: int = 1,
        grace_s: float = 300.0,
        deadline_s: float = 300.0,
    ) -> None:
        """Name the buildings. Controllers are built, and processes started, when they are first needed.

        Arguments and errors are those of `plan_many`. `grace_s`: how long a plan stays valid after its step while the
        next one is late, s. `deadline_s`: longest time of `plan`, s; a process that has not answered by then is ended,
        and its buildings are left to their own controllers. Without processes of its own there is no such limit.
        """
        is_integer = isinstance(workers, int) and not isinstance(workers, bool)
        if not is_integer or workers < 1 or not 0.0 <= grace_s < math.inf or not deadline_s > 0.0:
            raise ControllerConfigError(
                f"workers {workers!r}, grace_s {grace_s:g}, deadline_s {deadline_s:g}: expected one process or more, a "
                "grace of 0 or more that ends, and a deadline above 0"
            )
        buildings = buildings_of(models, config)
        self._here = BatchPlanner(buildings, grace_s)
        self.deadline_s = deadline_s
        names, workers = list(buildings), min(workers, max(1, len(buildings)))
        if workers > 1:
            refuse_while_starting()
        shares = [{name: buildings[name] for name in names[i::workers]} for i in range(workers)] if workers > 1 else []
        self._workers = [PlanningProcess(share, grace_s) for share in shares]
        self._worker_of = {name: worker for worker, share in zip(self._workers, shares, strict=True) for name in share}

    def __enter__(self) -> Portfolio:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End the processes."""
        for worker in self._workers:
            worker.end()

    def plan(
        self, observations: Mapping[str, Observation], states: Mapping[str, object] | None = None
    ) -> dict[str, Planned]:
        """See `plan_many`; raises `DataError` where what is given is no observation."""
        check_kind(observations, Mapping, "observations", "give them by the name of the building")
        check_kind(states or {}, Mapping, "states", "give `Planned.state` by the name of the building")
        for name, observation in observations.items():
            if not isinstance(observation, Observation):
                raise DataError(f"building '{name}': a {type(observation).__name__} is no Observation")
        states = states or {}
        requests = [(name, observation, states.get(name)) for name, observation in observations.items()]
        if not self._workers:
            return dict(self._here.plans(requests))
        until_s = time.monotonic() + self.deadline_s
        of_worker: dict[PlanningProcess, list[PlanRequest]] = {worker: [] for worker in self._workers}
        for request in requests:
            of_worker[self._worker_of.get(request[0], self._workers[0])].append(request)
        longest = max(len(own_requests) for own_requests in of_worker.values())
        submitted = [
            (worker, batch, _submit(worker, batch))
            for i in range(0, longest, AT_A_TIME)
            for worker, own_requests in of_worker.items()
            if (batch := own_requests[i : i + AT_A_TIME])
        ]
        plans = dict(
            request for worker, batch, future in submitted for request in self._collect(worker, batch, future, until_s)
        )
        return {name: plans[name] for name in observations}

    def _collect(
        self, worker: PlanningProcess, requests: list[PlanRequest], future: Future[Answer], until_s: float
    ) -> Plans:
        """Plans of some buildings of a process; where there are none, it is asked again for ever fewer of them."""
        try:
            return worker.plans(future.result(max(0.0, until_s - time.monotonic())))
        except TimeoutError:
            worker.end()
        except Exception as error:
            if isinstance(error, BrokenProcessPool) and (reason := worker.never_began()):
                return self._without_plan(requests, reason)
            if time.monotonic() < until_s:
                # Whether one of them ended the process is not known; that one cannot be sent or read is.
                batches = [requests] if isinstance(error, BrokenProcessPool) else _halves(requests)
                return [plan for batch in batches for plan in self._retry(worker, batch, until_s)]
        return self._without_plan(requests, f"no plan within {self.deadline_s:g} s")

    def _retry(self, worker: PlanningProcess, requests: list[PlanRequest], until_s: float) -> Plans:
        left_s = until_s - time.monotonic()
        try:
            if left_s <= 0.0:
                raise TimeoutError
            return worker.plans(_submit(worker, requests).result(left_s))
        except TimeoutError:
            worker.end()
            return self._without_plan(requests, f"no plan within {self.deadline_s:g} s, after its process failed")
        except BrokenProcessPool:
            reason = "its process died while planning it"
        except Exception as error:  # likewise
            reason = message_of(error)
        if len(requests) == 1:
            return self._without_plan(requests, reason)
        return [plan for batch in _halves(requests) for plan in self._retry(worker, batch, until_s)]

    def _without_plan(self, requests: list[PlanRequest], reason: str) -> Plans:
        return [
            (name, self._here.without_plan(name, observation, reason, state)) for name, observation, state in requests
        ]


def _submit(worker: PlanningProcess, requests: list[PlanRequest]) -> Future[Answer]:
    """The answer to come of a process, or the error of what cannot be sent to it."""
    try:
        return worker.submit(requests)
    except Exception as error:  # whatever pickling a state or an observation raises
        failed: Future[Answer] = Future()
        failed.set_exception(error)
        return failed


def _halves(requests: list[PlanRequest]) -> list[list[PlanRequest]]:
    middle = (len(requests) + 1) // 2
    return [half for half in (requests[:middle], requests[middle:]) if half]

"""What tests of a module compute alike is computed once: the same arguments give the same answer."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any

import numpy as np
import pytest

import thermoforce_mpc
from thermoforce_mpc.data import Array, Period
from thermoforce_mpc.experiment import identifying, measured_model
from thermoforce_mpc.identification import pipeline
from thermoforce_mpc.identification.network import estimate, lag, sensor
from thermoforce_mpc.identification.network.estimate import RoomRun
from thermoforce_mpc.identification.network.room import RoomNetwork
from thermoforce_mpc.identification.probing import operation
from thermoforce_mpc.plants.testcases import load_testcase
from thermoforce_mpc.protocols import Plant
from thermoforce_mpc.scenario.testcase import TestCase


def remembered(function: Callable[..., Any], key: Callable[..., Any]) -> Callable[..., Any]:
    """The function, called once for each value of `key` of its arguments; every caller gets a copy of its own."""
    answers: dict[bytes, bytes] = {}

    @wraps(function)
    def answer(*args: Any, **options: Any) -> Any:
        asked = pickle.dumps(key(*args, **options))
        if asked not in answers:
            answers[asked] = pickle.dumps(function(*args, **options))
        return pickle.loads(answers[asked])

    return answer


def _told(*args: Any, progress: object = None, **options: Any) -> object:
    return args, sorted(options.items())


def _probed(plant: Plant, *, before: Period, testcase: TestCase | None = None, **options: Any) -> object:
    named = testcase or load_testcase("bestest_hydronic_heat_pump")
    return plant.info, before.start_s, before.warmup_s, named.model_dump_json(), sorted(options.items())


def _sought(room: RoomNetwork, runs: Sequence[RoomRun], start: Array, spread: Array | None = None) -> object:
    """By value: what they worked out already is kept in them too."""
    given = [[_of_array(value) for value in vars(run).values()] for run in runs]
    return [getattr(room, one.name) for one in fields(room)], given, _of_array(start), _of_array(spread)


def _of_array(value: object) -> object:
    return (value.shape, value.tobytes()) if isinstance(value, np.ndarray) else value


def remember_identification(patch: pytest.MonkeyPatch) -> None:
    """Data that were identified once with some options are not identified with them again.

    With others, which say nothing of the network, it is not searched again from where it was.
    """
    once = remembered(pipeline.identify, _told)
    for users in (thermoforce_mpc, pipeline, measured_model, operation):
        patch.setattr(users, "identify", once)
    found = remembered(estimate.searched, _sought)
    for users in (estimate, lag, sensor):
        patch.setattr(users, "searched", found)


def remember_probing(patch: pytest.MonkeyPatch) -> None:
    """A plant that was probed once before a period is not probed again, and is left as it was."""
    patch.setattr(identifying, "identify_on", remembered(identifying.identify_on, _probed))

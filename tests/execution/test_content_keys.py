"""Equal inputs have equal keys, different ones have not."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import executed_tasks as functions
import numpy as np
import pytest
from pydantic import BaseModel

from thermoforce_mpc.execution import content_key
from thermoforce_mpc.execution.keys import canonical


class Colour(Enum):
    RED = 1


@dataclass(frozen=True)
class One:
    a: object


@dataclass(frozen=True)
class Other:
    a: object


class Model(BaseModel):
    a: float


DIFFERENT = [
    None,
    1,
    1.5,
    float("nan"),
    "1",
    "nan",
    b"1",
    [1],
    [[1]],
    {"a": 1},
    {"a": [1]},
    One(1),
    Other(1),
    One(One(1)),
    Model(a=1),
    Path("1"),
    Colour.RED,
    np.array([1]),
    np.array([1.0]),
    np.array([[1.0]]),
    np.array([1.0, 2.0]),
]


def test_different_inputs_have_different_keys():
    keys = [content_key(functions.total, value) for value in DIFFERENT]
    assert len(set(keys)) == len(keys)
    assert keys == [content_key(functions.total, value) for value in DIFFERENT]


def test_the_order_of_names_and_of_memory_plays_no_part():
    assert content_key(functions.total, {"a": 1, "b": 2}) == content_key(functions.total, {"b": 2, "a": 1})
    grid = np.arange(6.0).reshape(2, 3)
    assert content_key(functions.total, grid) == content_key(functions.total, np.asfortranarray(grid))


def test_function_and_source_are_in_the_key():
    assert content_key(functions.total, 1) != content_key(functions.divide, 1)
    assert content_key(functions.total, 1) != content_key(functions.total, 1, source="other")


def test_what_has_no_plain_content_is_refused():
    with pytest.raises(TypeError, match="plain data"):
        canonical({"a": object()})
    with pytest.raises(TypeError, match="numbers"):
        canonical(np.array([object()]))
    with pytest.raises(TypeError, match="plain data"):
        canonical({1: 2})
    with pytest.raises(TypeError, match="only a function of a module"):
        content_key(lambda inputs: 1, 1)

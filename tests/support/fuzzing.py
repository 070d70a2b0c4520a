"""Hostile input for the fuzz tests: valid files mutated, and JSON values of any kind.

Every run tries the same examples, a few of each; `FUZZ_EXAMPLES=5000 python -m pytest tests/fuzz` goes the long way.
"""

from __future__ import annotations

import datetime
import math
import os
from collections.abc import Callable
from typing import Any, TypeVar

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st


def fuzz(examples: int) -> settings:
    """Settings of a fuzz test; an example that takes 20 s, however slow the machine, counts as one without an end."""
    return settings(
        max_examples=int(os.environ.get("FUZZ_EXAMPLES", examples)),
        derandomize=True,
        database=None,
        deadline=datetime.timedelta(seconds=20),
        suppress_health_check=list(HealthCheck),
    )


Result = TypeVar("Result")


def result_or_error(
    kind: type[Exception], act: Callable[[], Result], *, names: str = "", most: int = 1500
) -> Result | None:
    """What `act` returns; None after an error of this kind, whose text must be of moderate length and name `names`."""
    try:
        return act()
    except kind as error:
        said = str(error)
    assert names in said
    assert len(said) < most
    return None


_NASTY = [
    b"", b"\x00", b"\xff\xfe", b"\n", b"\r", b",", b'"', b"-", b"nan", b"inf", b"1e999", b"-1e308", b"9" * 400,
    b"[" * 2000, b"{", b"}", b"&a *a", b"!!python/object/apply:os.system", b": ", b"true", b"\xe2\x80\xa8",
]  # fmt: skip
_ODD = [
    None, True, False, 0, 1, -1, 2**31, 2**63, 10**400, 0.5, -0.0, 1e308, -1e308, 5e-324, math.nan, math.inf, "", "nan",
    "true", "\x00", "\u0663", "\ud800", "x" * 3000, "../x", [], [[]], [None], ["x"] * 50, [1, "x"], {}, {"": 0},
    {"x": []},
]  # fmt: skip

# Drawn from a generator of its own: hypothesis itself prefers small and repeated choices, which leaves few examples.
_RANDOM = st.randoms(use_true_random=True)

VALUES = st.sampled_from(_ODD)
"""Values that JSON can hold, and Python's further ones."""


@st.composite
def mutated(draw: Any, content: bytes, most: int = 3) -> bytes:
    """`content` with up to `most` pieces cut out, replaced, inserted or repeated."""
    random = draw(_RANDOM)
    for _ in range(random.randint(1, most)):
        start = random.randint(0, len(content))
        stop = min(len(content), start + random.choice([0, 1, 1, 2, 8, 64, 1000, len(content)]))
        piece = random.choice([*_NASTY, content[start:stop] * 2, random.randbytes(random.randint(1, 8))])
        content = content[:start] + piece + content[stop:]
    return content


def paths(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of keys and indices to every value within `value`."""
    if isinstance(value, dict):
        below = list(value.items())
    else:
        below = list(enumerate(value)) if isinstance(value, list) else []
    return [path] + [found for key, one in below for found in paths(one, (*path, key))]


@st.composite
def tampered(draw: Any, document: Any, most: int = 2) -> Any:
    """A copy of a JSON document with up to `most` of its values replaced, removed, or taken from elsewhere in it."""
    random = draw(_RANDOM)
    for _ in range(random.randint(1, most)):
        where = random.choice(paths(document)[1:] or [()])
        elsewhere = _at(document, random.choice(paths(document)))
        document = _with(document, where, random.choice([*_ODD, elsewhere]), removed=random.random() < 0.1)
    return document


def _at(value: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        value = value[key]
    return value


def _with(value: Any, path: tuple[Any, ...], other: Any, *, removed: bool) -> Any:
    if not path:
        return other
    copy = dict(value) if isinstance(value, dict) else list(value)
    if removed and len(path) == 1:
        del copy[path[0]]
    else:
        copy[path[0]] = _with(copy[path[0]], path[1:], other, removed=removed)
    return copy

"""Functions and classes of the user's own, named as `path/to/file.py:name`; a path from the working directory."""

from __future__ import annotations

import importlib.util
import sys
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from thermoforce_mpc.errors import InputError


def is_own_code(name: str) -> bool:
    """Whether `name` is that of something in a file of the user's."""
    return ".py:" in name


def is_policy(name: str) -> bool:
    """Whether `name` is that of a trained policy's file."""
    return name.endswith(".zip")


def policy_settings(name: str) -> Path:
    """The file of a policy's settings, beside it."""
    return Path(name).with_suffix(".json")


def code_file(name: str) -> str | None:
    """The file whose code a controller or KPI of this `name` runs; a trained policy is unpickled."""
    if is_own_code(name):
        return name.rpartition(":")[0]
    return name if is_policy(name) else None


def own_code(where: str, key: str, error: Callable[[str], InputError]) -> Any:
    """What stands in a file under a name, as it was at the file's last change.

    Args:
        where: `path/to/file.py:name`.
        key: key or option that it was given by, for messages.
        error: raised where there is none.

    Raises:
        InputError: `error`: the file cannot be read or raises, or holds no such name; says why.
    """
    file, _, name = where.rpartition(":")
    path = Path(file)
    if path.suffix != ".py" or not name:
        raise error(f"{key}: {where!r}: expected path/to/file.py:name")
    if not path.is_file():
        raise error(f"{key}: {where!r}: no such file in {Path.cwd()}")
    content = _content(path.resolve(), path.stat().st_mtime_ns, key, error)
    if not callable(content.get(name)):
        own = {key: value for key, value in content.items() if callable(value) and not key.startswith("_")}
        public = [key for key, value in own.items() if getattr(value, "__module__", "") == content["__name__"]]
        raise error(f"{key}: {path} has no {name!r}; it has {', '.join(public) or 'nothing that can be called'}")
    return content[name]


@cache
def _content(path: Path, changed_ns: int, key: str, error: Callable[[str], InputError]) -> dict[str, Any]:
    """Names of a file as it was at its last change."""
    spec = importlib.util.spec_from_file_location(f"own_code_{path.stem}", path)
    assert spec is not None  # of a file that exists
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses and pickle look for it
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as problem:  # whatever the file raises
        at = line_in(str(path), problem)
        raise error(f"{key}: {path}{at} raised {type(problem).__name__}: {problem}") from problem
    return vars(module)


def line_in(file: str | None, error: BaseException) -> str:
    """', line N': the last line of `file` that led to an error; '' where none did."""
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
    return f", line {lines[-1]}" if lines else ""

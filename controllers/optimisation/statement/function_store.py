"""Functions of structures on disk, in the user's cache folder: text with its hash, rebuilt where anything differs."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca

import thermoforce_mpc.model.operator.casadi_export as export
from controllers.optimisation.statement.structure import Structure
from thermoforce_mpc.data.cache import cache_folder

# Files kept.
_MOST = 120


@cache
def _sources() -> str:
    """What decides how a structure is built: the text of this room and of the operator, and the version of CasADi."""
    files = [*sorted(Path(__file__).parent.glob("*.py")), Path(export.__file__)]
    return "".join(file.read_text() for file in files) + version("casadi")


def stored(
    s: Structure, name: str, build: Callable[[], tuple[dict[str, Any], list[ca.Function]]]
) -> tuple[dict[str, Any], list[ca.Function]]:
    """Facts and functions of a structure as they were saved, or else built and saved.

    Functions of the user (`terms`) may have changed: with them nothing is saved.
    """
    if s.terms:
        return build()
    key = hashlib.sha256(f"{_sources()}{s}".encode()).hexdigest()
    try:
        file = cache_folder() / "plans" / f"{key[:32]}.{name}"
    except RuntimeError:  # who runs this has no home
        return build()
    found = _load(file)
    if found is None:
        found = build()
        _save(file, *found)
    return found


def _load(file: Path) -> tuple[dict[str, Any], list[ca.Function]] | None:
    """What a file holds; None where there is none, or it is not as it was written."""
    try:
        sha256, text = file.read_text().split("\n", 1)
        if hashlib.sha256(text.encode()).hexdigest() != sha256:
            return None
        facts, texts = json.loads(text)
        facts = {name: tuple(value) if isinstance(value, list) else value for name, value in facts.items()}
        return facts, [ca.Function.deserialize(function) for function in texts]
    except (OSError, ValueError, RuntimeError):
        return None


def _save(file: Path, facts: Mapping[str, Any], functions: Sequence[ca.Function]) -> None:
    """Save them; without a word where the folder cannot be written."""
    text = json.dumps([dict(facts), [function.serialize() for function in functions]])
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=file.parent, delete=False) as temporary:
            temporary.write(f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")
        Path(temporary.name).replace(file)
        for path in sorted(file.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-_MOST]:
            path.unlink(missing_ok=True)
    except OSError:
        pass

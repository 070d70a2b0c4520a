"""Functions of structures on disk, in the user's cache folder: text with its hash, rebuilt where anything differs."""

from __future__ import annotations

import hashlib
import inspect
import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca

import thermoforce_mpc.model.operator.casadi_export as export
from controllers.optimisation import algebra, statement, terms
from controllers.optimisation.structure import Structure
from thermoforce_mpc.data.cache_folder import cache_folder

# Structures kept on disk.
_MOST = 60
_NAMES = ("local", "check", "rows")


@cache
def _sources() -> str:
    """What decides how a structure is built: the text of the statement, and the version of CasADi."""
    return "".join(inspect.getsource(module) for module in (algebra, statement, terms, export)) + version("casadi")


def _folder(s: Structure) -> Path:
    key = hashlib.sha256(f"{_sources()}{s}".encode()).hexdigest()
    return cache_folder() / "plans" / key[:32]


def load(s: Structure) -> tuple[dict[str, Any], list[ca.Function]] | None:
    """What was saved of a structure; None where nothing was, or it is not as it was written."""
    if s.terms:  # functions of the user, whose text may have changed
        return None
    try:
        folder = _folder(s)
        meta = json.loads((folder / "variables.json").read_text())
        texts = {name: (folder / f"{name}.casadi").read_text() for name in _NAMES}
        if meta["sha256"] != _hashes(meta["variables"], texts):
            return None
        variables = {name: tuple(v) if isinstance(v, list) else v for name, v in meta["variables"].items()}
        return variables, [ca.Function.deserialize(text) for text in texts.values()]
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        return None


def save(s: Structure, variables: Mapping[str, Any], functions: Sequence[ca.Function]) -> None:
    """Save a structure's functions in the place of damaged ones; without a word where the folder cannot be written."""
    if s.terms:
        return
    try:
        folder, texts = _folder(s), {function.name(): function.serialize() for function in functions}
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=folder.parent) as temporary:
            whole = Path(temporary) / "whole"
            whole.mkdir()
            for name, text in texts.items():
                (whole / f"{name}.casadi").write_text(text)
            meta = {"variables": dict(variables), "sha256": _hashes(dict(variables), texts)}
            (whole / "variables.json").write_text(json.dumps(meta))
            shutil.rmtree(folder, ignore_errors=True)
            whole.replace(folder)
        oldest = sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-_MOST]
        for path in oldest:
            shutil.rmtree(path, ignore_errors=True)
    except OSError:
        pass


def _hashes(variables: dict[str, Any], texts: Mapping[str, str]) -> dict[str, str]:
    parts = {"variables": json.dumps(variables), **texts}
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in parts.items()}

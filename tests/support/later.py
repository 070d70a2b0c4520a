"""Modules that load slowly, loaded when a test first asks for something of them.

All processes of a run collect all tests. The files that import these run in one of them: `tests/conftest.py`.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Later:
    """A module by its name; `ImportError` where it is first used and not there."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("_"):  # what pytest looks for in all that a test file names
            raise AttributeError(attribute)
        return getattr(import_module(self._name), attribute)


torch = Later("torch")
safetensors_torch = Later("safetensors.torch")
torch_operator = Later("benchmarks.operator.torch_operator")

"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# One thread per process: the processes of pytest-xdist are as many as the cores. Read when torch is imported.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """Reference data kept beside the project, where a developer has it; tests that need it skip where it is absent."""
    folder = ROOT.parent / "shared"
    if not (folder / "boptest_hp").is_dir():
        pytest.skip(f"reference data not found at {folder}")
    return folder

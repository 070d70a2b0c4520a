"""Fixtures shared by all tests."""

from __future__ import annotations

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """Reference data kept beside the project, where a developer has it; tests that need it skip where it is absent."""
    folder = ROOT.parent / "shared"
    if not (folder / "boptest_hp").is_dir():
        pytest.skip(f"reference data not found at {folder}")
    return folder

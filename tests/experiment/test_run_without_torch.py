"""A run with the shipped forecaster loads neither torch nor the libraries of the models."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

_CODE = """
import sys
from thermoforce_mpc.cli import main
try:
    main()
except SystemExit as done:
    assert not done.code, done.code
loaded = {"torch", "transformers", "chronos"} & set(sys.modules)
assert "onnxruntime" in sys.modules
assert not loaded, f"loaded: {loaded}"
"""


@pytest.mark.slow
def test_a_run_with_the_default_controller_loads_no_torch(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _CODE, "run", "--testcase", "bestest_hydronic_heat_pump", "--days", "0.05"]
    command += ["--baselines", "", "--out", str(tmp_path / "run")]
    command += ["--set", "identification.days=1.5", "--set", "identification.most_days=1.5"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "thermoforce_mpc" in done.stdout

"""A run's manifest proves by hashes before and after that the forecaster stayed as it was, or that it did not."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest
from forecasting import boundary_of, history_of, hours

from thermoforce_mpc.experiment.run_models import frozen_proof, weight_hash
from thermoforce_mpc.model.free_response.registry import build_free_response


@pytest.mark.parametrize(
    ("name", "options"), [("chronos", {}), ("residual", {"calibrate": False}), ("residual", {"calibrate": True})]
)
def test_hashes_before_and_after_are_equal_unless_a_weight_changed(
    name: str, options: dict[str, bool], bolt_folder: Path
) -> None:
    import torch

    free_response = build_free_response(name, backbone=str(bolt_folder), **options)
    controller = SimpleNamespace(predictor=SimpleNamespace(free_responses=(free_response, free_response)))
    before = weight_hash(controller)
    assert before is not None
    free = 15 + 2 * (hours(200) % 24 > 12)
    free_response.forecast(free, history_of(free), boundary_of(200, 24))
    assert frozen_proof(controller, before) == {"weights_before": before, "weights_after": before, "frozen": True}
    inner = free_response
    while not hasattr(inner, "modules"):
        inner = inner.inner if hasattr(inner, "inner") else inner.backbone
    with torch.no_grad():
        next(inner.modules[0].parameters())[0] += 1e-3
    assert frozen_proof(controller, before)["frozen"] is False


def test_a_rule_has_no_weights_to_prove() -> None:
    assert weight_hash(SimpleNamespace()) is None
    assert frozen_proof(SimpleNamespace(), None) == {}

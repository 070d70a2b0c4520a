"""Competence gate: a controller does not act on a model that is below the bar (docs/how-it-works/competence.md)."""

from __future__ import annotations

from pydantic import Field

from thermoforce_mpc.model.competence import Competence
from thermoforce_mpc.scenario.settings import StrictModel


class GateConfig(StrictModel):
    """Options of the competence gate."""

    enabled: bool = Field(True, description="do not act on a model whose held-out data condemn it")


def shut(config: GateConfig, competence: Competence | None) -> str | None:
    """Return why a controller must not act on a model of this verdict; None where it may, or was not judged."""
    if not config.enabled or competence is None or competence.competent:
        return None
    return f"gate: the model is {competence.in_words()}"

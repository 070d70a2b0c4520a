"""A zone model scaled to what was measured of it: a watch that stands back tries one for the return of control."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from thermoforce_mpc.model.operator.certificate import certificate
from thermoforce_mpc.model.thermal_model import ZoneModel

GAIN_BOUNDS = (0.3, 3.0)
"""Limits of gain and heat, as factors of the identified ones."""


@dataclass(frozen=True)
class ScaledModel:
    """The `model` in use; its gain and the heat of its machine are `gain` and `heat` times the identified ones."""

    model: ZoneModel
    gain: float = 1.0
    heat: float = 1.0

    @property
    def factors(self) -> tuple[float, float]:
        """All of what `model` differs in from the identified one."""
        return self.gain, self.heat

    @property
    def adapted(self) -> bool:
        """Whether `model` is another than the identified one."""
        return self.factors != (1.0, 1.0)


def scaled(identified: ZoneModel, gain: float, heat: float, n_steps: int) -> ScaledModel | None:
    """The identified model with other factors, within `GAIN_BOUNDS`; None if not certified over `n_steps` steps.

    Where heat is not modelled, `heat` has no effect.
    """
    gain, heat = (float(np.clip(factor, *GAIN_BOUNDS)) for factor in (gain, heat))
    operator = replace(identified.operator, gains=gain * identified.operator.gains)
    law = operator.heat_input.law
    if law is not None:
        # The heat of v = 1 scales with the machine, and the gain per v with it.
        c0, c1, c2, c3 = (heat * c for c in law.coefficients)
        weaker = replace(law, coefficients=(c0, c1, c2, c3))
        operator = replace(operator, heat_input=operator.heat_input.with_law(weaker), gains=operator.gains * heat)
    if not certificate(operator, n_steps).certified:
        return None
    return ScaledModel(replace(identified, operator=operator), gain, heat)

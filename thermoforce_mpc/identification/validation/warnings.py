"""What a user should know of a model before trusting it, besides the verdict: nothing here is a reason to refuse it."""

from __future__ import annotations

from collections.abc import Mapping

from thermoforce_mpc.model.machine.power import PowerModel

# Relative standard deviation of the answer after a day from which a model is called uncertain.
_UNCERTAIN = 0.15
# Share of the variance of measured power that level and weather explain at least where a meter has no other load; 0.44
# was seen with hot water on the meter.
_LEAST_EXPLAINED = 0.7


def uncertain(certainty: Mapping[str, float]) -> list[str]:
    """That the effect of a day of action is hardly known."""
    share = certainty["step_response_24h_sd_K"] / max(certainty["step_response_24h_K"], 1e-9)
    if share <= _UNCERTAIN:
        return []
    return [f"uncertain: the effect of a day of action is known to ± {100 * share:.0f} % only; probe longer or harder"]


def unexplained(power: PowerModel | None, machine: str) -> list[str]:
    """That measured power hardly follows the level."""
    if power is None or not power.r2 < _LEAST_EXPLAINED:
        return []
    return [
        f"warning: level and weather explain {100 * max(power.r2, 0.0):.0f} % of what was measured as power of "
        f"{machine} (R² {power.r2:.2f}), so that costs are planned with a poor law: check that the meter has no other "
        "load, such as hot water"
    ]

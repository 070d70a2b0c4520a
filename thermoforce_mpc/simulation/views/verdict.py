"""What came out of a run, in one sentence: cost, what others cost, and discomfort."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite

from thermoforce_mpc.simulation.comparison.outcome import COST, DISCOMFORT

Kpis = Mapping[str, float]
# Costs that differ by less are the same.
_SAME = 0.005
# Further discomfort from which on two runs are not compared by cost alone, K·h.
_COMPARABLE_KH = 0.5
_CALLED = {"native": "the building's own controller", "thermostat": "an on/off thermostat", "pi": "a PI controller"}


def verdict(controller: str, everyone: Mapping[str, Kpis], currency: str, days: float) -> str:
    """One sentence on `controller` beside the others of a run.

    Args:
        controller: name of the controller that it is about.
        everyone: KPIs by controller; `cost_tot`, currency/m², and `tdis_tot`, K·h.
        currency: of the costs.
        days: scored days.
    """
    own = everyone[controller]
    if not own.keys() >= {COST, DISCOMFORT}:
        return f"{controller}: the plant gives no cost or no discomfort."
    others = {name: kpis for name, kpis in everyone.items() if name != controller and kpis.keys() >= {COST, DISCOMFORT}}
    # The one that is hardest to beat first: the thermostat.
    ordered = sorted(others, key=lambda name: name != "thermostat")
    beside = [f"{_difference(own[COST], others[name][COST], currency)} {_CALLED.get(name, name)}" for name in ordered]
    text = f"{controller}: {own[COST]:.3g} {currency}/m²" + (f", {' and '.join(beside)}" if beside else "")
    text += f"; comfort missed by {_Kh(own)} K·h in {_days(days)}"
    if others:
        text += " (" + ", ".join(f"{name} {_Kh(others[name])}" for name in ordered) + ")"
    calmer = [name for name in ordered if own[DISCOMFORT] > others[name][DISCOMFORT] + _COMPARABLE_KH]
    cheaper = [name for name in calmer if own[COST] < others[name][COST]]
    if cheaper:
        text += f". It leaves more discomfort than {' and '.join(cheaper)}: compare costs at equal comfort"
    return text + "."


def _Kh(kpis: Kpis) -> str:
    return f"{kpis[DISCOMFORT]:.2f}" if kpis[DISCOMFORT] < 10 else f"{kpis[DISCOMFORT]:.0f}"


def _difference(own: float, other: float, currency: str) -> str:
    """'7 % less than', '2 % more than' or 'as much as'; in currency where the other costs nothing, or earns."""
    if other > 0 and own >= 0 and isfinite(own):
        share = own / other - 1.0
        if abs(share) < _SAME:
            return "as much as"
        return f"{abs(share):.0%} {'less' if share < 0 else 'more'} than".replace("%", " %")
    return f"{abs(own - other):.3g} {currency}/m² {'less' if own < other else 'more'} than"


def _days(days: float) -> str:
    weeks = {7: "one week", 14: "two weeks", 21: "three weeks", 28: "four weeks"}
    return weeks.get(int(days) if days == int(days) else -1, f"{days:g} day{'s' * (days != 1)}")

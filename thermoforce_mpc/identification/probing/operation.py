"""Records of ordinary operation: the part that tells most about the effect of acting, and what it tells.

A controller acts when the weather asks for it, so a record of operation may hold weeks in which the two never part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, Layout, Record
from thermoforce_mpc.data.series import bridged
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.probing.design import information

# Days of a record that are used: longer parts take longer, and hold other seasons and habits. By judgement
# (2026-11-22).
MOST_DAYS = 28.0
# Distance of the parts that are compared, days: a week has each of its days; and the least share of levels and
# temperatures that one must hold: half.
_EVERY_DAYS, _LEAST_KNOWN = 7.0, 0.5


@dataclass(frozen=True)
class OperationFinding:
    """What a linear model of a record says of one actuator: whether it is competent, why, and what to do about it.

    `words`: for an engineer, `plainly`: for the owner of the building, '' where competent or nothing could be fitted.
    """

    actuator: str
    competent: bool
    words: str
    advice: tuple[str, ...] = ()
    plainly: str = ""


def telling_part(record: Record, layout: Layout, days: float = MOST_DAYS) -> tuple[Record, str]:
    """The `days` of a longer record that tell most about the effects of all actuators, and a note; else the record.

    Raises:
        DataError: nowhere are levels, weather and temperatures known together for half of the time.
    """
    n = round(days * DAY_S / record.step_s)
    if record.n_steps <= n:
        return record, ""
    every = round(_EVERY_DAYS * DAY_S / record.step_s)
    starts = [*range(0, record.n_steps - n, every), record.n_steps - n]
    worth = [_worth(record.slice(start, start + n), layout) for start in starts]
    if not np.isfinite(worth).any():
        raise DataError(
            f"record: no {days:g} days in which levels, weather and zone temperatures are known for half of the time; "
            "give a part without such gaps, or measure longer"
        )
    # The latest of equally good ones: buildings change.
    best = max(zip(worth, starts, strict=True))[1]
    part = record.slice(best, best + n)
    at = part.stamps()
    whole = record.n_steps * record.step_s / DAY_S
    return part, f"of {whole:.0f} days, the {days:g} that tell most about acting were used: {at[0]} to {at[-1]}"


def _worth(part: Record, layout: Layout) -> float:
    """Information of a part about all actuators, nats; −inf where too little is known."""
    rows = (np.isfinite(part.u).all(axis=0), np.isfinite(part.T_out_C), np.isfinite(part.solar_W_m2))
    measured_shares = [*(row.mean() for row in rows), *np.isfinite(part.T_zone_C).mean(axis=1)]
    if min(measured_shares) < _LEAST_KNOWN:
        return -np.inf
    part, _ = bridged(part)
    return float(sum(information(part.part(home, [a])) for a, home in enumerate(layout.home)) * min(measured_shares))


def findings(record: Record, layout: Layout) -> list[OperationFinding]:
    """What a linear model of the record says of each actuator; where none can be fitted, the reason stands at all."""
    try:
        model = identify(record, layout=layout, config=IdentificationConfig(modulation="linear"))
    except DataError as error:
        return [OperationFinding(name, False, str(error)) for name in layout.names.actuators]
    verdicts = [card.competence for card in model.cards]
    return [
        OperationFinding(name, verdict.competent, verdict.in_words(), verdict.advice, verdict.plainly)
        for name, verdict in zip(layout.names.actuators, verdicts, strict=True)
        if verdict is not None
    ]

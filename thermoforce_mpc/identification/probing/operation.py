"""Records of ordinary operation: the part that tells most, and what it cannot tell about the effect of acting.

A controller acts when the weather asks for it, so a record of operation may hold weeks in which the two never part.
What is expected to be known (`tellings`) is that of the probing design (`design.expected_sd`): from levels and
weather alone, for a building as the priors expect it and disturbances of the assumed size, which are mostly smaller.
What the temperatures tell (`findings`) is the verdict on a linear model of them (`model.competence`); it counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, Layout, Record
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.identification.config import IdentificationConfig
from thermoforce_mpc.identification.pipeline import identify
from thermoforce_mpc.identification.probing.design import expected_sd, information
from thermoforce_mpc.identification.validation.competence import MOST_RELATIVE_SD
from thermoforce_mpc.model.gaps import bridged

# Days of a record that are used: longer parts take longer, and hold other seasons and habits.
MOST_DAYS = 28.0
# Distance of the parts that are compared, days, and the least share of levels and temperatures that one must hold.
_EVERY_DAYS, _LEAST_KNOWN = 7.0, 0.5
# Others on the same zone may do as much as the own actuator, neighbours less, see `couplings`.
_SAME_ZONE, _NEIGHBOUR = 1.0, 0.3
# Factor on the standard deviation from which another actuator blurs the effect.
_BLURRED = 1.25


@dataclass(frozen=True)
class Telling:
    """What a record is expected to tell about one actuator.

    `relative_sd`: of the effect of a day at full level on its zone; `blurred_by`: actuators whose levels went with its
    own so much that the effects cannot be told apart.
    `levels`: least and highest level in the record; `on_share`: share of the time above 0.02.
    """

    actuator: str
    zone: str
    relative_sd: float
    blurred_by: tuple[str, ...]
    levels: tuple[float, float]
    on_share: float

    @property
    def tells(self) -> bool:
        """Whether the effect is expected to be known well enough to plan with."""
        return self.relative_sd <= MOST_RELATIVE_SD

    def in_words(self) -> str:
        """One line: what is expected, and why it is not enough."""
        expectation = f"effect of {self.actuator} on {self.zone} expected to ± {100 * self.relative_sd:.0f} %"
        if self.tells:
            return f"{expectation}: enough, if the building is about as the priors expect"
        why = []
        if self.levels[1] - self.levels[0] < 0.05:
            why.append(f"its level hardly changes ({self.levels[0]:.2f} to {self.levels[1]:.2f})")
        elif self.on_share < 0.02:
            why.append(f"it is on for {100 * self.on_share:.1f} % of the time only")
        if self.blurred_by:
            why.append(f"it cannot be told apart from {', '.join(self.blurred_by)}, whose levels go with its own")
        if not why:
            why.append("its level goes with weather and time of day")
        return f"{expectation}, need {100 * MOST_RELATIVE_SD:.0f} %: the record cannot tell it; {'; '.join(why)}"


@dataclass(frozen=True)
class Finding:
    """What a linear model of a record says of one actuator: whether it is competent, why, and what to do about it."""

    actuator: str
    competent: bool
    words: str
    advice: tuple[str, ...] = ()


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


def findings(record: Record, layout: Layout) -> list[Finding]:
    """What a linear model of the record says of each actuator; where none can be fitted, the reason stands at all."""
    try:
        model = identify(record, layout=layout, config=IdentificationConfig(modulation="linear"))
    except DataError as error:
        return [Finding(name, False, str(error)) for name in layout.names.actuators]
    verdicts = [card.competence for card in model.cards]
    return [
        Finding(name, verdict.competent, verdict.in_words(), verdict.advice)
        for name, verdict in zip(layout.names.actuators, verdicts, strict=True)
        if verdict is not None
    ]


def tellings(record: Record, layout: Layout) -> list[Telling]:
    """What a record (a month or so) is expected to tell about each actuator; gaps are bridged.

    Raises:
        DataError: the weather was never measured.
    """
    filled, _ = bridged(record)
    return [_telling(filled, layout, a) for a in range(len(layout.home))]


def _telling(record: Record, layout: Layout, a: int) -> Telling:
    home, names = layout.home[a], layout.names
    others = [b for b in range(len(layout.home)) if b != a]
    weights = [_SAME_ZONE if layout.home[b] == home else _NEIGHBOUR for b in others]

    def sd(among: Sequence[int], weighted: Sequence[float]) -> float:
        return expected_sd(record.part(home, [a, *among]), (1.0, *weighted))

    alone, together = sd([], []), sd(others, weights)
    blurred = tuple(
        names.actuators[b] for b, weight in zip(others, weights, strict=True) if sd([b], [weight]) > _BLURRED * alone
    )
    u = record.u[a]
    return Telling(
        names.actuators[a],
        names.zones[home],
        together,
        blurred if together > _BLURRED * alone else (),
        (float(u.min()), float(u.max())),
        float((np.abs(u) > 0.02).mean()),
    )

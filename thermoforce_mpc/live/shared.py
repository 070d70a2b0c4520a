"""What was decided is shown, through a connection that can tell and in a file that the page reads; what people ask
through the connection is heard.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from thermoforce_mpc.commands.command import Command
from thermoforce_mpc.commands.loop import LearnedCommand, command_rows
from thermoforce_mpc.commands.tank import tank_rows
from thermoforce_mpc.errors import StorageError
from thermoforce_mpc.files import write_json
from thermoforce_mpc.live.control import Decision
from thermoforce_mpc.protocols import Connection
from thermoforce_mpc.records.people import SHOWN, People
from thermoforce_mpc.records.run_folder import saving_so_far

_LOG = logging.getLogger(__name__)
ACTING = ("control", "probe")
"""Modes of `tf-mpc control` in which the building is set."""


def shared_with(
    connection: Connection,
    people: People,
    told: Callable[[Decision], None],
    in_words: Callable[[Decision], str],
    folder: Path,
    mode: str = "control",
    commands: Mapping[str, LearnedCommand] | None = None,
    tank: Command | None = None,
) -> Callable[[Decision], None]:
    """`told`, then what was decided and asked to a `connection` with `tell`; what one with `listen` hears is asked.

    `in_words`: a decision in one line; `folder`: of the run; `mode`: one that sets nothing is not asked for another;
    `commands`: of actuators that are set by one; `tank`: of the tank of hot water.
    """
    acts = mode in ACTING
    asks = ("lower", "upper", "away", "boost", *(["mode"] if acts else []))
    tell, listen = getattr(connection, "tell", None), getattr(connection, "listen", None)

    def keep(said: dict[str, Any]) -> None:
        try:
            write_json(folder / SHOWN, said | {"mode": mode, "asks": asks}, follow=True)
        except (StorageError, ValueError) as error:
            _LOG.warning("the page does not know of it: %s", error)

    def show(said: dict[str, Any]) -> None:
        if tell is None:
            return
        try:
            asked = people.shown(pd.Timestamp.now("UTC")) | ({} if acts else {"mode": mode})
            tell(said | {"people": shown | asked})
        except Exception as error:  # somebody's connection may raise anything, and showing ends no control
            _LOG.warning("what was decided is not shown (%s: %s)", type(error).__name__, error)

    def asked(key: str) -> Callable[[str], None]:
        def ask(text: str) -> None:
            try:
                people.ask(key, text, pd.Timestamp.now("UTC"))
                _LOG.info("asked: %s %s", key, text[:50])
            finally:  # what was refused is shown as it is
                show({})

        return ask

    shown: dict[str, Any] = {}
    if listen is not None:
        listen({key: asked(key) for key in asks})
    keep({})

    def decided(decision: Decision) -> None:
        told(decision)
        plan, words = decision.plan, in_words(decision)
        if plan.lower_C.size:
            shown.update(planned_lower_C=float(plan.lower_C[0, 0]), planned_upper_C=float(plan.upper_C[0, 0]))
        steps = [
            {"s": float(at - plan.time_s[0]), "T_C": [round(float(T), 2) for T in plan.T_zone_C[:, k]]}
            for k, at in enumerate(plan.time_s)
        ]
        set_now = words.partition(": ")[0].partition("  ")[2]  # without the time and the reason
        if not acts or people.paused:
            set_now = f"nothing is set; it would be {set_now}"
        elif by_hand := people.by_hand(pd.Timestamp.now("UTC")):
            set_now += f"; left as set by hand: {', '.join(by_hand)}"
        planned = {"from": decision.instant.isoformat(), "next": words[:250], "steps": steps}
        said = {
            "status": plan.status.value, "why": decision.refused or plan.why, "level": set_now,
            "notes": list(decision.notes), "saving": saving_so_far(folder),
            "plan": planned | {"commands": [*command_rows(plan, commands or {}), *tank_rows(plan, tank)]},
        }  # fmt: skip
        keep(said)
        show(said)

    return decided

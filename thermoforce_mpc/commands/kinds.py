"""The kinds of commands by name: a new one is a class in a file of this folder, and its name in `KINDS`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args

from pydantic import Discriminator, Tag

from thermoforce_mpc.commands.command import Command
from thermoforce_mpc.commands.contacts import Enable, SGReady
from thermoforce_mpc.commands.heating_curve import CurveOffset, FlowTemperature
from thermoforce_mpc.commands.setpoint import Setpoint

KINDS: tuple[type[Command], ...] = (Setpoint, CurveOffset, FlowTemperature, SGReady, Enable)
"""What can be set in the place of a level."""


def names_of(kinds: Sequence[type[Command]]) -> str:
    """The names of kinds in words."""
    *others, last = [_name(one) for one in kinds]
    return f"{', '.join(others)} or {last}" if others else last


def told_apart(kinds: Sequence[type[Command]]) -> Any:
    """The type of a command that is one of `kinds`, told apart by its key `kind`."""
    return Annotated[
        Union[tuple(Annotated[one, Tag(_name(one))] for one in kinds)],  # noqa: UP007 (made while it runs)
        Discriminator(
            lambda value: value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None),
            custom_error_type="command_kind",
            custom_error_message=f"kind: expected {names_of(kinds)}",
        ),
    ]


def _name(kind: type[Command]) -> str:
    (name,) = get_args(kind.model_fields["kind"].annotation)
    return str(name)


if TYPE_CHECKING:
    AnyCommand = Command
else:
    AnyCommand = told_apart(KINDS)
    """A command of any kind."""

"""The kinds of commands by name."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Discriminator, Tag

from thermoforce_mpc.commands.contacts import Enable, SGReady
from thermoforce_mpc.commands.heating_curve import CurveOffset, FlowTemperature
from thermoforce_mpc.commands.setpoint import Setpoint


def _kind(value: Any) -> Any:
    return value.get("kind") if isinstance(value, dict) else getattr(value, "kind", None)


AnyCommand = Annotated[
    Annotated[Setpoint, Tag("setpoint")]
    | Annotated[CurveOffset, Tag("curve_offset")]
    | Annotated[FlowTemperature, Tag("flow_temperature")]
    | Annotated[SGReady, Tag("sg_ready")]
    | Annotated[Enable, Tag("enable")],
    Discriminator(
        _kind,
        custom_error_type="command_kind",
        custom_error_message="kind: expected setpoint, curve_offset, flow_temperature, sg_ready or enable",
    ),
]
"""A command of any kind, told apart by its key `kind`."""

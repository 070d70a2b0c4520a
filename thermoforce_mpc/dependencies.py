"""What dependencies would do by themselves, and the switches that stop it; set before the first of them is imported.

`import thermoforce_mpc` sets `SWITCHES` for its process and all that it starts, so that no dependency reports anything
to anybody. The command line sets `place` too, so that what they keep stands in our cache folder. A variable that is
set already stays as it is. What each dependency was seen to do: docs/reference/dependencies.md.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple


class Switch(NamedTuple):
    """An environment `variable` and the `value` that stops what `package` `does`."""

    variable: str
    value: str
    package: str
    does: str

    @property
    def is_off(self) -> bool:
        """Whether what it stops is stopped: False where the user set another value."""
        return os.environ.get(self.variable, "").lower() in (self.value, "true", "yes", "on")


SWITCHES = (
    # Read when its library is loaded; `disable_telemetry_events()` comes after the first event.
    Switch(
        "ORT_DISABLE_TELEMETRY", "1", "onnxruntime",
        "sends events to Microsoft, with a device id and a database below ~/.cache/Microsoft",
    ),
    # Read by huggingface_hub beside its own HF_HUB_DISABLE_TELEMETRY, and by others (donottrack.sh).
    Switch("DO_NOT_TRACK", "1", "huggingface_hub", "reports to the hub what is used"),
)  # fmt: skip


def report_nothing() -> None:
    """Set each of `SWITCHES` that has no value yet."""
    for switch in SWITCHES:
        os.environ.setdefault(switch.variable, switch.value)


def keep_in_place() -> None:
    """Have the dependencies of a program of ours keep what they keep in our cache folder; not those of the user's own.

    Matplotlib writes its list of fonts, and reads the user's style, where this says.
    """
    with suppress(RuntimeError):  # who runs this has no home: matplotlib takes a temporary folder
        os.environ.setdefault("MPLCONFIGDIR", str(cache_folder() / "matplotlib"))


def cache_folder() -> Path:
    """`$XDG_CACHE_HOME/thermoforce-mpc`, by default in `~/.cache`."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "thermoforce-mpc"

"""What is shown of a run: on a terminal, as one self-contained page, and while it is under way."""

from typing import TYPE_CHECKING

from thermoforce_mpc.registry import lazy_names

if TYPE_CHECKING:
    from thermoforce_mpc.report.html import write_report

__all__ = ["write_report"]

# Tables of commands that draw no report are shown without what a report needs.
__getattr__ = lazy_names(__name__, {"write_report": "thermoforce_mpc.report.html"})

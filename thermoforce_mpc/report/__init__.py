"""HTML report of a run: tables and plots in one self-contained file."""

from thermoforce_mpc.report.html import write_report

__all__ = ["write_report"]

"""The picture of a run: plots people look for, in one HTML file that needs nothing else."""

from thermoforce_mpc.simulation.report.html import write_report

__all__ = ["write_report"]

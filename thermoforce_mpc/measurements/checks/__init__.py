"""What a record says against itself: stamps, units, levels, meters, rooms and commands, found by check."""

from __future__ import annotations

from thermoforce_mpc.data import Layout, Record
from thermoforce_mpc.measurements.checks.common import Remark
from thermoforce_mpc.measurements.checks.levels import level_remarks
from thermoforce_mpc.measurements.checks.rooms import command_remarks, room_remarks
from thermoforce_mpc.measurements.checks.timing import timing_remarks
from thermoforce_mpc.measurements.checks.units import unit_remarks

__all__ = ["Remark", "command_remarks", "remarks"]


def remarks(record: Record, layout: Layout) -> tuple[Remark, ...]:
    """What is probably wrong with `record` of a building of `layout`, each with its remedy; none where nothing is.

    A remark says that a test of the record failed, not that a model of it is useless; the record is left as it is.
    """
    of_levels = level_remarks(record, layout)
    kinds = {remark.kind for remark in of_levels}
    # A level that is none tells nothing of stamps, and a meter of two loads nothing of its unit.
    of_stamps = [] if "level is no level" in kinds else timing_remarks(record, layout)
    of_units = [one for one in unit_remarks(record, layout) if not (kinds and one.kind == "unit of power")]
    return (*of_stamps, *of_levels, *of_units, *room_remarks(record, layout))

"""Control of a real building through a connection, step by step in real time."""

from thermoforce_mpc.live.building import KeptState, LiveBuilding, real_run
from thermoforce_mpc.live.control import Clock, Decision, WallClock, control
from thermoforce_mpc.records.people import People

__all__ = ["Clock", "Decision", "KeptState", "LiveBuilding", "People", "WallClock", "control", "real_run"]

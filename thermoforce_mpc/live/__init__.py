"""Control of a real building through a connection, step by step in real time."""

from thermoforce_mpc.live.building import LiveBuilding
from thermoforce_mpc.live.control import Clock, Decision, WallClock, control
from thermoforce_mpc.live.kept import KeptState, real_run

__all__ = ["Clock", "Decision", "KeptState", "LiveBuilding", "WallClock", "control", "real_run"]

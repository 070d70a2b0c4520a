"""Zones simulated as a whole in this process: a PI loop sets the heat source, and every data step is recorded."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np

from thermoforce_mpc.data import DAY_S, Record
from thermoforce_mpc.errors import PlantError
from thermoforce_mpc.plants.energyplus.engine import Reading, run_engine, weather_file
from thermoforce_mpc.plants.energyplus.zone import GAINS, HVAC, ZONE_WIRING, PiPolicy, ZoneJob, zone_model

# Maps the step's number (−1 while the engine warms up) and the zone temperature before it, °C, to u in [0, 1].
Policy = Callable[[int, float], float]


def simulate(job: ZoneJob) -> Record:
    """Run one job in this process.

    Returns:
        Record of `n_steps` steps from midnight of `first_day`, starting from the state after the engine's warm-up.
        `power_W` is NaN (there is no machine), `heat_W` the delivered heat, negative for cooling.

    Raises:
        PlantError: the engine refused the model or stopped early; includes the engine's messages.
    """
    if job.spec.engine_steps_per_hour % job.spec.steps_per_hour:
        raise PlantError(
            f"EnergyPlus: {job.spec.engine_steps_per_hour} engine steps an hour do not divide into "
            f"{job.spec.steps_per_hour} steps of the data"
        )
    if job.gains.shape != job.setpoint_C.shape or job.n_steps < 1:
        raise PlantError(
            f"EnergyPlus: set-points {job.setpoint_C.shape} and gains {job.gains.shape} differ or are empty"
        )
    per_day = round(DAY_S / job.spec.step_s)
    days = -(-job.n_steps // per_day)
    model = zone_model(job.spec, job.first_day, days)
    recorder = Recorder(job, PiPolicy(job))
    run_engine(json.dumps(model), weather_file(job.spec.weather), recorder, ZONE_WIRING)
    return recorder.history()


class Recorder:
    """`Driver` that acts before each step, reads after it, and stops when all steps are recorded."""

    def __init__(self, job: ZoneJob, policy: Policy) -> None:
        self._job, self._policy = job, policy
        self._sign = 1.0 if job.spec.mode == "heating" else -1.0
        self._before: Reading | None = None
        self._readings: list[Reading] = []
        self._u: list[float] = []
        self._acting = 0.0
        self._per_step = job.spec.engine_steps_per_hour // job.spec.steps_per_hour
        self._within, self._warming_up = 0, True

    @property
    def done(self) -> bool:
        """Whether every step was recorded."""
        return len(self._readings) == self._job.n_steps

    def begin(self, warming_up: bool) -> dict[str, float]:
        """Return the heat of each actuated source over the next step, W."""
        step = -1 if warming_up else len(self._readings)
        if step >= self._job.n_steps:
            return {HVAC: 0.0, GAINS: 0.0}
        if warming_up != self._warming_up:
            self._within, self._warming_up = 0, warming_up
        if self._within == 0:
            last = self._readings[-1] if self._readings else self._before
            setpoint = float(self._job.setpoint_C[0])
            self._acting = self._policy(step, last.T_zone_C if last else setpoint)
        gains = float(self._job.gains[max(step, 0)])
        spec = self._job.spec
        return {HVAC: self._sign * self._acting * spec.capacity_W, GAINS: gains * spec.gains_W}

    def end(self, warming_up: bool, read: Callable[[], Reading]) -> bool:
        """Store the reading at the end of a data step; return True when the run may stop.

        That is one step after the last requested one, since readings in the step of a stop are 0.
        """
        self._within = (self._within + 1) % self._per_step
        if self._within:
            return self.done
        if warming_up:
            self._before = read()
        elif not self.done:
            self._readings.append(read())
            self._u.append(self._acting)
            return False
        return self.done

    def history(self) -> Record:
        """Return the record; raises `PlantError` if the engine ended before all steps were recorded."""
        if not self.done or self._before is None:
            raise PlantError(f"EnergyPlus recorded {len(self._readings)} of {self._job.n_steps} steps and then ended")
        readings = [self._before, *self._readings]
        u = np.array(self._u)
        spec = self._job.spec
        return Record(
            time_s=np.asarray(self._job.first_day * DAY_S + spec.step_s * np.arange(len(readings), dtype=np.float64)),
            T_zone_C=np.array([r.T_zone_C for r in readings]),
            T_out_C=np.array([r.T_out_C for r in readings]),
            solar_W_m2=np.array([r.solar_W_m2 for r in readings]),
            u=u,
            power_W=np.full(u.size, np.nan),
            heat_W=self._sign * u * spec.capacity_W,
        )

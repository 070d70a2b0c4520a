"""Houses whose every number is known, to identify."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from thermoforce_mpc.data import DAY_S, HOUR_S, Record
from thermoforce_mpc.identification import Pair


@dataclass(frozen=True)
class House:
    """Two slow modes behind a delay: T = Σ modes; heat and weather enter with positive gains.

    `tau_h` of delay, room and structure; `gain_K` of full heat, `outdoor` and `solar_K` (per 100 W/m²) of room and
    structure; heat is `machine_W` (fixed, proportional) W with a slope per K.
    """

    tau_h: tuple[float, float, float] = (0.5, 3.0, 60.0)
    gain_K: tuple[float, float] = (2.0, 24.0)
    outdoor: tuple[float, float] = (0.1, 0.85)
    solar_K: tuple[float, float] = (1.0, 3.0)
    machine_W: tuple[float, float] = (1600.0, 8400.0)
    slope_per_K: float = 0.025
    sign: int = 1

    def heat_W(self, u, T_out):
        """Delivered heat (negative for cooling)."""
        fixed, proportional = self.machine_W
        return self.sign * ((u > 0) * fixed + u * proportional) * (1 + self.slope_per_K * T_out)

    def effect_K(self, drive, step_s: float) -> np.ndarray:
        """Exact response to a drive held over each step, from rest, at the n + 1 boundaries."""
        t0, *slow = (t * HOUR_S for t in self.tau_h)
        total = np.zeros(len(drive) + 1)
        for tau, gain in zip(slow, self.gain_K, strict=True):
            z = np.zeros(2)  # delayed drive, mode
            ea, eb = np.exp(-step_s / t0), np.exp(-step_s / tau)
            out = [0.0]
            for v in drive:
                # Mode driven by the delayed drive v + (z0 − v) exp(−s/t0) over the step, solved exactly.
                coupling = (ea - eb) / (1.0 - tau / t0)
                mode = eb * z[1] + gain * (v * (1 - eb) + (z[0] - v) * coupling)
                z = np.array([v + (z[0] - v) * ea, mode])
                out.append(mode)
            total += np.array(out)
        return total


def weather(days: float, step_s: float, seed: int, start_day: float = 20.0):
    """Time, outdoor temperature and irradiance at the boundaries: daily cycles with fronts and clouds."""
    n = round(days * DAY_S / step_s)
    time_s = start_day * DAY_S + np.arange(n + 1) * step_s
    rng = np.random.default_rng(seed)
    hour, day = time_s / HOUR_S % 24, time_s / DAY_S - start_day
    fronts = sum(rng.normal() * 2.0 * np.cos(2 * np.pi * day / p + rng.uniform(0, 6.3)) for p in (1.7, 2.9, 6.0))
    clouds = 0.6 + 0.4 * np.sin(2 * np.pi * day / 1.3 + rng.uniform(0, 6.3))
    T_out = 4.0 + 2.5 * np.cos(2 * np.pi * (hour - 15) / 24) + fronts
    solar = np.maximum(0.0, 350 * np.cos(2 * np.pi * (hour - 12.5) / 24) - 120) * clouds
    return time_s, T_out, solar


def random_levels(n: int, seed: int, levels=(0.0, 0.4, 0.7, 1.0), hold: int = 16) -> np.ndarray:
    """Levels held for random times, off about half of the time."""
    rng = np.random.default_rng(seed)
    u = np.empty(0)
    while u.size < n:
        level = rng.choice(levels[1:]) if rng.random() < 0.45 else 0.0
        u = np.append(u, np.full(rng.integers(1, hold + 1), level))
    return u[:n]


def record(
    house: House,
    days: float = 3.0,
    step_s: float = 900.0,
    seed: int = 0,
    u: np.ndarray | None = None,
    noise_K: float = 0.0,
    heat_measured: bool = True,
) -> Record:
    """What a sensor in this house would have recorded, starting in the steady state of a mean action."""
    time_s, T_out, solar = weather(days, step_s, seed)
    n = time_s.size - 1
    u = random_levels(n, seed + 1, hold=max(1, round(4 * HOUR_S / step_s))) if u is None else u
    heat = house.heat_W(u, T_out[:-1])
    full = house.machine_W[0] + house.machine_W[1]
    forced = house.effect_K(heat / full, step_s)
    free = np.zeros(n + 1)
    for tau, c, d in zip(house.tau_h[1:], house.outdoor, house.solar_K, strict=True):
        a = np.exp(-step_s / HOUR_S / tau)
        drive = c * 0.5 * (T_out[:-1] + T_out[1:]) + d * 0.01 * 0.5 * (solar[:-1] + solar[1:])
        z = [c * T_out[0] + 1.0]
        for value in drive:
            z.append(a * z[-1] + (1 - a) * value)
        free += np.array(z)
    # The heat before the record still fades away.
    before = 9.0 * house.sign * np.exp(-(time_s - time_s[0]) / HOUR_S / house.tau_h[-1])
    noise = noise_K * np.random.default_rng(seed + 2).normal(size=n + 1)
    power = (u > 0) * 1600.0 + u * 2000.0
    return Record(
        time_s=time_s,
        T_zone_C=6.0 + free + forced + before + noise,
        T_out_C=T_out,
        solar_W_m2=solar,
        u=u,
        power_W=power,
        heat_W=heat if heat_measured else np.full(n, np.nan),
    )


def make_pair(house: House, seed: int, days: float = 1.6) -> Pair:
    """Two runs of a house under the same weather, with levels of their own."""
    n = round(days * 24)
    runs = [record(house, days, 3600.0, seed, u=random_levels(n, 10 * seed + k, hold=4)) for k in (1, 2)]
    return Pair(*runs, label=str(seed))


def effect_rmse(model, house: House, seed: int = 99, step_s: float = 3600.0, hours: int = 24) -> tuple[float, float]:
    """RMSE (K) and RMS (K) of the 24-h effect of random plans against none, by the house's own equations."""
    from thermoforce_mpc.model.operator.building import forced_rollout
    from thermoforce_mpc.model.operator.parameters import feature_matrix

    operator = model.only.operator.resampled(step_s)
    time_s, T_out, solar = weather(20, step_s, seed)
    errors, effects = [], []
    for start in range(0, 20 * 24 - hours, hours):
        u = random_levels(hours, seed + start, hold=4)
        at = slice(start, start + hours)
        truth = house.effect_K(house.heat_W(u, T_out[at]) / sum(house.machine_W), step_s)[1:]
        features = feature_matrix(np.full(hours, 15.0), T_out[at], solar[at], time_s[at])
        rest = forced_rollout(operator, np.zeros(operator.order), np.zeros(hours), features)
        got = (forced_rollout(operator, np.zeros(operator.order), u, features) - rest).sum(axis=-1)
        errors.append(got - truth)
        effects.append(truth)
    return float(np.sqrt(np.mean(np.square(errors)))), float(np.sqrt(np.mean(np.square(effects))))

"""`tf-mpc bench names`: names and records drawn anew, and what `tf-mpc data map` takes their signals for.

A building is drawn (rooms, a machine with valves or without, weather), its records are made by a small model, and its
signals are named by one of fourteen styles. A signal is right where its role, and where it is used its unit, are those
that it was made with. Wrong and unmarked is what is wrong without a doubt that the map would show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.names.styles import STYLES
from thermoforce_mpc.comparison.outcome import Target, results_json
from thermoforce_mpc.data import DAY_S, Array, energy_kWh
from thermoforce_mpc.errors import InputError
from thermoforce_mpc.measurements.map.guesses import Column, Guess, guesses

_RIGHT, _UNMARKED = 0.95, 0.01
_QUICK = 120
# Roles that a map does not use are alike.
_UNUSED = {"", "humidity", "humidity of outdoors", "return water", "gas"}
_SET = {"setpoint", "lower", "upper"}
# Words of contacts of windows.
_WINDOWS = ("window", "fenster", "fönster", "fenêtre", "raam", "vindue", "ikkuna")


@dataclass(frozen=True)
class Signal:
    """A signal as it was made: its column, its role and its unit."""

    column: Column
    role: str
    unit: str = ""


def run_names_bench(
    *, seed: int = 1, buildings: int = 1000, quick: bool = False, progress: Callable[[str], None] = lambda line: None
) -> dict[str, Any]:
    """Draw `buildings` buildings by `seed`, and count the signals that are taken for what they are.

    Raises:
        InputError: no buildings.
    """
    if buildings < 1:
        raise InputError(f"{buildings} buildings: expected at least one")
    counts: dict[str, list[int]] = {style: [0, 0, 0] for style in STYLES}
    wrong: dict[tuple[str, str, str], int] = {}
    for k in range(min(buildings, _QUICK) if quick else buildings):
        style, signals = drawn(seed, k)
        for signal, guess in zip(signals, guesses([signal.column for signal in signals]), strict=True):
            counts[style][0] += 1
            counts[style][1] += is_right(signal, guess)
            if not is_right(signal, guess):
                counts[style][2] += guess.sure
                key = (signal.column.name, f"{signal.role} {signal.unit}".strip(), f"{guess.role} {guess.unit}".strip())
                wrong[key] = wrong.get(key, 0) + 1
    for (name, was, taken), times in sorted(wrong.items(), key=lambda item: -item[1])[:20]:
        progress(f"{times} times {name}: {was or 'nothing used'} taken for {taken or 'nothing used'}")
    rows = [
        {
            "style": style,
            "signals": n,
            "right_percent": 100.0 * right / n if n else None,
            "unmarked_percent": 100.0 * unmarked / n if n else None,
        }
        for style, (n, right, unmarked) in counts.items()
    ]
    n, right, unmarked = (sum(count[k] for count in counts.values()) for k in range(3))
    targets = [
        Target(f"share of {n} signals that are right", right / n, _RIGHT, "at least"),
        Target("share that is wrong and unmarked", unmarked / n, _UNMARKED),
    ]
    return results_json("names", rows, targets)


def is_right(signal: Signal, guess: Guess) -> bool:
    """Whether a guess has the role and the unit that the signal was made with."""
    if signal.role in _UNUSED:
        return guess.role in _UNUSED
    if signal.role in _SET:
        return guess.role in _SET
    return guess.role == signal.role and guess.unit == signal.unit


def drawn(seed: int, number: int) -> tuple[str, list[Signal]]:
    """The style and the signals of a building of a population."""
    rng = np.random.default_rng([seed, number])
    style = str(rng.choice(list(STYLES)))
    rooms, fahrenheit, names = STYLES[style]
    n_rooms = int(rng.integers(1, min(len(rooms), 5) + 1))
    step_s = float(rng.choice([300.0, 600.0, 900.0, 1800.0]))
    time_s = np.arange(0.0, rng.uniform(5.0, 12.0) * DAY_S, step_s)
    made = _records(rng, time_s, n_rooms)
    chosen = [str(room) for room in rng.permutation(rooms)[:n_rooms]]

    def name(kind: str, room: int | None = None) -> str:
        told = str(rng.choice(names[kind]))
        word = chosen[room or 0]
        slug = (
            word.lower().replace("ü", "u").replace("ä", "a").replace(" ", "_")
            if told.startswith(("sensor", "binary", "number"))
            else word
        )
        return told.format(r=slug, n=word.rpartition("_")[2])

    signals: list[Signal] = []
    unit = "°F" if fahrenheit else "°C"

    def add(kind: str, values: Array, role: str, of_unit: str = "", room: int | None = None) -> None:
        if not names.get(kind):
            return
        label = name(kind, room)
        if all(signal.column.name != label for signal in signals):
            if of_unit in ("°C", "°F"):
                values = np.round(values * 1.8 + 32.0, 1) if fahrenheit else np.round(values, int(rng.integers(1, 3)))
            signals.append(Signal(Column(label, time_s, values), role, of_unit))

    zone_names = [str(rng.choice(names["zone"]))]
    for r in range(n_rooms):
        fixed, names["zone"] = names["zone"], tuple(zone_names)
        add("zone", made["T"][r], "zone", unit, r)
        names["zone"] = fixed
        if rng.random() < 0.7:
            add("setpoint", np.round(2.0 * made["set"][r]) / 2.0, "setpoint", unit, r)
        if rng.random() < 0.7:
            percent = np.round(100.0 * made["valve"][r], 0)
            # Without a name for % a valve may be a share.
            share = "%" not in "".join(names["level"]) and rng.random() < 0.3
            add("level", np.round(made["valve"][r], 2) if share else percent, "level", "0-1" if share else "%", r)
        if rng.random() < 0.4:
            add("humidity", np.round(50.0 + 8.0 * np.sin(time_s / 9e4 + r) + rng.normal(0, 1, time_s.size)), "", "", r)
    add("outdoor", made["T_out"], "outdoor", unit)
    if rng.random() < 0.6:
        add("sun", np.round(made["sun"]), "sun", "W/m²")
    if rng.random() < 0.7:
        label = name("machine")
        switched = not any(word in label.lower() for word in ("%", "pct", "mod", "speed", "level", "u"))
        u = (made["load"] > 0.5).astype(float) if switched else made["load"]
        percent = not switched and ("%" in label or "pct" in label or rng.random() < 0.5)
        values = np.round(100.0 * u) if percent else np.round(u, 2)
        signals.append(Signal(Column(label, time_s, values), "level", "%" if percent else "0-1"))
    if rng.random() < 0.8 and names.get("power"):
        label = name("power")
        kilo = "kw" in label.lower()
        values = np.round(made["P"] / 1000.0, 2) if kilo else np.round(made["P"])
        signals.append(Signal(Column(label, time_s, values), "power", "kW" if kilo else "W"))
    if rng.random() < 0.5 and names.get("heat"):
        signals.append(Signal(Column(name("heat"), time_s, np.round(3.0 * made["P"])), "heat", "W"))
    if rng.random() < 0.5:
        counter = np.round(rng.uniform(100, 20000) + energy_kWh(np.cumsum(made["P"]), step_s), 2)
        add("counter", counter, "power", "kWh counter")
    for _ in range(int(rng.integers(0, 4))):
        add(
            "water",
            np.round(30.0 + 12.0 * made["load"] + 0.5 * made["T_out"] + rng.normal(0, 0.3, time_s.size), 1),
            "",
            unit,
        )
    for _ in range(int(rng.integers(0, 4))):
        label = name("other", int(rng.integers(n_rooms)))
        if all(signal.column.name != label for signal in signals):
            contact = any(word in label.lower() for word in _WINDOWS)
            of = ("window", "0-1") if contact else ("",)
            signals.append(Signal(Column(label, time_s, _other(rng, label, time_s)), *of))
    if rng.random() < 0.3:
        add("pv", np.round(5.0 * made["sun"]), "")
    if rng.random() < 0.3 and names.get("price"):
        label = name("price")
        cents = "ct/" in label or "öre/" in label
        price = np.round(0.25 + 0.08 * np.sin(time_s / 7000.0), 4)
        signals.append(
            Signal(
                Column(label, time_s, 100.0 * price if cents else price),
                "price",
                "cent per kWh" if cents else "per kWh",
            )
        )
    return style, signals


def _records(rng: np.random.Generator, time_s: Array, n: int) -> dict[str, Any]:
    """Records of `n` rooms under thermostats: temperatures (n, m), °C, valves, the machine's load and power, "
    "weather."""
    hour = time_s / 3600.0 % 24.0
    mean = float(rng.uniform(-5.0, 12.0))
    slow = np.interp(time_s, np.linspace(0.0, time_s[-1], 12), rng.normal(0.0, 3.0, 12))
    T_out = (
        mean + slow + rng.uniform(2.0, 5.0) * np.sin((hour - 9.0) / 12.0 * np.pi) + rng.normal(0.0, 0.1, time_s.size)
    )
    clear = np.repeat(rng.uniform(0.2, 1.0, 40), -(-time_s.size // 40))[: time_s.size]
    sun = np.maximum(0.0, 600.0 * np.sin((hour - 7.0) / 10.0 * np.pi)) * ((hour > 7.0) & (hour < 17.0)) * clear
    step_h = float(time_s[1] - time_s[0]) / 3600.0
    T, valve, target = np.empty((n, time_s.size)), np.empty((n, time_s.size)), np.empty((n, time_s.size))
    for r in range(n):
        day, night = rng.choice([20.0, 20.5, 21.0, 21.5, 22.0]), rng.choice([17.0, 18.0, 19.0])
        begins, ends = rng.integers(5, 9), rng.integers(20, 24)
        target[r] = np.where((hour >= begins) & (hour < ends), day, night)
        room, loss, gain = float(day), rng.uniform(0.01, 0.025), rng.uniform(0.8, 1.4)
        for k in range(time_s.size):
            opening = float(np.clip(0.8 * (target[r, k] - room) + 0.3, 0.0, 1.0))
            room += step_h * (gain * opening - loss * (room - T_out[k]) + 0.0006 * sun[k])
            T[r, k], valve[r, k] = room + rng.normal(0.0, 0.03), opening
    load = np.clip(valve.mean(axis=0) * (1.0 - T_out / 40.0), 0.0, 1.0)
    power = np.where(load > 0.05, 500.0 + rng.uniform(800.0, 3000.0) * load + rng.normal(0.0, 8.0, time_s.size), 6.0)
    return {
        "T": T,
        "valve": np.round(20.0 * valve) / 20.0,
        "set": target,
        "T_out": T_out,
        "sun": sun,
        "load": load,
        "P": power,
    }


def _other(rng: np.random.Generator, label: str, time_s: Array) -> Array:
    """Values of a signal that is of no use, by its name."""
    low = label.lower()
    hour = time_s / 3600.0 % 24.0
    if any(word in low for word in _WINDOWS):
        return (rng.random(time_s.size) < 0.1).astype(float)
    if "co2" in low:
        return np.asarray(
            np.round(650.0 + 250.0 * np.sin((hour - 4.0) / 12.0 * np.pi) + rng.normal(0.0, 20.0, time_s.size)),
            dtype=np.float64,
        )
    if any(word in low for word in ("row", "idx", "stunden")):
        return np.asarray(np.arange(time_s.size) + float(rng.integers(0, 5000)), dtype=np.float64)
    if any(word in low for word in ("pres", "druk", "druck")):
        return np.asarray(np.round(1013.0 + 8.0 * np.sin(time_s / 2e5), 1), dtype=np.float64)
    if any(word in low for word in ("batter", "quality")):
        return np.asarray(np.round(100.0 - time_s / 5e5), dtype=np.float64)
    if any(word in low for word in ("wind", "vent", "licht", "light", "spd")):
        return np.asarray(np.round(np.abs(rng.normal(4.0, 3.0, time_s.size)), 1), dtype=np.float64)
    return (rng.random(time_s.size) < 0.1).astype(float)

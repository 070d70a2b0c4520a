#!/usr/bin/env bash
# CasADi's integrators see an event only where its indicator falls through zero, and one indicator for both switches of a
# thermostat switches once.
#
# Versions: casadi 3.8.2 (events are experimental; it says so once, and says nothing of the rest)
# A good guess: an event is a change of sign of the indicator, either way, as in FMI and Modelica: T - 21 switches a heater off
# Seen: with indicators T - 21 and 19 - T the heater is never switched off and the room reaches 29 °C; with 21 - T and T - 19
# it cycles, exact to 0.001 K; with one indicator that changes its meaning with the mode (21 - T while on, T - 19 while off)
# it is switched off once and never on again
# Why it matters: a simulated thermostat that does not switch looks like a house that is well insulated
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/pip" install -q --no-compile casadi==3.8.2 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PY'
import math

import casadi as ca

TAU_H, WARMEST_C, HOURS = 20.0, 30.0, 48.0


def exact():
    T, on, left = 20.0, 1, HOURS
    while True:
        end, switch = WARMEST_C * on, 21.0 if on else 19.0
        lasts = TAU_H * math.log((end - T) / (end - switch))
        if lasts > left:
            return end + (T - end) * math.exp(-left / TAU_H)
        T, on, left = switch, 1 - on, left - lasts


def simulated(indicators, next_mode):
    x, index = ca.MX.sym("x", 2), ca.MX.sym("index")
    T, on = x[0], x[1]
    none = [ca.MX.sym(name, 0) for name in "zpu"]
    after = ca.vertcat(T, next_mode(on, index))
    transition = ca.Function(
        "transition", [index, ca.MX.sym("t"), x, *none], [after], ["index", "t", "x", "z", "p", "u"], ["post_x"]
    )
    dae = {"x": x, "ode": ca.vertcat((WARMEST_C * on - T) / TAU_H, 0), "zero": indicators(T, on)}
    room = ca.integrator("room", "cvodes", dae, 0.0, HOURS, {"transition": transition})
    return float(room(x0=[20.0, 1.0])["xf"][0])


rising = simulated(lambda T, on: ca.vertcat(T - 21, 19 - T), lambda on, index: index)
falling = simulated(lambda T, on: ca.vertcat(21 - T, T - 19), lambda on, index: index)
one = simulated(lambda T, on: ca.if_else(on > 0.5, 21 - T, T - 19), lambda on, index: 1 - on)
print(f"exact {exact():.2f} °C; rising {rising:.2f}, falling {falling:.2f}, one indicator {one:.2f} °C")
assert abs(falling - exact()) < 0.01
assert rising > 29.0
assert one < 2.5
PY

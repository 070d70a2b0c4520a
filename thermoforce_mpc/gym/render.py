"""Picture of an episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from thermoforce_mpc.data import HOUR_S, Array


def drawn(
    trace: Sequence[tuple[Mapping[str, float], Array]], rewards: Sequence[float], actions: Sequence[str]
) -> NDArray[np.uint8]:
    """Temperatures with their bounds, actions and summed reward over the hours, as pixels (400, 800, 3).

    Args:
        trace: measured values by name, °C for names that begin with T, and actions (A,), one pair per step.
        rewards: reward of each step.
        actions: names of the actions.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    above, below, last = figure.subplots(3, 1, sharex=True, height_ratios=(3, 1, 1))
    if trace:
        hours = (np.array([state["time"] for state, _ in trace]) - trace[0][0]["time"]) / HOUR_S
        for name in trace[0][0]:
            values = [state[name] for state, _ in trace]
            if name.startswith("T_zone"):
                above.plot(hours, values, label=name)
            elif name.startswith(("lower", "upper")):
                above.plot(hours, values, color="0.6", linewidth=1, drawstyle="steps-post")
        for i, name in enumerate(actions):
            below.plot(hours, [action[i] for _, action in trace], drawstyle="steps-pre", label=name)
        last.plot(hours, np.cumsum(rewards))
        above.legend(fontsize=7, ncols=3)
    above.set_ylabel("°C")
    below.set_ylabel("action")
    last.set_ylabel("reward")
    last.set_xlabel("hours")
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()

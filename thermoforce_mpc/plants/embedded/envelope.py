"""Step of an envelope: implicit Euler (first order, L-stable) with film coefficients of the previous step. Compiled.

The nodes of all constructions form one tridiagonal system that shares only the air and the radiant node. It is solved
for three right-hand sides (constant, per K of air, per K of the radiant node); with the balance of the radiant node,
and that of the air, these two follow.
"""

from __future__ import annotations

import numpy as np

from thermoforce_mpc.data.compiled import njit
from thermoforce_mpc.plants.embedded import exposure as x
from thermoforce_mpc.plants.embedded import houses as c

_SIGMA = 5.670374419e-8
_ZERO_ROUNDING_K = 1e-4
# Columns of the work space (n, 5) of a step: the three right-hand sides, the diagonal, and its factors.
CONSTANT, OF_AIR, OF_STAR, _DIAGONAL, _FACTOR = range(5)
# Columns of what differs from the schedule, held for 15 min: people, heat of cooking W, air changes by windows 1/h.
PEOPLE, COOKING, WINDOWS = range(3)
# Where people keep to it.
AS_SCHEDULED = np.zeros((1, 3))


@njit(cache=True, inline="always")
def read_weather(grid: np.ndarray, time_s: float, w: np.ndarray) -> None:
    """Interpolate the exposure linearly at `time_s` into `w` (19,)."""
    at = (time_s % ((grid.shape[0] - 1) * x.GRID_S)) / x.GRID_S
    row = int(at)
    share = at - row
    for j in range(x.N_COLUMNS):
        w[j] = (1.0 - share) * grid[row, j] + share * grid[row + 1, j]


@njit(cache=True)
def films(nodes: np.ndarray, T_air: float, env: c.Envelope, film: np.ndarray) -> None:
    """Write the film conductances of the inside surfaces, W/K, into `film` (k,)."""
    for k in range(env.inside.size):
        difference = nodes[env.inside[k]] - T_air
        if env.facing[k] == c.UPRIGHT:
            film[k] = env.film[k, 0] * (abs(difference) + _ZERO_ROUNDING_K) ** env.film_exponent[k, 0]
        else:
            rising = difference if env.facing[k] == c.FLOOR else -difference
            d = abs(rising) + _ZERO_ROUNDING_K
            share = min(max(0.5 + 0.5 * rising / env.blend_K, 0.0), 1.0)
            share = share * share * (3.0 - 2.0 * share)
            film[k] = (
                share * env.film[k, 0] * d ** env.film_exponent[k, 0]
                + (1.0 - share) * env.film[k, 1] * d ** env.film_exponent[k, 1]
            )


@njit(cache=True)
def respond(
    nodes: np.ndarray,
    film: np.ndarray,
    radiant_W: float,
    heat_W: np.ndarray,
    dt: float,
    w: np.ndarray,
    env: c.Envelope,
    work: np.ndarray,
) -> None:
    """Solve a step of `dt` s into `work` (n, 5): nodes = constant + of air · T_air + of star · T_star.

    `film` (k,) W/K, see `films`; `radiant_W` radiant gains; `heat_W` heat into the nodes `env.heated`, W; `w` (19,)
    the exposure at the end of the step.
    """
    n, n_inside = nodes.size, env.inside.size
    for i in range(n):
        work[i, _DIAGONAL] = env.capacity[i] / dt + env.coupling[i] + (env.coupling[i - 1] if i > 0 else 0.0)
        work[i, CONSTANT] = env.capacity[i] / dt * nodes[i]
        work[i, OF_AIR] = 0.0
        work[i, OF_STAR] = 0.0
    for k in range(env.heated.size):
        work[env.heated[k], CONSTANT] += heat_W[k]
    work[env.ground, _DIAGONAL] += env.ground_W_K
    work[env.ground, CONSTANT] += env.ground_W_K * env.ground_K
    for k in range(6):
        i = env.outside[k]
        view, area = env.sky_view[k], env.outside_m2[k]
        surroundings4 = view * w[x.T_SKY] ** 4 + (1.0 - view) * w[x.T_OUT] ** 4
        environment = surroundings4**0.25
        difference = nodes[i] - w[x.T_OUT]
        natural = env.natural[k, 1 if difference > 0.0 else 0] * abs(difference) ** (1.0 / 3.0)
        forced = w[x.FORCED + k]
        convective = area * (natural + forced if env.adds_forced else np.sqrt(natural**2 + forced**2))
        sun = 0.0
        if k == c.WINDOW:
            radiative = area * env.pane_radiation
            if env.radiates_linearly:
                environment = (surroundings4 + 3.0 * c.START_K**4) / (4.0 * c.START_K**3)
        else:
            T = environment if env.radiates_linearly else nodes[i]
            radiative = area * env.emissivity * _SIGMA * (T + environment) * (T * T + environment * environment)
            sun = area * w[x.ABSORBED + k]
        work[i, _DIAGONAL] += convective + radiative
        work[i, CONSTANT] += convective * w[x.T_OUT] + radiative * environment + sun
    for k in range(4):
        work[env.panes[k], CONSTANT] += 0.5 * w[x.PANE_OUTER if k < 2 else x.PANE_INNER]
    for k in range(n_inside):
        i = env.inside[k]
        absorbed = env.beam[k] * w[x.BEAM_IN] + env.diffuse[k] * w[x.DIFFUSE_IN] + env.emitted[k] * radiant_W
        work[i, _DIAGONAL] += film[k] + env.radiant_W_K[k]
        work[i, CONSTANT] += absorbed
        work[i, OF_AIR] += film[k]
        work[i, OF_STAR] += env.radiant_W_K[k]

    # Thomas algorithm for all constructions at once: couplings between them are zero.
    work[0, _FACTOR] = work[0, _DIAGONAL]
    for i in range(1, n):
        ratio = env.coupling[i - 1] / work[i - 1, _FACTOR]
        work[i, _FACTOR] = work[i, _DIAGONAL] - ratio * env.coupling[i - 1]
        for j in range(3):
            work[i, j] += ratio * work[i - 1, j]
    for j in range(3):
        work[n - 1, j] /= work[n - 1, _FACTOR]
    for i in range(n - 2, -1, -1):
        for j in range(3):
            work[i, j] = (work[i, j] + env.coupling[i] * work[i + 1, j]) / work[i, _FACTOR]


@njit(cache=True)
def air_and_star(
    stored_W_K: float, source_W: float, film: np.ndarray, radiant_W: float, env: c.Envelope, work: np.ndarray
) -> tuple[float, float]:
    """Return the temperatures of the air and of the massless radiant node at the end of a step, K.

    The air takes `source_W` and gives `stored_W_K` times its temperature, besides its exchange with the surfaces.
    """
    m11, m12, r1 = stored_W_K, 0.0, source_W
    m21, m22, r2 = 0.0, 0.0, env.emitted_to_star * radiant_W
    for k in range(env.inside.size):
        i = env.inside[k]
        m11 += film[k] * (1.0 - work[i, OF_AIR])
        m12 -= film[k] * work[i, OF_STAR]
        r1 += film[k] * work[i, CONSTANT]
        m21 -= env.radiant_W_K[k] * work[i, OF_AIR]
        m22 += env.radiant_W_K[k] * (1.0 - work[i, OF_STAR])
        r2 += env.radiant_W_K[k] * work[i, CONSTANT]
    determinant = m11 * m22 - m12 * m21
    return (r1 * m22 - m12 * r2) / determinant, (m11 * r2 - m21 * r1) / determinant


@njit(cache=True)
def star_beside(T_air: float, radiant_W: float, env: c.Envelope, work: np.ndarray) -> float:
    """Return the temperature of the radiant node at the end of a step in which the air is at `T_air`, K."""
    balance, given = env.emitted_to_star * radiant_W, 0.0
    for k in range(env.inside.size):
        i = env.inside[k]
        given += env.radiant_W_K[k] * (1.0 - work[i, OF_STAR])
        balance += env.radiant_W_K[k] * (work[i, CONSTANT] + work[i, OF_AIR] * T_air)
    return balance / given


@njit(cache=True)
def settle(nodes: np.ndarray, T_air: float, T_star: float, work: np.ndarray) -> None:
    """Set the nodes (n,) to the end of the step."""
    for i in range(nodes.size):
        nodes[i] = work[i, CONSTANT] + work[i, OF_AIR] * T_air + work[i, OF_STAR] * T_star


@njit(cache=True)
def radiant_temperature(nodes: np.ndarray, env: c.Envelope) -> float:
    """Return the mean radiant temperature of the inside surfaces, K."""
    radiant = 0.0
    for k in range(env.inside.size):
        radiant += env.weight[k] * nodes[env.inside[k]]
    return radiant

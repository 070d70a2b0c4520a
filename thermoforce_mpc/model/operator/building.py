"""Operator of a building: one monotone operator per pair of zone and actuator, rolled out over a horizon.

F_z = Σ_a F_za with F_za as in `operator.parameters` (paper eq:operator), so the sign of an effect is certified pair by
pair. What an actuator delivers, v(u, T_out) and its modulation m(x), does not depend on where the heat goes: all pairs
of one actuator share it, with the features x of the actuator's home zone, and only poles and gains are the pair's own.
A pair without an effect is None. One zone with one actuator is `single`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from thermoforce_mpc.data import SINGLE, Array
from thermoforce_mpc.data.series import first_order
from thermoforce_mpc.errors import DataError
from thermoforce_mpc.model.operator.certificate import Certificate, certificate
from thermoforce_mpc.model.operator.parameters import N_FEATURES, OperatorParameters

# What all pairs of one actuator have in common.
_OF_ACTUATOR = (
    "hidden_weight", "hidden_bias", "output_weight", "output_bias", "feature_mean", "feature_scale", "gamma", "sign",
    "heat_input", "feedback",
)  # fmt: skip


def forced_rollout(params: OperatorParameters, F0: Array, u: Array, features: Array) -> Array:
    """Return the forced state of every mode at the end of each of N steps (paper eq:operator), (..., N, r), K.

    `F0` (..., r) K is now, `u` (..., N) in [0, 1], `features` (..., N, 4) at the start of each step with T − F. Raises
    `DataError` where shapes do not fit together, or a value is not finite.
    """
    u = np.asarray(u, dtype=np.float64)
    F0 = np.asarray(F0, dtype=np.float64)
    features = np.asarray(features, dtype=np.float64)
    if u.ndim < 1 or features.shape[-2:] != (u.shape[-1], N_FEATURES):
        raise DataError(f"forced rollout: u {u.shape} and features {features.shape} do not describe the same steps")
    if F0.shape[-1:] != (params.order,):
        raise DataError(f"forced rollout: F0 has shape {F0.shape}, expected (..., {params.order})")
    if not (np.isfinite(u).all() and np.isfinite(F0).all() and np.isfinite(features).all()):
        raise DataError("forced rollout: u, F0 and features must be finite")
    if params.feedback_active:
        return _stepwise(params, F0, u, features)
    return driven_rollout(params, F0, params.drive(u, features))


def driven_rollout(params: OperatorParameters, F0: Array, drive: Array) -> Array:
    """Return the forced state of every mode for a known m(x)·v: `F0` (..., r) K, `drive` (..., N) → (..., N, r) K."""
    lead = np.broadcast_shapes(drive.shape[:-1], F0.shape[:-1])
    drives = np.broadcast_to(drive, (*lead, drive.shape[-1]))[..., None] * params.gains
    return first_order(params.poles, drives, F0)


def _stepwise(params: OperatorParameters, F0: Array, u: Array, features: Array) -> Array:
    """Roll out step by step, all candidates at once, for m(x) that depends on F."""
    lead = np.broadcast_shapes(u.shape[:-1], features.shape[:-2], F0.shape[:-1])
    n = u.shape[-1]
    forced = np.empty((*lead, n, params.order))
    state = np.broadcast_to(F0, (*lead, params.order))
    for t in range(n):
        state = params.step(state, u[..., t], features[..., t, :])
        forced[..., t, :] = state
    return forced


@dataclass(frozen=True)
class BuildingOperator:
    """Operators of Z zones and A actuators; raises `DataError` where names or pairs do not fit together.

    `pairs[z][a]`: the operator of actuator a on zone z, or None where it has no effect; all have one step. `home` (A,):
    zone whose features enter the modulation of each actuator, which must have an effect there.
    """

    zones: tuple[str, ...]
    actuators: tuple[str, ...]
    pairs: tuple[tuple[OperatorParameters | None, ...], ...]
    home: tuple[int, ...]

    def __post_init__(self) -> None:
        for what, names in (("zone", self.zones), ("actuator", self.actuators)):
            if not names or len(set(names)) != len(names):
                raise DataError(f"building operator: names of {what}s {list(names)}: need one or more, each once")
        Z, A = len(self.zones), len(self.actuators)
        if len(self.pairs) != Z or any(len(row) != A for row in self.pairs):
            raise DataError(f"building operator: pairs are not {Z} zones of {A} actuators each")
        if len(self.home) != A or not all(0 <= z < Z for z in self.home):
            raise DataError(f"building operator: home {self.home}: expected a zone's number below {Z} per actuator")
        step_s = self.step_s
        for z, a, pair in self.each():
            where = f"building operator: {self.actuators[a]} on {self.zones[z]}"
            if pair.step_s != step_s:
                raise DataError(f"{where}: step {pair.step_s:g} s differs from the first actuator's")
            home = self.of_actuator(a)
            for name in _OF_ACTUATOR:
                if not np.array_equal(getattr(pair, name), getattr(home, name)):
                    raise DataError(f"{where}: {name} differs from that of its home zone")
            if pair.feedback_active and (Z > 1 or A > 1):
                raise DataError(
                    f"{where}: feedback of the predicted temperature is for one zone and one actuator: with several, "
                    "an action changes the gain of all others of its zone, which the certificate does not bound"
                )

    def each(self) -> Iterator[tuple[int, int, OperatorParameters]]:
        """Zone, actuator and operator of every pair with an effect."""
        for z, row in enumerate(self.pairs):
            for a, pair in enumerate(row):
                if pair is not None:
                    yield z, a, pair

    def of_actuator(self, a: int) -> OperatorParameters:
        """The operator of actuator `a` on its home zone: its sign, heat input and modulation."""
        pair = self.pairs[self.home[a]][a]
        if pair is None:
            raise DataError(
                f"building operator: {self.actuators[a]} has no effect in its home zone {self.zones[self.home[a]]}"
            )
        return pair

    @cached_property
    def of_actuators(self) -> tuple[OperatorParameters, ...]:
        """`of_actuator` of each actuator (A,)."""
        return tuple(self.of_actuator(a) for a in range(len(self.actuators)))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Zones Z, actuators A, highest order of the pairs r."""
        return len(self.zones), len(self.actuators), max(pair.order for *_, pair in self.each())

    @property
    def step_s(self) -> float:
        """Step of poles and gains, s."""
        return self.of_actuator(0).step_s

    @property
    def signs(self) -> Array:
        """Sign of each actuator (A,): +1 heating, −1 cooling."""
        return np.array([float(own.sign) for own in self.of_actuators])

    @property
    def u_min(self) -> Array:
        """Lowest level of each actuator (A,): 0, or below where it heats and cools."""
        return np.array([own.heat_input.u_min for own in self.of_actuators])

    @cached_property
    def gains(self) -> Array:
        """g (Z, A, r), K per step; 0 where there is no effect, and beyond a pair's order."""
        return self._stacked("gains")

    @cached_property
    def poles(self) -> Array:
        """a (Z, A, r); 0 as `gains`."""
        return self._stacked("poles")

    @cached_property
    def steady_gains_K(self) -> Array:
        """Steady effect of full level (Z, A, r), K; 0 as `gains`."""
        return self._stacked("steady_gains_K")

    def _stacked(self, name: str) -> Array:
        out = np.zeros(self.shape)
        for z, a, pair in self.each():
            out[z, a, : pair.order] = getattr(pair, name)
        return out

    def drive(self, u: Array, features: Array) -> Array:
        """Drive m(x)·v of each actuator: `u` (..., A, N), `features` (Z, N, 4) with T − F → (..., A, N)."""
        u, features = np.asarray(u, dtype=np.float64), np.asarray(features, dtype=np.float64)
        each = enumerate(zip(self.home, self.of_actuators, strict=True))
        return np.stack([own.drive(u[..., a, :], features[z]) for a, (z, own) in each], axis=-2)

    def rollout(self, F0: Array, u: Array, features: Array) -> Array:
        """Forced state of every pair at the end of each of N steps (paper eq:operator), (..., Z, A, N, r), K.

        `F0` (Z, A, r) K is now, `u` (..., A, N), `features` (Z, N, 4) at the start of each step with T − F. The sum
        over actuators and modes is the forced response of a zone. Raises `DataError` as `forced_rollout`.
        """
        u, F0, features = (np.asarray(value, dtype=np.float64) for value in (u, F0, features))
        Z, A, r = self.shape
        n = u.shape[-1] if u.ndim > 1 else -1
        if u.shape[-2:] != (A, n) or features.shape != (Z, n, N_FEATURES) or F0.shape != (Z, A, r):
            raise DataError(
                f"forced rollout of {Z} zones and {A} actuators: u {u.shape}, features {features.shape} and "
                f"F0 {F0.shape} do not describe the same steps"
            )
        if not (np.isfinite(u).all() and np.isfinite(F0).all() and np.isfinite(features).all()):
            raise DataError("forced rollout: u, F0 and features must be finite")
        if self.of_actuator(0).feedback_active:
            return forced_rollout(self.of_actuator(0), F0[0, 0], u[..., 0, :], features[0])[..., None, None, :, :]
        return self.driven(F0, self.drive(u, features))

    def driven(self, F0: Array, drive: Array) -> Array:
        """Forced state for known drives: `F0` (Z, A, r) K, `drive` (..., A, N) → (..., Z, A, N, r) K."""
        Z, A, r = self.shape
        out = np.zeros((*drive.shape[:-2], Z, A, drive.shape[-1], r))
        for z, a, pair in self.each():
            out[..., z, a, :, : pair.order] = driven_rollout(pair, F0[z, a, : pair.order], drive[..., a, :])
        return out

    def modulated(self, heat: Array, features: Array, forced_K: Array) -> Array:
        """Drive of one step: v = `heat` (A,), `features` (Z, 4) with T − F, forced state (Z, A, r) K → m·v (A,)."""
        each = enumerate(zip(self.home, self.of_actuators, strict=True))
        return np.array([own.modulation(own.seen(features[z], forced_K[z, a])) * heat[a] for a, (z, own) in each])

    def advance(self, forced_K: Array, drive: Array) -> Array:
        """Advance one step of eq:operator: `forced_K` (Z, A, r) K under `drive` m·v (A,) → (Z, A, r) K."""
        return np.asarray(self.poles * forced_K + self.gains * drive[:, None])

    @property
    def constant_modulation(self) -> bool:
        """Whether no modulation depends on the features."""
        return all(own.constant_modulation is not None for own in self.of_actuators)

    def resampled(self, step_s: float) -> BuildingOperator:
        """The operator at another step, pair by pair."""
        if step_s == self.step_s:
            return self
        return self.map(lambda pair: pair.resampled(step_s))

    def map(self, change: Callable[[OperatorParameters], OperatorParameters]) -> BuildingOperator:
        """The operator with `change` applied to every pair."""
        return self.map_pairs(lambda z, a, pair: change(pair))

    def map_actuators(self, change: Callable[[int, OperatorParameters], OperatorParameters]) -> BuildingOperator:
        """The operator with `change` applied to every pair, given the actuator's number."""
        return self.map_pairs(lambda z, a, pair: change(a, pair))

    def map_pairs(self, change: Callable[[int, int, OperatorParameters], OperatorParameters]) -> BuildingOperator:
        """The operator with `change` applied to every pair, given the numbers of zone and actuator."""
        pairs = tuple(
            tuple(None if pair is None else change(z, a, pair) for a, pair in enumerate(row))
            for z, row in enumerate(self.pairs)
        )
        return replace(self, pairs=pairs)

    def certificates(self, n_steps: int = 48) -> dict[tuple[str, str], Certificate]:
        """Certificate of every pair with an effect, by names of zone and actuator (paper, proposition)."""
        return {(self.zones[z], self.actuators[a]): certificate(pair, n_steps) for z, a, pair in self.each()}

    @property
    def n_trained(self) -> int:
        """Trained parameters: poles and gains of each pair, and each actuator's modulation once."""
        return self._counted(lambda head: head.n_trained)

    @property
    def n_used(self) -> int:
        """Trained parameters that enter predictions, see `OperatorParameters.n_used`."""
        return self._counted(lambda head: head.n_used)

    def _counted(self, count: Callable[[OperatorParameters], int]) -> int:
        modulation = sum(count(own) - 2 * own.order for own in self.of_actuators)
        return sum(2 * pair.order for *_, pair in self.each()) + modulation


def single(operator: OperatorParameters) -> BuildingOperator:
    """One zone with one actuator."""
    return BuildingOperator(SINGLE.zones, SINGLE.actuators, ((operator,),), (0,))

"""Largest posterior of all rooms of a building together, in which a wall or door has one conductance.

Two rooms see it, each beside heat of its own that was not measured: where one of them knows it better, all that the
other one took for it goes with it. Fits of single rooms say where to begin, and their curvature, how far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from thermoforce_mpc.data import Array
from thermoforce_mpc.identification.network.estimate import RoomFit
from thermoforce_mpc.identification.network.room import BETWEEN, neighbours_of

# Largest slope by a standard deviation at which a search ends, nats, and its most steps: as from one fit to another
# near it.
_FLAT, _MOST_STEPS = 1e-2, 200


@dataclass(frozen=True)
class JointPosterior:
    """Posterior of the `rooms` of a building (Z,), of floor areas `area_m2` (Z,), by what is free of their parameters.

    Free (Q,) are θ of all rooms (P,), one after the other, but of a wall or door, which two rooms have in θ per m² of
    their floors, the logarithm of its conductance in W/K. Its prior is between those of the two rooms, in the middle:
    half of each counts.
    """

    rooms: Sequence[RoomFit]
    area_m2: Array

    @cached_property
    def free(self) -> Array:
        """The most likely of what is free (Q,)."""
        from scipy.optimize import minimize

        own = np.concatenate([fit.theta for fit in self.rooms])
        if not self._shared.any():
            return own
        covariances = [fit.covariance for fit in self.rooms]
        weights = self._joints.T / np.concatenate([np.diagonal(covariance) for covariance in covariances])
        start = weights @ (own - self._shift) / weights.sum(axis=1)
        root = np.linalg.cholesky(self._together(covariances))

        def by_sds(x: Array) -> tuple[float, Array]:
            value, slope = self._value(start + root @ x)
            return value, slope @ root

        options = {"gtol": _FLAT, "maxiter": _MOST_STEPS}
        found = minimize(by_sds, np.zeros(start.size), jac=True, method="BFGS", options=options)
        return np.asarray(start + root @ found.x)

    @cached_property
    def covariance(self) -> Array:
        """Covariance of what is free (Q, Q), by the curvature at the most likely."""
        thetas = self.thetas(self.free)
        return self._together([fit.covariance_at(theta) for fit, theta in zip(self.rooms, thetas, strict=True)])

    @cached_property
    def positive(self) -> NDArray[np.intp]:
        """Which of what is free are logarithms of positive parameters (K,)."""
        of_rooms = np.concatenate([np.arange(fit.theta.size) < len(fit.room.names) for fit in self.rooms])
        return np.flatnonzero(of_rooms @ self._joints)

    def thetas(self, free: Array) -> list[Array]:
        """θ of each room (Z,) at values of what is free (Q,)."""
        return np.split(self._joints @ free + self._shift, self._begins[1:-1])

    @property
    def sds(self) -> list[Array]:
        """Standard deviation of θ of each room (Z,)."""
        joints = self._joints
        return np.split(np.sqrt(np.sum(joints @ self.covariance * joints, axis=1)), self._begins[1:-1])

    def _value(self, free: Array) -> tuple[float, Array]:
        """Half the negative log posterior up to a constant, and its gradient (Q,); infinite where a room's is."""
        thetas = self.thetas(free)
        of_rooms = [fit.posterior(theta) for fit, theta in zip(self.rooms, thetas, strict=True)]
        value, slope = sum(value for value, _ in of_rooms), np.concatenate([slope for _, slope in of_rooms])
        if not np.isfinite(value):
            return np.inf, np.zeros_like(free)
        away = np.concatenate(thetas) - np.concatenate([fit.room.mean for fit in self.rooms])
        twice = self._twice
        return float(value - 0.5 * twice @ away**2), (slope - twice * away) @ self._joints

    def _together(self, covariances: Sequence[Array]) -> Array:
        """Covariance of what is free (Q, Q), of that of θ of each room by itself (Z,)."""
        precision = block_diag(*map(np.linalg.inv, covariances)) - np.diag(self._twice)
        return np.asarray(np.linalg.inv(self._joints.T @ precision @ self._joints))

    @property
    def _twice(self) -> Array:
        """Precision of the half of each room's prior that does not count (P,)."""
        return np.where(self._shared, 0.5 / np.concatenate([fit.room.sd for fit in self.rooms]) ** 2, 0.0)

    @property
    def _begins(self) -> NDArray[np.intp]:
        """Where θ of each room begins among those of all, and how many these are (Z + 1,)."""
        return np.cumsum([0, *(fit.theta.size for fit in self.rooms)])

    @cached_property
    def _shared(self) -> NDArray[np.bool_]:
        """Which of θ of all rooms two of them have (P,)."""
        shared = np.zeros(self._begins[-1], dtype=bool)
        shared[[here for _, here, _ in self._sides()]] = True
        return shared

    @cached_property
    def _joints(self) -> Array:
        """θ of all rooms, but for `_shift`, as a linear function of what is free (P, Q)."""
        of = np.arange(self._begins[-1])
        for _, here, there in self._sides():
            of[here] = min(here, there)
        return np.asarray(of[:, None] == np.unique(of), dtype=np.float64)

    @cached_property
    def _shift(self) -> Array:
        """θ of all rooms where what is free is 0 (P,): from W/K to those per m² of floor."""
        shift = np.zeros(self._begins[-1])
        for z, here, _ in self._sides():
            shift[here] = -np.log(self.area_m2[z])
        return shift

    def _sides(self) -> Iterator[tuple[int, int, int]]:
        """A room and where it has a wall or door among θ of all rooms, and where the other one has it."""
        begins, Z = self._begins, len(self.rooms)

        def place(name: str, here: int, there: int) -> int:
            k = neighbours_of(here, Z).index(there)
            return int(begins[here]) + self.rooms[here].room.place[f"{name}_{k}"]

        for z, fit in enumerate(self.rooms):
            for other in neighbours_of(z, Z) if fit.room.neighbours else ():
                for name in BETWEEN:
                    yield z, place(name, z, other), place(name, other, z)

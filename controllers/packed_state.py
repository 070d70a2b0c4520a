"""The state of a building as a planning process hands it out: packed, and named, so that it need not travel twice."""

from __future__ import annotations

import pickle
from dataclasses import dataclass


@dataclass(frozen=True, eq=False)
class PackedState:
    """A controller's state in bytes. It may be pickled, as any state.

    Attributes:
        name: of no other state; the process that packed it still knows it by this name for a while.
        packed: the state, pickled.
    """

    name: str
    packed: bytes | memoryview

    def unpacked(self) -> object:
        """The state itself."""
        return pickle.loads(self.packed)

    def __reduce__(self) -> tuple[type[PackedState], tuple[str, bytes]]:
        return PackedState, (self.name, bytes(self.packed))

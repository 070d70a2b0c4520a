"""Typed client for the BOPTEST REST protocol; contains no control code."""

from boptest_client.client import BoptestClient
from boptest_client.errors import (
    AdvanceInterrupted,
    BadAddress,
    BoptestError,
    ConnectError,
    ConnectionLost,
    InternalError,
    Moved,
    ProtocolError,
    RequestRejected,
    ServiceError,
    ServiceTimeout,
    TransportError,
    UnknownTest,
)
from boptest_client.transport import TransportConfig
from boptest_client.types import Point, Scenario

__all__ = [
    "AdvanceInterrupted",
    "BadAddress",
    "BoptestClient",
    "BoptestError",
    "ConnectError",
    "ConnectionLost",
    "InternalError",
    "Moved",
    "Point",
    "ProtocolError",
    "RequestRejected",
    "Scenario",
    "ServiceError",
    "ServiceTimeout",
    "TransportConfig",
    "TransportError",
    "UnknownTest",
]

"""Typed client for the BOPTEST REST protocol; contains no control code."""

from boptest_client.answers import Point, ServiceScenario, safe_text
from boptest_client.client import BoptestClient
from boptest_client.errors import (
    AdvanceInterrupted,
    BadAddress,
    BoptestError,
    ConnectError,
    ConnectionLost,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceError,
    ServiceTimeout,
    TlsError,
    TransportError,
    UnknownTest,
)
from boptest_client.transport import TransportConfig

__all__ = [
    "AdvanceInterrupted",
    "BadAddress",
    "BoptestClient",
    "BoptestError",
    "ConnectError",
    "ConnectionLost",
    "InternalError",
    "Point",
    "ProtocolError",
    "RequestRejected",
    "ServiceError",
    "ServiceScenario",
    "ServiceTimeout",
    "TlsError",
    "TransportConfig",
    "TransportError",
    "UnknownTest",
    "safe_text",
]

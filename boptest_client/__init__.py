"""Typed client for the BOPTEST REST protocol; knows nothing about control."""

from boptest_client.client import BoptestClient
from boptest_client.errors import (
    BoptestError,
    ConnectError,
    InternalError,
    ProtocolError,
    RequestRejected,
    ServiceError,
    ServiceTimeout,
    TransportError,
    UnknownTest,
)
from boptest_client.transport import TransportConfig
from boptest_client.types import Point

__all__ = [
    "BoptestClient",
    "BoptestError",
    "ConnectError",
    "InternalError",
    "Point",
    "ProtocolError",
    "RequestRejected",
    "ServiceError",
    "ServiceTimeout",
    "TransportConfig",
    "TransportError",
    "UnknownTest",
]

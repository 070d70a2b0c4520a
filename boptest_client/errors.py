"""The client's errors, as a tree one can catch at any height.

BoptestError
├── BadAddress            the base URL is not an http(s) address
├── TransportError        no usable answer came
│   ├── ConnectError        no connection was made: nothing was sent
│   ├── ConnectionLost      the connection broke before the answer was complete
│   ├── ServiceTimeout      no answer in time
│   └── AdvanceInterrupted  no answer to a step, and the state of the test could not be told
├── ProtocolError         an answer came, but not BOPTEST's envelope
└── ServiceError          the service said no
    ├── RequestRejected     400: what was asked is wrong
    ├── UnknownTest         the test case or test is not known there (any more)
    └── InternalError       500 and above
"""

from __future__ import annotations


class BoptestError(Exception):
    """Base of all errors of this client; `endpoint` says which request, `message` what happened."""

    def __init__(self, endpoint: str, message: str) -> None:
        super().__init__(f"{endpoint}: {message}")
        self.endpoint, self.message = endpoint, message


class BadAddress(BoptestError):
    """The base URL of the service is not an http(s) address."""


class TransportError(BoptestError):
    """No usable answer came from the service."""


class ConnectError(TransportError):
    """The service cannot be reached; nothing was sent."""


class ConnectionLost(TransportError):
    """The connection broke after the request went out; the service may have acted on it."""


class ServiceTimeout(TransportError):
    """The service did not answer in time; it may still act on the request."""


class AdvanceInterrupted(TransportError):
    """No answer came to a step, and whether it was simulated could not be found out: start the run again."""


class ProtocolError(BoptestError):
    """The answer is not what the protocol says."""


class ServiceError(BoptestError):
    """The service answered with an error; `status` is the HTTP status."""

    def __init__(self, endpoint: str, message: str, status: int) -> None:
        super().__init__(endpoint, f"{message} (HTTP {status})")
        self.status = status


class RequestRejected(ServiceError):
    """The service found the request wrong (400)."""


class UnknownTest(ServiceError):
    """The test case or test is not known there (any more): stopped, timed out, or never was."""


class InternalError(ServiceError):
    """The service failed inside (500 and above)."""

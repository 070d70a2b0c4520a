"""Errors of the client: no usable answer, an answer of something else, or an error that the service tells."""

from __future__ import annotations


class BoptestError(Exception):
    """Base of all errors of this client; `endpoint` names the request, `message` the failure."""

    def __init__(self, endpoint: str, message: str) -> None:
        super().__init__(f"{endpoint}: {message}")
        self.endpoint, self.message = endpoint, message

    def add(self, words: str) -> None:
        """Let `words` follow the message."""
        self.message += words
        self.args = (f"{self.endpoint}: {self.message}",)


class BadAddress(BoptestError):
    """The base URL of the service is not an http(s) address."""


class TransportError(BoptestError):
    """No usable answer from the service."""


class ConnectError(TransportError):
    """The service cannot be reached; nothing was sent."""


class TlsError(ConnectError):
    """No encrypted connection: the port speaks plain HTTP, or the certificate is not trusted."""


class ConnectionLost(TransportError):
    """The connection broke after the request went out; the service may have acted on it."""


class ServiceTimeout(TransportError):
    """The service did not answer in time; it may still act on the request."""


class AdvanceInterrupted(TransportError):
    """A step failed until patience was out; `BoptestClient.go_on_from` finds out whether it was simulated."""


class ProtocolError(BoptestError):
    """The answer is not one of a BOPTEST service, or of another time: what came is told."""


class ServiceError(BoptestError):
    """The service answered with an error; `status` is the HTTP status."""

    def __init__(self, endpoint: str, message: str, status: int) -> None:
        super().__init__(endpoint, f"{message} (HTTP {status})")
        self.status = status


class RequestRejected(ServiceError):
    """The service rejected the request (400)."""


class UnknownTest(ServiceError):
    """The service says that the test case or test does not exist: unknown name, stopped, or timed out."""


class InternalError(ServiceError):
    """The service failed internally (500 and above), or has too much to do (429)."""

"""Seals authenticate the cell and the nodes it starts, because any session may claim any source id.

The cell makes a secret at its start and hands it to the nodes that it starts itself. Their samples and queries carry
a code over key, session, number and payload (HMAC-SHA256), which needs the secret.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets

_SECRET_BYTES = 32


class Seal:
    """Makes and checks seals with one secret.

    Attributes:
        secret: for the nodes that the cell starts; it goes through a pipe, never over the bus.
    """

    def __init__(self, secret: bytes) -> None:
        self.secret = secret

    @classmethod
    def new(cls) -> Seal:
        """Make a seal with a new random secret."""
        return cls(secrets.token_bytes(_SECRET_BYTES))

    def of(self, key: str, source: str, number: int, payload: bytes) -> bytes:
        """Return the seal of one payload.

        Args:
            key: the complete Zenoh key.
            source: the sending session.
            number: the session's number for this payload.
        """
        signed = hmac.new(self.secret, f"{key}\n{source}\n{number}\n".encode(), hashlib.sha256)
        signed.update(payload)
        return signed.digest()

    def fits(self, seal: bytes, key: str, source: str, number: int, payload: bytes) -> bool:
        """Whether ``seal`` was made with this secret for exactly this key, session, number and payload."""
        return hmac.compare_digest(seal, self.of(key, source, number, payload))

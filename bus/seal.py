"""Tells what the other holder of a secret said from what anybody else says, who may claim to be any session.

The cell makes a secret at its start, and hands it to the nodes that it starts itself. What these and the cell say and
ask carries a code over key, session, number and payload (HMAC-SHA256), which nobody else can make.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets

_SECRET_BYTES = 32


class Seal:
    """Seals, and looks at seals, with one secret.

    Attributes:
        secret: for whoever is to be believed; it goes through a pipe, never over the bus.
    """

    def __init__(self, secret: bytes) -> None:
        self.secret = secret

    @classmethod
    def new(cls) -> Seal:
        """With a secret that nobody knows yet."""
        return cls(secrets.token_bytes(_SECRET_BYTES))

    def of(self, key: str, source: str, number: int, payload: bytes) -> bytes:
        """The seal of what session ``source`` says on the whole ``key``, as its ``number``."""
        signed = hmac.new(self.secret, f"{key}\n{source}\n{number}\n".encode(), hashlib.sha256)
        signed.update(payload)
        return signed.digest()

    def fits(self, seal: bytes, key: str, source: str, number: int, payload: bytes) -> bool:
        """Whether the holder of the secret has sealed it."""
        return hmac.compare_digest(seal, self.of(key, source, number, payload))

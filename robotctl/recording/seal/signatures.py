"""Ed25519 signatures (RFC 8032), by libsodium.

PyNaCl is imported on first use: it takes 10 ms and 1.1 MB. The package `cryptography` took 8.6 MB.
"""

from __future__ import annotations

from typing import Final

SEED_BYTES: Final = 32


class SigningKey:
    """A private key."""

    def __init__(self, seed: bytes) -> None:
        """Take the 32 bytes that determine the key."""
        from nacl.bindings import crypto_sign_seed_keypair

        public, self._secret = crypto_sign_seed_keypair(seed)
        self.public: str = public.hex()
        """The public key in hex."""

    def sign(self, data: bytes) -> bytes:
        """Return the signature, 64 bytes."""
        from nacl.bindings import crypto_sign, crypto_sign_BYTES

        signed: bytes = crypto_sign(data, self._secret)
        return signed[:crypto_sign_BYTES]


def is_signed(data: bytes, signature: bytes, public: str) -> bool:
    """Return whether the holder of the private key of `public` (in hex) signed `data`."""
    from nacl.bindings import crypto_sign_open
    from nacl.exceptions import BadSignatureError

    try:
        crypto_sign_open(signature + data, bytes.fromhex(public))
    except (BadSignatureError, ValueError):
        return False
    return True

"""Finds the one bit whose flip explains a wrong CRC-32.

A CRC is linear: the flip of a bit changes it by a power of x, modulo the polynomial, and the
exponent is the distance of the bit from the end. Below 512 MB no two bits have the same one.
"""

from __future__ import annotations

from typing import Final

_POLYNOMIAL: Final = 0xEDB88320
_ONE: Final = 1 << 31
"""The polynomial 1: the lowest power is the highest bit."""

_ORDER: Final = (1 << 32) - 1
"""x to this power is 1."""

_STEPS: Final = 1 << 16
_REGISTER_BITS: Final = 32


def find_flip(told: int, found: int, size: int) -> int | None:
    """Return the offset of the byte in which one flipped bit explains the difference, or None.

    `told` and `found` are checksums of `size` bytes. The search takes 0.1 s for 100 MB.
    """
    if told == found:
        return None
    exponents = _exponents()
    giant, effect = _power(-_STEPS), told ^ found
    last = _REGISTER_BITS + 8 * size
    for begin in range(0, min(last, _ORDER), _STEPS):
        exponent = exponents.get(effect)
        if exponent is not None:
            behind = (begin + exponent - _REGISTER_BITS) // 8
            return size - 1 - behind if 0 <= behind < size else None
        effect = _product(effect, giant)
    return None


def _exponents() -> dict[int, int]:
    """Return the exponents of the first powers of x."""
    exponents = {}
    power = _ONE
    for exponent in range(_STEPS):
        exponents[power] = exponent
        power = power >> 1 ^ (_POLYNOMIAL if power & 1 else 0)
    return exponents


def _product(left: int, right: int) -> int:
    product = 0
    while left:
        if left & _ONE:
            product ^= right
        left = left << 1 & _ORDER
        right = right >> 1 ^ (_POLYNOMIAL if right & 1 else 0)
    return product


def _power(exponent: int) -> int:
    """Return x to a power, which may be negative."""
    exponent %= _ORDER
    result, base = _ONE, _ONE >> 1
    while exponent:
        if exponent & 1:
            result = _product(result, base)
        base = _product(base, base)
        exponent >>= 1
    return result

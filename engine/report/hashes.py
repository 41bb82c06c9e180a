"""Whole numbers from hashes, which decide ties and draws independently of the order of the input."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

Hashes = npt.NDArray[np.uint64]

_FACTORS = np.array([0x9E3779B97F4A7C15, 0xD6E8FEB86659FD93], np.uint64)


def hash_of(*parts: object) -> int:
    """Return a number of 64 bits for some values, equal in every process."""
    return int.from_bytes(hashlib.blake2b(repr(parts).encode(), digest_size=8).digest(), "big")


def permute(hashes: Hashes, salt: int) -> Hashes:
    """Permute all numbers of 64 bits, by the salt.

    Args:
        hashes: Numbers to permute (n).
        salt: Number of 64 bits that chooses the permutation.

    Returns:
        The number that each number becomes (n).
    """
    result = hashes ^ np.uint64(salt)
    for factor in _FACTORS:
        result = result * factor
        result ^= result >> np.uint64(32)
    return result


def in_hash_order(texts: Iterable[str], salt: str) -> tuple[str, ...]:
    """Return texts in an order that depends on them and the salt alone."""
    return tuple(sorted(texts, key=lambda text: hash_of(salt, text)))

"""A mutation loop for where atheris is not installed; inputs that are answered in a new way join the pool."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

import numpy as np

__all__ = ["mutated", "pool_of"]

MOST_POOLED, LONGEST = 400, 100_000


def _position(rng: np.random.Generator, data: bytes) -> int:
    return int(rng.integers(len(data) + 1))


def _once(rng: np.random.Generator, data: bytes, pool: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    a, b = sorted((_position(rng, data), _position(rng, data)))
    b = min(b, a + 64)
    kind = int(rng.integers(8))
    if kind == 0 and data:
        flipped = bytearray(data)
        flipped[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        return bytes(flipped)
    if kind == 1:
        return data[:a] + rng.bytes(int(rng.integers(1, 5))) + data[a:]
    if kind == 2:
        return data[:a] + data[b:]
    if kind == 3:
        return data[:b] + data[a:b] * int(rng.integers(1, 40)) + data[b:]
    if kind == 4:
        other = pool[int(rng.integers(len(pool)))]
        return data[:a] + other[_position(rng, other) :]
    word = words[int(rng.integers(len(words)))]
    if kind == 5:
        return data[:a] + word + data[a:]
    if kind == 6:
        return data[:a] + word + data[b:]
    numbers = list(re.finditer(rb"-?\d+(\.\d+)?", data))
    if not numbers:
        return data[:a] + word + data[a:]
    found = numbers[int(rng.integers(len(numbers)))]
    return data[: found.start()] + word + data[found.end() :]


def mutated(rng: np.random.Generator, pool: Sequence[bytes], words: Sequence[bytes]) -> bytes:
    """One of the pool, changed in one to five places."""
    data = pool[int(rng.integers(len(pool)))]
    for _ in range(int(rng.integers(1, 6))):
        data = _once(rng, data, pool, words)
    return data[:LONGEST]


def pool_of(
    rng: np.random.Generator, start: Sequence[bytes], words: Sequence[bytes], answer: Callable[[bytes], str]
) -> Iterator[None]:
    """Mutate for ever, one input each time; `answer` runs an input and says in words how it went."""
    pool, seen = [*start], {answer(data) for data in start}
    while True:
        data = mutated(rng, pool, words)
        how = answer(data)
        if how not in seen and len(pool) < MOST_POOLED:
            seen.add(how)
            pool.append(data)
        yield

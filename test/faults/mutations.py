# Copyright 2026 the uw_visibility developers
# SPDX-License-Identifier: Apache-2.0
"""Damage to bytes, as disks, cables and attackers do it; the same for the same seed."""

from __future__ import annotations

import random

ABSURD = (
    bytes(4), b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x80", bytes(8), b"\xff" * 8,
    b"\xff" * 7 + b"\x7f", b"\0\0\0\0\1\0\0\0", b"\1\0\0\0\0\0\0\0", b"\0\0\0\x40",
)


def flip_bit(data: bytes, rng: random.Random) -> bytes:
    """Turn one bit round."""
    changed = bytearray(data)
    changed[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def flip_bits(data: bytes, rng: random.Random) -> bytes:
    """Turn some bits round, close to one another or not."""
    spread = rng.choice((16, 1000, len(data)))
    begin = rng.randrange(len(data))
    changed = bytearray(data)
    for _ in range(rng.randrange(2, 40)):
        place = min(begin + rng.randrange(spread), len(data) - 1)
        changed[place] ^= 1 << rng.randrange(8)
    return bytes(changed)


def truncate(data: bytes, rng: random.Random) -> bytes:
    """Cut the end off."""
    return data[: rng.randrange(len(data))]


def cut_out(data: bytes, rng: random.Random) -> bytes:
    """Leave a part out."""
    begin = rng.randrange(len(data))
    return data[:begin] + data[begin + rng.choice((1, 4, 100, 4096, len(data) // 4)):]


def repeat(data: bytes, rng: random.Random) -> bytes:
    """Have a part twice."""
    begin = rng.randrange(len(data))
    end = begin + rng.choice((1, 8, 100, 4096, len(data) // 4))
    return data[:end] + data[begin:]


def write_absurd(data: bytes, rng: random.Random) -> bytes:
    """Put absurd numbers over some bytes, often near one of the ends, where sizes are."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 3))):
        number = rng.choice(ABSURD)
        width = rng.choice((200, 2000, len(data)))
        place = rng.randrange(min(width, len(data)))
        if rng.random() < 0.5:
            place = len(data) - 1 - place
        changed[place : place + len(number)] = number
    return bytes(changed[: len(data)])


def erase(data: bytes, rng: random.Random) -> bytes:
    """Put nothing over a block, as a disk that lost a page."""
    begin = rng.randrange(len(data)) // 512 * 512
    length = min(rng.choice((16, 512, 4096)), len(data) - begin)
    return data[:begin] + bytes(length) + data[begin + length:]


MUTATIONS = (flip_bit, flip_bits, truncate, cut_out, repeat, write_absurd, erase)


def mutate(data: bytes, rng: random.Random) -> tuple[str, bytes]:
    """Damage bytes in a way that the seed chooses; returns its name and the bytes."""
    mutation = rng.choice(MUTATIONS)
    return mutation.__name__, mutation(data, rng)

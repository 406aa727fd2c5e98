"""Sensor noise."""

import math


def philox4x32(counter, key):
    """Philox4x32-10 of Random123: four 32-bit words from a counter of four and a key of two."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(10):
        product0, product1 = 0xD2511F53 * c0, 0xCD9E8D57 * c2
        c0, c1 = (product1 >> 32) ^ c1 ^ k0, product1 & 0xFFFFFFFF
        c2, c3 = (product0 >> 32) ^ c3 ^ k1, product0 & 0xFFFFFFFF
        k0, k1 = (k0 + 0x9E3779B9) & 0xFFFFFFFF, (k1 + 0xBB67AE85) & 0xFFFFFFFF
    return c0, c1, c2, c3


def standard_normal(seed, sample_index, channel, replicate, day):
    """Draw the standard normal number [-] of one controller sample: one half of a Box-Muller pair.

    seed is an unsigned 64-bit integer, the other arguments are unsigned 32-bit integers.
    """
    counter = (sample_index // 2, channel, replicate, day)
    key = (seed & 0xFFFFFFFF, seed >> 32)
    r0, r1, r2, r3 = philox4x32(counter, key)
    u1, u2 = ((((low | high << 32) >> 12) + 0.5) * 2.0**-52 for low, high in ((r0, r1), (r2, r3)))
    radius, angle = math.sqrt(-2.0 * math.log(u1)), 2.0 * math.pi * u2
    return radius * (math.cos(angle) if sample_index % 2 == 0 else math.sin(angle))

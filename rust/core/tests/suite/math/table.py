"""Writes table.txt: arguments and correctly rounded results, as bits of f64.

    python3 table.py > table.txt

needs mpmath. One line each: function, x, y (0 where unused), result.
"""

import random
import struct
from fractions import Fraction

from mpmath import mp, mpf

mp.prec = 1400  # enough for x mod π at the largest x, and for cancellations


def rounded(v):
    """The nearest double, subnormals included."""
    sign, man, exp, _ = v._mpf_
    try:
        # Division of integers rounds correctly.
        q = float(Fraction(int(man)) * Fraction(2) ** exp)
    except OverflowError:
        q = float("inf")
    return -q if sign else q


def bits(v):
    return format(struct.unpack("<Q", struct.pack("<d", v))[0], "016x")


rng = random.Random(1)


def magnitude(lo, hi):
    """±2ᵉ·m, with e evenly distributed."""
    return rng.choice([-1, 1]) * rng.uniform(1, 2) * 2.0 ** rng.randint(lo, hi)


def next_to_poles(count):
    """Of the doubles next to multiples of π/2 below 2³⁰, the nearest."""
    half_pi = mp.pi / 2
    with mp.workprec(200):
        near = []
        for _ in range(40 * count):
            k = int(2 ** rng.uniform(0, 29))
            x = rounded(k * half_pi)
            near.append((float(abs(x - k * half_pi)), x))
    return [x for _, x in sorted(near)[:count]]


ANGLES = (
    [rng.uniform(-10, 10) for _ in range(8)]
    + [magnitude(2, 29) for _ in range(8)]
    + [magnitude(-40, 0) for _ in range(4)]
    + next_to_poles(10)
    + [1e22, -3e100, 1.7e308, 5e-324, 2.0**30, 2.0**30 + 1, 0.7853981633974483]
)
UNIT = (
    [rng.uniform(-1, 1) for _ in range(14)]
    + [magnitude(-40, -2) for _ in range(4)]
    + [1 - 2.0**-53, -1 + 2.0**-53, 1 - 1e-9, 1e-9 - 1, 0.5, -0.5, 0.5 + 2.0**-53, 5e-324]
)
REALS = (
    [rng.uniform(-4, 4) for _ in range(14)]
    + [magnitude(-40, 4) for _ in range(8)]
    + [rng.uniform(-700, 700) for _ in range(6)]
    + [1.0, -1.0, 0.34657359027997264, 5e-324, -1e-300, 18.5, 18.8, 19.0, 709.7, -744.0, 710.4]
)
POSITIVE = (
    [rng.uniform(0, 4) for _ in range(10)]
    + [abs(magnitude(-1020, 1020)) for _ in range(10)]
    + [1 + magnitude(-52, -2) for _ in range(6)]
    + [5e-324, 3e-310, 2.2250738585072014e-308, 1.7976931348623157e308, 0.7071067811865476, 2.0]
)
POWERS = (
    [(rng.uniform(0, 5), rng.uniform(-20, 20)) for _ in range(16)]
    + [(1 + magnitude(-30, -2), magnitude(2, 8)) for _ in range(8)]
    + [(x, rng.uniform(-744, 709) / float(mp.log(x))) for x in (abs(magnitude(-900, 900)) for _ in range(16))]
    + [(-2.5, 7.0), (-2.5, -6.0), (1 - 2.0**-53, 2.0**60), (1 + 2.0**-52, 3e18), (2.0, -1074.0), (10.0, -320.5)]
)
POINTS = (
    [(rng.uniform(-1, 1), rng.uniform(-1, 1)) for _ in range(16)]
    + [(magnitude(-1000, 1000), magnitude(-1000, 1000)) for _ in range(6)]
    + [(x, x * magnitude(-30, 30)) for x in (magnitude(-900, 900) for _ in range(12))]
    + [(1e308, 1.7e308), (-1e308, -2e307), (5e-324, -1e-323), (1e-310, 3e-310), (1e-300, 1e20), (1.0, -1e300)]
)
UNARY = {
    "sin": (mp.sin, ANGLES),
    "cos": (mp.cos, ANGLES),
    "tan": (mp.tan, ANGLES),
    "asin": (mp.asin, UNIT),
    "acos": (mp.acos, UNIT),
    "atan": (mp.atan, REALS + [magnitude(-60, 60) for _ in range(8)]),
    "exp": (mp.exp, REALS),
    "log": (mp.log, POSITIVE),
    "sinh": (mp.sinh, REALS),
    "cosh": (mp.cosh, REALS),
    "tanh": (mp.tanh, REALS),
    "asinh": (mp.asinh, REALS + [magnitude(-60, 60) for _ in range(8)] + [1e9, 1e300]),
}
BINARY = {
    "pow": (lambda x, y: mp.power(x, y) if x > 0 else mp.power(-x, y) * (-1) ** int(y), POWERS),
    "atan2": (mp.atan2, POINTS),
}

for name, (f, xs) in UNARY.items():
    for x in xs:
        print(name, bits(x), "0", bits(rounded(f(mpf(x)))))
for name, (f, xys) in BINARY.items():
    for x, y in xys:
        print(name, bits(x), bits(y), bits(rounded(f(mpf(x), mpf(y)))))

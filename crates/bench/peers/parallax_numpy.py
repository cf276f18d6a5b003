"""Parallax of a converged pair in NumPy: the peer of `cargo xtask bench-vs numpy`.

The same closed form as crates/geometry/src/bulk.rs on the same points, in float64 on one thread, written three ways:

* plain: as one writes it, every operation a new array;
* reused: every operation into an array made beforehand (out=), no allocation;
* blocked: the same over pieces that stay in the cache.

usage: parallax_numpy.py SIZE SECONDS [OUTPUT]

Prints one JSON object: points per second of each way (best of the repetitions that fit into SECONDS), NumPy's version.
With OUTPUT, writes p then q of the reused way as raw little-endian float64.
"""

import json
import os
import sys
import time

# One thread, whatever a linear algebra library would like: set before NumPy is loaded.
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"

try:
    import numpy as np
except ImportError:
    print("numpy is missing for this python3; install it, for instance with: python3 -m pip install numpy",
          file=sys.stderr)
    sys.exit(3)

T, F, M, L = 0.07, 0.0065, 50.0, 2.0
REACH2 = L * L + T * T / 4
SIN, COS = (T / 2) / REACH2 ** 0.5, L / REACH2 ** 0.5
SQUARE = M * F * T * L / REACH2
LINEAR = -M * F * T * (L * L - T * T / 4) / REACH2
CONSTANT = -SQUARE * T * T / 4
VERTICAL = 2 * M * F * SIN
NEAREST = T / 2 * SIN


def points(n):
    """The points of the Rust side: fractional parts of multiples of three irrational steps."""
    i = np.arange(n, dtype=np.float64)
    x = (i * 0.61803398875) % 1.0 * 2.0 - 1.0
    y = (i * 0.75487766625) % 1.0 * 1.6 - 0.8
    z = (i * 0.56984029099) % 1.0 * 9.0 + 1.0
    return x, y, z


def plain(x, y, z):
    """p and q, NaN where a point is not in front of both cameras."""
    ahead = z * COS + NEAREST
    side = x * SIN
    left = ahead + side
    right = ahead - side
    inverse = 1.0 / (left * right)
    front = np.minimum(left, right) > 0.0
    p = (SQUARE * (x * x + z * z) + LINEAR * z + CONSTANT) * inverse
    q = VERTICAL * x * y * inverse
    return np.where(front, p, np.nan), np.where(front, q, np.nan)


class Reused:
    """The same with no allocation: three scratch arrays and a mask of one piece's length."""

    def __init__(self, n):
        self.scratch = [np.empty(n) for _ in range(3)]
        self.mask = np.empty(n, dtype=bool)

    def __call__(self, x, y, z, p, q):
        side, inverse, lower = (a[: len(x)] for a in self.scratch)
        mask = self.mask[: len(x)]
        np.multiply(z, COS, out=inverse)
        inverse += NEAREST
        np.multiply(x, SIN, out=side)
        np.subtract(inverse, side, out=lower)
        inverse += side
        np.minimum(inverse, lower, out=side)
        np.less_equal(side, 0.0, out=mask)
        inverse *= lower
        np.divide(1.0, inverse, out=inverse)
        # p = (x² S + z (z S + B) + C) / (D_l D_r)
        np.multiply(z, SQUARE, out=p)
        p += LINEAR
        p *= z
        np.multiply(x, x, out=side)
        side *= SQUARE
        p += side
        p += CONSTANT
        p *= inverse
        np.multiply(x, y, out=q)
        inverse *= VERTICAL
        q *= inverse
        if mask.any():
            p[mask] = np.nan
            q[mask] = np.nan


def best_rate(work, n, seconds):
    """Points per second of the fastest repetition; small arrays are repeated inside one measurement."""
    inner = max(1, 200_000 // n)
    work()
    best = float("inf")
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        for _ in range(inner):
            work()
        best = min(best, (time.perf_counter() - start) / inner)
    return n / best


def main():
    n, seconds = int(sys.argv[1]), float(sys.argv[2])
    x, y, z = points(n)
    p, q = np.empty(n), np.empty(n)
    rates = {"plain": best_rate(lambda: plain(x, y, z), n, seconds)}
    whole = Reused(n)
    rates["reused"] = best_rate(lambda: whole(x, y, z, p, q), n, seconds)
    for block in (1024, 4096, 16384):
        if block >= n:
            continue
        piece = Reused(block)
        cuts = [slice(a, min(a + block, n)) for a in range(0, n, block)]

        def blocked():
            for cut in cuts:
                piece(x[cut], y[cut], z[cut], p[cut], q[cut])

        rates[f"blocked_{block}"] = best_rate(blocked, n, seconds)
    whole(x, y, z, p, q)
    if len(sys.argv) > 3:
        with open(sys.argv[3], "wb") as out:
            p.astype("<f8").tofile(out)
            q.astype("<f8").tofile(out)
    print(json.dumps({"numpy": np.__version__, "points": n, "rates": rates}))


if __name__ == "__main__":
    main()

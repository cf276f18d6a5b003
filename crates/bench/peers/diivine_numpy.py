"""The 88 features of DIIVINE in NumPy and SciPy: the peer of `cargo xtask bench-vs diivine`, and a second opinion.

Written from the description of the index (Moorthy and Bovik 2011, as released), not from the Rust code, in float64 on
one thread; the work is done by SciPy's transforms and filters and by BLAS.

usage: diivine_numpy.py features PICTURE...            one JSON list of 88 numbers a line, for PNG or other pictures
       diivine_numpy.py bench WIDTH HEIGHT RAW SECONDS  features of a raw 8-bit picture, with the seconds they take
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
    import scipy
    from scipy import fft
    from scipy.ndimage import correlate1d
    from scipy.special import gamma
except ImportError:
    print("numpy or scipy is missing for this python3; install them, for instance with: python3 -m pip install numpy scipy",
          file=sys.stderr)
    sys.exit(3)

ORIENTATIONS = 6
LAGS = (1, 5, 9, 13, 17, 21, 25)
BINS = 100
C2 = (0.03 * 255) ** 2
STEP = 1024  # entries of the angular table in half a turn

_m = np.arange(-257, 2)
_high2 = np.cos(np.pi * _m / 512) ** 2
_high2[0], _high2[-1] = _high2[1], _high2[-2]
HIGH = np.sqrt(_high2)
LOW = np.sqrt(1 - _high2)
ANGULAR = np.sqrt(1024 * 120.0 ** 2 / (6 * 3628800)) * np.cos(np.pi * np.arange(-2049, 1026) / STEP) ** 5

GRID = np.arange(200, 10001) / 1000
RATIO = gamma(1 / GRID) * gamma(3 / GRID) / gamma(2 / GRID) ** 2

_w = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
WINDOW = _w / _w.sum()


def look_up(table, position):
    i = np.clip(position.astype(np.int64), 0, len(table) - 2)
    t = table[i]
    return t + (table[i + 1] - t) * (position - i)


def radial(table, rho, shift):
    return look_up(table, (rho + 257 / 256 + shift) * 256)


def angular(theta, b):
    return look_up(ANGULAR, (theta + 2049 * np.pi / STEP - np.pi * b / ORIENTATIONS) * (STEP / np.pi))


def pyramid(image):
    """The high-pass residual and the twelve bands."""
    h, w = image.shape
    spectrum = fft.fftshift(fft.fft2(image))
    x = (np.arange(w) - w // 2) / (w / 2)
    y = (np.arange(h) - h // 2) / (h / 2)
    x, y = np.meshgrid(x, y)
    theta = np.arctan2(y, x)
    r = np.hypot(x, y)
    r[h // 2, w // 2] = r[h // 2, w // 2 - 1]
    rho = np.log2(r)

    def back(s):
        return fft.ifft2(fft.ifftshift(s), overwrite_x=True).real

    high = back(spectrum * radial(HIGH, rho, 0))
    low = spectrum * radial(LOW, rho, 0)
    bands = []
    for shift in (1, 2):
        ring = -1j * low * radial(HIGH, rho, shift)
        bands += [back(ring * angular(theta, b)) for b in range(ORIENTATIONS)]
        h, w = low.shape
        nh, nw = -(-h // 2), -(-w // 2)
        crop = np.s_[h // 2 - nh // 2:, w // 2 - nw // 2:]
        low, rho, theta = (a[crop][:nh, :nw] for a in (low, rho, theta))
        low = low * radial(LOW, rho, shift)
    return high, bands


def keys(d):
    d = np.abs(d)
    inner = (1.5 * d - 2.5) * d * d + 1
    outer = ((-0.5 * d + 2.5) * d - 4) * d + 2
    return np.where(d <= 1, inner, np.where(d <= 2, outer, 0.0))


def enlarge_axis(a, length, scale):
    """Along the first axis."""
    n = len(a)
    u = np.arange(1, length + 1) / scale + (1 - 1 / scale) / 2
    first = np.floor(u - 2).astype(int)
    taps = first[:, None] + np.arange(6)
    weights = keys(u[:, None] - taps)
    weights /= weights.sum(axis=1, keepdims=True)
    index = (taps - 1) % (2 * n)
    index = np.where(index < n, index, 2 * n - 1 - index)
    out = np.zeros((length,) + a.shape[1:])
    for k in range(6):
        if weights[:, k].any():
            out += weights[:, k, None] * a[index[:, k]]
    return out


def enlarge(a, size, scales):
    rows = enlarge_axis(a, size[0], scales[0])
    return np.ascontiguousarray(enlarge_axis(np.ascontiguousarray(rows.T), size[1], scales[1]).T)


def resized(a, size):
    return enlarge(a, size, (size[0] / a.shape[0], size[1] / a.shape[1]))


def normalised(bands, b):
    """Divisively normalised band b (0 to 11), without its guard band, mean removed."""
    band = bands[b]
    h, w = band.shape
    inside = np.s_[1:h - 1, 1:w - 1]
    columns = [band[1 - dy:h - 1 - dy, 1 - dx:w - 1 - dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    has_parent = b < 5
    if has_parent:
        parent = bands[b + 6]
        columns.append(enlarge(parent, (2 * parent.shape[0], 2 * parent.shape[1]), (2, 2))[:h, :w][inside])
    scale = b - b % 6
    columns += [bands[scale + o][inside] for o in range(6) if scale + o != b]
    y = np.empty((len(columns), (h - 2) * (w - 2)))
    for row, column in zip(y, columns):
        row.reshape(h - 2, w - 2)[...] = column
    c = y @ y.T / y.shape[1]
    values, vectors = np.linalg.eigh(c)
    kept = np.where(values > 0, values, 0)
    kept *= values.sum() / kept.sum()
    c = (vectors * kept) @ vectors.T
    u, s, vt = np.linalg.svd(c)
    s = np.where(s > len(c) * np.spacing(s[0]), 1 / np.where(s > 0, s, 1), 0)
    inverse = (vt.T * s) @ u.T
    z = np.sqrt(np.einsum("ij,ij->j", y, inverse @ y) / (10 if has_parent else 9))
    if not np.all(z > 0):
        raise ValueError("a constant picture has no features")
    centre = band[inside]
    g = (centre - centre.mean()) / z.reshape(h - 2, w - 2)
    guard = 16 if b < 6 else 8
    g = g[guard:-guard, guard:-guard]
    return g - g.mean()


def shape(samples, centre):
    t = samples - centre
    q = np.mean(t * t) / np.mean(np.abs(t)) ** 2
    return GRID[np.argmin(np.abs(q - RATIO))]


def blurred(a):
    return correlate1d(correlate1d(a, WINDOW, axis=0), WINDOW, axis=1)[5:-5, 5:-5]


def moments(a):
    mean = blurred(a)
    return a, mean, blurred(a * a) - mean * mean


def contrast_structure(a, b):
    (a, mean_a, var_a), (b, mean_b, var_b) = a, b
    covariance = blurred(a * b) - mean_a * mean_b
    return np.mean((2 * covariance + C2) / (var_a + var_b + C2))


def correlations(g):
    """Correlation over pairs of quantised samples at each lag."""
    low, high = g.min(), g.max()
    width = (high - low) / BINS
    index = np.clip(np.ceil((g - low) / width) - 1, 0, BINS - 1)
    x = low + (index + 0.5) * width
    x2 = x * x
    rho = []
    for j in LAGS:
        n = s = s2 = product = 0.0
        cuts = (np.s_[:, :-j], np.s_[:, j:]), (np.s_[:-j], np.s_[j:]), (np.s_[:-j, :-j], np.s_[j:, j:]), (np.s_[:-j, j:], np.s_[j:, :-j])
        for one, other in cuts:
            a, b = x[one], x[other]
            n += 2 * a.size
            s += a.sum() + b.sum()
            s2 += x2[one].sum() + x2[other].sum()
            product += 2 * np.einsum("ij,ij->", a, b)
        mean = s / n
        rho.append((product / n - mean * mean) / (s2 / n - mean * mean))
    return np.array(rho)


def cubic(rho):
    j = np.array(LAGS, float)
    powers = np.stack([j ** 3, j ** 2, j, np.ones(7)], axis=1)
    q, r = np.linalg.qr(powers)
    coefficients = np.linalg.solve(r, q.T @ rho)
    rest = rho - q @ (q.T @ rho)
    return [*coefficients, np.sum(rest * rest)]


def features(image):
    image = np.asarray(image, float)
    if image.min() == image.max():
        raise ValueError("a constant picture has no features")
    high, bands = pyramid(image)
    g = [normalised(bands, b) for b in range(12)]
    f = [np.var(m) for m in g]
    f += [shape(m, m.mean()) for m in g]
    for b in range(ORIENTATIONS):
        pool = np.concatenate([g[b].ravel(), g[b + 6].ravel()])
        f.append(shape(pool, pool.mean()))
    f.append(shape(np.concatenate([m.ravel() for m in g]), pool.mean()))
    reference = moments(high)
    f += [contrast_structure(moments(resized(band, image.shape) if b > 5 else band), reference) for b, band in enumerate(bands)]
    for m in g[:6]:
        f += cubic(correlations(m))
    maps = [moments(m) for m in g[:6]]
    f += [contrast_structure(maps[a], maps[b]) for a in range(6) for b in range(a + 1, 6)]
    return [float(v) for v in f]


def main():
    if sys.argv[1] == "features":
        from PIL import Image

        for path in sys.argv[2:]:
            print(json.dumps(features(np.asarray(Image.open(path)))))
        return
    width, height, raw, seconds = int(sys.argv[2]), int(sys.argv[3]), sys.argv[4], float(sys.argv[5])
    image = np.fromfile(raw, np.uint8).reshape(height, width)
    best, spent = float("inf"), 0.0
    while spent < seconds:
        start = time.perf_counter()
        values = features(image)
        best = min(best, time.perf_counter() - start)
        spent += best
    print(json.dumps({"numpy": np.__version__, "scipy": scipy.__version__, "seconds": best, "features": values}))


if __name__ == "__main__":
    main()

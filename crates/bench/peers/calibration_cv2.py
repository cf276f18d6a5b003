"""OpenCV's stereo calibration with views held out, for `cargo xtask bench-vs calibration`.

usage: calibration_cv2.py JOB.json

JOB.json: {"folder", "pairs": [[left, right] file names], "target": {"kind": "chessboard"|"charuco", ...}, "folds", "rounds",
"ours": [[left, right] corners of each pair as [id, u, v]], "points": [[x, y] of each corner, metres]}.

Prints JSON: OpenCV's corners in the same form, and for each corner set ("cv", "ours") and each way (intrinsics refined together with the
pose, or fixed) the models of every fold (fold k leaves out the pairs k, k + folds, ...) and of all pairs, with the best time of several
rounds on one thread. Lens: five coefficients. Both calls as the project's baseline has them.
"""

import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np

cv2.setNumThreads(1)
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-9)
LEAST = 6


def detector(target):
    if target["kind"] == "chessboard":
        size = (target["columns"], target["rows"])
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)

        def detect(grey):
            ok, corners = cv2.findChessboardCorners(grey, size)
            if not ok:
                return []
            corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), criteria)
            return [[i, float(x), float(y)] for i, (x, y) in enumerate(corners.reshape(-1, 2))]

        return detect
    aruco = cv2.aruco
    dictionary = aruco.getPredefinedDictionary(getattr(aruco, target["dictionary"]))
    size = (target["columns"], target["rows"])
    board = aruco.CharucoBoard(size, target["square"], target["marker"], dictionary)
    finder = aruco.CharucoDetector(board)

    def detect(grey):
        corners, ids, _, _ = finder.detectBoard(255 - grey if target["inverted"] else grey)
        if ids is None:
            return []
        return [[int(i), float(x), float(y)] for i, (x, y) in zip(ids.ravel(), corners.reshape(-1, 2))]

    return detect


def calibrated(pairs, points, size, fixed):
    """Lens of each camera from its own views, then the pose from the corners that both see."""

    def of(corners):
        ids = [int(c[0]) for c in corners]
        seen = np.array([c[1:] for c in corners], np.float32).reshape(-1, 1, 2)
        return points[ids].astype(np.float32), seen

    lenses = []
    for camera in range(2):
        views = [of(pair[camera]) for pair in pairs if len(pair[camera]) >= LEAST]
        _, k, d, _, _ = cv2.calibrateCamera(
            [v[0] for v in views], [v[1] for v in views], size, None, None, criteria=CRITERIA
        )
        lenses.append((k, d))
    board, left, right = [], [], []
    for pair in pairs:
        both = {c[0] for c in pair[0]} & {c[0] for c in pair[1]}
        if len(both) < LEAST:
            continue
        seen = [sorted(c for c in eye if c[0] in both) for eye in pair]
        (p, l), (_, r) = of(seen[0]), of(seen[1])
        board.append(p)
        left.append(l)
        right.append(r)
    flags = cv2.CALIB_FIX_INTRINSIC if fixed else cv2.CALIB_USE_INTRINSIC_GUESS
    (k1, d1), (k2, d2) = lenses
    rms, k1, d1, k2, d2, r, t, _, _ = cv2.stereoCalibrate(
        board, left, right, k1.copy(), d1.copy(), k2.copy(), d2.copy(), size, flags=flags, criteria=CRITERIA
    )
    flat = lambda m: [float(v) for v in np.asarray(m).ravel()]
    return {"rms": float(rms), "k": [flat(k1), flat(k2)], "d": [flat(d1), flat(d2)], "r": flat(r), "t": flat(t)}


def main():
    job = json.loads(Path(sys.argv[1]).read_text())
    folder, folds, rounds = Path(job["folder"]), job["folds"], job["rounds"]
    points = np.array([[x, y, 0.0] for x, y in job["points"]])
    detect = detector(job["target"])
    corners, detecting, size = [], 0.0, None
    for names in job["pairs"]:
        pair = []
        for name in names:
            grey = cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE)
            size = grey.shape[::-1]
            begin = time.perf_counter()
            pair.append(detect(grey))
            detecting += time.perf_counter() - begin
        corners.append(pair)
    report = {"opencv": cv2.__version__, "corners": corners, "detect_s": detecting, "models": []}
    for origin, sets in (("cv", corners), ("ours", job["ours"])):
        for fixed in (False, True):
            best = float("inf")
            for _ in range(rounds):
                begin = time.perf_counter()
                whole = calibrated(sets, points, size, fixed)
                best = min(best, time.perf_counter() - begin)
            parts = [
                calibrated([p for i, p in enumerate(sets) if i % folds != k], points, size, fixed) for k in range(folds)
            ]
            report["models"].append(
                {"corners": origin, "fixed": fixed, "seconds": best, "whole": whole, "folds": parts}
            )
    print(json.dumps(report))


main()

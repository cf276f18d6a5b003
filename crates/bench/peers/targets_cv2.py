"""OpenCV's detectors of calibration targets, timed on one thread.

argv: folder of data (stereo/calib below it), seconds to measure each set. Prints JSON: per set and detector the pictures found, the
median of the fastest times per picture in milliseconds, and the corners.
"""

import json
import sys
import time
from pathlib import Path

import cv2
import numpy as np

cv2.setNumThreads(1)
folder = Path(sys.argv[1])
repeats = int(sys.argv[2])
aruco = cv2.aruco


def numbered(corners):
    return [[i, float(x), float(y)] for i, (x, y) in enumerate(corners.reshape(-1, 2))]


def classic(window):
    """The classic detector and cornerSubPix; windows reach this far to each side, as OpenCV counts them."""

    def detect(grey):
        ok, corners = cv2.findChessboardCorners(grey, (9, 6))
        if not ok:
            return []
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
        return numbered(cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), criteria))

    return detect


def sectors(flags):
    def detect(grey):
        ok, corners = cv2.findChessboardCornersSB(grey, (9, 6), flags=flags)
        return numbered(corners) if ok else []

    return detect


def charuco(columns, rows, square, marker, name, legacy, inverted):
    board = aruco.CharucoBoard((columns, rows), square, marker, aruco.getPredefinedDictionary(getattr(aruco, name)))
    board.setLegacyPattern(legacy)
    detector = aruco.CharucoDetector(board)

    def detect(grey):
        corners, ids, _, _ = detector.detectBoard(255 - grey if inverted else grey)
        if ids is None:
            return []
        return [[int(i), float(x), float(y)] for i, (x, y) in zip(ids.ravel(), corners.reshape(-1, 2))]

    return detect


sets = [
    ("opencv_chessboard", "classic", classic(5)),
    ("opencv_chessboard", "classic, win 3", classic(3)),
    ("opencv_chessboard", "classic, win 7", classic(7)),
    ("opencv_chessboard", "classic, win 9", classic(9)),
    ("opencv_chessboard", "sector-based", sectors(0)),
    (
        "opencv_chessboard",
        "sectors, exact",
        sectors(cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY),
    ),
    ("charuco_pair_cam0_cam3", "charuco", charuco(4, 5, 0.054, 0.0405, "DICT_4X4_1000", False, True)),
    ("charuco_single", "charuco", charuco(5, 7, 0.04, 0.02, "DICT_6X6_250", True, False)),
]
report = []
for name, way, detect in sets:
    files = sorted(p for p in (folder / name).iterdir() if p.suffix in (".jpg", ".png"))
    corners, times = {}, []
    for file in files:
        grey = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        best = float("inf")
        for _ in range(repeats):
            begin = time.perf_counter()
            corners[file.name] = detect(grey)
            best = min(best, time.perf_counter() - begin)
        times.append(1e3 * best)
    report.append({"set": name, "way": way, "ms": float(np.median(times)), "corners": corners})
json.dump({"opencv": cv2.__version__, "sets": report}, sys.stdout)

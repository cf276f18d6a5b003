"""OpenCV's semi-global matchers on one thread or two, one pair, for `cargo xtask bench-vs depth`.

usage: depth_opencv.py WIDTH HEIGHT LEFT.u8 RIGHT.u8 DISPARITIES ROUNDS

Prints JSON: for each matcher the best time in seconds and the share of pixels within a pixel of the median of its own answer (a sign of
life). Parameters are those of the project's baseline: block size 1, P1 = 8, P2 = 24, pre-filter cap 31, left-right check within 1, islands of
100 pixels. Both pictures are extended on the left by the number of disparities (the edge repeated), because these matchers give no answer in
the first columns otherwise.
"""

import json
import sys
import time

import cv2
import numpy as np


def main():
    width, height = int(sys.argv[1]), int(sys.argv[2])
    left, right = (
        np.fromfile(path, np.uint8).reshape(height, width) for path in sys.argv[3:5]
    )
    count, rounds = int(sys.argv[5]), int(sys.argv[6])
    padded = [
        cv2.copyMakeBorder(eye, 0, 0, count, 0, cv2.BORDER_REPLICATE)
        for eye in (left, right)
    ]
    modes = {"HH": cv2.STEREO_SGBM_MODE_HH, "SGBM_3WAY": cv2.STEREO_SGBM_MODE_SGBM_3WAY}
    report = {"version": cv2.__version__}
    for name, mode in modes.items():
        matcher = cv2.StereoSGBM_create(
            minDisparity=0,
            numDisparities=count,
            blockSize=1,
            P1=8,
            P2=24,
            disp12MaxDiff=1,
            preFilterCap=31,
            uniquenessRatio=0,
            speckleWindowSize=100,
            speckleRange=2,
            mode=mode,
        )
        times = {}
        for threads in (1, 2):
            cv2.setNumThreads(threads)
            best = float("inf")
            for _ in range(rounds):
                start = time.perf_counter()
                found = matcher.compute(*padded)
                best = min(best, time.perf_counter() - start)
            times[str(threads)] = best
        found = found[:, count:].astype(np.float64) / 16
        report[name] = {"seconds": times, "found": float((found >= 0).mean())}
    print(json.dumps(report))


main()

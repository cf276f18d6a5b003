"""OpenCV's side of `cargo xtask bench-vs remap`: one thread, best of repetitions.

    python3 remap_cv2.py FOLDER

FOLDER holds job.json, source.u8 (rows of pixels of three channels), map_u.f32 and map_v.f32. Pictures made by OpenCV are written
into it; times, in seconds, and sums over its rectification maps go to stdout as JSON.
"""

import json
import sys
import time

try:
    import cv2
    import numpy as np
except ImportError:
    print("numpy or cv2 is missing for this python3; install them, for instance with: python3 -m pip install numpy opencv-python",
          file=sys.stderr)
    sys.exit(3)


def best(work, seconds):
    fastest = float("inf")
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        work()
        fastest = min(fastest, time.perf_counter() - start)
    return fastest


def main(folder):
    cv2.setNumThreads(1)
    with open(f"{folder}/job.json") as file:
        job = json.load(file)
    width, height, seconds = job["width"], job["height"], job["seconds"]
    source = np.fromfile(f"{folder}/source.u8", np.uint8).reshape(height, width, 3)
    u, v = (np.fromfile(f"{folder}/map_{c}.f32", np.float32).reshape(height, width) for c in "uv")
    fixed = cv2.convertMaps(u, v, cv2.CV_16SC2)
    types = {"u8": source, "u16": source.astype(np.uint16) * 257, "f32": source.astype(np.float32)}
    kernels = {"bilinear": cv2.INTER_LINEAR, "bicubic": cv2.INTER_CUBIC, "lanczos": cv2.INTER_LANCZOS4}
    times = {}
    for name, picture in types.items():
        for channels in (1, 3):
            of = picture if channels == 3 else np.ascontiguousarray(picture[:, :, 1])
            out = np.empty_like(of)
            for kernel, flag in kernels.items():
                times[f"{name} x {channels} {kernel}"] = best(lambda: cv2.remap(of, *fixed, flag, out), seconds)
    for kernel, flag in kernels.items():
        cv2.remap(source, *fixed, flag).tofile(f"{folder}/cv2_{kernel}.u8")
    cameras = [[np.array(part) for part in camera] for camera in job["cameras"]]
    size = (width, height)

    def maps():
        return [cv2.initUndistortRectifyMap(*camera, size, cv2.CV_16SC2) for camera in cameras]

    times["maps"] = best(maps, 2 * seconds)
    for i, (whole, part) in enumerate(maps()):
        places = whole.astype(np.float32)
        places[:, :, 0] += (part & 31) / np.float32(32)
        places[:, :, 1] += (part >> 5) / np.float32(32)
        places.tofile(f"{folder}/cv2_map_{i}.f32")
    json.dump({"version": cv2.__version__, "times": times}, sys.stdout)


main(sys.argv[1])

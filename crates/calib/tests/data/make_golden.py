"""Makes the golden files of this folder with OpenCV (cv2 with numpy; 5.0.0 was used): python3 make_golden.py

All numbers are our own. `golden.json` holds what cv2.projectPoints and cv2.fisheye.projectPoints make of points in the frame of
the left camera: for each case the files and both cameras' pixels. The files are written by cv2.FileStorage, except ROS's and
Kalibr's, which are written by PyYAML from cv2.stereoRectify's R and P and from R, T.
"""

import json

import cv2
import numpy as np
import yaml

SIZE = (1280, 800)
POINTS = np.array([[x, y, z] for z in (0.9, 2.5, 7.0) for y in (-0.25 * z, 0.0, 0.3 * z) for x in (-0.4 * z, -0.05 * z, 0.35 * z)])
K = [np.array([[808.27, 0, 634.17], [0, 807.53, 407.66], [0, 0, 1.0]]), np.array([[810.88, 0, 651.34], [0, 810.25, 413.07], [0, 0, 1.0]])]
FISHEYE_K = [np.array([[412.5, 0, 634.17], [0, 411.75, 407.66], [0, 0, 1.0]]), np.array([[410.25, 0, 651.34], [0, 409.5, 413.07], [0, 0, 1.0]])]
D4 = [np.array([-0.21, 0.06, 4e-4, -3e-4]), np.array([-0.2, 0.055, -2e-4, 5e-4])]
D5 = [np.append(D4[0], -0.012), np.append(D4[1], 0.009)]
D8 = [np.append(D5[0], [0.03, -0.01, 0.004]), np.append(D5[1], [0.02, 0.005, -0.003])]
FISHEYE_D = [np.array([-0.012, 0.004, -0.0021, 3e-4]), np.array([-0.01, 0.0035, -0.0018, 2e-4])]
# x_right = R x_left + T: the right camera stands 0.12 m to the right, turned inwards by 4 degrees and rolled.
R = cv2.Rodrigues(np.array([0.01, -0.07, 0.015]))[0]
T = np.array([[-0.12], [0.004], [0.006]])


def pixels(k, d, rotation, shift, fisheye):
    rvec = cv2.Rodrigues(rotation)[0]
    if fisheye:
        px = cv2.fisheye.projectPoints(POINTS.reshape(-1, 1, 3), rvec, shift, k, d.reshape(4, 1))[0]
    else:
        px = cv2.projectPoints(POINTS, rvec, shift, k, d)[0]
    return px.reshape(-1, 2).tolist()


def pair(files, k, d, fisheye=False):
    return {
        "files": files,
        "left": pixels(k[0], d[0], np.eye(3), np.zeros((3, 1)), fisheye),
        "right": pixels(k[1], d[1], R, T, fisheye),
    }


def store(name, values):
    fs = cv2.FileStorage(name, cv2.FILE_STORAGE_WRITE)
    for key, value in values.items():
        fs.write(key, value)
    fs.release()


def essential():
    t = T.ravel()
    cross = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    return cross @ R


def opencv():
    cases = []
    size = {"image_width": SIZE[0], "image_height": SIZE[1]}
    for ext in ("yml", "xml"):
        # As stereo_calib writes them, the size of the pictures added.
        intrinsics, extrinsics = f"opencv_intrinsics.{ext}", f"opencv_extrinsics.{ext}"
        store(intrinsics, {**size, "M1": K[0], "D1": D5[0].reshape(1, 5), "M2": K[1], "D2": D5[1].reshape(1, 5)})
        r1, r2, p1, p2, q = cv2.stereoRectify(K[0], D5[0], K[1], D5[1], SIZE, R, T)[:5]
        store(extrinsics, {"R": R, "T": T, "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q})
        cases.append(pair([intrinsics, extrinsics], K, D5))
        # One file, other names, eight coefficients as a list of one dimension, millimetres.
        rational = f"opencv_rational_mm.{ext}"
        e = essential() * 1000.0
        store(
            rational,
            {**size, "K1": K[0], "D1": D8[0], "K2": K[1], "D2": D8[1], "R": R, "T": T * 1000.0, "E": e, "F": e, "length_unit": "mm"},
        )
        cases.append(pair([rational], K, D8))
        fisheye = f"opencv_fisheye.{ext}"
        store(
            fisheye,
            {
                **size,
                "cameraMatrix1": FISHEYE_K[0],
                "distCoeffs1": FISHEYE_D[0].reshape(4, 1),
                "cameraMatrix2": FISHEYE_K[1],
                "distCoeffs2": FISHEYE_D[1].reshape(4, 1),
                "fisheye_model": 1,
                "R": R,
                "T": T,
            },
        )
        cases.append(pair([fisheye], FISHEYE_K, FISHEYE_D, fisheye=True))
    store("opencv_single.yml", {**size, "fisheye_model": 0, "camera_matrix": K[0], "distortion_coefficients": D5[0].reshape(5, 1)})
    store("opencv_single_fisheye.xml", {**size, "camera_matrix": FISHEYE_K[0], "distortion_model": "equidistant", "dist_coeffs": FISHEYE_D[0]})
    return cases


def ros_file(name, camera, k, model, d, r, p):
    def matrix(m):
        m = np.atleast_2d(m)
        return {"rows": m.shape[0], "cols": m.shape[1], "data": [float(v) for v in m.ravel()]}

    content = {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_name": camera,
        "camera_matrix": matrix(k),
        "distortion_model": model,
        "distortion_coefficients": matrix(d),
        "rectification_matrix": matrix(r),
        "projection_matrix": matrix(p),
    }
    with open(name, "w") as f:
        yaml.safe_dump(content, f, sort_keys=False, default_flow_style=None)


def ros():
    cases = []
    for kind, model, k, d in (
        ("plumb_bob", "plumb_bob", K, D5),
        ("rational", "rational_polynomial", K, D8),
        ("equidistant", "equidistant", FISHEYE_K, FISHEYE_D),
    ):
        # R and P do not depend on the lens as far as the poses go.
        r1, r2, p1, p2 = cv2.stereoRectify(k[0], None, k[1], None, SIZE, R, T)[:4]
        files = [f"ros_{kind}_left.yaml", f"ros_{kind}_right.yaml"]
        ros_file(files[0], "rig/left", k[0], model, d[0], r1, p1)
        ros_file(files[1], "rig/right", k[1], model, d[1], r2, p2)
        cases.append(pair(files, k, d, fisheye=kind == "equidistant"))
    return cases


def kalibr():
    cases = []
    for name, model, k, d in (("radtan", "radtan", K, D4), ("equidistant", "equidistant", FISHEYE_K, FISHEYE_D)):
        chain = {}
        for i in range(2):
            chain[f"cam{i}"] = {
                "cam_overlaps": [1 - i],
                "camera_model": "pinhole",
                "distortion_coeffs": [float(v) for v in d[i]],
                "distortion_model": model,
                "intrinsics": [float(k[i][0, 0]), float(k[i][1, 1]), float(k[i][0, 2]), float(k[i][1, 2])],
                "resolution": list(SIZE),
                "rostopic": f"/cam{i}/image_raw",
            }
        chain["cam1"]["T_cn_cnm1"] = np.block([[R, T], [np.zeros((1, 3)), np.ones((1, 1))]]).tolist()
        file = f"kalibr_{name}.yaml"
        with open(file, "w") as f:
            yaml.safe_dump(chain, f, default_flow_style=None)
        cases.append(pair([file], k, d, fisheye=model == "equidistant"))
    return cases


if __name__ == "__main__":
    cases = opencv() + ros() + kalibr()
    with open("golden.json", "w") as f:
        json.dump({"points_in_left": POINTS.tolist(), "cases": cases}, f, indent=0)
        f.write("\n")

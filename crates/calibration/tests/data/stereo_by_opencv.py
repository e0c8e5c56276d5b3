"""Calibrates a stereo head with OpenCV from the corners that pb3dp has found, as the reference of the tests.

Made with Python 3.11, numpy 2.4.6 and opencv-python-headless 4.14.0.94 from PyPI:

    pb3dp calibrate stereo --left opencv_chessboards --right opencv_chessboards --board 9x6 --square 25 --corners corners.csv
    python stereo_by_opencv.py corners.csv 640 480 25 brown-5 > opencv_4_14_stereo.csv
    pb3dp calibrate stereo --left bumblebee2_chessboards --right bumblebee2_chessboards --board 6x4 --square 30 --corners bumblebee2_corners.csv
    python stereo_by_opencv.py bumblebee2_corners.csv 640 480 30 radial-1 > bumblebee2_4_14_stereo.csv

A file of corners holds view, camera, column, row, u, v; what comes out numbers by name, lengths in mm. Each camera is calibrated by
itself first, then both and their pose together, again and again until the rms does not fall, with the coefficients of the
lens model that is named (brown-5: k1 k2 p1 p2 k3; radial-1: k1) and no further flags; OpenCV's rms is that of the distance
between predicted and seen corners. Boards: rotation vector and translation of each view's board in the left camera, as
stereoCalibrate gives them.
"""

import csv
import sys

import cv2
import numpy as np

cv2.setNumThreads(1)
file, width, height, square_mm = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
lens = {"brown-5": 0, "radial-1": cv2.CALIB_FIX_K2 + cv2.CALIB_FIX_K3 + cv2.CALIB_ZERO_TANGENT_DIST}[sys.argv[5]]
views = {}
with open(file, newline="") as text:
    for row in csv.DictReader(text):
        corner = (int(row["column"]), int(row["row"]))
        views.setdefault(row["view"], {}).setdefault(row["camera"], {})[corner] = (float(row["u"]), float(row["v"]))

names, objects, lefts, rights = [], [], [], []
for name, cameras in views.items():
    common = sorted(set(cameras["left"]) & set(cameras["right"]), key=lambda corner: (corner[1], corner[0]))
    names.append(name)
    objects.append(np.array([[c * square_mm, r * square_mm, 0] for c, r in common], np.float32))
    lefts.append(np.array([cameras["left"][corner] for corner in common], np.float32))
    rights.append(np.array([cameras["right"][corner] for corner in common], np.float32))

stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 1000, 1e-12)
size = (width, height)
rms_left, k1, d1, _, _ = cv2.calibrateCamera(objects, lefts, size, None, None, flags=lens, criteria=stop)
rms_right, k2, d2, _, _ = cv2.calibrateCamera(objects, rights, size, None, None, flags=lens, criteria=stop)
rms, before = np.inf, np.inf
for _ in range(10):
    rms, k1, d1, k2, d2, turn, shift, _, _, rvecs, tvecs, _ = cv2.stereoCalibrateExtended(
        objects, lefts, rights, k1, d1, k2, d2, size, np.eye(3), np.zeros((3, 1)),
        flags=cv2.CALIB_USE_INTRINSIC_GUESS + lens, criteria=stop,
    )
    # One call ends before the lowest point; the next one goes on from its cameras.
    if not rms < before - 1e-12:
        break
    before = rms


def line(name, values):
    print(name + "," + ",".join(repr(float(value)) for value in np.ravel(values)))


line("rms_left_alone_px", rms_left)
line("rms_right_alone_px", rms_right)
line("rms_px", rms)
for side, k, d in (("left", k1, d1), ("right", k2, d2)):
    line(side + "_fx_fy_cx_cy", [k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
    line(side + "_k1_k2_p1_p2_k3", d)
line("cam_right_from_cam_left_rotation_vector", cv2.Rodrigues(turn)[0])
line("cam_right_from_cam_left_translation_mm", shift)
line("baseline_mm", np.linalg.norm(shift))
for name, rvec, tvec in zip(names, rvecs, tvecs):
    line("board_" + name, [*np.ravel(rvec), *np.ravel(tvec)])

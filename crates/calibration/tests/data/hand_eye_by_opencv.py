"""Calibrates hands with OpenCV's five methods, as the reference of the tests.

Made with Python 3.11, numpy 2.4.6 and opencv-python-headless 4.14.0.94 from PyPI:

    cargo run --release -p pb3dp-calibration --example hand_eye_poses > poses.csv
    python hand_eye_by_opencv.py poses.csv > opencv_4_14_hand_eye.csv

The first file holds the flange in the base and the board in the left camera of each stop of each simulated rig of tests/hand_eye.rs;
the second one rig, method, and the camera on the flange as a rotation vector (rad) and a translation (m).
"""

import csv
import sys

import cv2
import numpy as np

METHODS = {
    "TSAI": cv2.CALIB_HAND_EYE_TSAI,
    "PARK": cv2.CALIB_HAND_EYE_PARK,
    "HORAUD": cv2.CALIB_HAND_EYE_HORAUD,
    "ANDREFF": cv2.CALIB_HAND_EYE_ANDREFF,
    "DANIILIDIS": cv2.CALIB_HAND_EYE_DANIILIDIS,
}

rigs = {}
with open(sys.argv[1], newline="") as text:
    for row in csv.reader(text):
        if row[0] != "rig":
            rigs.setdefault(int(row[0]), []).append([float(number) for number in row[2:]])

print("rig,method,rx,ry,rz,x,y,z")
for rig, stops in rigs.items():
    stops = np.array(stops)
    turns = [cv2.Rodrigues(stop[0:3])[0] for stop in stops]
    board_turns = [cv2.Rodrigues(stop[6:9])[0] for stop in stops]
    shifts = [stop[3:6].reshape(3, 1) for stop in stops]
    board_shifts = [stop[9:12].reshape(3, 1) for stop in stops]
    for name, method in METHODS.items():
        turn, shift = cv2.calibrateHandEye(turns, shifts, board_turns, board_shifts, method=method)
        numbers = [*np.ravel(cv2.Rodrigues(turn)[0]), *np.ravel(shift)]
        print(f"{rig},{name}," + ",".join(f"{number:.7f}" for number in numbers))

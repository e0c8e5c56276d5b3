"""Finds the corners of chessboards with OpenCV in two ways, as the reference of the tests.

Made with Python 3.11, numpy 2.4.6 and opencv-python-headless 4.14.0.94 from PyPI:

    python corners_by_opencv.py opencv_chessboards 9 6 > opencv_chessboards_4_14_corners.csv
    python corners_by_opencv.py bumblebee2_chessboards 6 4 > bumblebee2_4_14_corners.csv

Each line is one corner: view, camera, method, u, v, in pixels whose centres are whole numbers. The methods are `sb`,
findChessboardCornersSB with its accurate and exhaustive flags, and `subpix`, findChessboardCorners followed by cornerSubPix
with a window of 11 x 11 pixels. Which corner is the first one is OpenCV's choice.
"""

import glob
import os
import sys

import cv2
import numpy as np

cv2.setNumThreads(1)
folder, columns, rows = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
print("view,camera,method,u,v")
for file in sorted(glob.glob(os.path.join(folder, "*.jpg"))):
    stem = os.path.splitext(os.path.basename(file))[0]
    side = "left" if "left" in stem else "right"
    picture = cv2.cvtColor(cv2.imread(file, cv2.IMREAD_COLOR), cv2.COLOR_BGR2GRAY)
    found = {}
    seen, corners = cv2.findChessboardCornersSB(
        picture, (columns, rows), flags=cv2.CALIB_CB_EXHAUSTIVE + cv2.CALIB_CB_ACCURACY
    )
    if seen:
        found["sb"] = corners
    seen, corners = cv2.findChessboardCorners(picture, (columns, rows))
    if seen:
        found["subpix"] = cv2.cornerSubPix(picture, corners, (5, 5), (-1, -1), stop)
    for method, corners in found.items():
        for u, v in np.reshape(corners, (-1, 2)):
            print(f"{stem.replace(side, '')},{side},{method},{u:.3f},{v:.3f}")

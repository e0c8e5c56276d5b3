"""Draws pictures of boards with markers with OpenCV, and finds their corners with it, as the reference of the tests.

Made with Python 3.11, numpy 2.4.6 and opencv-python-headless 4.14.0.94 from PyPI, in this folder:

    python coded_boards_by_opencv.py

Pictures are drawn through a pinhole from a board of 20 pixels per mm, 4 x 4 samples for each pixel, a little blur and noise of
one grey value, and written into coded_boards/. coded_boards.csv holds for each picture and corner of the board: picture,
column, row, the true pixel, and the pixel that OpenCV found, if it found it (CharucoDetector; for the AprilGrid ArucoDetector
followed by cornerSubPix with a window of 7 x 7). Columns and rows count from the corner at the top on the left as printed.

The ChArUco board is CharucoBoard((8, 6), 30 mm, 22 mm, DICT_4X4_50). The AprilGrid is drawn as Kalibr's documents have it:
6 x 6 tags 36h11 of 24 mm with borders of two bits, tag 0 below on the left, numbers growing to the right and then upwards,
gaps of 0.3 tags, and black squares in the gaps at all corners of tags. OpenCV's tags are turned by half a turn for that.
"""

import csv

import cv2
import numpy as np

cv2.setNumThreads(1)
SCALE = 20  # pixels per mm
MARGIN_MM = 20
SIZE = (640, 480)
FOCAL, CENTRE = 700.0, (322.0, 236.0)


def charuco():
    board = cv2.aruco.CharucoBoard((8, 6), 30, 22, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    picture = board.generateImage((8 * 30 * SCALE, 6 * 30 * SCALE), marginSize=0, borderBits=1)
    corners = {(c, r): (30.0 + 30 * c, 30.0 + 30 * r) for r in range(5) for c in range(7)}

    def find(gray):
        found, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(gray)
        if ids is None:
            return {}
        return {(int(n) % 7, int(n) // 7): p for n, p in zip(ids.ravel(), found.reshape(-1, 2))}

    return picture, corners, find


def april_grid():
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    tag, gap = 24.0, 7.2
    pitch, side = tag + gap, 6 * (tag + gap) + gap
    picture = np.full((round(side * SCALE), round(side * SCALE)), 255, np.uint8)
    corners = {}
    for y in range(7):
        for x in range(7):
            a, b = round(x * pitch * SCALE), round(y * pitch * SCALE)
            picture[b : b + round(gap * SCALE), a : a + round(gap * SCALE)] = 0
    for y in range(6):
        for x in range(6):
            a, b = round((gap + x * pitch) * SCALE), round((gap + y * pitch) * SCALE)
            marker = cv2.aruco.generateImageMarker(dictionary, 6 * (5 - y) + x, round(tag * SCALE), borderBits=2)
            picture[b : b + marker.shape[0], a : a + marker.shape[1]] = cv2.rotate(marker, cv2.ROTATE_180)
            for c, r in ((0, 0), (1, 0), (1, 1), (0, 1)):
                corners[(2 * x + c, 2 * y + r)] = (gap + x * pitch + c * tag, gap + y * pitch + r * tag)

    def find(gray):
        parameters = cv2.aruco.DetectorParameters()
        parameters.markerBorderBits = 2
        quads, ids, _ = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(gray)
        found = {}
        for quad, n in zip(quads, [] if ids is None else ids.ravel()):
            x, y = int(n) % 6, 5 - int(n) // 6
            # Its first corner is the one below on the right of the tag as printed.
            for (c, r), p in zip(((1, 1), (0, 1), (0, 0), (1, 0)), quad.reshape(-1, 2)):
                found[(2 * x + c, 2 * y + r)] = p
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        if found:
            pixels = np.array(list(found.values()), np.float32).reshape(-1, 1, 2)
            pixels = cv2.cornerSubPix(gray, pixels, (3, 3), (-1, -1), stop)
            found = dict(zip(found, pixels.reshape(-1, 2)))
        return found

    return picture, corners, find


def view(picture, rotation_vector, middle_mm, rng):
    """The picture of a board whose middle is at a place before the camera, and the homography from its mm to pixels."""
    picture = cv2.copyMakeBorder(picture, *[MARGIN_MM * SCALE] * 4, cv2.BORDER_CONSTANT, value=255)
    turn = cv2.Rodrigues(np.array(rotation_vector))[0]
    half = np.array([picture.shape[1] / SCALE / 2 - MARGIN_MM, picture.shape[0] / SCALE / 2 - MARGIN_MM])
    columns = np.column_stack([turn[:, 0], turn[:, 1], np.array(middle_mm) - turn[:, :2] @ half])
    camera = np.array([[FOCAL, 0, CENTRE[0]], [0, FOCAL, CENTRE[1]], [0, 0, 1.0]])
    pixel_from_mm = camera @ columns
    # Pixel centres are whole numbers here and there: a pixel of the board is 1 / SCALE mm, its centre half of that further on.
    mm_from_board = np.array([[1 / SCALE, 0, 0.5 / SCALE - MARGIN_MM], [0, 1 / SCALE, 0.5 / SCALE - MARGIN_MM], [0, 0, 1.0]])
    fine_from_pixel = np.array([[4.0, 0, 1.5], [0, 4.0, 1.5], [0, 0, 1.0]])
    fine = cv2.warpPerspective(
        picture, fine_from_pixel @ pixel_from_mm @ mm_from_board, (4 * SIZE[0], 4 * SIZE[1]),
        flags=cv2.INTER_AREA, borderMode=cv2.BORDER_CONSTANT, borderValue=120,
    )
    image = fine.reshape(SIZE[1], 4, SIZE[0], 4).mean(axis=(1, 3))
    image = cv2.GaussianBlur(image * 0.8 + 25, (0, 0), 0.6) + rng.normal(0, 1, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), pixel_from_mm


VIEWS = [
    ("whole", (0.25, -0.35, 0.1), (10, -5, 380)),
    ("turned", (-0.4, 0.3, 2.4), (-15, 10, 420)),
    ("part", (0.3, 0.4, -0.3), (90, 50, 260)),
]
rng = np.random.default_rng(7)
with open("coded_boards.csv", "w", newline="") as file:
    table = csv.writer(file, lineterminator="\n")
    table.writerow(["picture", "column", "row", "u", "v", "u_opencv", "v_opencv"])
    for kind, (board, corners, find) in (("charuco", charuco()), ("aprilgrid", april_grid())):
        for name, rotation_vector, middle_mm in VIEWS:
            gray, pixel_from_mm = view(board, rotation_vector, middle_mm, rng)
            cv2.imwrite(f"coded_boards/{kind}_{name}.png", gray, [cv2.IMWRITE_PNG_COMPRESSION, 9])
            found = find(gray)
            for (c, r), (x, y) in corners.items():
                p = pixel_from_mm @ np.array([x, y, 1.0])
                theirs = [f"{value:.3f}" for value in found[(c, r)]] if (c, r) in found else ["", ""]
                table.writerow([f"{kind}_{name}", c, r, f"{p[0] / p[2]:.4f}", f"{p[1] / p[2]:.4f}", *theirs])

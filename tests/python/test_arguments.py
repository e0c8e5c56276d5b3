"""Wrong arguments raise an error that names the thing, its value and the remedy; none is a panic."""

import itertools
import json
import re
import shutil

import numpy as np
import pytest

import pb3dp
from conftest import CASES, ROOT

# Options in messages that no call of the package raises: viewers, and the conversion of another format.
NOT_FOR_PYTHON = {"--live", "--src", "--dst", "--dst-storage", "--layout"}

RECTANGLE = pb3dp.Region.rectangle(150, 120, 90, 80)


def refused(call, *words):
    """The error of a call, whose text has all of these words."""
    with pytest.raises(pb3dp.Error) as raised:
        call()
    for word in words:
        assert word in str(raised.value), str(raised.value)
    return raised.value


def test_images_of_another_kind(case):
    _, pair, estimator = case
    left, right = pair.left, pair.right
    refused(lambda: estimator.estimate(left.astype(np.float32), right, RECTANGLE), "left", "float32", "uint8")
    refused(lambda: estimator.estimate(left, right.astype(">u2"), RECTANGLE), "right", "uint16", "uint8")
    refused(lambda: estimator.estimate(left, right.tolist(), RECTANGLE), "right", "list", "numpy array")
    refused(lambda: estimator.estimate(left, None, RECTANGLE), "right", "None")
    refused(lambda: estimator.estimate("left.png", right, RECTANGLE), "left is a str", "read_image")
    refused(lambda: estimator.estimate(left / 255.0, right, RECTANGLE), "float64", "255 * image")
    refused(lambda: estimator.estimate(left[..., :2], right, RECTANGLE), "left", "2]", "height x width x 3")
    refused(lambda: estimator.estimate(left.ravel(), right, RECTANGLE), "left", "shape", "height x width")
    refused(lambda: estimator.estimate(left[:0], right, RECTANGLE), "left", "shape [0,")


def test_images_of_another_size_have_a_code(case):
    _, pair, estimator = case
    error = refused(lambda: estimator.estimate(pair.left[:-1], pair.right, RECTANGLE), "the left image is", "calibration")
    assert error.code is not None and error.code.startswith("PB3DP-EST-")


def test_exchanged_images():
    recording = pb3dp.Recording(CASES[0])
    pair, estimator = recording[0], pb3dp.Estimator(recording.rig)
    refused(lambda: estimator.estimate(pair.right, pair.left, RECTANGLE), "exchanged", "swap")


def test_regions(case):
    _, pair, estimator = case
    outside = pb3dp.Region.rectangle(5000, 0, 90, 80)
    error = refused(lambda: estimator.estimate(pair.left, pair.right, outside), "outside")
    assert error.code is not None
    refused(lambda: estimator.estimate(pair.left, pair.right, pb3dp.Region.click(-7, 1e12)), "-7")
    refused(lambda: pb3dp.Region.rectangle(0, 0, 0, 80), "width 0", "positive")
    refused(lambda: estimator.estimate(pair.left, pair.right, (0, 0, 9, 9)), "region is a tuple", "Region.rectangle")
    refused(lambda: estimator.estimate(pair.left, pair.right, None), "region is None", "Region.rectangle")
    refused(lambda: pb3dp.Region.rectangle(float("nan"), 0, 10, 80), "NaN", "not a number")
    refused(lambda: pb3dp.Region.rectangle(0, 0, float("nan"), 80), "NaN")
    refused(lambda: pb3dp.Region.polygon([[0, 0], [10, 0]]), "at least 3")
    refused(lambda: pb3dp.Region.polygon(np.full((4, 2), np.inf)), "inf")
    refused(lambda: pb3dp.Region.parse("circle:1,2,3"), "circle:1,2,3", "rect:X,Y,WIDTH,HEIGHT")
    height, width = pair.left.shape[:2]
    refused(lambda: pb3dp.Region.mask(np.ones((height, width), bool)), "mask", "black")
    refused(lambda: pb3dp.Region.mask(np.zeros((height, width, 3), np.uint8)), "mask", "height x width")
    refused(lambda: pb3dp.Region.mask(np.zeros((height, width))), "mask", "bool or uint8")
    small = np.zeros((20, 20), bool)
    small[5:15, 5:15] = True
    refused(lambda: estimator.estimate(pair.left, pair.right, pb3dp.Region.mask(small)), "20 x 20")


def test_a_mask_is_the_region_of_its_pixels(case):
    _, pair, estimator = case
    mask = np.zeros(pair.left.shape[:2], np.uint8)
    mask[120:200, 150:240] = 255
    of_mask = estimator.estimate(pair.left, pair.right, pb3dp.Region.mask(mask))
    of_rectangle = estimator.estimate(pair.left, pair.right, RECTANGLE)
    assert of_mask.z_m == of_rectangle.z_m
    assert estimator.estimate(pair.left, pair.right, pb3dp.Region.mask(mask > 0)).z_m == of_mask.z_m


def test_parameters(case):
    rig = case[0].rig
    refused(lambda: pb3dp.Estimator(rig, "visp"), "visp", "published, direct")
    for bad in [(-1.0, 0.5), (0.0, 0.5), (0.6, 0.5), (float("nan"), 0.5), (0.3, float("inf"))]:
        refused(lambda bad=bad: pb3dp.Estimator(rig, z_range_m=bad), "z_m")
        refused(lambda bad=bad: pb3dp.Tracker(rig, z_range_m=bad), "z_m")
    refused(lambda: pb3dp.Estimator(rig, tilt_max_rad=2.0), "tilt_max_rad", "2")
    refused(lambda: pb3dp.Estimator(rig, value_range=(9, 9)), "value_range", "(9, 9)")
    refused(lambda: pb3dp.Estimator(rig, config="nowhere.toml"), "nowhere.toml", "PB3DP-CFG-001")
    with pytest.raises(TypeError):
        pb3dp.Estimator("calib.json")
    with pytest.raises(OverflowError):
        pb3dp.Estimator(rig, seed=-1)


def test_files(tmp_path):
    error = refused(lambda: pb3dp.StereoRig.load(tmp_path / "calib.json"), "calib.json")
    assert error.code is None or error.code.startswith("PB3DP-")
    refused(pb3dp.StereoRig.load, "0")
    broken = tmp_path / "calib.json"
    broken.write_text("{")
    refused(lambda: pb3dp.StereoRig.load(broken), "calib.json")
    refused(lambda: pb3dp.Recording(tmp_path / "nowhere.mcap"), "nowhere.mcap")
    refused(lambda: pb3dp.Recording(CASES[0], pair_within_s=float("nan")), "pair_within_s")
    refused(lambda: pb3dp.read_image(tmp_path / "nowhere.png"), "nowhere.png")
    with pytest.raises(IndexError, match="1 pairs"):
        pb3dp.Recording(CASES[0])[1]


def test_trackers(case):
    recording, pair, _ = case
    tracker = pb3dp.Tracker(recording.rig)
    error = refused(lambda: tracker.track(pair.left, pair.right), "no target yet")
    assert error.code is not None and not tracker.is_started
    for skew_s in [2.0, float("nan")]:
        refused(lambda skew_s=skew_s: tracker.track(pair.left, pair.right, RECTANGLE, skew_s=skew_s), "skew_s", "0.1 seconds")
        refused(lambda skew_s=skew_s: pb3dp.Recording(CASES[0], skew_s=skew_s), "skew_s", "0.1 seconds")
    for motion in [np.eye(3), np.zeros((4, 4)), np.full((4, 4), np.nan), np.diag([1.0, 1.0, -1.0, 1.0])]:
        refused(lambda motion=motion: tracker.track(pair.left, pair.right, RECTANGLE, cam_left_prev_from_cam_left_now=motion), "cam_left_prev")


def test_numbers_at_random_never_panic(case):
    _, pair, estimator = case
    values = [0.0, -1.0, 1e300, -1e300, float("nan"), float("inf"), 3.5, 2**31, 2**63]
    for numbers in itertools.islice(itertools.product(values, repeat=4), 0, None, 97):
        try:
            region = pb3dp.Region.rectangle(*numbers)
            estimator.estimate(pair.left, pair.right, region, deadline_s=0.0)
        except pb3dp.Error as error:
            assert str(error)
    for numbers in itertools.islice(itertools.product(values, repeat=2), 0, None, 5):
        try:
            estimator.estimate(pair.left, pair.right, RECTANGLE, centroid_px=numbers, deadline_s=numbers[0])
        except pb3dp.Error as error:
            assert str(error)


def test_messages_name_arguments_and_no_options(case, tmp_path):
    recording, pair, _ = case
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        shutil.copy(CASES[0] / f"{side}.png", tmp_path / side / "0.png")
    error = refused(lambda: pb3dp.Recording(tmp_path), "calibration=[FILE]")
    assert "--" not in str(error)
    estimate = pb3dp.Estimator(recording.rig, z_range_m=(0.05, 0.07)).estimate(pair.left, pair.right, RECTANGLE)
    assert "(z_range_m)" in estimate.reason and "--" not in estimate.reason
    # The line of the program keeps its words.
    assert "(--z-range)" in json.loads(estimate.to_json())["reason"]


def test_every_option_in_a_message_has_an_argument():
    # Those of the estimation are an `Argument`, which the compiler and `cargo xtask check-deps` check.
    tables = ["crates/python/src/wording.rs", "crates/wiring/src/message_codes.rs"]
    known = {option for table in tables for option in re.findall(r'(?:\(|=> )"(--[a-z-]+)', (ROOT / table).read_text())}
    folders = ["crates/record/src", "crates/bag/src", "hal/camera-recordings/src", "crates/setup/src/region_spec.rs"]
    found = {}
    for folder in folders:
        files = (ROOT / folder).rglob("*.rs") if (ROOT / folder).is_dir() else [ROOT / folder]
        for line in (line for file in files for line in file.read_text().splitlines()):
            # Not the variables of style sheets: `--red: #d1242f`, `var(--red)`.
            if not line.lstrip().startswith("//") and "var(--" not in line:
                found.update(dict.fromkeys(re.findall(r"(?<![a-zA-Z-])--[a-z][a-z-]*[a-z](?![a-z:-])", line), line.strip()))
    assert {"--calib", "--rectified", "--range", "--topics"} <= set(found)
    missing = {option: line for option, line in found.items() if option not in known and option not in NOT_FOR_PYTHON}
    assert not missing, missing


def test_a_range_in_millimetres_is_refused(case):
    rig = case[0].rig
    for make in (pb3dp.Estimator, pb3dp.Tracker):
        refused(lambda make=make: make(rig, z_range_m=(200, 600)), "(200, 600), in metres", "not millimetres")


def test_a_chessboard_alone_is_no_doubt_of_the_calibration(case):
    """A texture that repeats matches at many places, which says nothing about the calibration."""
    recording = case[0]
    width, height = recording.rig.image_size
    v, u = np.mgrid[:height, :width]
    board = np.where((u // 14 + v // 14) % 2 == 0, 40, 200).astype(np.uint8)
    estimate = pb3dp.Estimator(recording.rig).estimate(board, np.roll(board, -20, axis=1), RECTANGLE)
    assert not any("calibration" in warning for warning in estimate.warnings), estimate.warnings


def test_calibrations_that_leave_values_unstated(tmp_path):
    camera, lens = "[[700, 0, 321], [0, 700, 238], [0, 0, 1]]", "[-0.012, 0.041, -0.038, 0.008]"
    file = tmp_path / "stereo.yml"
    file.write_text(
        f"%YAML:1.0\n---\nK1: {camera}\nK2: {camera}\nD1: {lens}\nD2: {lens}\n"
        "R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-64.3, 0, 0]\n"
    )

    def load(**stated):
        return pb3dp.StereoRig.load(file, **stated)

    refused(lambda: load(), "image_width", "calibrated_size")
    size = {"image_size": (640, 480)}
    refused(lambda: load(**size), "four coefficients", 'lens="equidistant"')
    other = tmp_path / "centimetres.yml"
    other.write_text(file.read_text().replace("-64.3", "-12.86"))
    refused(lambda: pb3dp.StereoRig.load(other, **size), "12.9 mm", "128.6 mm", 'calibration_unit="mm"')
    refused(lambda: load(**size, calibration_unit="inch"), "calibration_unit", "inch", "use mm, cm or m")
    refused(lambda: load(**size, calibration_unit="mm"), 'lens="brown" or lens="equidistant"')
    grey = np.full((480, 640), 90, np.uint8)
    refused(lambda: load(images=(grey, grey)), "the images do not decide", 'lens="brown" or lens="equidistant"')
    doubts = load(lens="brown", images=(grey, grey)).warnings
    assert len(doubts) == 2 and "calibrated_size" in doubts[0] and "calibration_unit" in doubts[1], doubts
    refused(lambda: load(image_size=(320, 240), calibration_unit="mm", lens="brown"), "calibrated_size 640x480")
    rig = load(image_size=(320, 240), calibrated_size=(640, 480), calibration_unit="mm", lens="equidistant")
    assert rig.image_size == (320, 240) and rig.left_distortion[0] == "equidistant"
    assert np.allclose(rig.left_matrix, [[350, 0, 160.25], [0, 350, 118.75], [0, 0, 1]])
    assert abs(rig.baseline_m - 0.0643) < 1e-12
    rectified = load(**size, calibration_unit="mm", lens="brown", rectified=True)
    assert rectified.left_distortion[0] == "none"

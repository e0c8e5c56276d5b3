"""The package computes what the program computes, to the bit."""

import csv
import json
import math

import numpy as np
import pytest

import pb3dp
from conftest import CASES, estimator_of, lines, program, without_time


def bits(matrix_mm, pose):
    """Whether a homogeneous matrix of the program, in millimetres, is this pose."""
    scale = np.ones((4, 4))
    scale[:3, 3] = 1e3
    return np.array_equal(np.reshape(matrix_mm, (4, 4)), pose * scale)


def covariance_mm(covariance):
    """In the units of the program, multiplied in its order."""
    unit = np.array([1e3] * 3 + [1.0] * 3)
    return covariance * unit[:, None] * unit[None, :]


@pytest.mark.parametrize("method", ["direct", "published"])
@pytest.mark.parametrize("folder", CASES, ids=lambda folder: folder.name)
def test_estimates_of_cases(folder, method):
    recording = pb3dp.Recording(folder)
    pair = recording[0]
    description = json.loads((folder / "case.json").read_text())
    at = description.get("region_centroid_px")
    estimate = estimator_of(recording, method).estimate(pair.left, pair.right, recording.region, centroid_px=at)
    [line] = lines("estimate", "--cases", folder, "--method", method, "--json")
    assert without_time(estimate.to_json(line["case"])) == line
    assert estimate.status == line["status"] and estimate.reason == line["reason"] and estimate.warnings == line["warnings"]
    if line["z_mm"] is None:
        assert estimate.z_m is None and estimate.cam_left_from_model is None
        return
    assert (estimate.z_m * 1e3).hex() == line["z_mm"].hex()
    assert estimate.normal.tolist() == line["normal"]
    assert bits(line["cam_left_from_model"], estimate.cam_left_from_model)
    assert (estimate.translation_m * 1e3).tolist() == line["point_mm"]
    assert math.isclose(np.linalg.norm(estimate.quaternion_xyzw), 1.0, rel_tol=1e-12)
    if line["covariance"] is None:
        assert estimate.covariance is None
    else:
        assert covariance_mm(estimate.covariance).ravel().tolist() == line["covariance"]
        assert list(estimate.observed) == line["observed"]


def test_an_estimate_of_image_files_with_a_rectangle():
    folder = CASES[1]
    files = [folder / name for name in ("left.png", "right.png")]
    rig = pb3dp.StereoRig.load(folder / "calib.json")
    left, right = map(pb3dp.read_image, files)
    region = "rect:150,120,90,80"
    estimate = pb3dp.Estimator(rig, z_range_m=(350 * 1e-3, 800 * 1e-3)).estimate(left, right, pb3dp.Region.parse(region))
    [line] = lines("estimate", "--left", files[0], "--right", files[1], "--calib", folder / "calib.json", "--region", region, "--z-range",
                   "350,800", "--json")
    assert without_time(estimate.to_json(line["case"])) == line
    estimate = pb3dp.Estimator(rig).estimate(left, right, pb3dp.Region.rectangle(150, 120, 90, 80))
    [line] = lines("estimate", "--left", files[0], "--right", files[1], "--calib", folder / "calib.json", "--region", region, "--json")
    assert without_time(estimate.to_json(line["case"])) == line


def test_the_visible_surface_of_a_region(tmp_path):
    folder = CASES[1]
    files = [folder / name for name in ("left.png", "right.png")]
    rig = pb3dp.StereoRig.load(folder / "calib.json")
    estimator = pb3dp.Estimator(rig, z_range_m=(350 * 1e-3, 800 * 1e-3))
    left, right = map(pb3dp.read_image, files)
    surface = estimator.visible_surface(left, right, pb3dp.Region.parse("rect:150,120,90,80"))
    assert isinstance(surface, pb3dp.VisibleSurface)
    positions, sigmas, colours, measured = surface
    cloud = tmp_path / "cloud.ply"
    lines("estimate", "--left", files[0], "--right", files[1], "--calib", folder / "calib.json", "--region", "rect:150,120,90,80",
          "--z-range", "350,800", "--surface", cloud, "--json")
    _, stored = cloud.read_bytes().split(b"end_header\n", 1)
    stored = np.frombuffer(stored, [("xyz", "<f4", 3), ("sigma", "<f4"), ("rgb", "u1", 3), ("measured", "?")])
    assert 6000 < len(stored) == len(positions)
    assert np.array_equal(stored["xyz"], (1e3 * positions).astype(np.float32))
    assert np.array_equal(stored["sigma"], (1e3 * sigmas).astype(np.float32))
    assert np.array_equal(stored["rgb"], colours)
    assert np.array_equal(stored["measured"], measured) and measured.mean() > 0.5


@pytest.mark.parametrize("method", ["direct", "published"])
def test_a_tracked_recording(recorded, method):
    recording = pb3dp.Recording(recorded / "run.mcap")
    tracker = pb3dp.Tracker(recording.rig, method, z_range_m=recording.z_range_m, tilt_max_rad=recording.tilt_max_rad)
    expected = lines("track", "--sequence", recorded / "run.mcap", "--method", method, "--json")
    assert len(expected) == len(recording) > 20
    for pair, line in zip(recording, expected, strict=True):
        region = recording.region if pair.index == 0 else None
        estimate = tracker.track(pair.left, pair.right, region, time_ns=pair.time_ns)
        assert without_time(estimate.to_json(pair.index, pair.t_s)) == line
        if line["cam_left_from_model"] is not None:
            assert bits(line["cam_left_from_model"], estimate.cam_left_from_model)
    surface = tracker.surface()
    assert isinstance(surface, pb3dp.Surface)
    positions, normals, sigmas, colours = surface
    assert positions.shape == normals.shape == colours.shape and colours.dtype == np.uint8
    assert sigmas.shape == (len(positions),) and np.all(sigmas > 0.0)
    assert (len(positions) > 100) == (method == "direct")


def test_a_stepped_run(recorded):
    with open(recorded / "out/estimates.csv") as table:
        expected = list(csv.DictReader(table))
    settings = {"scene.target": "card", "estimator.compare": []}
    with pb3dp.Run("sim", settings=settings, stop_after_s=1.0) as run:
        steps = list(run)
    pairs = [pair for step in steps for pair in step.pairs]
    assert len(steps) == 101 and steps[-1].t_s == 1.0
    assert len(pairs) >= len(expected) - 1 > 20
    for pair, row in zip(pairs, expected):
        assert f"{pair.t_s:.6f}" == row["t_s"] and pair.estimate.status == row["status"]
        translation_mm = pair.estimate.translation_m * 1e3
        assert [f"{value:.4f}" for value in translation_mm] == [row[name] for name in ("x_mm", "y_mm", "z_mm")]
        covariance = covariance_mm(pair.estimate.covariance)
        written = [[float(row[f"c{i}{j}"]) for j in range(1, 7)] for i in range(1, 7)]
        assert [[float(f"{value:.6e}") for value in line] for line in covariance] == written
    for pair, stored in zip(pairs, pb3dp.Recording(recorded / "run.mcap")):
        assert np.array_equal(pair.left, stored.left) and np.array_equal(pair.right, stored.right)


def test_the_codes_are_those_of_the_program():
    with pytest.raises(pb3dp.Error) as raised:
        pb3dp.Run("nowhere.toml")
    assert raised.value.code == "PB3DP-CFG-001" and raised.value.code in str(raised.value)
    assert program("explain", raised.value.code)


def test_a_recorded_run_as_arrays(recorded):
    run = pb3dp.RecordedRun(recorded / "run.mcap")
    settings = {"scene.target": "card", "estimator.compare": []}
    with pb3dp.Run("sim", settings=settings, stop_after_s=1.0) as stepped:
        steps = list(stepped)
    pairs = [pair for step in steps for pair in step.pairs]
    assert run.step_times_s.tolist() == [step.t_s for step in steps] and run.states == [step.state for step in steps]
    assert np.array_equal(run.world_from_hand, [step.world_from_hand for step in steps])
    assert np.array_equal(run.world_from_target, [step.world_from_target for step in steps])
    for arm in (0, 1):
        assert np.array_equal(run.joints_rad(arm), [step.joints_rad(arm) for step in steps])
    assert np.array_equal(run.cam_left_from_model[: len(pairs)], [pair.estimate.cam_left_from_model for pair in pairs])
    assert np.array_equal(run.covariances[: len(pairs)], [pair.estimate.covariance for pair in pairs])
    assert np.array_equal(run.cam_left_from_target[: len(pairs)], [pair.cam_left_from_target for pair in pairs])
    assert run.estimate_times_s.shape == (len(run.statuses),) and set(run.statuses) == {"ok"}
    with pytest.raises(pb3dp.Error, match="case.json|calib.json|recording"):
        pb3dp.RecordedRun(CASES[0] / "case.json")


def toml_of(rig, file, names=("left.fx", "right.fx", "cam_right_from_cam_left.x_m", "cam_right_from_cam_left.ry_rad")):
    """Writes a calibration as `pb3dp calibrate stereo` does, with a covariance of these numbers."""
    m = rig.cam_right_from_cam_left
    w = math.sqrt(1.0 + np.trace(m[:3, :3])) / 2.0
    xyz = [(m[2, 1] - m[1, 2]) / (4.0 * w), (m[0, 2] - m[2, 0]) / (4.0 * w), (m[1, 0] - m[0, 1]) / (4.0 * w)]
    head = {"format": "pb3dp stereo calibration 1", "date": "2026-11-22T09:00:00Z", "tool": "a test", "source": "a test"}
    text = "".join(f"{key} = {json.dumps(value)}\n" for key, value in head.items())
    for side, matrix, lens in [("left", rig.left_matrix, rig.left_distortion), ("right", rig.right_matrix, rig.right_distortion)]:
        numbers = {"fx_px": matrix[0, 0], "fy_px": matrix[1, 1], "cx_px": matrix[0, 2], "cy_px": matrix[1, 2]}
        text += f"\n[{side}]\nimage_size_px = {list(rig.image_size)}\n"
        text += "".join(f"{key} = {float(value)!r}\n" for key, value in numbers.items())
        text += f'distortion_model = "{lens[0]}"\ndistortion_coefficients = {lens[1].tolist()}\n'
    text += f"\n[cam_right_from_cam_left]\ntranslation_m = {m[:3, 3].tolist()}\nrotation_wxyz = {[w, *map(float, xyz)]}\n"
    sigmas = np.array([0.4, 0.5, 2e-5, 3e-5])
    covariance = np.diag(sigmas**2) + 0.5 * np.outer(sigmas, sigmas) * (1 - np.eye(4))
    text += f"\n[measured]\n\n[gates]\n\n[covariance]\nnames = {json.dumps(list(names))}\nmatrix = {covariance.tolist()}\n"
    file.write_text(text)
    return covariance


def test_the_share_of_the_calibration_in_an_estimate(tmp_path):
    folder, file = CASES[1], tmp_path / "calibration.toml"
    plain = pb3dp.StereoRig.load(folder / "calib.json")
    covariance = toml_of(plain, file)
    rig = pb3dp.StereoRig.load(file)
    names, matrix = rig.calibration_covariance
    assert names[2] == "cam_right_from_cam_left.x_m" and np.array_equal(matrix, covariance)
    files = [folder / name for name in ("left.png", "right.png")]
    left, right = map(pb3dp.read_image, files)
    region = "rect:150,120,90,80"
    estimate = pb3dp.Estimator(rig).estimate(left, right, pb3dp.Region.parse(region))
    [line] = lines("estimate", "--left", files[0], "--right", files[1], "--calib", file, "--region", region, "--json")
    assert without_time(estimate.to_json(line["case"])) == line
    assert covariance_mm(estimate.calibration_covariance).ravel().tolist() == line["calibration_covariance"]
    assert np.array_equal(estimate.pose_covariance, estimate.covariance + estimate.calibration_covariance)
    # A calibration file without a covariance gives no share.
    assert plain.calibration_covariance is None
    assert pb3dp.Estimator(plain).estimate(left, right, pb3dp.Region.parse(region)).calibration_covariance is None


def test_a_covariance_that_does_not_fit_the_rig_is_noted(tmp_path):
    file = tmp_path / "calibration.toml"
    toml_of(pb3dp.StereoRig.load(CASES[1] / "calib.json"), file, ("left.fx", "right.fx", "left.zoom", "right.fy"))
    assert any("left.zoom" in note for note in pb3dp.StereoRig.load(file).notes)


def test_the_shares_of_the_calibration_in_a_tracked_recording(recorded, tmp_path):
    file = tmp_path / "calibration.toml"
    toml_of(pb3dp.Recording(recorded / "run.mcap").rig, file)
    recording = pb3dp.Recording(recorded / "run.mcap", calibration=[file])
    tracker = pb3dp.Tracker(recording.rig, z_range_m=recording.z_range_m, tilt_max_rad=recording.tilt_max_rad)
    expected = lines("track", "--sequence", recorded / "run.mcap", "--calib", file, "--json")
    for pair, line in zip(recording, expected, strict=True):
        estimate = tracker.track(pair.left, pair.right, recording.region if pair.index == 0 else None, time_ns=pair.time_ns)
        assert without_time(estimate.to_json(pair.index, pair.t_s)) == line
        assert covariance_mm(estimate.calibration_covariance).ravel().tolist() == line["calibration_covariance"]
        assert covariance_mm(estimate.calibration_covariance_of_motion).ravel().tolist() == line["calibration_covariance_of_motion"]
        assert covariance_mm(estimate.first_pose_covariance).ravel().tolist() == line["first_pose_covariance"]
        assert covariance_mm(estimate.pose_covariance).ravel().tolist() == line["pose_covariance"]
        assert covariance_mm(estimate.surface_covariance).ravel().tolist() == line["surface_covariance"]
        assert (estimate.surface_from_model.shape, estimate.surface_version) == ((4, 4), line["surface_version"])
    moved = np.abs(estimate.calibration_covariance_of_motion).max()
    assert moved > 0.0
    # Marking the target again begins with another first pose.
    again = tracker.track(pair.left, pair.right, recording.region, time_ns=pair.time_ns + 40_000_000)
    assert np.abs(again.calibration_covariance_of_motion).max() < 1e-9 * moved

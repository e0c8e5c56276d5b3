"""Stubs, docstrings, pages and the notebook."""

import inspect
import re
import shutil
import subprocess
import sys

import nbformat
import numpy as np
import pytest
from nbclient import NotebookClient

import pb3dp
from conftest import CASES, ROOT, estimator_of
from stub import STUB, with_docstrings

PAGES = ["README.md", "crates/python/README.md", "docs/how-to/from-python.md"]
FOLDER = 'Recording("images")'
UNITS = {"_m": "metre", "_rad": "radian", "_s": "second", "_ns": "nanosecond", "_px": "pixel", "_hz": "per second"}
NOTEBOOK = ROOT / "docs/how-to/from-python.ipynb"


def test_the_stubs_are_those_of_the_package():
    done = subprocess.run([sys.executable, "-m", "mypy.stubtest", "pb3dp"], capture_output=True, text=True, check=False, cwd=ROOT / "tests/python")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_program_that_uses_the_package_passes_the_strict_check(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        "import pb3dp\n\nrecording = pb3dp.Recording('r.mcap')\nestimator = pb3dp.Estimator(recording.rig, z_range_m=recording.z_range_m)\n"
        "region = recording.region or pb3dp.Region.click(3, 4)\nfor pair in recording:\n"
        "    estimate = estimator.estimate(pair.left, pair.right, region)\n    pose = estimate.cam_left_from_model\n"
        "    print(pose[:3, 3] if pose is not None else estimate.reason)\n"
    )
    done = subprocess.run([sys.executable, "-m", "mypy", "--strict", program], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_stub_has_the_docstrings_of_the_module():
    assert STUB.read_text() == with_docstrings(STUB.read_text()), "run cargo xtask python --stub"


def test_everything_has_a_docstring_with_its_arguments_and_units():
    assert set(pb3dp._pb3dp.__all__) <= set(pb3dp.__all__)
    for name in pb3dp.__all__:
        thing = getattr(pb3dp, name)
        if name == "__version__":
            continue
        check_docstring(name, thing)
        # The fields of a named tuple stand in the docstring of its class.
        for member in vars(thing) if inspect.isclass(thing) and not issubclass(thing, tuple) else ():
            if not member.startswith("_") and name != "Error":
                check_docstring(member, getattr(thing, member))


def check_docstring(name, thing):
    """A docstring states the unit that a name abbreviates, and names every argument."""
    text = inspect.getdoc(thing)
    assert text, name
    is_made = inspect.isclass(thing) and "__new__" in vars(thing)
    called = inspect.signature(thing).parameters if is_made or inspect.isroutine(thing) else []
    arguments = [given for given in called if given != "self"]
    assert not [given for given in arguments if f"`{given}`" not in text], (name, arguments, text)
    for suffix, word in UNITS.items():
        if any(each.endswith(suffix) for each in [name, *arguments]):
            assert word in text, (name, word, text)


@pytest.mark.parametrize("page", PAGES)
def test_the_lines_of_a_page_run(page, monkeypatch, tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    assert blocks, "a page without lines of Python"
    monkeypatch.chdir(ROOT)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names = {"__name__": "page"}
    for block in blocks:
        is_of_folder = FOLDER in block
        monkeypatch.chdir(folder_of_images(tmp_path) if is_of_folder else ROOT)
        exec(compile(block, page, "exec"), {"__name__": "page"} if is_of_folder else names)  # noqa: S102
    (ROOT / "pose.png").unlink(missing_ok=True)


def folder_of_images(base):
    """A folder in which `images` is a recording of three pairs and a damaged one."""
    images = base / "images"
    if not images.exists():
        images.mkdir()
        shutil.copy(CASES[0] / "calib.json", images)
        for number in range(4):
            for side in ("left", "right"):
                shutil.copy(CASES[0] / f"{side}.png", images / f"{side}_{number:04}.png")
        (images / "left_0002.png").write_bytes(b"no image")
    return base


def test_a_loop_leaves_out_damaged_pairs(tmp_path):
    recording = pb3dp.Recording(folder_of_images(tmp_path) / "images")
    assert [pair.index for pair in recording] == [0, 1, 3] and len(recording) == 4
    assert len(list(recording)) == 3
    [warning] = recording.warnings
    assert "left_0002.png" in warning
    with pytest.raises(pb3dp.Error, match="left_0002.png"):
        recording[2]


def test_a_calibration_is_a_path_or_a_list(tmp_path):
    images = folder_of_images(tmp_path) / "images"
    (images / "calib.json").rename(tmp_path / "calib.json")
    file = tmp_path / "calib.json"
    for given in (file, str(file), [file]):
        assert len(pb3dp.Recording(images, calibration=given)) == 4
    with pytest.raises(pb3dp.Error, match="calibration is a StereoRig: give the path"):
        pb3dp.Recording(images, calibration=pb3dp.StereoRig.load(file))


def test_the_notebook_runs(monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "results are not part of the repository: clear the outputs"
    NotebookClient(notebook, timeout=120, kernel_name="python3", resources={"metadata": {"path": str(ROOT)}}).execute()


def test_a_pose_is_drawn(case, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from pb3dp import plot

    recording, pair, _ = case
    estimate = estimator_of(recording).estimate(pair.left, pair.right, recording.region)
    axes = plot.show_pose(pair.left, estimate, recording.rig)
    assert "mm" in axes.get_title() and len(axes.lines) == 3
    assert [text.get_text() for text in axes.texts] == ["x", "y", "z"]
    marked = plot.show_pose(pair.left, estimate, recording.rig, region=pb3dp.Region.rectangle(10, 20, 30, 40))
    assert marked.lines[0].get_xydata().tolist() == [[10, 20], [40, 20], [40, 60], [10, 60], [10, 20]]
    # The origin is drawn on the ray of the centroid.
    assert np.allclose(axes.lines[0].get_xydata()[0], estimate.centroid_px, atol=1e-6)


def test_a_track_is_drawn(case, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "Agg")
    from pb3dp import plot

    recording, pair, _ = case
    tracker = pb3dp.Tracker(recording.rig, z_range_m=recording.z_range_m)
    black = np.zeros_like(pair.left)
    tracked = [tracker.track(pair.left, pair.right, recording.region), tracker.track(pair.left, pair.right), tracker.track(black, black)]
    assert [found.status == "ok" for found in tracked] == [True, True, False]
    position, turn, sigma = plot.show_track(tracked, [0.0, 0.1, 0.2]).axes
    assert len(position.lines) == 3 and np.allclose(position.lines[0].get_xydata()[0], 0.0)
    assert len(turn.patches) == 1 and turn.patches[0].get_x() == pytest.approx(0.15)
    z_mm = 1e3 * np.sqrt(tracked[1].covariance[2, 2])
    assert sigma.lines[2].get_ydata()[1] == pytest.approx(z_mm)
    with pytest.raises(pb3dp.Error, match="give 3 times"):
        plot.show_track(tracked, [0.0])


def test_a_rig_is_described(case):
    rig = case[0].rig
    assert rig.image_size == case[1].left.shape[1::-1] and 0.01 < rig.baseline_m < 1
    assert rig.left_matrix.shape == (3, 3) and rig.cam_right_from_cam_left[0, 3] < 0
    assert rig.left_distortion.model == "none" and str(CASES[0].name) in rig.source
    [pixel] = rig.project_left(np.array([[0.0, 0.0, 1.0]]))
    assert np.allclose(pixel, rig.left_matrix[:2, 2])
    assert np.isnan(rig.project_left(np.array([[0.0, 0.0, -1.0]]))).all()


def test_every_calibration_format_is_read(tmp_path):
    rig = pb3dp.StereoRig.load(CASES[0] / "calib.json")
    same = pb3dp.StereoRig.load(CASES[0])
    assert same.baseline_m == rig.baseline_m and same.format == "calib.json"
    (width, height), m = rig.image_size, rig.left_matrix
    fx, fy, cx, cy = m[0, 0], m[1, 1], m[0, 2], m[1, 2]
    camera = f"  camera_model: pinhole\n  intrinsics: [{fx}, {fy}, {cx}, {cy}]\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n"
    camera += f"  resolution: [{width}, {height}]\n"
    rows = "".join(f"  - {row.tolist()}\n" for row in rig.cam_right_from_cam_left)
    kalibr = tmp_path / "camchain.yaml"
    kalibr.write_text(f"cam0:\n{camera}cam1:\n{camera}  T_cn_cnm1:\n{rows}")
    assert pb3dp.StereoRig.load(kalibr).baseline_m == pytest.approx(rig.baseline_m)

"""The schema of the dataset format (docs/dataset.schema.json) against the test data, the program's reader and its writers."""

import json
import shutil
import subprocess

import pytest

from conftest import CASES, PB3DP, ROOT, program
from schemas import Schema

SCHEMA = Schema("docs/dataset.schema.json")

# The sizes and signs differ, so that no coefficient can stand for another one.
DISTORTION = [-0.1, 0.02, 1e-3, -2e-3, 0.1]


def check_file(definition, file):
    value = json.loads(file.read_text())
    SCHEMA.check(definition, value)
    return value


def test_the_schema_is_valid():
    SCHEMA.check_itself()


@pytest.mark.parametrize("folder", CASES, ids=lambda folder: folder.name)
def test_the_test_data_follow_the_schema(folder):
    check_file("case", folder / "case.json")
    check_file("calib", folder / "calib.json")


def test_there_are_four_cases():
    assert len(CASES) == 4


@pytest.fixture
def estimated(tmp_path):
    """Estimates a copy of the first case with another description; gives exit code and messages."""
    folder = tmp_path / "case"
    shutil.copytree(CASES[0], folder)

    def estimate(case):
        (folder / "case.json").write_text(json.dumps(case))
        done = subprocess.run([PB3DP, "estimate", "--cases", folder], capture_output=True, text=True, timeout=300, check=False)
        return done.returncode, done.stderr

    return estimate


def changed(value, place, new):
    """A copy of a JSON value with another value at a place, which is a list of keys."""
    copy = json.loads(json.dumps(value))
    part = copy
    for key in place[:-1]:
        part = part[key]
    assert part[place[-1]] != new
    part[place[-1]] = new
    return copy


def test_the_schema_refuses_what_the_program_refuses(estimated):
    case = json.loads((CASES[0] / "case.json").read_text())
    assert SCHEMA.errors("case", case) == []
    assert estimated(case)[0] == 0
    for place, new in [
        (["left"], 7),
        (["region_polygon_left_px"], [[1, 2], [3, 4]]),
        (["search", "tilt_max_deg"], 85.01),
        (["search", "z_min_mm"], -1),
        (["region_polygon_left_px", 1], [1, 2, 3]),
    ]:
        wrong = changed(case, place, new)
        assert SCHEMA.errors("case", wrong), place
        code, messages = estimated(wrong)
        # The message names the key, so that no other problem is the reason.
        assert code == 1 and f"`{place[0]}" in messages and "case.json" in messages, (place, code, messages)


def test_a_recording_of_the_program_follows_the_schema(tmp_path):
    setup = tmp_path / "setup.toml"
    skew = '[[camera.faults]]\nkind = "skewed"\nfrom_s = 0.0\nuntil_s = 9.0\nstamped_millis = -0.25\n'
    setup.write_text(f'base = "sim"\n[camera]\ndistortion = {DISTORTION}\n{skew}[scene]\ntarget = "card"\n[estimator]\ncompare = []\n')
    recording, extracted = tmp_path / "recording", tmp_path / "extracted"
    program("run", "--config", setup, "--stop-after", "0.2", "--out", tmp_path / "out", "--record", recording)
    sequence = check_file("sequence", recording / "sequence.json")
    assert len(sequence["times_s"]) == len(sequence["truth"]["cam_left_from_model"]) == sequence["frames"] > 3
    assert any(abs(skew_s + 0.25e-3) < 1e-9 for skew_s in sequence["skew_s"])
    program("extract", recording, "--out", extracted)
    for folder in (recording, extracted):
        calibration = check_file("calib", folder / "calib.json")
        assert calibration["distortion_left"] == {"model": "plumb_bob", "coefficients": DISTORTION}


def test_the_case_that_the_writer_writes_follows_the_schema():
    # No command of the program writes a case; crates/record/tests/dataset.rs checks that the writer writes this one.
    case = check_file("case", ROOT / "crates/record/tests/data/written_case.json")
    assert {"case", "planar", "hard", "region_centroid_px", "search", "truth"} <= set(case)

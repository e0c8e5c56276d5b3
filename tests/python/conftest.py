"""Images of the repository, and the program."""

import json
import os
import subprocess
from pathlib import Path

import pytest

import pb3dp

ROOT = Path(__file__).resolve().parents[2]
CASES = sorted((ROOT / "tests/data/cases").iterdir())
PB3DP = os.environ["PB3DP"]


def program(*args, expect=0):
    """Runs the program; gives its standard output."""
    done = subprocess.run([PB3DP, *map(str, args)], capture_output=True, text=True, timeout=300, check=False, cwd=ROOT)
    assert done.returncode == expect, f"{args}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def lines(*args, expect=0):
    """The JSON lines of the program, without the time that the computer took."""
    return [without_time(line) for line in program(*args, expect=expect).splitlines()]


def without_time(line):
    """A JSON line without the time that the computer took."""
    return {key: value for key, value in json.loads(line).items() if key != "ms"}


@pytest.fixture(scope="session")
def case():
    """The first case: its recording, its pair and an estimator."""
    recording = pb3dp.Recording(CASES[0])
    return recording, recording[0], estimator_of(recording)


def estimator_of(recording, method="direct"):
    """An estimator with the search range of a recording."""
    return pb3dp.Estimator(recording.rig, method, z_range_m=recording.z_range_m, tilt_max_rad=recording.tilt_max_rad)


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """A recorded run of one second, with its folder of results."""
    base = tmp_path_factory.mktemp("run")
    program("run", "--config", "sim", "--set", "scene.target=card", "--set", "estimator.compare=[]", "--stop-after", "1", "--out", base / "out",
            "--record", base / "run.mcap")
    return base

"""Recordings read by Rerun, without a window. Its package is large: these tests run in ci, otherwise on demand, with PB3DP_RERUN=1."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import decoded

if not os.environ.get("PB3DP_RERUN"):
    pytest.skip("NOT CHECKED: Rerun is tried only with PB3DP_RERUN=1", allow_module_level=True)

from rerun.experimental import RrdReader  # noqa: E402

RERUN = Path(sys.executable).parent / "rerun"


@pytest.fixture(scope="module")
def rerun(tmp_path_factory):
    """The program as a function; without its usage statistics."""
    home = tmp_path_factory.mktemp("home")
    environment = {"HOME": str(home), "PATH": os.environ["PATH"], "NO_COLOR": "1"}

    def call(*args):
        done = subprocess.run([RERUN, *map(str, args)], env=environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, f"{args}: {done.returncode}\n{done.stdout}\n{done.stderr}"
        return done.stdout + done.stderr

    call("analytics", "disable")
    return call


@pytest.fixture(scope="module")
def chunks(rerun, run, tmp_path_factory):
    """The recording after its conversion: the name of a topic or of a part of it, and a table."""
    converted = tmp_path_factory.mktemp("rerun") / "run.rrd"
    rerun("mcap", "convert", run / "run.mcap", "--output", converted)
    return [(chunk.entity_path, chunk.to_record_batch()) for chunk in RrdReader(converted).stream()]


def test_the_check_of_rerun_knows_every_topic(rerun, run):
    text = rerun("mcap", "check", run / "run.mcap")
    verdicts = {topic: (word, rest) for word, topic, rest in re.findall(r"^(\w+) +\d+ +\d+ +(/\S+) +(.*)$", text, re.M)}
    assert set(verdicts) == set(decoded(run / "run.mcap")), text
    assert {topic: rest for topic, (word, rest) in verdicts.items() if word != "ok"} == {}, text


def test_rerun_converts_every_message_with_its_time(run, chunks):
    times = {}
    for topic, batch in chunks:
        # Neither undecoded messages, which it keeps as bytes.
        assert not any(name.startswith("McapMessage:") for name in batch.schema.names), topic
        if "message_log_time" in batch.schema.names:
            times.setdefault(topic, []).extend(time.value for time in batch.column("message_log_time"))
    for topic, messages in decoded(run / "run.mcap").items():
        # A static transform holds at all times.
        expected = [] if topic == "/tf_static" else [at for at, _ in messages]
        assert sorted(times.get(topic, [])) == expected, topic
    assert any(topic == "/tf_static" and "Transform3D:translation" in batch.schema.names for topic, batch in chunks)


def test_rerun_decodes_messages_of_our_own_with_the_definitions_in_the_file(run, chunks):
    messages = decoded(run / "run.mcap")
    for topic, kind, names in (
        ("/pb3dp/steps", "ControlStep", ["number", "at_nanos", "mode", "state", "hand_from_hand_shifted", "base_from_model"]),
        ("/pb3dp/pairs", "PairResult", ["sequence", "exposed_at_nanos", "status", "cam_left_from_model", "covariance"]),
    ):
        column = f"pb3dp_msgs.msg.{kind}:message"
        found = []
        for _, batch in (chunk for chunk in chunks if chunk[0] == topic and column in chunk[1].schema.names):
            times = (time.value for time in batch.column("message_log_time"))
            found += [(at, rows[0]) for at, rows in zip(times, batch.column(column).to_pylist())]
        found.sort(key=lambda item: item[0])
        assert [(at, [row[name] for name in names]) for at, row in found] == [
            (at, [getattr(message, name) for name in names]) for at, message in messages[topic]
        ]


def test_rerun_draws_images_cameras_joints_and_transforms(chunks):
    drawn = {topic: set() for topic, _ in chunks}
    for topic, batch in chunks:
        drawn[topic] |= {name.split(":")[0] for name in batch.schema.names}
    for topic, kind in (
        ("/left/image_raw", "Image"),
        ("/right/image_raw", "Image"),
        ("/left/camera_info", "Pinhole"),
        ("/right/camera_info", "Pinhole"),
        ("/vs_robot/joint_states/position", "Scalars"),
        ("/tf", "Transform3D"),
        ("/pb3dp/events", "TextLog"),
    ):
        assert kind in drawn[topic], (topic, drawn[topic])

"""One run, recorded as a file and as a folder."""

import json
import os
import subprocess

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

PB3DP = os.environ["PB3DP"]
SECONDS = 1.0


def pb3dp(*args, expect=0):
    """Runs the program; gives its standard output."""
    done = subprocess.run([PB3DP, *map(str, args)], capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == expect, f"{args}: {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def tracked(*args):
    """The lines of `track --json`, without what the computer's speed and the origin of time decide."""
    lines = [json.loads(line) for line in pb3dp("track", "--json", *args).splitlines()]
    return [{key: value for key, value in line.items() if key not in ("ms", "t_s")} for line in lines]


def decoded(file):
    """All messages by topic, by the library of the format's authors."""
    messages = {}
    with open(file, "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, ros in reader.iter_decoded_messages():
            messages.setdefault(channel.topic, []).append((message.log_time, ros))
    return messages


def nanos(header):
    """A stamp in nanoseconds."""
    return header.stamp.sec * 10**9 + header.stamp.nanosec


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """A file and a folder of the same run: the same seed gives the same run."""
    base = tmp_path_factory.mktemp("run")
    for record in (base / "run.mcap", base / "sequence"):
        pb3dp("run", "--config", "sim", "--set", "scene.target=card", "--set", "run.pace=fast", "--set", "estimator.compare=[]",
              "--stop-after", SECONDS, "--out", base / "out", "--record", record)
    return base

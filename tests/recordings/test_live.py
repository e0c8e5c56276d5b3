"""A run that a viewer watches while it goes on: the protocol of Foxglove, with libraries that are not ours."""

import json
import re
import struct
import subprocess
import time

import pytest
from conftest import PB3DP, pb3dp
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

LATCHED = ("/pb3dp/setup", "/pb3dp/version", "/pb3dp/schema_version", "/pb3dp/calibration", "/tf_static")


class Viewer:
    """A client that subscribes to every channel with its number and 1000 more, and decodes what it gets."""

    def __init__(self, url, protocol="foxglove.sdk.v1"):
        self.socket = connect(url, subprotocols=[protocol], max_size=None, open_timeout=5)
        assert self.socket.subprotocol == protocol
        info = json.loads(self.socket.recv(timeout=5))
        assert info["op"] == "serverInfo" and info["capabilities"] == []
        self.decoders = {}

    def receive(self, seconds):
        """Everything of some seconds: times and decoded messages by topic."""
        messages = {}
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                data = self.socket.recv(timeout=left)
            except TimeoutError:
                break
            if isinstance(data, str):
                self.subscribe(json.loads(data))
                continue
            opcode, subscription, at_ns = struct.unpack_from("<BIQ", data)
            topic, decode = self.decoders[subscription]
            assert opcode == 1
            messages.setdefault(topic, []).append((at_ns, decode(data[13:])))
        return messages

    def subscribe(self, advertise):
        """Subscribes to new channels."""
        subscriptions = []
        for channel in advertise["channels"]:
            number = channel["id"] + 1000
            schema = Schema(id=number, name=channel["schemaName"], encoding=channel["schemaEncoding"], data=channel["schema"].encode())
            decode = DecoderFactory().decoder_for(channel["encoding"], schema)
            assert decode, channel
            self.decoders[number] = (channel["topic"], decode)
            subscriptions.append({"id": number, "channelId": channel["id"]})
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))


@pytest.fixture
def url(tmp_path):
    """Where a run in real time serves its viewers."""
    if "--live" not in pb3dp("run", "--help"):
        pytest.skip("NOT CHECKED: pb3dp run has no --live")
    arguments = ["run", "--config", "sim", "--set", "scene.target=card", "--set", "run.pace=real-time", "--set", "estimator.compare=[]",
                 "--stop-after", "30", "--out", tmp_path / "out", "--live", "127.0.0.1:18765"]
    child = subprocess.Popen([PB3DP, *map(str, arguments)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    url = "ws://127.0.0.1:18765"
    try:
        for _ in range(100):
            try:
                connect(url, subprotocols=["foxglove.sdk.v1"], open_timeout=5).close()
                break
            except OSError:
                time.sleep(0.1)
        yield url
    finally:
        child.kill()
        child.wait()


@pytest.mark.parametrize("protocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_a_viewer_decodes_what_a_run_sends(url, protocol):
    messages = Viewer(url, protocol).receive(3)
    for topic in LATCHED:
        assert len(messages[topic]) == 1, topic
    assert "[camera]" in messages["/pb3dp/setup"][0][1].data
    images = [image for topic in ("/left/image_raw", "/left/image_raw/compressed") for _, image in messages.get(topic, [])]
    assert len(images) > 10
    assert all(len(image.data) == image.height * image.step for image in images if hasattr(image, "step"))
    assert len(messages["/tf"]) > 10 and messages["/tf"][0][1].transforms


def test_pages_of_others_are_refused(url):
    with pytest.raises(InvalidStatus, match=re.escape("403")):
        connect(url, subprotocols=["foxglove.sdk.v1"], origin="https://evil.example", open_timeout=5)

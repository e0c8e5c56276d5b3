"""The schema of the panel's messages (docs/reference/panel-api.schema.json) against the answers of a running program."""

import json
import re
import subprocess
import threading
import time
import urllib.error
import urllib.request
from contextlib import contextmanager

import pytest
from websockets.sync.client import connect

from conftest import PB3DP, ROOT
from schemas import Schema

SCHEMA = Schema("docs/reference/panel-api.schema.json")
# Time in which everything happens, also on a busy machine; nothing is measured with it.
PATIENCE_S = 30
# The heartbeats of a script; the panel regards the operator as silent after 500 ms.
HEARTBEAT_S = 0.05
NOT_UNDERSTOOD = "PB3DP-PAN-017"
SUSPENDED = "PB3DP-PAN-030"


class Panel:
    """The playground with its panel, and a script that uses its interface."""

    def __init__(self, folder):
        self.session = None
        self.log = open(folder / "log", "w", encoding="utf-8")
        arguments = ["run", "--config", "playground", "--panel", "127.0.0.1:0", "--out", folder / "out"]
        self.process = subprocess.Popen([PB3DP, *arguments], stdout=subprocess.PIPE, stderr=self.log, text=True)
        self.is_over = threading.Event()
        self.heart = None
        found = (re.search(r"http://([0-9.:]+)/", line) for line in self.process.stdout)
        self.address = next((one.group(1) for one in found if one), None)
        assert self.address, (folder / "log").read_text()
        threading.Thread(target=self.process.stdout.read, daemon=True).start()

    def ask(self, path, body=None):
        """Status and JSON of an answer; with a body the request is a POST."""
        headers = {"Content-Type": "application/json", **({"PB3DP-Session": self.session} if self.session else {})}
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(f"http://{self.address}/api/{path}", data, headers)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            return error.code, json.load(error)

    def checked(self, definition, path, body=None, status=200):
        """An answer that has the form of a definition."""
        found, answer = self.ask(path, body)
        assert found == status, (path, found, answer)
        SCHEMA.check(definition, answer)
        return answer

    def state(self):
        return self.checked("state", "state")

    def seen(self):
        """The part of the state that a command states."""
        state = self.state()
        return {"state": state["state"]["number"], "target": state["target"]["id"], "time_ms": state["time_ms"]}

    def wait_for(self, what, is_so):
        """The first state for which a function gives true."""
        end = time.monotonic() + PATIENCE_S
        while not is_so(state := self.state()):
            assert time.monotonic() < end, f"{what}: {state}"
            time.sleep(0.02)
        return state

    def keep_alive(self, nonce):
        """Sends heartbeats until the end."""

        def beat():
            following = nonce
            while not self.is_over.wait(HEARTBEAT_S):
                _, answer = self.ask("heartbeat", {"nonce": following})
                following = answer.get("nonce", following)

        self.heart = threading.Thread(target=beat)
        self.heart.start()

    def start(self):
        """Selects a target and starts; a busy machine may suspend the program for a moment."""
        self.checked("command_answer", "select", {"region": "rect:345,200,90,80", "name": "crab", "seen": self.seen()})
        self.wait_for("ready", lambda state: state["target"]["id"] == 1 and state["state"]["is_ready"])
        for _ in range(5):
            status, answer = self.ask("start", {"seen": self.seen()})
            if answer.get("code") != SUSPENDED:
                break
        assert status == 200, answer
        SCHEMA.check("command_answer", answer)

    @contextmanager
    def page(self):
        """A page of this session."""
        with connect(f"ws://{self.address}/api/events", proxy=None, open_timeout=PATIENCE_S) as socket:
            yield Page(socket, self.session)

    def end(self):
        """Stops the program; gives its exit code."""
        self.is_over.set()
        if self.heart:
            self.heart.join()
        self.process.terminate()
        try:
            return self.process.wait(PATIENCE_S)
        finally:
            self.process.kill()
            self.log.close()


class Page:
    """The WebSocket of a page."""

    def __init__(self, socket, session):
        self.socket = socket
        self.send({"type": "hello", "protocol": 1, "session": session})
        answer = self.next_of("answer")
        assert (answer["to"], answer["accepted"]) == ("hello", True), answer

    def send(self, message):
        self.socket.send(json.dumps(message))

    def next_of(self, kind):
        """The next message of a type; every message until then follows the schema."""
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end:
            message = json.loads(self.socket.recv(timeout=PATIENCE_S))
            SCHEMA.check("server_message", message)
            if message["type"] == kind:
                return message
        raise AssertionError(f"no message of the type {kind}")


@pytest.fixture
def panel(tmp_path):
    running = Panel(tmp_path)
    try:
        running.wait_for("the first images", lambda state: state["images"]["sequence"] is not None)
        yield running
    finally:
        code = running.end()
    assert code == 130, "a signal ends the run with its report"


def test_the_schema_is_valid():
    SCHEMA.check_itself()


def test_every_answer_follows_the_schema(panel):
    info = panel.checked("info", "info")
    limit = info["arms"][0]["limits"][0]
    assert limit["gateway_deg"] is None and limit["gateway_speed_deg_per_s"] is None
    # The limits of a gateway, as in crates/panel/tests/real_time/watching.rs.
    limit.update(gateway_deg=[-11.5, 5.7], gateway_speed_deg_per_s=28.6)
    SCHEMA.check("info", info)
    assert not panel.state()["state"]["is_moving"]
    lease = panel.checked("lease_answer", "lease", {"action": "take", "name": "test"})
    panel.session = lease["session"]
    nonce = panel.checked("nonce_answer", "heartbeat", {"nonce": lease["nonce"]})["nonce"]
    panel.keep_alive(nonce)
    panel.start()
    state = panel.wait_for("motion", lambda state: state["state"]["is_moving"])
    assert len(state["target"]["cam_left_from_model"]) == 16 and len(state["arms"][0]["position_deg"]) == 7
    panel.checked("command_answer", "hold", {})
    panel.checked("error", "start", {}, status=400)
    panel.checked("error", "nothing", status=404)
    assert panel.checked("controls_answer", "controls")["cameras"] == []
    panel.checked("cameras_answer", "cameras")
    assert panel.checked("epipolar_answer", "epipolar?u=320&v=240")["right_px"]
    assert panel.checked("preview", "preview", {"region": "rect:345,200,90,80"})["axes_px"] is not None
    assert panel.checked("preview", "preview", {"region": "rect:1,1,3,3"})["axes_px"] is None
    panel.checked("command_answer", "stop", {})
    panel.wait_for("stopped", lambda state: state["state"]["name"] == "stopped")
    panel.checked("error", "start", {"seen": panel.seen()}, status=409)
    with panel.page() as page:
        page.next_of("state")
        page.next_of("heartbeat")
        page.send({"type": "nonsense"})
        assert not page.next_of("answer")["accepted"]


# Each definition of a request with its path and a body.
REQUESTS = [
    ("select", "select", {"region": "click:1,2", "seen": ...}),
    ("seen_request", "start", {"seen": ...}),
    ("hold", "hold", {"hand_only": True}),
    ("lease", "lease", {"action": "take-over", "name": "x"}),
    ("jog", "jog", {"offset_mm": [1, 2, 3], "offset_deg": [0, 0, 0], "seen": ...}),
    ("speed", "speed", {"percent": 3, "seen": ...}),
    ("control", "controls", {"side": "right", "id": 9_963_776, "value": -1}),
    ("control", "controls", {"side": "left", "id": 10_094_850, "value": 7, "seen": ...}),
]
MESSAGES = [
    {"type": "images", "left": True, "right": False, "view": "rectified"},
    {"type": "heartbeat", "nonce": "0123456789abcdef", "visible": True},
]


def test_the_schema_refuses_the_unknown_fields_that_the_panel_refuses(panel):
    seen = panel.seen()
    panel.session = panel.checked("lease_answer", "lease", {"action": "take", "name": "test"})["session"]
    for definition, path, body in REQUESTS:
        body = {key: seen if value is ... else value for key, value in body.items()}
        assert SCHEMA.errors(definition, body) == [], body
        # The panel refuses this body for another reason at most.
        assert panel.ask(path, body)[1].get("code") != NOT_UNDERSTOOD, body
        more = {**body, "more": 1}
        assert SCHEMA.errors(definition, more), more
        assert panel.checked("error", path, more, status=400)["code"] == NOT_UNDERSTOOD, more
    with panel.page() as page:
        for message in MESSAGES:
            assert SCHEMA.errors("client_message", message) == [], message
            more = {**message, "more": 1}
            assert SCHEMA.errors("client_message", more), more
            page.send(more)
            answer = page.next_of("answer")
            assert not answer["accepted"] and "unknown field `more`" in answer["error"], (more, answer)


def test_the_controls_of_cameras_follow_the_schema():
    # Simulated cameras have no controls; crates/panel/tests/real_time/messages.rs checks that the panel gives these answers.
    answers = json.loads((ROOT / "crates/panel/tests/data/controls_answers.json").read_text())
    assert set(answers) == {"get", "post", "refused"} and answers["get"]["cameras"][1]["controls"]
    SCHEMA.check("controls_answer", answers["get"])
    SCHEMA.check("controls_answer", answers["post"])
    SCHEMA.check("error", answers["refused"])

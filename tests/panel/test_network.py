"""The network between page and program falls silent, and a computer whose clock is wrong: `cargo xtask panel`."""

import socket
import threading
import time
import urllib.parse

import pytest

from conftest import Page, wait_for

DAY_MS = 24 * 3600 * 1000


class Relay:
    """A line to the panel that can fall silent: bytes no longer come through, and no end is told to either side."""

    def __init__(self, panel):
        self.token = panel.token
        self.panel = urllib.parse.urlsplit(panel.url).netloc.split(":")
        self.is_silent = False
        self.open = []
        self.door = socket.create_server(("127.0.0.1", 0))
        self.url = f"http://127.0.0.1:{self.door.getsockname()[1]}/"
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            try:
                near, _ = self.door.accept()
            except OSError:
                return
            far = socket.create_connection((self.panel[0], int(self.panel[1])))
            # A connection that was open when the line fell silent never recovers.
            ends = {"near": near, "far": far, "is_dead": self.is_silent}
            self.open.append(ends)
            for one, other in ((near, far), (far, near)):
                threading.Thread(target=self.carry, args=(ends, one, other), daemon=True).start()

    def carry(self, ends, one, other):
        try:
            while data := one.recv(65536):
                if not ends["is_dead"]:
                    other.sendall(data)
            if not ends["is_dead"]:
                other.shutdown(socket.SHUT_WR)
        except OSError:
            pass

    def fall_silent(self):
        self.is_silent = True
        for ends in self.open:
            ends["is_dead"] = True

    def recover(self):
        self.is_silent = False

    def close(self):
        self.door.close()
        for ends in self.open:
            ends["near"].close()
            ends["far"].close()


@pytest.fixture
def relay(panel):
    relay = Relay(panel)
    yield relay
    relay.close()


def test_a_line_that_falls_silent_holds_the_arms_and_the_page_says_so(browser, panel, relay):
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = Page(context.new_page(), relay)
    page.follow()
    wait_for(lambda: panel.state_name() == "tracking")
    relay.fall_silent()
    wait_for(lambda: panel.state_name() == "holding")
    assert "PB3DP-SUP-005" in panel.state()["why"]["line"]
    wait_for(lambda: page.text("#state") == "no connection")
    relay.recover()
    wait_for(lambda: page.text("#state") == "holding", "the page does not connect again")
    time.sleep(1.0)
    assert panel.state_name() == "holding", "a line that is back moves nothing"
    context.close()


def test_the_clock_of_the_browser_does_not_matter(browser, panel):
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    tab = context.new_page()
    tab.add_init_script(f"const now = Date.now.bind(Date); Date.now = () => now() - 3 * {DAY_MS};")
    page = Page(tab, panel)
    page.follow()
    wait_for(lambda: panel.state_name() == "tracking")
    tab.evaluate(f"() => {{ const now = Date.now; Date.now = () => now() + 300 * {DAY_MS}; }}")
    # The clock steps while the hand follows: nothing is silent, nothing is stale.
    tab.wait_for_timeout(2000)
    assert panel.state_name() == "tracking"
    page.command("hold")
    wait_for(lambda: panel.state_name() == "holding")
    page.command("resume")
    wait_for(lambda: panel.state_name() == "tracking")
    context.close()
    assert page.errors == []

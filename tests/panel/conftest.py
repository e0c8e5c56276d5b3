"""The program under test with its panel, and browsers that use it."""

import json
import mimetypes
import os
import pathlib
import re
import ssl
import subprocess
import threading
import time
import urllib.error
import urllib.parse
import urllib.request

import pytest
from playwright.sync_api import sync_playwright

ARTEFACTS = pathlib.Path(os.environ.get("PB3DP_PANEL_ARTEFACTS", "out/panel"))
PROGRAM = os.environ["PB3DP"]
CHROMIUM = os.environ.get("PB3DP_CHROMIUM", "/usr/bin/chromium")
# Files of the page from this folder instead of the program's own: try a change without a build.
ASSETS = os.environ.get("PB3DP_PANEL_ASSETS")
# A machine that is slowed down by a build needs longer; nothing is measured with it.
PATIENCE_S = 20


class Panel:
    """A running program, and its interface for scripts."""

    def __init__(self, arguments, token=None):
        self.token = token
        # The certificate is made at the start.
        self.trust = ssl._create_unverified_context() if token else None
        ARTEFACTS.mkdir(parents=True, exist_ok=True)
        self.log = open(ARTEFACTS / "pb3dp.log", "a", encoding="utf-8")
        self.process = subprocess.Popen([PROGRAM, *arguments], stdout=subprocess.PIPE, stderr=self.log, text=True)
        self.url = None
        for line in self.process.stdout:
            found = re.search(r"https?://[0-9.:]+/", line)
            if found:
                self.url = found.group(0)
                break
        assert self.url, f"the program printed no address; see {ARTEFACTS}/pb3dp.log"
        threading.Thread(target=self.process.stdout.read, daemon=True).start()
        wait_for(lambda: self.state()["images"]["sequence"] is not None)

    def post(self, path, body, session=None, headers=None):
        headers = {"Content-Type": "application/json", **(headers or {})}
        if session:
            headers["PB3DP-Session"] = session
        if self.token:
            headers["Authorization"] = f"Bearer {self.token}"
        request = urllib.request.Request(self.url + path, json.dumps(body).encode(), headers)
        try:
            with urllib.request.urlopen(request, timeout=10, context=self.trust) as answer:
                return answer.status, json.load(answer)
        except urllib.error.HTTPError as error:
            return error.code, json.load(error)

    def state(self):
        headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
        request = urllib.request.Request(self.url + "api/state", headers=headers)
        with urllib.request.urlopen(request, timeout=10, context=self.trust) as answer:
            return json.load(answer)

    def state_name(self):
        return self.state()["state"]["name"]

    def end(self):
        self.process.terminate()
        try:
            code = self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = "killed after 30 s"
        self.log.close()
        return code


def wait_for(what, message="", patience_s=PATIENCE_S):
    end = time.monotonic() + patience_s
    while not (result := what()):
        assert time.monotonic() < end, message or "it did not happen in time"
        time.sleep(0.02)
    return result


@pytest.fixture
def faults():
    """Faults of the cameras, as text of a setup; a test with others states them by a fixture of this name."""
    return ""


@pytest.fixture
def panel(tmp_path, faults):
    """The playground, paced by the clock."""
    setup = tmp_path / "setup.toml"
    setup.write_text(f'base = "playground"\n{faults}')
    running = Panel(["run", "--config", str(setup), "--panel", "127.0.0.1:0", "--out", str(tmp_path / "run")])
    yield running
    assert running.end() == 130, "a signal ends the run with its report"


@pytest.fixture(scope="session")
def browser():
    with sync_playwright() as playwright:
        options = ["--no-sandbox", "--disable-dev-shm-usage"]
        if ASSETS:
            # A page that the test delivers has no address of its own; its WebSocket would be refused.
            options.append("--disable-features=LocalNetworkAccessChecks")
        opened = playwright.chromium.launch(executable_path=CHROMIUM, args=options)
        yield opened
        opened.close()


@pytest.fixture
def page(browser, panel):
    """A page of its own browser context; an error on it fails the test."""
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    opened = Page(context.new_page(), panel)
    yield opened
    context.close()
    assert opened.errors == []


class Page:
    """What an operator does on the page."""

    def __init__(self, page, panel):
        self.page = page
        self.errors = []
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.on("console", lambda line: self.errors.append(line.text) if is_own_error(line) else None)
        if ASSETS:
            with urllib.request.urlopen(panel.url, timeout=10) as answer:
                self.policy = answer.headers["Content-Security-Policy"]
            # An expression, not a function: a function would delay the commands until the test asks the page something.
            page.route(re.compile("^[^/]*//[^/]*/(?!api/)"), self.own_asset)
        page.goto(panel.url)
        if panel.token:
            self.give_token("0" * len(panel.token))
            page.wait_for_selector("#token .refused", state="visible")
            self.give_token(panel.token)
        wait_for(lambda: "pair" in self.text("#images"), "no state reached the page")
        # Who points at an image has seen one.
        page.wait_for_selector("#left[data-shown]")

    def own_asset(self, route):
        path = urllib.parse.urlsplit(route.request.url).path.lstrip("/") or "index.html"
        file = pathlib.Path(ASSETS) / path
        if file.is_file():
            kind = mimetypes.guess_type(path)[0]
            route.fulfill(path=file, content_type=kind, headers={"Content-Security-Policy": self.policy, "Content-Type": kind})
        else:
            route.continue_()

    def give_token(self, token):
        self.page.fill("#token input", token)
        self.page.click("#token button")

    def text(self, selector):
        return self.page.inner_text(selector)

    def take_command(self):
        self.page.click("#take")
        wait_for(lambda: self.text("#holder").startswith("You lead"))

    def place(self, u, v):
        box = self.page.locator("#left").bounding_box()
        scale = box["width"] / 640
        return box["x"] + (u + 0.5) * scale, box["y"] + (v + 0.5) * scale

    def drag(self, begin, end, steps=6):
        self.page.mouse.move(*self.place(*begin))
        self.page.mouse.down()
        for step in range(1, steps + 1):
            share = step / steps
            self.page.mouse.move(*self.place(*(a + (b - a) * share for a, b in zip(begin, end))))
        self.page.mouse.up()

    def preview(self):
        shown = self.page.locator("#preview:not(.computing)")
        wait_for(lambda: shown.is_visible() or self.text("#answer").startswith("preview"))
        assert shown.is_visible(), self.text("#answer")
        return self.text("#preview-title")

    def select(self, name, begin=(345, 200), end=(435, 280)):
        self.page.click("button[data-tool=rectangle]")
        self.drag(begin, end)
        self.preview()
        self.page.fill("#target-name", name)
        self.page.click("#select")
        self.page.wait_for_selector("#preview", state="hidden")

    def command(self, name):
        self.page.locator(f"#do-{name}").click(timeout=PATIENCE_S * 1000)

    def follow(self):
        self.take_command()
        self.select("crab")
        self.command("start")

    def screenshot(self, name):
        self.page.screenshot(path=str(ARTEFACTS / f"{name}.png"), full_page=True)


def is_own_error(line):
    # Refusals that a test provokes are logged by the browser itself.
    return line.type == "error" and "Failed to load resource" not in line.text and "WebSocket" not in line.text

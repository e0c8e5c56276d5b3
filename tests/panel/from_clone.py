"""From a fresh clone to a hand that follows, by the README alone: `cargo xtask panel --from-clone` (10 minutes)."""

import os
import pathlib
import re
import subprocess
import time

from conftest import ARTEFACTS, Page, Panel, wait_for

CLONE = pathlib.Path(os.environ.get("PB3DP_CLONE", ""))
AT_MOST_S = 600.0


class Transcript:
    """Lines with the time since the first command."""

    def __init__(self, file):
        file.parent.mkdir(parents=True, exist_ok=True)
        self.file = open(file, "w", encoding="utf-8")
        self.begin = time.monotonic()

    def passed_s(self):
        return time.monotonic() - self.begin

    def say(self, text):
        line = f"{self.passed_s():6.1f} s  {text}"
        print(line, flush=True)
        self.file.write(line + "\n")
        self.file.flush()


def commands_of_readme():
    readme = (CLONE / "README.md").read_text(encoding="utf-8")
    first = re.search(r"```sh\n(cargo xtask demo)\b", readme)
    then = re.search(r"After the demo, run `target/release/pb3dp (run [^`]*--panel)`", readme)
    assert first and then, "the README names other commands"
    return first.group(1), then.group(1)


def test_from_a_clone_to_a_hand_that_follows(browser, monkeypatch):
    first, then = commands_of_readme()
    monkeypatch.chdir(CLONE)
    transcript = Transcript(ARTEFACTS / "from_clone.txt")
    head = subprocess.check_output(["git", "rev-parse", "--short=12", "HEAD"], text=True).strip()
    transcript.say(f"a clone of {head}, {os.cpu_count()} processors, crates downloaded before")
    transcript.say(f"$ {first}")
    environment = {name: value for name, value in os.environ.items() if name != "CARGO_TARGET_DIR"}
    demo = subprocess.Popen(first.split(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment)
    for line in demo.stdout:
        if line.strip() and not re.match(r"\s*(Compiling|Downloaded|Downloading) ", line):
            transcript.say(line.rstrip())
    assert demo.wait() == 0
    transcript.say(f"$ target/release/pb3dp {then}")
    panel = Panel(then.split())
    transcript.say(f"browser: {panel.url}")
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    page = Page(context.new_page(), panel)
    page.take_command()
    transcript.say("click: Take command")
    page.page.click("button[data-tool=rectangle]")
    page.drag((345, 200), (435, 280))
    transcript.say("drag: a rectangle over the crab")
    transcript.say(f"page: {page.preview()} | {page.text('#preview-text')}".replace("\n", " "))
    page.page.click("#select")
    page.page.wait_for_selector("#preview", state="hidden")
    chosen_s = transcript.passed_s()
    transcript.say("click: Select this target")
    page.command("start")
    transcript.say("click: Start")
    wait_for(lambda: panel.state_name() == "tracking")
    transcript.say(f"page: {page.text('#state')}")
    page.page.click("button[data-tool=push]")
    page.drag((390, 240), (420, 250), steps=20)
    transcript.say("drag: the crab, 30 pixels to the right")
    wait_for(lambda: panel.state_name() == "tracking")
    transcript.say(f"page: {page.text('#state')} | {page.text('#why')}")
    follows_s = transcript.passed_s()
    page.screenshot("from_clone")
    context.close()
    transcript.say(f"Ctrl-C: exit code {panel.end()}")
    transcript.say(f"chosen by mouse after {chosen_s:.0f} s, the hand follows after {follows_s:.0f} s, at most {AT_MOST_S:.0f} s allowed")
    assert page.errors == [] and follows_s <= AT_MOST_S

"""The operator panel in a browser, on the real program and the simulated cell: `cargo xtask panel`."""

import http.server
import json
import math
import subprocess
import threading
import time

from axe_playwright_python.sync_playwright import Axe

from conftest import PATIENCE_S, PROGRAM, Page, Panel, wait_for
from test_cameras import Cameras, open_section

MOVING = ("approaching", "tracking")


def is_following(panel):
    return panel.state_name() == "tracking"


def place_of_target_mm(panel):
    return panel.state()["truth"]["world_from_target"][3:12:4]


def test_an_object_is_chosen_by_dragging_and_the_hand_follows_it(panel, page):
    page.take_command()
    page.page.click("button[data-tool=rectangle]")
    page.drag((345, 200), (435, 280))
    assert "will work" in page.preview()
    assert "mm (1 sigma)" in page.text("#preview-text")
    page.screenshot("preview")
    page.page.fill("#target-name", "crab")
    page.page.click("#select")
    wait_for(lambda: panel.state()["state"]["is_ready"], "the target was not found")
    assert not panel.state()["state"]["is_moving"], "a selection moves nothing"
    page.command("start")
    wait_for(lambda: is_following(panel), "the hand does not follow")
    page.page.check("#heat")
    begin, pushed_from = panel.state()["target"]["point_mm"], place_of_target_mm(panel)
    page.page.click("button[data-tool=push]")
    page.drag((320, 240), (400, 270), steps=12)
    # The hand follows so closely that its error tells nothing.
    wait_for(lambda: math.dist(place_of_target_mm(panel), pushed_from) > 40.0, "the target was not pushed")
    wait_for(lambda: is_following(panel) and panel.state()["control"]["error_mm"] < 5.0, "the hand did not arrive")
    end = panel.state()["target"]["point_mm"]
    assert abs(begin[2] - end[2]) < 15.0, "the distance to the target stays"
    page.screenshot("following")
    page.command("hold")
    wait_for(lambda: panel.state_name() == "holding")
    page.command("resume")
    wait_for(lambda: is_following(panel))
    page.page.click("#stop")
    wait_for(lambda: panel.state_name() == "stopped")
    page.command("reset")
    wait_for(lambda: panel.state_name() == "idle")
    wait_for(lambda: "select it again" in page.text("#reason"), "the page still shows a target as selected")
    assert "Start: select a target first" in page.text("#blocked")


def test_polygon_and_click_give_a_preview_and_a_bad_region_says_why(panel, page):
    page.page.click("button[data-tool=polygon]")
    for corner in ((290, 205), (362, 210), (355, 275), (288, 270)):
        page.page.mouse.click(*page.place(*corner))
    page.page.keyboard.press("Enter")
    assert "will" in page.preview()
    page.page.click("#discard")
    page.page.wait_for_selector("#preview", state="hidden")
    page.page.click("button[data-tool=click]")
    page.page.mouse.click(*page.place(324, 240))
    assert "will" in page.preview()
    page.page.click("#discard")
    page.page.click("button[data-tool=rectangle]")
    page.drag((5, 300), (60, 470))
    page.preview()
    assert page.text("#preview-text"), "a preview explains itself"
    assert page.page.locator("#select").is_disabled(), "who does not lead selects nothing"


def test_a_second_target_is_chosen_while_the_hand_follows_and_the_first_again_by_name(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.select("sand", (220, 260), (290, 330))
    wait_for(lambda: panel.state()["target"]["name"] == "sand")
    wait_for(lambda: panel.state_name() == "selecting", "a change of the target leads through a hold")
    first = panel.state()["target"]["id"]

    def choose_again():
        # A click on a page that shows the target before is refused; a person clicks again.
        page.page.locator("#saved button", has_text="crab").click()
        page.page.wait_for_timeout(500)
        target = panel.state()["target"]
        return target["name"] == "crab" and target["id"] > first

    wait_for(choose_again)
    wait_for(lambda: panel.state()["state"]["is_ready"])
    page.command("start")
    wait_for(lambda: is_following(panel))


def test_the_command_passes_from_one_browser_to_another_through_a_hold(browser, panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    context = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True)
    other = Page(context.new_page(), panel)
    other.page.fill("#operator-name", "second")
    other.page.click("#take")
    other.page.wait_for_selector("#takeover", state="visible")
    assert is_following(panel), "asking changes nothing"
    other.page.click("#takeover-yes")
    wait_for(lambda: panel.state()["operator"]["holder"]["name"] == "second")
    wait_for(lambda: panel.state_name() == "holding", "taking over holds every arm")
    wait_for(lambda: page.text("#holder").startswith("second"))
    assert page.page.locator("#do-resume").is_disabled()
    other.command("resume")
    wait_for(lambda: is_following(panel))
    page.page.click("#stop")
    wait_for(lambda: panel.state_name() == "stopped", "stop is for everybody")
    context.close()
    assert other.errors == []


def test_a_hidden_tab_and_a_suspended_page_hold_the_arms(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.page.evaluate("Object.defineProperty(document, 'hidden', {get: () => true, configurable: true})")
    wait_for(lambda: panel.state_name() == "holding")
    assert "PB3DP-SUP-005" in panel.state()["why"]["line"]
    page.page.evaluate("delete document.hidden")
    time.sleep(1.0)
    assert panel.state_name() == "holding", "a visible page alone moves nothing"
    page.command("resume")
    wait_for(lambda: is_following(panel))
    # The limit is 0.5 s of the run's clock, which is slower than real time on a loaded machine.
    page.page.evaluate("() => { const end = performance.now() + 5000; while (performance.now() < end); }")
    wait_for(lambda: panel.state_name() == "holding")


def test_a_reload_in_motion_ends_the_motion(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.page.reload()
    wait_for(lambda: panel.state_name() in ("holding", "stopped"))
    time.sleep(1.0)
    assert panel.state_name() in ("holding", "stopped"), "nothing moves by a reload"


def test_old_and_repeated_commands_are_refused(panel, page):
    sent = []
    page.page.on("request", lambda request: sent.append(request) if request.url.endswith("/api/start") else None)
    page.follow()
    wait_for(lambda: is_following(panel))
    page.command("hold")
    wait_for(lambda: panel.state_name() == "holding")
    session = sent[0].headers["pb3dp-session"]
    status, answer = panel.post("api/start", sent[0].post_data_json, session)
    assert status == 409 and answer["code"].startswith("PB3DP-PAN-"), answer
    state = panel.state()
    seen = {"state": state["state"]["number"], "target": state["target"]["id"], "time_ms": state["time_ms"]}
    for wrong in ({"time_ms": seen["time_ms"] - 5000}, {"time_ms": seen["time_ms"] + 60000}, {"target": 77}, {"state": 1}):
        status, answer = panel.post("api/resume", {"seen": {**seen, **wrong}}, session)
        assert status == 409, (wrong, answer)
    status, answer = panel.post("api/resume", {"seen": seen}, "0" * 32)
    assert status == 403, answer
    assert panel.state_name() == "holding"


def test_a_command_that_is_held_up_or_doubled_on_its_way_moves_nothing(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.command("hold")
    wait_for(lambda: panel.state_name() == "holding")
    answers = []

    def stop_overtakes(route):
        panel.post("api/stop", {})
        wait_for(lambda: panel.state_name() == "stopped")
        # Twice, as a proxy that tries again would send it.
        answers.extend(route.fetch().status for _ in range(2))
        route.abort()

    page.page.route("**/api/resume", stop_overtakes)
    page.command("resume")
    end = time.monotonic() + PATIENCE_S
    while len(answers) < 2 and time.monotonic() < end:
        page.page.wait_for_timeout(50)
    assert answers == [409, 409]
    page.page.wait_for_timeout(500)
    assert panel.state_name() == "stopped"


def test_a_second_tab_of_the_same_browser_watches(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    tab = Page(page.page.context.new_page(), panel)
    wait_for(lambda: is_following(panel), "a page in the background is silent; its owner leads again")
    assert not tab.text("#holder").startswith("You lead")
    assert tab.page.locator("#do-hold").is_disabled()
    assert not tab.page.locator("#stop").is_disabled()
    tab.page.click("#stop")
    wait_for(lambda: panel.state_name() == "stopped", "stop is for everybody")
    tab.page.close()
    assert tab.errors == []


HOSTILE = """<!doctype html><script>
const url = new URLSearchParams(location.search).get("panel");
const results = [];
async function attack() {
  for (const path of ["stop", "hold", "start", "lease"]) {
    for (const type of ["application/json", "text/plain"]) {
      try {
        const answer = await fetch(url + "api/" + path, {method: "POST", mode: type === "text/plain" ? "no-cors" : "cors",
          headers: {"Content-Type": type}, body: '{"action":"take","name":"evil"}'});
        results.push(path + " " + answer.type + " " + answer.status);
      } catch (error) { results.push(path + " blocked"); }
    }
  }
  await new Promise((done) => {
    const socket = new WebSocket(url.replace("http", "ws") + "api/events");
    socket.onopen = () => { results.push("socket open"); done(); };
    socket.onerror = () => { results.push("socket blocked"); done(); };
  });
  document.title = results.join("; ");
}
attack();
</script>"""


def test_a_page_of_another_origin_reaches_nothing(browser, panel, page):
    class Hostile(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(HOSTILE.encode())

        def log_message(self, *_):
            pass

    server = http.server.HTTPServer(("127.0.0.1", 0), Hostile)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    page.follow()
    wait_for(lambda: is_following(panel))
    context = browser.new_context()
    hostile = context.new_page()
    hostile.goto(f"http://127.0.0.1:{server.server_port}/?panel={panel.url}")
    wait_for(lambda: "socket" in hostile.title())
    assert "socket blocked" in hostile.title(), hostile.title()
    assert " 200" not in hostile.title(), hostile.title()
    time.sleep(0.5)
    assert panel.state_name() in MOVING, "a hostile page cannot even stop the arms"
    assert panel.state()["operator"]["holder"]["name"] != "evil"
    context.close()
    server.shutdown()


# Elements that make the page wider than the window.
TOO_WIDE = """(width) => document.documentElement.scrollWidth <= width ? [] :
  [...document.querySelectorAll("body *:not(table *)")].filter((one) => one.getBoundingClientRect().right > width)
    .map((one) => one.outerHTML.slice(0, 200))"""


def test_the_page_fits_and_is_accessible(panel, page):
    Cameras(page.page)
    open_section(page)
    page.follow()
    wait_for(lambda: is_following(panel))
    for width, height in ((390, 844), (1280, 900), (2560, 1440)):
        page.page.set_viewport_size({"width": width, "height": height})
        for scheme in ("light", "dark"):
            page.page.emulate_media(color_scheme=scheme)
            page.page.wait_for_timeout(400)
            assert page.page.evaluate(TOO_WIDE, width) == [], f"{width} px, {scheme}"
            page.screenshot(f"{width}-{scheme}")
            found = Axe().run(page.page).response["violations"]
            serious = [one for one in found if one["impact"] in ("serious", "critical")]
            names = [(one["id"], [node["html"] for node in one["nodes"]][:3]) for one in serious]
            assert names == [], f"{width} px, {scheme}"


def test_a_panel_for_other_computers_asks_for_its_token(browser, tmp_path):
    token = tmp_path / "token"
    subprocess.run([PROGRAM, "gateway", "key", token], check=True)
    arguments = ["run", "--config", "playground", "--out", tmp_path / "run", "--panel", "0.0.0.0:0", "--panel-token", token]
    protected = Panel(arguments, token.read_text().strip())
    protected.url = protected.url.replace("0.0.0.0", "127.0.0.1")
    assert protected.url.startswith("https://")
    context = browser.new_context(ignore_https_errors=True)
    opened = context.new_page()
    addresses = []
    opened.on("request", lambda request: addresses.append(request.url))
    opened.on("websocket", lambda socket: addresses.append(socket.url))
    page = Page(opened, protected)
    page.follow()
    wait_for(lambda: is_following(protected))
    page.page.reload()
    wait_for(lambda: "pair" in page.text("#images"), "the tab keeps the token")
    assert len(addresses) > 10
    assert [url for url in addresses if protected.token in url] == [], "no address has the token"
    context.close()
    assert page.errors == []
    assert protected.end() == 130


def test_a_region_is_marked_with_keys_on_the_pair_that_was_shown(panel, page):
    sent = []
    page.page.on("request", lambda request: sent.append(request) if request.url.endswith("/api/preview") else None)
    page.page.click("button[data-tool=rectangle]")
    page.page.focus("#left")
    for key in ["Shift+ArrowLeft"] * 3 + ["Shift+ArrowUp"] * 3 + ["Enter"] + ["Shift+ArrowRight"] * 7 + ["Shift+ArrowDown"] * 7:
        page.page.keyboard.press(key)
    wait_for(lambda: panel.state()["images"]["sequence"] > sent[0].post_data_json["sequence"] + 60)
    page.page.keyboard.press("Enter")
    assert "will work" in page.preview()
    assert sent[-1].post_data_json["region"] == "rect:290,210,70,70"
    assert sent[-1].post_data_json["sequence"] == sent[0].post_data_json["sequence"], "the pair was frozen"
    # A corner is dragged.
    with page.page.expect_request(lambda request: request.post_data_json == sent[-1].post_data_json | {"region": "rect:290,210,80,75"}):
        page.drag((360, 280), (370, 285))
    page.page.focus("#left")
    page.page.keyboard.press("Escape")
    page.page.wait_for_selector("#preview", state="hidden")
    page.page.check("#rectified")
    page.page.wait_for_selector("#left[data-shown=rectified]")
    page.drag((290, 210), (360, 280))
    assert not page.page.is_checked("#rectified"), "regions are marked in raw images"


def test_disabled_commands_have_a_reason_in_words(panel, page):
    assert "Start, Hold, Hold hand, Resume, Re-align, Reset: take the command first" in page.text("#blocked")
    page.take_command()
    wait_for(lambda: "Start: select a target first" in page.text("#blocked"))
    assert "Reset: only after a stop or a fault" in page.text("#blocked")


def test_two_quick_clicks_are_two_steps_and_zero_comes_back(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.page.click("#jog summary")
    more = page.page.get_by_role("button", name="x plus one step", exact=True)
    more.click(click_count=3)
    wait_for(lambda: panel.state()["control"]["jog"]["offset_mm"] == [15, 0, 0])
    page.page.click("#jog-zero")
    wait_for(lambda: panel.state()["control"]["jog"]["offset_mm"] == [0, 0, 0])


def test_a_stop_that_nothing_answers_is_told_and_sent_again(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.page.route("**/api/stop", lambda route: route.abort())
    # What the page says on its open connection does not arrive either.
    page.page.evaluate("() => { window.sends = WebSocket.prototype.send; WebSocket.prototype.send = function (text) { if (!text.includes('stop')) window.sends.call(this, text); }; }")
    page.page.click("#stop")
    page.page.wait_for_selector("#alert", state="visible")
    assert "Use the emergency stop" in page.text("#alert")
    wait_for(lambda: panel.state_name() in ("holding", "stopped"), "who stops in vain is no sign of life")
    page.page.unroute("**/api/stop")
    wait_for(lambda: panel.state_name() == "stopped", "the stop is sent again")
    page.page.wait_for_selector("#alert", state="hidden")


def test_a_stop_goes_over_the_open_connection_if_no_other_one_is_possible(panel, page):
    page.follow()
    wait_for(lambda: is_following(panel))
    page.page.route("**/api/stop", lambda route: route.abort())
    page.page.click("#stop")
    wait_for(lambda: panel.state_name() == "stopped", patience_s=3)
    wait_for(lambda: page.text("#answer") == "stop: done")
    assert page.page.is_hidden("#alert")


def test_hold_to_run_is_pressed_by_button_or_key_and_ends_with_the_focus(panel, page):
    def with_hold_to_run(route):
        route.fulfill(json={**route.fetch().json(), "hold_to_run": True})

    sent = []
    page.page.on("websocket", lambda socket: socket.on("framesent", lambda frame: sent.append(frame)))
    page.page.route("**/api/info", with_hold_to_run)
    page.page.reload()
    wait_for(lambda: "pair" in page.text("#images"))
    page.take_command()

    def is_pressed():
        sent.clear()
        page.page.wait_for_timeout(400)
        beats = [json.loads(frame) for frame in sent if '"heartbeat"' in frame]
        assert beats, "the page answers heartbeats"
        return beats[-1]["pressed"]

    assert not is_pressed()
    box = page.page.locator("#run").bounding_box()
    page.page.locator("#run").hover()
    page.page.mouse.down()
    assert is_pressed()
    page.page.mouse.move(box["x"] - 50, box["y"] - 50)
    page.page.mouse.up()
    assert not is_pressed(), "the button is released outside of it"
    page.page.focus("#do-hold")
    page.page.keyboard.down("h")
    assert is_pressed()
    page.page.evaluate("window.dispatchEvent(new Event('blur'))")
    assert not is_pressed(), "another window has the focus"
    page.page.keyboard.up("h")
    page.page.fill("#operator-name", "")
    page.page.focus("#operator-name")
    page.page.keyboard.down("h")
    assert not is_pressed(), "the key goes into the name"
    page.page.keyboard.up("h")

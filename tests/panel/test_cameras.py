"""The section with the cameras: controls, checks of the images, calibration."""

import json
import re

from conftest import wait_for

EXPOSURE, AUTO, GAIN = 0x009A0902, 0x009A0901, 0x00980913


def control(id, name, kind, range_, value, **more):
    low, high, default = range_
    known = {"unit": None, "mode": None, "is_locked": False, "moves_the_lens": False, "menu": []}
    return {"id": id, "name": name, "kind": kind, "min": low, "max": high, "step": 1, "default": default, "value": value, **known, **more}


class Cameras:
    """Answers as the panel does with real cameras (docs/reference/panel-api.schema.json), so that the page can be tried without any."""

    def __init__(self, page):
        self.sent = []
        self.problem = None
        self.values = {side: {EXPOSURE: 40, AUTO: 1, GAIN: 64} for side in ("left", "right")}
        page.route("**/api/controls", self.answer)

    def answer(self, route):
        error = None
        if route.request.method == "POST":
            body = route.request.post_data_json
            self.sent.append((body["side"], body["id"], body["value"]))
            assert route.request.headers["pb3dp-session"]
            if body["value"] > 5000:
                error = {"error": "controls: bus:left: `Exposure` cannot be 9000; its range is 1 to 5000", "code": "PB3DP-PAN-041"}
            else:
                # A driver may keep another value than the one that was set.
                self.values[body["side"]][body["id"]] = body["value"] - body["value"] % 2 if body["id"] == GAIN else body["value"]
        route.fulfill(status=409 if error else 200, content_type="application/json", body=json.dumps(error or self.state()))

    def state(self):
        losses = dict.fromkeys(("lost", "damaged", "short", "late", "unpaired", "wrongly_stamped"), 0)
        cameras = [{"name": f"bus:{side}", "controls": self.controls(side), "losses": {**losses, "late": 3}} for side in self.values]
        return {"may_change": True, "why_not": None, "problem": self.problem, "cameras": cameras, "line": None}

    def controls(self, side):
        values = self.values[side]
        is_auto = values[AUTO] != 1
        menu = [{"value": 1, "text": "Manual Mode"}, {"value": 3, "text": "Aperture Priority Mode"}]
        mode = "auto" if is_auto else "manual"
        unit = {"name": "ms", "factor": 0.1}
        return [
            control(AUTO, "Auto Exposure", "menu", (0, 3, 3), values[AUTO], menu=menu),
            control(EXPOSURE, "Exposure", "integer", (1, 5000, 100), values[EXPOSURE], unit=unit, mode=mode, is_locked=is_auto),
            control(GAIN, "Gain", "integer", (0, 255, 64), values[GAIN]),
        ]


def open_section(page):
    page.page.click("#camera-details summary")
    wait_for(lambda: page.page.locator("#findings tr").count() > 5, "no check of the images came")


def test_simulated_cameras_say_why_nothing_can_be_set_and_their_images_are_checked(panel, page):
    open_section(page)
    assert page.text("#controls-why") == "Controls: the cameras are simulated and have no controls."
    assert page.page.locator("#camera-left").is_hidden()
    row = page.page.locator("#findings tr", has=page.page.get_by_role("rowheader", name="brightness left")).inner_text()
    assert re.search(r"good\s+[0-9.]+ grey levels\s+30 to 210", row), row
    assert page.page.get_by_role("rowheader", name="rows", exact=True).is_visible()
    assert "ms after the left one" in page.text("#camera-skew")
    assert page.text("#calibrations")


def test_a_control_is_set_with_mouse_and_keys_and_read_back(panel, page):
    cameras = Cameras(page.page)
    open_section(page)
    exposure, gain = (page.page.locator(f"#control-left-{id}") for id in (EXPOSURE, GAIN))
    wait_for(lambda: "take the command first" in page.text("#controls-why"))
    assert exposure.is_disabled()
    page.take_command()
    wait_for(exposure.is_enabled)
    assert page.text("#controls-why") == ""
    text = lambda id: page.text(f"#controls-left .control:has(#control-left-{id}) output")
    assert text(EXPOSURE) == "40 (4.00 ms)"
    assert "manual" in page.text(f"#control-left-{EXPOSURE}-facts") and "3 late" in page.text("#camera-left-losses")
    exposure.focus()
    page.page.keyboard.press("ArrowRight")
    wait_for(lambda: text(EXPOSURE) == "41 (4.10 ms)")
    assert cameras.sent == [("left", EXPOSURE, 41)]
    wait_for(lambda: page.text("#setup-lines-left") == "[camera.left]\nexposure_millis = 4.1\ngain = 64")
    assert page.text("#setup-lines-right") == "[camera.right]\nexposure_millis = 4.0\ngain = 64"
    box = gain.bounding_box()
    gain.click(position={"x": box["width"] * 0.8, "y": box["height"] / 2})
    # Also asks the page, which then answers its requests.
    wait_for(lambda: text(GAIN) != "64" and len(cameras.sent) == 2)
    asked = cameras.sent[1][2]
    assert cameras.sent[1][:2] == ("left", GAIN) and 150 < asked < 255
    wait_for(lambda: text(GAIN) == str(asked - asked % 2), "the value is read back")
    number = page.page.locator(f"#control-left-{EXPOSURE}-number")
    number.fill("9000")
    number.press("Enter")
    wait_for(lambda: "its range is 1 to 5000" in page.text(f"#control-left-{EXPOSURE}-wrong"))
    page.page.focus("#operator-name")
    wait_for(lambda: text(EXPOSURE) == "41 (4.10 ms)", "a refused value is not shown")
    cameras.problem = "bus:left: no such camera; check plug and cable"
    page.page.wait_for_selector("#alert", state="visible")
    assert "No live images: bus:left: no such camera" in page.text("#alert")
    cameras.problem = None
    page.page.wait_for_selector("#alert", state="hidden")
    page.page.select_option(f"#control-left-{AUTO}", "3")
    wait_for(lambda: "set by the camera" in page.text(f"#control-left-{EXPOSURE}-facts"))
    wait_for(exposure.is_disabled)
    assert page.text("#setup-lines-left").splitlines()[1] == 'exposure_millis = "auto"'
    page.screenshot("cameras")


def test_controls_are_disabled_while_an_arm_moves(panel, page):
    Cameras(page.page)
    open_section(page)
    page.follow()
    wait_for(lambda: panel.state()["state"]["is_moving"])
    wait_for(lambda: page.text("#controls-why") == "Controls: an arm moves; use Hold first.")
    assert page.page.locator(f"#control-right-{GAIN}").is_disabled()
    page.command("hold")
    wait_for(page.page.locator(f"#control-right-{GAIN}").is_enabled)

"""The pages of recorded runs in a browser: zoom, hover and print, without a network."""

import csv
import json
import math
import re
import subprocess

import pytest
from axe_playwright_python.sync_playwright import Axe

from conftest import ARTEFACTS, PROGRAM

# The first mark of the experiment is at 3 s.
SECONDS = 4
MARK_S = 3.0
NASTY = "</script><img src=x onerror=\"window.hit=1\"><script>window.hit=1</script>"
DATA = re.compile('(?<=<script type="application/json">).*?(?=</script>)')


def pb3dp(*args, expect=(0,)):
    done = subprocess.run([PROGRAM, *map(str, args)], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode in expect, f"{args}: {done.returncode}\n{done.stdout}\n{done.stderr}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The reports of a recorded run, and of its comparison with a shorter one."""
    folder = tmp_path_factory.mktemp("report")
    setup = ["--config", "sim", "--set", "scene.target=card", "--set", "run.pace=fast", "--set", "estimator.compare=[]"]
    for name, seconds in (("run", SECONDS), ("shorter", 1)):
        pb3dp("run", *setup, "--stop-after", seconds, "--out", folder / name, "--record", folder / f"{name}.mcap")
    pb3dp("report", folder / "run.mcap", "--out", folder / "report")
    pb3dp("replay", "--compare", folder / "run.mcap", folder / "shorter.mcap", "--out", folder / "compare", expect=(0, 3))
    return folder


@pytest.fixture
def opened(browser):
    """Opens files, each in a context of its own; an error or a request fails the test."""
    contexts, wrong = [], []

    def open_file(file, **options):
        contexts.append(browser.new_context(viewport={"width": 1280, "height": 900}, **options))
        page = contexts[-1].new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda line: wrong.append(line.text) if line.type == "error" else None)
        page.on("request", lambda request: wrong.append(request.url) if request.url[:5] not in ("file:", "data:") else None)
        page.goto(file.as_uri())
        return page

    yield open_file
    for context in contexts:
        context.close()
    assert wrong == []


def rows(file):
    with file.open(newline="") as text:
        return [{key: float(cell) for key, cell in row.items() if key not in ("mode", "status") and cell} for row in csv.DictReader(text)]


def nearest(table, time):
    return min(table, key=lambda row: abs(row["t_s"] - time))


def numbers(text):
    return [float(number) for number in re.findall(r"-?[0-9.]+", text.replace("\u2212", "-"))]


def plot(page, title):
    return page.locator("figure.plot.live").filter(has=page.locator("b", has_text=title))


def area(page, title):
    """The rectangle of a plot between its axes."""
    over = plot(page, title).locator(".u-over")
    over.scroll_into_view_if_needed()
    return over.bounding_box()


def readings(page, title):
    return plot(page, title).locator("figcaption .reading").all_inner_texts()


def cursor_s(page):
    return numbers(page.inner_text(".axis-bar .reading >> nth=0"))[0]


def shown_s(page):
    return numbers(page.inner_text(".axis-bar .reading >> nth=1"))


def point(page, title, share):
    box = area(page, title)
    page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2)
    return box


def drag(page, title, begin, end):
    box = point(page, title, begin)
    page.mouse.down()
    page.mouse.move(box["x"] + end * box["width"], box["y"] + 20, steps=4)
    page.mouse.up()


def canvas(page, title):
    """What a plot shows."""
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
    return plot(page, title).locator("canvas").evaluate("(canvas) => canvas.toDataURL()")


def is_labelled(page, title, share):
    """Whether a mark is drawn above the plot at a share of its width."""
    x = round(share * area(page, title)["width"])
    return plot(page, title).locator("canvas").evaluate(
        """(canvas, x) => {
          const [left, top] = [canvas.parentElement.querySelector(".u-over").offsetLeft + x - 4, 4];
          return canvas.getContext("2d").getImageData(left, top, 8, 16).data.some((value) => value > 0);
        }""", x)


def test_the_values_at_the_cursor_are_those_of_the_tables(folder, opened):
    page = opened(folder / "report/report.html")
    estimates, steps = rows(folder / "report/estimates.csv"), rows(folder / "report/timeseries.csv")
    for share in (0.31, 0.8):
        point(page, "frame to estimate", share)
        time = cursor_s(page)
        assert abs(time - share * shown_s(page)[1]) < 0.02
        latency = readings(page, "frame to estimate")[0]
        assert latency.endswith(" ms")
        assert numbers(latency) == [pytest.approx(nearest(estimates, time)["latency_ms"], abs=1e-3)]
        # The other plots show their values at the same time. The length of a displacement does not depend on the axes.
        by_axis = [readings(page, f"({axis}) position") for axis in "abc"]
        assert all(text.endswith(" mm") for texts in by_axis for text in texts)
        for index, body in enumerate(("target", "wanted", "hand")):
            at, start = nearest(steps, time), steps[0]
            expected = math.dist(*([row[f"{body}_{axis}_mm"] for axis in "xyz"] for row in (at, start)))
            assert math.hypot(*(numbers(texts[index])[0] for texts in by_axis)) == pytest.approx(expected, abs=2e-3), body
    page.screenshot(path=str(ARTEFACTS / "report.png"))


def test_a_dragged_span_is_shown_in_all_plots_until_the_whole_run_is_asked_for(folder, opened):
    page = opened(folder / "report/report.html")
    titles = ["(a) position", "hand: position error"]
    whole, before = shown_s(page), [canvas(page, title) for title in titles]
    assert whole[0] == 0 and abs(whole[1] - SECONDS) < 0.05 and page.is_disabled("text=Whole run")
    resets = (lambda: page.click("text=Whole run"), lambda: page.mouse.dblclick(*middle(page)), lambda: page.keyboard.press("Escape"))
    for reset in resets:
        drag(page, "hand: position error", 0.5, 0.9)
        begin, end = shown_s(page)
        assert abs(begin - 0.5 * whole[1]) < 0.03 and abs(end - 0.9 * whole[1]) < 0.03
        assert all(canvas(page, title) != image for title, image in zip(titles, before))
        for title in titles:
            assert is_labelled(page, title, (MARK_S - begin) / (end - begin)), "the mark moved with its time"
            assert not is_labelled(page, title, (MARK_S - 0.3 - begin) / (end - begin))
        plot(page, "hand: position error").locator(".uplot").focus()
        reset()
        assert shown_s(page) == whole
        assert [canvas(page, title) for title in titles] == before
    area(page, "(a) position")
    drag(page, "hand: position error", 0.4, 0.9)
    drag(page, "hand: position error", 0.5, 0.6)
    page.screenshot(path=str(ARTEFACTS / "report_zoomed.png"))
    assert shown_s(page)[1] - shown_s(page)[0] == pytest.approx(0.1 * 0.5 * whole[1], abs=0.02)


def middle(page):
    box = area(page, "hand: position error")
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def test_keys_move_the_cursor_and_zoom_and_a_screen_reader_gets_the_values(folder, opened):
    page = opened(folder / "report/report.html")
    root = plot(page, "frame to estimate").locator(".uplot")
    root.focus()
    times = [row["t_s"] for row in rows(folder / "report/estimates.csv")]
    page.keyboard.press("Home")
    for time in times[:4]:
        page.keyboard.press("ArrowRight")
        assert cursor_s(page) == pytest.approx(time, abs=1e-4)
    page.keyboard.press("ArrowLeft")
    assert cursor_s(page) == pytest.approx(times[2], abs=1e-4)
    said = root.get_attribute("aria-valuetext")
    assert numbers(said) == [cursor_s(page), *numbers(readings(page, "frame to estimate")[0])] and " ms" in said
    assert root.get_attribute("role") == "slider" and root.get_attribute("aria-label") == "frame to estimate"
    whole = shown_s(page)
    page.keyboard.press("PageUp")
    page.keyboard.press("+")
    page.keyboard.press("+")
    begin, end = shown_s(page)
    assert end - begin == pytest.approx(0.25 * (whole[1] - whole[0]), abs=1e-3) and begin < cursor_s(page) < end
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")
    assert shown_s(page)[1] >= cursor_s(page) > end - 1e-3, "the range follows the cursor"
    page.keyboard.press("-")
    page.keyboard.press("-")
    assert shown_s(page) == whole
    violations = Axe().run(page).response["violations"]
    assert [f"{rule['id']}: {node['html']}" for rule in violations for node in rule["nodes"]] == []


def test_the_wheel_zooms_with_ctrl_only_and_fingers_pinch(folder, opened):
    page = opened(folder / "report/report.html", has_touch=True)
    whole = shown_s(page)
    point(page, "frame to estimate", 0.5)
    page.mouse.wheel(0, -10)
    assert shown_s(page) == whole
    box = point(page, "frame to estimate", 0.5)
    page.keyboard.down("Control")
    page.mouse.wheel(0, -200)
    page.keyboard.up("Control")
    for _ in range(50):
        if shown_s(page) != whole:
            break
        page.wait_for_timeout(20)
    begin, end = shown_s(page)
    assert end - begin < 0.7 * whole[1] and (begin + end) / 2 == pytest.approx(whole[1] / 2, abs=0.05)
    page.click("text=Whole run")
    box = area(page, "frame to estimate")
    touch = page.context.new_cdp_session(page)
    y = box["y"] + box["height"] / 2

    def fingers(kind, *shares):
        at = [{"x": box["x"] + share * box["width"], "y": y, "id": index} for index, share in enumerate(shares)]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    fingers("touchStart", 0.4)
    fingers("touchMove", 0.25)
    assert cursor_s(page) == pytest.approx(0.25 * whole[1], abs=0.05)
    fingers("touchEnd")
    fingers("touchStart", 0.4, 0.6)
    fingers("touchMove", 0.3, 0.7)
    fingers("touchMove", 0.2, 0.8)
    fingers("touchEnd")
    begin, end = shown_s(page)
    assert end - begin == pytest.approx(whole[1] / 3, abs=0.1) and (begin + end) / 2 == pytest.approx(whole[1] / 2, abs=0.05)


def test_a_comparison_has_both_runs_where_both_are(folder, opened):
    page = opened(folder / "compare/compare.html")
    title = "state of the supervisor"
    point(page, title, 0.9)
    states = dict(entry.split() for entry in plot(page, title).locator("b").inner_text().split(": ")[1].split(", "))
    assert states[readings(page, title)[0]] == "tracking"
    point(page, title, 0.1)
    assert all(states[number] == "tracking" for number in readings(page, title)), "a state holds until the next one"
    point(page, "latency", 0.1)
    assert all(numbers(text)[0] > 0 for text in readings(page, "latency"))
    drag(page, "latency", 0.0, 0.2)
    page.screenshot(path=str(ARTEFACTS / "compare.png"))


def test_without_scripts_the_page_says_what_is_missing(folder, opened):
    notice = "text=The plots of this page need scripts"
    assert opened(folder / "report/report.html").locator(notice).count() == 0
    page = opened(folder / "report/report.html", java_script_enabled=False)
    assert page.locator(notice).is_visible() and page.locator(".axis-bar").count() == 0
    assert page.locator("table").count() > 3


def test_a_printed_page_has_its_plots_in_the_colours_of_paper(folder, opened):
    page = opened(folder / "report/report.html", color_scheme="dark")
    ink = "getComputedStyle(document.documentElement).getPropertyValue('--ink')"
    dark, before = page.evaluate(ink), canvas(page, "(a) position")
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert page.evaluate(ink) != dark and canvas(page, "(a) position") != before
    plots = page.locator("figure.plot.live canvas:visible")
    assert plots.count() >= 10 and page.locator(".axis-bar:visible, .reading:visible").count() == 0
    widths = plots.evaluate_all("(all) => all.map((one) => one.clientWidth - one.closest('figure').clientWidth)")
    assert max(widths) <= 0
    page.screenshot(path=str(ARTEFACTS / "report_printed.png"))
    page.emulate_media(media="screen")
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(ink) == dark


def test_texts_of_a_recording_are_not_run(folder, opened):
    text = (folder / "report/report.html").read_text()

    def spoiled(found):
        data = json.loads(found.group(0))
        for axis in (data["x"], data["y"]):
            axis.update(quantity=NASTY, unit=NASTY)
        data["marks"] = [{"at": 1.0, "label": NASTY}]
        return json.dumps(data).replace("<", "\\u003c")

    text = DATA.sub(spoiled, text).replace("</i>hand<", f"</i>{NASTY.replace('<', '&lt;')}<")
    file = folder / "report" / "<img src=x onerror=window.hit=1>.html"
    file.write_text(text)
    page = opened(file)
    point(page, "frame to estimate", 0.5)
    assert NASTY in page.inner_text(".axis-bar") and NASTY in readings(page, "frame to estimate")[0]
    assert NASTY in plot(page, "(a) position").locator(".uplot").get_attribute("aria-valuetext")
    assert page.locator("img[src=x]").count() == 0 and page.evaluate("window.hit") is None


def test_a_script_that_got_into_the_page_would_not_run(folder, browser):
    file = folder / "report" / "foreign.html"
    file.write_text((folder / "report/report.html").read_text().replace("</h1>", f"</h1>{NASTY.replace('</script>', '', 1)}", 1))
    page = browser.new_page()
    refused = []
    page.on("console", lambda line: refused.append(line.text))
    page.goto(file.as_uri())
    assert page.evaluate("window.hit") is None and page.locator(".axis-bar").count() == 1
    assert any("Content Security Policy" in line for line in refused)
    page.close()

"""A target that is occluded, lost and found again, seen in the browser: `cargo xtask panel`."""

import pytest

from conftest import wait_for

# Seconds of the run's clock: enough time before to choose the target.
OCCLUDED = (30.0, 36.0)
DARK = (42.0, 45.0)


@pytest.fixture
def faults():
    fault = '[[camera.faults]]\nkind = "{}"\n{}\nfrom_s = {}\nuntil_s = {}\n'
    bar = fault.format("occluder", "width_share = 0.06\ncrosses = true", *OCCLUDED)
    return bar + fault.format("black", 'cameras = "both"', *DARK)


def run_s(panel):
    return panel.state()["time_ms"] / 1e3


def test_a_target_is_occluded_lost_and_found_again(panel, page):
    page.follow()
    wait_for(lambda: panel.state_name() == "tracking")
    assert run_s(panel) < OCCLUDED[0], "this machine is too slow: the bar comes before the target is followed"
    errors_mm = []
    while run_s(panel) < OCCLUDED[1] + 1.0:
        state = panel.state()
        assert state["state"]["name"] in ("approaching", "tracking", "holding"), "a bar in front of a part of it"
        errors_mm += [abs(error) for error in state["target"]["error_mm"] or []]
        page.page.wait_for_timeout(20)
    assert len(errors_mm) > 30, "most states have a pose"
    assert max(errors_mm) < 20.0, f"the pose was off by {max(errors_mm)} mm behind a bar"
    wait_for(lambda: panel.state_name() == "lost", "black images lose the target", 60.0)
    wait_for(lambda: "PB3DP-SUP-" in page.text("#why"), "the page does not say why")
    page.screenshot("lost")
    wait_for(lambda: panel.state_name() == "tracking", "the target was not found again", 60.0)
    assert panel.state()["target"]["name"] == "crab"

"""Measures the time that the package adds to each call, and writes docs/benchmarks/python.md: cargo xtask python --wheel --bench."""

import platform
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import pb3dp

ROOT = Path(__file__).resolve().parents[2]
CALLS = 400
GOAL_US = 50.0

PAGE = """# Python

This page is written by the command below; change the program, not the page.

The time on the wall of a call from Python, minus the CPU time that the estimator states for its own work, which is the time that the program reports: the cost of the arguments, of the results, and of releasing and taking the lock of the interpreter.
Medians of {calls} calls on each of {cases} cases with images of {size}, after the first call.
The goal is at most {goal:.0f} microseconds for images that need not be copied.

```text
cargo xtask python --wheel --bench
```

Commit {commit}; {processor}; Python {python}, numpy {numpy}.

| call | images | estimator, microseconds | added, microseconds | added, share |
| --- | --- | --- | --- | --- |
{rows}

{verdict}
"""


def added_us(call, stated_s):
    """Medians of the stated time and of the added time, microseconds."""
    call()
    stated, added = [], []
    for _ in range(CALLS):
        start = time.perf_counter()
        result = call()
        elapsed_us = (time.perf_counter() - start) * 1e6
        stated.append(stated_s(result) * 1e6)
        added.append(elapsed_us - stated[-1])
    return statistics.median(stated), statistics.median(added)


def layouts(pair):
    """The same images in different memory."""
    both = np.concatenate([pair.left, pair.right], axis=1)
    width = pair.left.shape[1]
    grey = [np.ascontiguousarray(image[..., 1]) for image in (pair.left, pair.right)]
    return {
        "uint8, red green blue, in one piece": (pair.left, pair.right),
        "halves of one image": (both[:, :width], both[:, width:]),
        "uint8, grey": grey,
        "uint16, grey, 12 bits": tuple(image.astype(np.uint16) << 4 for image in grey),
        "blue green red, copied": (pair.left[..., ::-1], pair.right[..., ::-1]),
    }


def read_all(estimate):
    """Reads all results."""
    for name in ("status", "reason", "warnings", "z_m", "normal", "cam_left_from_model", "covariance", "observed", "fitness", "quaternion_xyzw"):
        getattr(estimate, name)
    return estimate


def measured(recording):
    """The rows of one case: call, images, stated and added time."""
    pair, region = recording[0], recording.region
    keywords = {"z_range_m": recording.z_range_m, "tilt_max_rad": recording.tilt_max_rad}
    rows = []
    for name, (left, right) in layouts(pair).items():
        estimator = pb3dp.Estimator(recording.rig, **keywords, value_range=(0, 255 << 4))
        rows.append(("estimate", name, *added_us(lambda: estimator.estimate(left, right, region), lambda result: result.cpu_s)))  # noqa: B023
    estimator = pb3dp.Estimator(recording.rig, **keywords)
    left, right = pair.left, pair.right
    rows.append(("estimate, all results read", "uint8, red green blue, in one piece",
                 *added_us(lambda: read_all(estimator.estimate(left, right, region)), lambda result: result.cpu_s)))
    tracker = pb3dp.Tracker(recording.rig, **keywords)
    tracker.track(left, right, region)
    rows.append(("track", "uint8, red green blue, in one piece", *added_us(lambda: tracker.track(left, right), lambda result: result.cpu_s)))
    return rows


def processor():
    """Name of the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def main():
    """Measures and writes the page; fails if the goal is not met."""
    cases = [pb3dp.Recording(folder) for folder in sorted((ROOT / "tests/data/cases").iterdir())]
    of_cases = [measured(recording) for recording in cases]
    rows, worst = [], 0.0
    for same in zip(*of_cases, strict=True):
        call, images = same[0][:2]
        stated, added = (statistics.median(row[index] for row in same) for index in (2, 3))
        rows.append(f"| {call} | {images} | {stated:.0f} | {added:.1f} | {100 * added / stated:.1f} % |")
        if "copied" not in images and "read" not in call:
            worst = max(worst, added)
    commit = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()
    width, height = cases[0].rig.image_size
    is_met = worst <= GOAL_US
    page = PAGE.format(calls=CALLS, cases=len(cases), size=f"{width}x{height}", goal=GOAL_US, commit=commit or "unknown", processor=processor(),
                       python=platform.python_version(), numpy=np.__version__, rows="\n".join(rows),
                       verdict=f"The goal is {'' if is_met else 'not '}met: the largest of its rows is {worst:.1f} microseconds.")
    (ROOT / "docs/benchmarks/python.md").write_text(page)
    print(page)
    return 0 if is_met else 1


if __name__ == "__main__":
    sys.exit(main())

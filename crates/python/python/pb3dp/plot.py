"""Poses drawn with matplotlib (``pip install pb3dp[plot]``): into an image, and over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ._pb3dp import Error, Estimate, Region, StereoRig, TrackEstimate

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["show_pose", "show_track"]


def _figure(size: tuple[float, float] | None = None) -> Figure:
    try:
        from matplotlib import pyplot
    except ImportError as error:
        raise Error("matplotlib is not installed: pip install pb3dp[plot]") from error
    return pyplot.figure(figsize=size, layout="constrained")


def show_pose(
    image: npt.NDArray[np.uint8],
    estimate: Estimate | TrackEstimate,
    rig: StereoRig,
    axes: Axes | None = None,
    length_m: float = 0.05,
    region: Region | None = None,
) -> Axes:
    """Draws the axes of ``model`` (x red, y green, z blue) and the status into the left image.

    ``length_m`` is the length of the axes, metres. ``region`` is drawn as well if it is a rectangle or a polygon. Without a pose only the
    image, the region and the status are drawn. Returns the axes of matplotlib.
    """
    if axes is None:
        axes = _figure().add_subplot()
    axes.imshow(image, cmap="gray" if image.ndim == 2 else None)
    corners_px = None if region is None else region.corners_px
    if corners_px is not None:
        axes.plot(*np.vstack([corners_px, corners_px[:1]]).T, color="yellow", linewidth=1)
    pose = estimate.cam_left_from_model
    title = estimate.status
    if pose is not None:
        ends = pose[:3, 3] + length_m * pose[:3, :3].T
        origin, *ends_px = rig.project_left(np.vstack([pose[:3, 3], ends]))
        for end, name, colour in zip(ends_px, "xyz", ("red", "lime", "blue"), strict=True):
            axes.plot([origin[0], end[0]], [origin[1], end[1]], color=colour, linewidth=2)
            axes.annotate(name, end, color=colour, xytext=(3, 3), textcoords="offset points")
        x, y, z = pose[:3, 3]
        title += f": x {x * 1e3:.1f}, y {y * 1e3:.1f}, z {z * 1e3:.1f} mm; axes {length_m * 1e3:.0f} mm"
    axes.set_title(title)
    axes.set_axis_off()
    return axes


def show_track(tracked: Sequence[TrackEstimate], times_s: npt.ArrayLike | None = None) -> Figure:
    """Draws the motion of a target since its first pose, with standard deviations, over time or over the number of the pair.

    Positions are along the axes of ``cam_left``, standard deviations along those of ``model``. Pairs whose status is not ``ok`` are shaded.
    Returns the figure of matplotlib.
    """
    figure = _figure((9.0, 8.0))
    position, turn, sigma = figure.subplots(3, 1, sharex=True)
    times = np.arange(len(tracked)) if times_s is None else np.asarray(times_s)
    if times.shape != (len(tracked),):
        raise Error(f"times_s has the shape {times.shape}: give {len(tracked)} times, one for each estimate")
    known = [(time, found) for time, found in zip(times, tracked, strict=True) if found.cam_left_from_model is not None]
    if known:
        at = np.array([time for time, _ in known])
        poses = np.array([found.cam_left_from_model for _, found in known])
        turns = poses[:, :3, :3] @ poses[0, :3, :3].T
        angle = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
        position.plot(at, 1e3 * (poses[:, :3, 3] - poses[0, :3, 3]), ".-", label=["x, right", "y, down", "z, forward"])
        turn.plot(at, np.degrees(angle), ".-", color="black")
        stated = [(time, np.sqrt(np.diag(found.covariance))) for time, found in known if found.covariance is not None]
        if stated:
            sigma.plot([time for time, _ in stated], 1e3 * np.array([sigmas[:3] for _, sigmas in stated]), ".-", label=["x", "y", "z"])
    half = np.median(np.diff(times)) / 2.0 if len(times) > 1 else 0.5
    for time, found in zip(times, tracked, strict=True):
        if found.status != "ok":
            for axes in (position, turn, sigma):
                axes.axvspan(time - half, time + half, color="orange", alpha=0.3, linewidth=0)
    position.set(ylabel="mm", title="Motion since the first pose, along the axes of the left camera (shaded: not ok)")
    turn.set(ylabel="degrees", title="Turn since the first pose")
    sigma.set(ylabel="mm", title="Standard deviation of the position, along the axes of the target", ylim=(0.0, None))
    sigma.set_xlabel("number of the pair" if times_s is None else "s")
    for axes in (position, sigma):
        if axes.lines:
            axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure

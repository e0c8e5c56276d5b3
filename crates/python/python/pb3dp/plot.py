"""Poses drawn into images, with matplotlib (``pip install pb3dp[plot]``)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ._pb3dp import Error, Estimate, StereoRig, TrackEstimate

if TYPE_CHECKING:
    import numpy.typing as npt
    from matplotlib.axes import Axes

__all__ = ["show_pose"]


def show_pose(
    image: npt.NDArray[np.uint8],
    estimate: Estimate | TrackEstimate,
    rig: StereoRig,
    axes: Axes | None = None,
    length_m: float = 0.05,
) -> Axes:
    """Draws the axes of ``model`` (x red, y green, z blue) and the status into the left image.

    ``length_m`` is the length of the axes, metres. Without a pose only the image and the status are drawn. Returns the axes of matplotlib.
    """
    if axes is None:
        try:
            from matplotlib import pyplot
        except ImportError as error:
            raise Error("matplotlib is not installed: pip install pb3dp[plot]") from error
        axes = pyplot.figure().add_subplot()
    axes.imshow(image, cmap="gray" if image.ndim == 2 else None)
    pose = estimate.cam_left_from_model
    title = estimate.status
    if pose is not None:
        ends = pose[:3, 3] + length_m * pose[:3, :3].T
        origin, *ends_px = rig.project_left(np.vstack([pose[:3, 3], ends]))
        for end, colour in zip(ends_px, ("red", "lime", "blue"), strict=True):
            axes.plot([origin[0], end[0]], [origin[1], end[1]], color=colour, linewidth=2)
        x, y, z = pose[:3, 3]
        title += f": x {x * 1e3:.1f}, y {y * 1e3:.1f}, z {z * 1e3:.1f} mm"
    axes.set_title(title)
    axes.set_axis_off()
    return axes

"""Pose of unknown objects from a calibrated stereo pair, tracking, recordings and simulated visual servoing.

Lengths are metres and angles radians. A transform ``a_from_b`` maps coordinates in ``b`` to ``a``; matrices are 4x4, row by row. Images are
arrays of height x width x 3, uint8, in the order red, green, blue. Frames: ``cam_left`` is the left camera (x to the right, y down, z forward),
``model`` is fixed to the target. No real arm and no real camera can be reached from here.
"""

from ._pb3dp import (
    Error,
    Estimate,
    Estimator,
    Pair,
    RecordedRun,
    Recording,
    Region,
    Run,
    RunPair,
    RunStep,
    StereoRig,
    TrackEstimate,
    Tracker,
    __version__,
    read_image,
)

__all__ = [
    "Error",
    "Estimate",
    "Estimator",
    "Pair",
    "RecordedRun",
    "Recording",
    "Region",
    "Run",
    "RunPair",
    "RunStep",
    "StereoRig",
    "TrackEstimate",
    "Tracker",
    "__version__",
    "read_image",
]

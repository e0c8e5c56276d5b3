"""Pose of unknown objects from a calibrated stereo pair, tracking, recordings and simulated visual servoing.

Lengths are metres, angles radians, times and durations seconds (``_s``). One exception: the stamp of a pair, ``time_ns``, is an integer of
nanoseconds. A float has a resolution of 0.2 microseconds for seconds since 1970; with the exact stamp the package tracks a recording to the
same bits as the program.

A transform ``a_from_b`` maps coordinates in ``b`` to ``a``; matrices are 4x4, row by row. Images are
arrays of height x width x 3, uint8, in the order red, green, blue. Frames: ``cam_left`` is the left camera (x to the right, y down, z forward),
``model`` is fixed to the target. No real arm and no real camera can be reached from here.
"""

from ._named_tuples import Distortion, NamedCovariance, Surface, VisibleSurface
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
    "Distortion",
    "Error",
    "Estimate",
    "Estimator",
    "NamedCovariance",
    "Pair",
    "RecordedRun",
    "Recording",
    "Region",
    "Run",
    "RunPair",
    "RunStep",
    "StereoRig",
    "Surface",
    "TrackEstimate",
    "Tracker",
    "VisibleSurface",
    "__version__",
    "read_image",
]

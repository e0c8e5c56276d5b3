"""Results with several arrays: they unpack in the order of their fields."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

__all__ = ["Distortion", "NamedCovariance", "Surface", "VisibleSurface"]


class VisibleSurface(NamedTuple):
    """The visible surface of a region, pixel by pixel, as `Estimator.visible_surface` returns it.

    `points_m`: positions in `cam_left`, N x 3, metres. `sigmas_m`: standard deviations along the rays of the pixels, N, metres. `colours`: N x 3,
    uint8, red, green, blue. `measured`: N, bool: whether the pixel has a match of its own in the right image; others have a depth of their
    neighbours.
    """

    points_m: npt.NDArray[np.float64]
    sigmas_m: npt.NDArray[np.float64]
    colours: npt.NDArray[np.uint8]
    measured: npt.NDArray[np.bool_]


class Surface(NamedTuple):
    """The recovered surface of a tracked target, as `Tracker.surface` returns it.

    `points_m`: positions in `model`, N x 3, metres. `normals`: unit normals in `model` towards the first camera, N x 3. `sigmas_m`: standard
    deviations along the rays of the first left image, N, metres. `colours`: N x 3, uint8, red, green, blue.
    """

    points_m: npt.NDArray[np.float64]
    normals: npt.NDArray[np.float64]
    sigmas_m: npt.NDArray[np.float64]
    colours: npt.NDArray[np.uint8]


class Distortion(NamedTuple):
    """The lens of a camera, as `StereoRig.left_distortion` returns it.

    `model`: `none`, `plumb_bob`, `rational_polynomial` or `equidistant`. `coefficients`: those of the model in the order of OpenCV.
    """

    model: str
    coefficients: npt.NDArray[np.float64]


class NamedCovariance(NamedTuple):
    """The covariance of the N numbers of a calibration, as `StereoRig.calibration_covariance` returns it.

    `names`: of the numbers, such as `left.fx`, N. `matrix`: N x N, in the units of the numbers: pixels, metres, radians.
    """

    names: list[str]
    matrix: npt.NDArray[np.float64]

"""The compiled part of the package."""

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, final

import numpy as np
import numpy.typing as npt

from ._named_tuples import Distortion, NamedCovariance, Surface, VisibleSurface

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

__version__: str

_Floats = npt.NDArray[np.float64]
_Bytes = npt.NDArray[np.uint8]
_Image = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
_Path = str | os.PathLike[str]
_Corners = Sequence[Sequence[float]] | _Floats

class Error(Exception):
    """An input that cannot be used, or a failure.

    The text is that of the program, with the arguments of this package in the place of options: the thing, its value, the remedy. `code` is the
    code of the message, such as `PB3DP-EST-002`, or None; `pb3dp explain CODE` prints cause and remedy.
    """
    code: str | None

def read_image(path: _Path) -> npt.NDArray[Any]:
    """Reads an image file as the program does: PNG, JPEG, TIFF, BMP, PGM, PPM or WebP.

    Returns an array of height x width x 3, uint8, in the order red, green, blue. A file with 16 bits per channel gives uint16; a grey one of
    16 bits gives height x width. Raises `Error` if the file at `path` cannot be read.
    """

@final
class StereoRig:
    """A calibrated pair of cameras.

    Frames: `cam_left` and `cam_right` have x to the right, y down, z forward, and their origin in the optical centre.
    """
    @staticmethod
    def load(
        *paths: _Path,
        image_size: tuple[int, int] | None = None,
        calibration_unit: str | None = None,
        calibrated_size: tuple[int, int] | None = None,
        lens: str | None = None,
        rectified: bool = False,
        images: tuple[_Image, _Image] | None = None,
    ) -> StereoRig:
        """Loads a calibration from `paths`: the file of `pb3dp calibrate`, `calib.json`, a Kalibr camchain, an OpenCV stereo YAML or its two files,
        two ROS `camera_info` files (left, right), or a folder that contains them. The format is detected from the contents.

        For files that leave something unstated: `image_size` is (width, height) of the images in pixels; `calibration_unit` the unit of length of
        an OpenCV file, "mm", "cm" or "m"; `calibrated_size` the (width, height) that the calibration was made with, from which it is scaled to
        `image_size`; `lens` the model of four coefficients, "brown" or "equidistant". `rectified`: whether the images are rectified already.
        `images`: a left and a right image of these cameras, as in `Estimator.estimate`; they give `image_size`, and decide the lens model as in
        the program. Raises `Error` if a file cannot be read, or leaves something unstated that no argument states.
        """
    def project_left(self, points_in_cam_left: _Floats) -> _Floats:
        """Projects points into the raw left image, with the distortion of the lens: `points_in_cam_left`, N x 3, metres, to N x 2, pixels. Points
        that the camera cannot see give NaN. Raises `Error` for another shape.
        """
    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of the images, pixels."""
    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres, metres."""
    @property
    def left_matrix(self) -> _Floats:
        """Camera matrix of the left camera, 3x3, pixels."""
    @property
    def right_matrix(self) -> _Floats:
        """Camera matrix of the right camera, 3x3, pixels."""
    @property
    def left_distortion(self) -> Distortion:
        """Lens of the left camera: a `Distortion`, its model and its coefficients."""
    @property
    def right_distortion(self) -> Distortion:
        """Lens of the right camera, as `left_distortion`."""
    @property
    def cam_right_from_cam_left(self) -> _Floats:
        """Pose of the left camera in the right one: 4x4, maps coordinates in `cam_left` to `cam_right`, translation in metres."""
    @property
    def calibration_covariance(self) -> NamedCovariance | None:
        """Covariance of the N numbers of the calibration with their names, a `NamedCovariance`, or None: `left.fx` (pixels), `right.k1`, and
        `cam_right_from_cam_left.x_m` to `rz_rad`. TOML files of `pb3dp calibrate stereo` state it; estimates then have
        `calibration_covariance`.
        """
    @property
    def format(self) -> str:
        """The format of the file, in words."""
    @property
    def source(self) -> str:
        """The file or files."""
    @property
    def warnings(self) -> list[str]:
        """Assumptions about what the file leaves unstated that can be wrong; they also stand in `warnings` of the estimates."""
    @property
    def notes(self) -> list[str]:
        """What the reader assumed or left out."""

@final
class Region:
    """The pixels of an object in the left image.

    Pixel coordinates: u to the right, v down; (0, 0) is the centre of the first pixel.
    """
    @staticmethod
    def parse(text: str) -> Region:
        """A region from a `text` in the notation of the program: `rect:X,Y,WIDTH,HEIGHT`, `poly:X1,Y1;X2,Y2;X3,Y3`, `mask:FILE` or `click:X,Y`,
        pixels. Raises `Error` for another text.
        """
    @staticmethod
    def rectangle(x: float, y: float, width: float, height: float) -> Region:
        """A rectangle: its first column `x` and row `y`, its `width` and `height`, pixels. Raises `Error` if it has no area."""
    @staticmethod
    def polygon(corners: _Corners) -> Region:
        """A polygon: `corners` is an array of N x 2, column and row, pixels. Raises `Error` for less than three corners."""
    @staticmethod
    def click(x: float, y: float) -> Region:
        """A region grown from one pixel over its colour: column `x` and row `y`, pixels. Raises `Error` for numbers that are not finite."""
    @staticmethod
    def mask(mask: npt.NDArray[np.bool_] | _Bytes) -> Region:
        """The pixels that are True, or not 0: `mask` is an array of height x width, bool or uint8, with the size of the left image. Raises `Error`
        for another type or shape, and for a mask without pixels.
        """
    @property
    def corners_px(self) -> _Floats | None:
        """The corners of a rectangle or a polygon: N x 2, column and row, pixels; None for masks and clicks."""

@final
class Estimate:
    """The pose of a region in one stereo pair, with its status and the reason for it.

    Frames: `cam_left` is the left camera (x to the right, y down, z forward). `model` is on the plane of the region: its origin on the ray of
    `centroid_px`, z along the normal away from the camera, x along the rows of the image.
    """
    def to_json(self, case: str = "") -> str:
        """The line that `pb3dp estimate --json` prints, in millimetres and milliseconds; `case` is the name in it."""
    @property
    def status(self) -> str:
        """`ok`, `weak-tilt`, `weak-depth`, `ambiguous`, `miscalibrated` or `not-observable`; treat a word that you do not know as not `ok`."""
    @property
    def reason(self) -> str:
        """What led to the status."""
    @property
    def warnings(self) -> list[str]:
        """What may make the pose worse than its status."""
    @property
    def method(self) -> str:
        """The method: `direct` or `published`."""
    @property
    def z_m(self) -> float | None:
        """Depth of the plane on the ray of `centroid_px`, metres, or None."""
    @property
    def normal(self) -> _Floats | None:
        """Unit normal of the plane in `cam_left`, 3 numbers, towards the camera, or None."""
    @property
    def cam_left_from_model(self) -> _Floats | None:
        """Pose of the plane: 4x4, maps coordinates in `model` to `cam_left`, translation in metres; or None."""
    @property
    def translation_m(self) -> _Floats | None:
        """Translation of `cam_left_from_model`, 3 numbers, metres, or None."""
    @property
    def quaternion_xyzw(self) -> _Floats | None:
        """Rotation of `cam_left_from_model` as unit quaternion, 4 numbers x, y, z, w, or None."""
    @property
    def covariance(self) -> _Floats | None:
        """Covariance of the pose, 6x6, or None: of xi = (x, y, z in metres, then a rotation vector in radians), both along the axes of `model`,
        with true pose = cam_left_from_model * exp(xi).
        """
    @property
    def pose_covariance(self) -> _Floats | None:
        """The sum of `covariance` and `calibration_covariance`, 6x6, or None."""
    @property
    def calibration_covariance(self) -> _Floats | None:
        """The share of the calibration in the covariance of the pose, 6x6 as `covariance`, in which it is not contained; None without a pose, or if
        the calibration file states no covariance (`StereoRig.calibration_covariance`).
        """
    @property
    def observed(self) -> list[bool] | None:
        """Whether the images determine x, y, z and the turns about them (axes of `model`), 6 values, or None if the method does not tell."""
    @property
    def fitness(self) -> float | None:
        """How well the images agree, at most 1, or None."""
    @property
    def z_sigma_m(self) -> float | None:
        """Standard deviation of the depth, metres, or None."""
    @property
    def normal_sigma_rad(self) -> float | None:
        """Standard deviation of the normal, radians, or None."""
    @property
    def centroid_px(self) -> tuple[float, float]:
        """The point of the left image on whose ray the depth is given: column and row, pixels."""
    @property
    def row_offset_px(self) -> float | None:
        """Row of the right image minus row of the left one in the rectified pair, pixels, or None."""
    @property
    def cpu_s(self) -> float:
        """CPU time from the images in memory to the pose, seconds."""

@final
class Estimator:
    """Estimates the pose of a region in single stereo pairs.

    `rig`: the calibrated cameras. `method`: `direct` or `published`. `z_range_m`: the nearest and the farthest depth to search, metres; by
    default those with disparities of 35 to 5 % of the width. `tilt_max_rad`: the largest tilt to search, radians; default 60 degrees. `config`:
    a TOML file with all parameters of the methods. `seed`: of the search of the published method. `value_range`: the values that become black
    and white in images of uint16, such as (0, 4095) for 12 bits; measured on the first pair by default. Raises `Error` if an argument is out of
    its range.

    Every pair is compared with the calibration, as in the program: a vertical misalignment of its rows is corrected, and if the rows contradict
    the calibration, the status is `miscalibrated`.
    An estimator can be used by several threads; its calls wait for each other.
    """
    def __new__(
        cls,
        rig: StereoRig,
        method: str = "direct",
        *,
        z_range_m: tuple[float, float] | None = None,
        tilt_max_rad: float | None = None,
        config: _Path | None = None,
        seed: int | None = None,
        value_range: tuple[int, int] | None = None,
    ) -> Estimator: ...
    def estimate(
        self,
        left: _Image,
        right: _Image,
        region: Region,
        *,
        centroid_px: tuple[float, float] | list[float] | None = None,
        deadline_s: float | None = None,
    ) -> Estimate:
        """Estimates the pose of a region.

        `left` and `right`: the raw images, as the cameras delivered them; height x width x 3 in the order red, green, blue, or height x width,
        of uint8 or uint16. Images are used where they are, also parts of larger images, if the values of a row are beside each other; others
        are copied. Do not write to them before the call returns. `region`: the object in the left image. `centroid_px`: the point of the left
        image on whose ray the depth is given, pixels; by default the centroid of the region. `deadline_s`: after this CPU time, seconds, the
        best estimate so far is returned, with a warning.

        A pose that cannot be determined is a status of the result. Raises `Error` if the images or the region cannot be used.
        """
    def visible_surface(self, left: _Image, right: _Image, region: Region) -> VisibleSurface:
        """The visible surface of a region, pixel by pixel, for objects that are no plane: a `VisibleSurface` of N points in `cam_left`, metres.

        `left`, `right` and `region` as for `estimate`. Errors of neighbours are not independent. Empty for the published method. Raises `Error`
        as `estimate` does, with the code `PB3DP-EST-012` if too few pixels have a match: the depth range or the calibration is wrong.
        """
    @property
    def method(self) -> str:
        """The method: `direct` or `published`."""
    @property
    def z_range_m(self) -> tuple[float, float]:
        """The nearest and the farthest depth that are searched, metres."""
    @property
    def tilt_max_rad(self) -> float:
        """The largest tilt that is searched, radians."""

@final
class TrackEstimate:
    """The pose of a tracked target in one frame, with its status and the reason for it.

    Frames: `cam_left` is the left camera (x to the right, y down, z forward). `model` is fixed to the target: in the first frame its origin is on
    the ray of the centroid of the region, z along the normal away from the camera, x along the rows of the image.
    """
    def to_json(self, frame: int = 0, t_s: float = 0.0) -> str:
        """The line that `pb3dp track --json` prints, in millimetres and milliseconds; `frame` is the number in it, and `t_s` the time, seconds."""
    @property
    def status(self) -> str:
        """`ok`, `weak-tilt`, `partly-observed`, `weak-depth`, `ambiguous`, `miscalibrated`, `not-observable` or `lost`; treat a word
        that you do not know as not `ok`.
        """
    @property
    def reason(self) -> str:
        """What led to the status."""
    @property
    def warnings(self) -> list[str]:
        """What may make the pose worse than its status; reported once, with the first frame."""
    @property
    def cam_left_from_model(self) -> _Floats | None:
        """Pose of the target: 4x4, maps coordinates in `model` to `cam_left`, translation in metres; or None."""
    @property
    def translation_m(self) -> _Floats | None:
        """Translation of `cam_left_from_model`, 3 numbers, metres, or None."""
    @property
    def quaternion_xyzw(self) -> _Floats | None:
        """Rotation of `cam_left_from_model` as unit quaternion, 4 numbers x, y, z, w, or None."""
    @property
    def covariance(self) -> _Floats | None:
        """Covariance of the pose since the first one, 6x6, or None: of xi = (x, y, z in metres, then a rotation vector in radians), both along the
        axes of `model`, with true pose = cam_left_from_model * exp(xi). In the first frame it is that of the first pose.
        """
    @property
    def first_pose_covariance(self) -> _Floats | None:
        """Covariance of the first pose against the visible surface of the target, 6x6 as `covariance`, or None: choice of the surface, relief, noise,
        motion between the exposures, and the share of the calibration.
        """
    @property
    def pose_covariance(self) -> _Floats | None:
        """Covariance of the pose against the visible surface, 6x6 as `covariance`, or None: the sum of `covariance` and `first_pose_covariance`."""
    @property
    def surface_from_model(self) -> _Floats | None:
        """Pose of the visible surface in `model`, as the frames so far show it: 4x4, metres, or None. `model` itself never moves."""
    @property
    def surface_covariance(self) -> _Floats | None:
        """Covariance of `surface_from_model` against the visible surface, 6x6 as `covariance`, or None."""
    @property
    def surface_version(self) -> int | None:
        """Number of frames that have improved `surface_from_model`, or None; 0: it is the identity."""
    @property
    def calibration_covariance(self) -> _Floats | None:
        """The share of the calibration in `pose_covariance`, 6x6; None without a pose, or if the calibration file states no covariance
        (`StereoRig.calibration_covariance`).
        """
    @property
    def calibration_covariance_of_motion(self) -> _Floats | None:
        """The share of the calibration in the motion since the first pose of the target, 6x6, not contained in `covariance`, or None: zero at the
        first pose, and small while the target is near it.
        """
    @property
    def observed(self) -> list[bool] | None:
        """Whether the images determine x, y, z and the turns about them (axes of `model`), 6 values, or None if the method does not tell."""
    @property
    def fitness(self) -> float | None:
        """Agreement of model and images, at most 1, or None."""
    @property
    def outline_px(self) -> _Floats:
        """Outline of the target in the left image: N x 2, pixels."""
    @property
    def cpu_s(self) -> float:
        """CPU time from the images in memory to the pose, seconds."""

@final
class Tracker:
    """Tracks one target through a sequence of stereo pairs.

    The arguments `rig`, `method`, `z_range_m` (metres), `tilt_max_rad` (radians), `config`, `seed` and `value_range` are those of `Estimator`.
    Raises `Error` if one of them is out of its range.
    A tracker can be used by several threads; its calls wait for each other.
    """
    def __new__(
        cls,
        rig: StereoRig,
        method: str = "direct",
        *,
        z_range_m: tuple[float, float] | None = None,
        tilt_max_rad: float | None = None,
        config: _Path | None = None,
        seed: int | None = None,
        value_range: tuple[int, int] | None = None,
    ) -> Tracker: ...
    def track(
        self,
        left: _Image,
        right: _Image,
        region: Region | None = None,
        *,
        time_ns: int | None = None,
        deadline_s: float | None = None,
        cam_left_prev_from_cam_left_now: _Floats | None = None,
        skew_s: float | None = None,
    ) -> TrackEstimate:
        """Tracks the target in the next pair.

        `left` and `right`: as in `Estimator.estimate`. `region`: marks the target; needed with the first pair, later it marks another target.
        `time_ns`: the middle of the left exposure, whole nanoseconds on any clock, as in `Pair.time_ns`; without it the pairs are taken as equally
        spaced. `deadline_s`: after this CPU time, seconds, the best estimate so far is returned. `cam_left_prev_from_cam_left_now`: the motion of
        the left camera since the previous pair, 4x4, metres, if an arm knows it. `skew_s`: middle of the right exposure minus middle of the left
        one, seconds; the tracker takes out the target's motion in it (needs `time_ns`). 0: both at once. None: not known; the tracker looks for it
        in the motion, and warns of the skew that it finds, or of the error that an unknown one may cause.

        A pose that cannot be determined is a status of the result. Raises `Error` if the images, the region, the motion or the skew cannot be used.
        """
    def surface(self) -> Surface:
        """The recovered surface: a `Surface` of N points in `model`, metres. Empty before a target was found, and for the published method."""
    @property
    def is_started(self) -> bool:
        """Whether a region was marked and accepted."""
    @property
    def method(self) -> str:
        """The method: `direct` or `published`."""

@final
class Pair:
    """A stereo pair of a recording."""
    @property
    def index(self) -> int:
        """Number of the pair, from 0."""
    @property
    def t_s(self) -> float:
        """Middle of the left exposure, seconds on the clock of the recording."""
    @property
    def time_ns(self) -> int:
        """Middle of the left exposure, whole nanoseconds on the clock of the recording, for `Tracker.track`: exact, as seconds in a float are not."""
    @property
    def skew_s(self) -> float:
        """Middle of the right exposure minus middle of the left one, seconds."""
    @property
    def left(self) -> _Bytes:
        """The raw left image, height x width x 3, uint8, in the order red, green, blue."""
    @property
    def right(self) -> _Bytes:
        """The raw right image, as `left`."""

@final
class Recording:
    """A recording of stereo pairs: an MCAP file or rosbag2 folder, a sequence or case folder, a EuRoC folder, or a folder of images.

    `recording[i]` is the pair with number i, from 0; a damaged one raises `Error`. A loop gives all pairs in order, leaves out the damaged
    ones, and adds the reason to `warnings`.

    `path`: the file or folder. `calibration`: a calibration file or a list of files, as in `StereoRig.load`, instead of that of the recording.
    `topics`: those of the left and the right images in an MCAP file; by default two that differ only in left and right. `pair_within_s`: the
    longest time between the images of a pair, seconds. `value_range`: the values that become black and white in images with 16 bits; measured on
    the first pair by default. `segment`: the part of an MCAP file whose `camera_info` changes, from 1 on. `skew_s`: middle of the right exposure
    minus middle of the left one in every pair, seconds. `rate_hz`: pairs per second, if the recording has no times. `calibration_unit`,
    `calibrated_size`, `lens` and `rectified` are those of `StereoRig.load`. Raises `Error` if the recording cannot be read.
    """
    def __new__(
        cls,
        path: _Path,
        *,
        calibration: _Path | Sequence[_Path] | None = None,
        topics: Sequence[str] | None = None,
        pair_within_s: float = 0.003,
        value_range: tuple[int, int] | None = None,
        segment: int | None = None,
        skew_s: float | None = None,
        rate_hz: float | None = None,
        calibration_unit: str | None = None,
        calibrated_size: tuple[int, int] | None = None,
        lens: str | None = None,
        rectified: bool = False,
    ) -> Recording: ...
    def __len__(self) -> int: ...
    def __getitem__(self, key: int, /) -> Pair: ...
    def __iter__(self) -> Iterator[Pair]: ...
    @property
    def rig(self) -> StereoRig:
        """The calibration of its cameras."""
    @property
    def times_s(self) -> _Floats:
        """Middle of the left exposure of each of the N pairs, seconds on the clock of the recording."""
    @property
    def region(self) -> Region | None:
        """The target in the left image of the first pair, or None."""
    @property
    def z_range_m(self) -> tuple[float, float] | None:
        """The nearest and the farthest depth to search that the recording states, metres, or None."""
    @property
    def tilt_max_rad(self) -> float | None:
        """The largest tilt to search that the recording states, radians, or None."""
    @property
    def cam_left_from_model(self) -> _Floats | None:
        """The true pose of the target in each pair, N x 4 x 4, translation in metres, or None."""
    @property
    def notes(self) -> list[str]:
        """What the user should know of the recording, from the pairs that were read so far."""
    @property
    def warnings(self) -> list[str]:
        """What is missing or not as it should be, and the damaged pairs that loops have left out so far."""

@final
class RecordedRun:
    """Estimates and control steps of a run that `pb3dp run --record FILE.mcap` has recorded, as arrays.

    `path`: the file, which may have been broken off. Times are seconds since the first control step. Unknown numbers are NaN. Images are in
    `Recording`. Raises `Error` if the file is no recorded run.
    """
    def __new__(cls, path: _Path) -> RecordedRun: ...
    @property
    def estimate_times_s(self) -> _Floats:
        """Middle of the exposure of each of the N estimates, seconds."""
    @property
    def statuses(self) -> list[str]:
        """Status of each of the N estimates, as in `TrackEstimate.status`."""
    @property
    def reasons(self) -> list[str]:
        """What led to each of the N statuses."""
    @property
    def cam_left_from_model(self) -> _Floats:
        """Estimated poses: N x 4 x 4, each maps coordinates in `model` to `cam_left`, translation in metres."""
    @property
    def covariances(self) -> _Floats:
        """Covariances of the estimated poses: N x 6 x 6, as in `TrackEstimate.covariance`."""
    @property
    def pose_covariances(self) -> _Floats:
        """Covariances against the visible surface: N x 6 x 6, as in `TrackEstimate.pose_covariance`."""
    @property
    def cam_left_from_target(self) -> _Floats:
        """True poses of the target in simulation: N x 4 x 4, each maps coordinates in `target` to `cam_left`, translation in metres."""
    @property
    def step_times_s(self) -> _Floats:
        """Begin of each of the M control steps, seconds."""
    @property
    def states(self) -> list[str]:
        """State of the supervisor in each of the M steps."""
    @property
    def modes(self) -> list[str]:
        """Mode of the controller in each of the M steps."""
    @property
    def base_from_model(self) -> _Floats:
        """Pose of the target by the filter of the controller, in the base of the arm with the cameras: M x 4 x 4, metres."""
    @property
    def world_from_hand(self) -> _Floats:
        """Pose of the hand: M x 4 x 4, metres; in simulation the true one, otherwise that from the measured joints."""
    @property
    def world_from_target(self) -> _Floats:
        """Pose of the target: M x 4 x 4, metres, as `world_from_hand`."""
    def joints_rad(self, arm: int) -> _Floats:
        """Measured joint angles of an arm: M x joints, radians. `arm`: 0 carries the cameras, 1 the target. Raises `IndexError` for another number."""

@final
class RunPair:
    """A pair that a simulated run has estimated, with the truth."""
    @property
    def t_s(self) -> float:
        """Middle of the exposure since the first control step, seconds."""
    @property
    def sequence(self) -> int:
        """Number of the pair; a gap means that pairs were lost."""
    @property
    def estimate(self) -> TrackEstimate:
        """The estimate of the method that leads the hand. Its `cpu_s` is the time on the wall."""
    @property
    def cam_left_from_target(self) -> _Floats | None:
        """True pose of the target at the exposure: 4x4, maps coordinates in `target` to `cam_left`, translation in metres, or None."""
    @property
    def left(self) -> _Bytes | None:
        """The rendered left image, height x width x 3, uint8, in the order red, green, blue; None in a run without images. A copy."""
    @property
    def right(self) -> _Bytes | None:
        """The rendered right image, as `left`."""

@final
class RunStep:
    """One control step of a simulated run. Arm 0 carries the cameras, arm 1 the target."""
    def joints_rad(self, arm: int) -> _Floats:
        """Measured joint angles of an arm, one number for each joint, radians. `arm`: 0 carries the cameras, 1 the target. Raises `IndexError` for
        another number.
        """
    def requested_rad_per_s(self, arm: int) -> _Floats | None:
        """Joint velocities that the controller requests of an arm, one number for each joint, radians per second, or None if the arm shall hold.
        `arm` as for `joints_rad`.
        """
    @property
    def number(self) -> int:
        """Number of the step, from 0."""
    @property
    def t_s(self) -> float:
        """Time since the first step, seconds."""
    @property
    def state(self) -> str:
        """State of the supervisor, such as `following`."""
    @property
    def why(self) -> str:
        """Why the arm does not move, and the remedy, in one line."""
    @property
    def mode(self) -> str:
        """Mode of the controller, with the reason if the arm holds."""
    @property
    def world_from_hand(self) -> _Floats | None:
        """True pose of the hand: 4x4, maps coordinates in `hand` to `world`, translation in metres, or None."""
    @property
    def world_from_target(self) -> _Floats | None:
        """True pose of the target: 4x4, maps coordinates in `target` to `world`, translation in metres, or None."""
    @property
    def base_from_model(self) -> _Floats | None:
        """Pose of the target by the filter of the controller, in the base of arm 0: 4x4, metres, or None."""
    @property
    def pairs(self) -> list[RunPair]:
        """The pairs that were estimated since the step before: most steps have none."""

@final
class Run:
    """A run of the simulated cell, step by step: cameras, estimation, control and both arms in simulated time.

    `config`: a TOML file or a built-in setup, such as `sim`; or several, of which later ones override. `settings`: single keys, such as
    `{"scene.target": "card", "experiment.target": "pushed"}`. `seed`: of all random numbers. `stop_after_s`: the end, seconds. Raises `Error`
    if the setup cannot be used.

    The run is that of `pb3dp run` with the same setup and seed, to the bit, as long as nothing is changed from outside. Only simulated arms
    and cameras can be used: a setup with others is refused. A `for` loop gives all steps; leaving a `with` block ends the run.
    """
    def __new__(
        cls,
        config: _Path | Sequence[_Path] = ...,
        *,
        settings: Mapping[str, object] | None = None,
        seed: int | None = None,
        stop_after_s: float | None = None,
    ) -> Run: ...
    def __enter__(self) -> Run: ...
    def __exit__(self, *_exception: object) -> None: ...
    def __iter__(self) -> Run: ...
    def __next__(self) -> RunStep: ...
    def step(self) -> RunStep | None:
        """The next control step, or None after the last one. Raises `Error` if the run fails."""
    def shift_hand(self, hand_from_hand_shifted: _Floats) -> None:
        """Moves the desired pose of the hand by `hand_from_hand_shifted`: 4x4, in axes of the hand as the setup states it, translation in metres.
        It holds from the next step on, until it is moved again. Raises `Error` if the matrix is no pose.
        """
    def set_speed_share(self, speed_share: float) -> None:
        """Sets the share of the commanded velocity that the arm with the cameras gets from the next step on: `speed_share`, 0 to 1. Raises `Error`
        for another number.
        """
    def push_target(self, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, turn_rad: float = 0.0) -> None:
        """Pushes the target to an offset from its start, along its axes there: `x_m`, `y_m`, `z_m` in metres (at most 0.12), and `turn_rad` about
        its z axis in radians (at most 0.35). It moves there within half a second; a larger offset is reduced to these limits. Raises
        `Error` for numbers that are not finite, and without the setting `experiment.target = "pushed"`.
        """
    def close(self) -> None:
        """Ends the run; further steps are None."""
    @property
    def method(self) -> str:
        """The method that estimates the pose and leads the hand, such as `direct`."""
    @property
    def control_period_s(self) -> float:
        """Simulated time between two steps, seconds."""

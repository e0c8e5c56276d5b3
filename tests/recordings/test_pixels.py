"""Pixels of emulated cameras, in every layout and format, beside those that OpenCV decodes from the same bytes."""

import os
import subprocess

import cv2
import numpy
import pytest

PROGRAM = os.environ["PB3DP_EMULATED_PAIR"]
WIDTH, HEIGHT = 64, 48
PADDING = 10
LAYOUTS = {"side-by-side": (2, 1), "top-bottom": (1, 2), "two-devices": (1, 1)}
# Formats whose colours are rounded: OpenCV calculates with other fractional bits.
ROUNDED = {"YUYV": 1, "NV12": 1, "MJPG": 3}
RANGES = {"Y10": (0, 1023), "Y12": (0, 4095), "Y16": (0, 65535)}


def noise(seed, shape, low=0, high=256, dtype=numpy.uint8):
    """Values without a pattern."""
    return numpy.random.default_rng(seed).integers(low, high, shape, dtype=dtype)


def padded(rows):
    """Bytes of rows, with other bytes behind each."""
    rows = rows.reshape(rows.shape[0], -1)
    filler = noise(7, (rows.shape[0], PADDING))
    return numpy.hstack([rows.view(numpy.uint8), filler]).tobytes(), rows.view(numpy.uint8).shape[1] + PADDING


def grey(values):
    return cv2.cvtColor(values, cv2.COLOR_GRAY2RGB)


def shades(words, low, high):
    """Words of 16 bits as OpenCV scales them to 8 bits."""
    return grey(cv2.convertScaleAbs(numpy.clip(words, low, high) - low, alpha=255.0 / (high - low)))


def raw(format, columns, rows, value_range=None):
    """Bytes and stride of an image, and what OpenCV makes of it."""
    # OpenCV takes luminance below black for black.
    luma = noise(1, (rows, columns), 16)
    if format == "GREY":
        return *padded(luma), grey(luma)
    if format in RANGES:
        low, high = value_range or RANGES[format]
        words = noise(2, (rows, columns), 0, RANGES[format][1] + 1, numpy.uint16)
        return *padded(words.astype("<u2")), shades(words, low, high)
    if format == "YUYV":
        pairs = numpy.dstack([luma, noise(3, (rows, columns))])
        return *padded(pairs), cv2.cvtColor(pairs, cv2.COLOR_YUV2RGB_YUY2)
    if format == "NV12":
        chroma = noise(4, (rows // 2, columns))
        data, stride = padded(numpy.vstack([luma, chroma]))
        uv = chroma.reshape(rows // 2, columns // 2, 2)
        return data, stride, cv2.cvtColorTwoPlane(luma, uv, cv2.COLOR_YUV2RGB_NV12)
    if format in ("RGB3", "BGR3"):
        colours = noise(5, (rows, columns, 3))
        return *padded(colours), colours if format == "RGB3" else cv2.cvtColor(colours, cv2.COLOR_BGR2RGB)
    # A smooth scene: decoders differ in how they continue the chroma of an edge.
    x, y = numpy.meshgrid(numpy.arange(columns), numpy.arange(rows))
    scene = numpy.dstack([x, 2 * y, 128 + (x + y) // 3]).astype(numpy.uint8)
    _, file = cv2.imencode(".jpg", scene, [cv2.IMWRITE_JPEG_QUALITY, 95])
    return file.tobytes(), 4096, cv2.cvtColor(cv2.imdecode(file, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)


def emulated(folder, format, layout, data, stride, value_range=None, crops=(None, None)):
    """Left and right image of an emulated camera, and the encoding of the images as delivered."""
    (folder / "memory").write_bytes(data)
    text = [",".join(map(str, numbers)) if numbers else "-" for numbers in (value_range, *crops)]
    command = [PROGRAM, format, layout, f"{WIDTH}x{HEIGHT}", str(stride), *text, str(folder / "memory"), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    width, height, skew, *encoding = done.stdout.split()
    assert skew == "0"
    images = [(folder / f"{side}.rgb").read_bytes() for side in ("left", "right")]
    return [numpy.frombuffer(image, numpy.uint8).reshape(int(height), int(width), 3) for image in images], encoding


def compare(found, expected, format):
    assert found.shape == expected.shape
    worst = numpy.abs(found.astype(int) - expected.astype(int)).max()
    assert worst <= ROUNDED.get(format, 0), f"{format}: {worst} grey levels apart"


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("format", ["GREY", "Y10", "Y12", "Y16", "YUYV", "NV12", "RGB3", "BGR3", "MJPG"])
@pytest.mark.parametrize("crops", [(None, None), ((2, 4, 33, 21), (30, 20, 33, 21))])
def test_both_views_are_those_of_opencv(tmp_path, format, layout, crops):
    across, down = LAYOUTS[layout]
    data, stride, expected = raw(format, WIDTH * across, HEIGHT * down)
    images, encoding = emulated(tmp_path, format, layout, data, stride, crops=crops)
    origins = [(0, 0), (WIDTH * (across - 1), HEIGHT * (down - 1))]
    for found, (left, top), crop in zip(images, origins, crops, strict=True):
        x, y, width, height = crop or (0, 0, WIDTH, HEIGHT)
        compare(found, expected[top + y : top + y + height, left + x : left + x + width], format)
    assert len({image.tobytes() for image in images}) == (1 if layout == "two-devices" and crops == (None, None) else 2)
    if format in RANGES:
        # A recording keeps the words; OpenCV scales them to the same image.
        assert encoding == ["mono16"]
        words = numpy.frombuffer((tmp_path / "right.delivered").read_bytes(), "<u2").reshape(images[1].shape[:2])
        compare(images[1], shades(words, *RANGES[format]), format)


@pytest.mark.parametrize("format", RANGES)
def test_a_stated_range_is_scaled_as_by_opencv(tmp_path, format):
    value_range = (100, RANGES[format][1] // 2)
    data, stride, expected = raw(format, 2 * WIDTH, HEIGHT, value_range)
    (left, right), _ = emulated(tmp_path, format, "side-by-side", data, stride, value_range)
    compare(left, expected[:, :WIDTH], format)
    compare(right, expected[:, WIDTH:], format)


def test_interleaved_views_are_the_channels_that_opencv_parts(tmp_path):
    both = noise(6, (HEIGHT, WIDTH, 2))
    data, stride = padded(both)
    images, encoding = emulated(tmp_path, "Y8I", "interleaved", data, stride)
    assert encoding == ["mono8"]
    for found, side, expected in zip(images, ("left", "right"), cv2.split(both), strict=True):
        compare(found, grey(expected), "Y8I")
        assert (tmp_path / f"{side}.delivered").read_bytes() == expected.tobytes()


@pytest.mark.parametrize(
    "format, code",
    [
        ("RGGB", cv2.COLOR_BayerRGGB2RGB),
        ("GRBG", cv2.COLOR_BayerGRBG2RGB),
        ("GBRG", cv2.COLOR_BayerGBRG2RGB),
        ("BA81", cv2.COLOR_BayerBGGR2RGB),
    ],
)
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("crops", [(None, None), ((2, 4, 37, 21), (26, 20, 37, 21))])
def test_bayer_views_are_those_of_opencv_except_at_their_borders(tmp_path, format, code, layout, crops):
    across, down = LAYOUTS[layout]
    mosaic = noise(8, (HEIGHT * down, WIDTH * across))
    data, stride = padded(mosaic)
    images, _ = emulated(tmp_path, format, layout, data, stride, crops=crops)
    origins = [(0, 0), (WIDTH * (across - 1), HEIGHT * (down - 1))]
    for found, (left, top), crop in zip(images, origins, crops, strict=True):
        x, y, width, height = crop or (0, 0, WIDTH, HEIGHT)
        view = mosaic[top + y : top + y + height, left + x : left + x + width]
        expected = cv2.cvtColor(numpy.ascontiguousarray(view), code)
        compare(found[1:-1, 1:-1], expected[1:-1, 1:-1], format)

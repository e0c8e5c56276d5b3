"""The same image gives the same bits in every layout of memory, and is not copied where that is possible."""

import threading
import time

import numpy as np
import pytest

import pb3dp
from conftest import CASES, estimator_of, without_time


def answer(estimator, left, right, region):
    return without_time(estimator.estimate(left, right, region).to_json())


def test_every_layout_of_memory_gives_the_same_bits(case):
    recording, pair, estimator = case
    region, left, right = recording.region, pair.left, pair.right
    expected = answer(estimator, left, right, region)
    height, width = left.shape[:2]
    both = np.concatenate([left, right], axis=1)
    upside_down = np.ascontiguousarray(left[::-1])
    read_only = left.copy()
    read_only.flags.writeable = False
    # Memory of another library, with gaps between the rows.
    camera = np.ndarray((height, width, 3), np.uint8, bytearray(np.pad(left, ((0, 0), (2, 3), (0, 0))).tobytes()), 6, (3 * width + 15, 3, 1))
    for strided in [
        (camera, right),
        (both[:, :width], both[:, width:]),
        (np.pad(left, ((3, 2), (5, 7), (0, 0)))[3:-2, 5:-7], np.pad(right, ((0, 1), (0, 0), (0, 0)))[:-1]),
        (np.concatenate([left, left], axis=2)[..., :3], np.pad(right, ((0, 0), (0, 0), (1, 0)))[..., 1:]),
        (upside_down[::-1], right),
        (np.asfortranarray(left), np.asfortranarray(right)),
        (np.ascontiguousarray(left[..., ::-1])[..., ::-1], right),
        (read_only, right),
    ]:
        assert strided[0].shape == (height, width, 3)
        assert answer(estimator, *strided, region) == expected


def test_grey_images_are_those_with_three_equal_channels(case):
    recording, pair, _ = case
    grey = [image[..., 1].copy() for image in (pair.left, pair.right)]
    rgb = [np.repeat(image[..., None], 3, axis=2) for image in grey]
    expected = answer(estimator_of(recording), *rgb, recording.region)
    assert answer(estimator_of(recording), *grey, recording.region) == expected
    strided = [image[..., 1] for image in (pair.left, pair.right)]
    assert answer(estimator_of(recording), *strided, recording.region) == expected
    both = np.concatenate(grey, axis=1)
    halves = np.split(both, 2, axis=1)
    assert answer(estimator_of(recording), *halves, recording.region) == expected


def test_images_with_sixteen_bits(case):
    recording, pair, _ = case
    deep = [image.astype(np.uint16) for image in (pair.left, pair.right)]
    stated = pb3dp.Estimator(recording.rig, z_range_m=recording.z_range_m, tilt_max_rad=recording.tilt_max_rad, value_range=(0, 255))
    assert answer(stated, *deep, recording.region) == answer(estimator_of(recording), pair.left, pair.right, recording.region)
    inside = [np.pad(image, ((2, 1), (3, 4), (0, 0)), constant_values=65535)[2:-1, 3:-4] for image in deep]
    fresh = pb3dp.Estimator(recording.rig, z_range_m=recording.z_range_m, tilt_max_rad=recording.tilt_max_rad, value_range=(0, 255))
    assert answer(fresh, *inside, recording.region) == answer(stated, *deep, recording.region)
    grey = [image[..., 1].copy() for image in (pair.left, pair.right)]
    of_grey = pb3dp.Estimator(recording.rig, z_range_m=recording.z_range_m, tilt_max_rad=recording.tilt_max_rad, value_range=(0, 4080))
    found = answer(of_grey, *(image.astype(np.uint16) * 16 for image in grey), recording.region)
    assert found == answer(estimator_of(recording), *grey, recording.region)
    measured = estimator_of(recording).estimate(deep[0] * 16, deep[1] * 16, recording.region)
    assert abs(measured.z_m - stated.estimate(*deep, recording.region).z_m) < 0.005 * measured.z_m


def test_images_are_not_copied_where_they_need_not_be():
    # Images of a wrong size are refused at once, after they were taken over: the time of the call is that of a copy, if there is one.
    size = 600
    rig = pb3dp.Recording(CASES[0]).rig
    estimator = pb3dp.Estimator(rig, value_range=(0, 4095))
    region = pb3dp.Region.rectangle(0, 0, 9, 9)

    def median_s(image):
        times = []
        for _ in range(5):
            start = time.perf_counter()
            try:
                estimator.estimate(image, image, region)
            except pb3dp.Error:
                pass
            times.append(time.perf_counter() - start)
        return sorted(times)[2]

    whole = np.zeros((size, size, 3), np.uint8)
    copied_s = median_s(np.asfortranarray(whole))
    both = np.zeros((size, 2 * size, 3), np.uint8)
    for image in (whole, both[:, :size], both[:, size:], whole[..., 0].copy(), whole.astype(np.uint16), both.astype(np.uint16)[:, size:]):
        assert median_s(image) * 10 < copied_s, (image.shape, image.strides, image.dtype)


def test_images_of_one_row_or_column_are_taken():
    rig, region = pb3dp.Recording(CASES[0]).rig, pb3dp.Region.rectangle(0, 0, 9, 9)
    for shape in [(1, 1), (1, 9), (9, 1), (1, 1, 3), (1, 9, 3), (9, 1, 3)]:
        for image in (np.zeros(shape, np.uint8), np.zeros((18, *shape[1:]), np.uint16)[:: 18 // shape[0]]):
            with pytest.raises(pb3dp.Error, match=f"{shape[1]}x{shape[0]}|{shape[1]} x {shape[0]}"):
                pb3dp.Estimator(rig, value_range=(0, 9)).estimate(image, image, region)


def test_threads_estimate_at_the_same_time(case):
    recording, pair, _ = case
    estimators = [estimator_of(recording) for _ in range(2)]
    for estimator in estimators:
        estimator.estimate(pair.left, pair.right, recording.region)
    counted, is_over = [0], threading.Event()

    def work(estimator):
        for _ in range(10):
            estimator.estimate(pair.left, pair.right, recording.region)

    def count():
        while not is_over.is_set():
            counted[0] += 1
            time.sleep(0.0005)

    counter = threading.Thread(target=count)
    threads = [threading.Thread(target=work, args=[estimator]) for estimator in estimators]
    counter.start()
    start = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    elapsed_s = time.perf_counter() - start
    is_over.set()
    counter.join()
    # With the lock held, the counter would get a turn between two estimates only: about 20.
    assert counted[0] > 40, f"{counted[0]} turns in {elapsed_s:.2f} s"


def test_one_estimator_serves_several_threads(case):
    recording, pair, estimator = case
    expected, found = answer(estimator, pair.left, pair.right, recording.region), []
    threads = [threading.Thread(target=lambda: found.append(answer(estimator, pair.left, pair.right, recording.region))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [expected] * 4

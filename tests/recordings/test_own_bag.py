"""The steps of docs/recordings.md from a bag of others to a table of poses, as they are written there."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy
import pandas
from conftest import PB3DP
from PIL import Image
from rosbags.rosbag2 import StoragePlugin, Writer
from test_recordings import STORE, TYPES, stamp

PAGE = Path(__file__).parents[2] / "docs/recordings.md"


def write_bag(folder, sequence_folder):
    """Rectified colour images with their calibration, as a stereo driver of ROS 2 records them."""
    sequence = json.loads((sequence_folder / "sequence.json").read_text())
    calib = json.loads((sequence_folder / sequence["calib"]).read_text())
    width, height = calib["image_size"]
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {"image_rect": "sensor_msgs/msg/Image", "camera_info": "sensor_msgs/msg/CameraInfo"}
        topics = {
            (side, name): writer.add_connection(f"/stereo/{side}/{name}", kind, typestore=STORE)
            for side in ("left", "right")
            for name, kind in kinds.items()
        }
        for number, time in enumerate(sequence["times_s"]):
            at_ns = 1_700_000_000_000_000_000 + round(time * 1e9)
            for side in ("left", "right"):
                pixels = numpy.asarray(Image.open(sequence_folder / (sequence[side] % number)))
                image = TYPES[kinds["image_rect"]](header=stamp(at_ns), height=height, width=width, encoding="rgb8", is_bigendian=0,
                                                   step=3 * width, data=pixels.reshape(-1))
                k = numpy.array(calib["K_" + side]).reshape(3, 3)
                projection = numpy.hstack([k, numpy.zeros((3, 1))])
                projection[0, 3] = 0 if side == "left" else k[0, 0] * calib["t_mm"][0] * 1e-3
                info = TYPES[kinds["camera_info"]](
                    header=stamp(at_ns), height=height, width=width, distortion_model="plumb_bob", d=numpy.zeros(5), k=k.reshape(-1),
                    r=numpy.eye(3).reshape(-1), p=projection.reshape(-1), binning_x=0, binning_y=0,
                    roi=TYPES["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False))
                for name, message in (("image_rect", image), ("camera_info", info)):
                    writer.write(topics[side, name], at_ns, STORE.serialize_cdr(message, kinds[name]))
    return sequence


def test_the_page_leads_from_a_bag_to_a_table_and_a_plot(run, tmp_path):
    sequence = write_bag(tmp_path / "my_bag", run / "sequence")
    section = PAGE.read_text().split("## Use your own recording")[1]
    block = next(block for block in re.findall(r"```text\n(.*?)```", section, re.DOTALL) if "poses.csv" in block)
    extract = re.search(r"`(pb3dp extract my_bag [^`]*)`", section)[1]
    left, top = numpy.min(sequence["region_polygon_left_px"], axis=0).round().astype(int)
    right, bottom = numpy.max(sequence["region_polygon_left_px"], axis=0).round().astype(int)
    script = extract + "\n" + "".join(line for line in block.splitlines(keepends=True) if "pip install" not in line)
    script = script.replace("X,Y,WIDTH,HEIGHT", f"{left},{top},{right - left},{bottom - top}")
    script = script.replace("pb3dp ", f"{PB3DP} ").replace("venv/bin/python", sys.executable)
    done = subprocess.run(["sh", "-e", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    # The printed table shows the poses, and the image the target is chosen on is the first one.
    assert re.search(r"t_s +status +x_mm +y_mm +z_mm", done.stdout) and "..." not in done.stdout.splitlines()[0], done.stdout
    first = numpy.asarray(Image.open(tmp_path / "out/images/left/000000.png"))
    assert (first == numpy.asarray(Image.open(run / "sequence" / (sequence["left"] % 0)))).all()
    table = pandas.read_csv(tmp_path / "out/poses.csv")
    assert len(table) == sequence["frames"] and (table["status"] == "ok").all(), table["status"]
    assert sequence["search"]["z_min_mm"] < table["z_mm"].median() < sequence["search"]["z_max_mm"]
    assert Image.open(tmp_path / "out/depth.png").width > 100

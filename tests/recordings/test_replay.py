"""Recorded runs, run again."""

import csv
import json
import signal
import subprocess
import time

import pytest
from conftest import PB3DP, pb3dp
from mcap.reader import make_reader
from mcap.writer import Writer


@pytest.fixture(scope="session")
def live(tmp_path_factory):
    """A live run with threads and arms behind links, recorded.

    A computer that stands still for a tenth of a second loses its arms, rightly: then the run is made again.
    """
    failure = None
    for attempt in range(6):
        # Other work of the computer may have to end first.
        time.sleep(10 * (attempt > 0))
        base = tmp_path_factory.mktemp("live")
        try:
            pb3dp("run", "--config", "hil", "--stop-after", 4, "--out", base / "out", "--record", base / "run.mcap")
            return base / "run.mcap"
        except AssertionError as stalled:
            failure = stalled
            if "PB3DP-ARM" not in str(stalled):
                break
    raise failure


def compared(text, kind):
    """Numbers of comparisons and differences of a kind."""
    words = next(line.split() for line in text.splitlines() if line.startswith(kind))
    return int(words[1]), int(words[3])


def copied(source, target, keep):
    """Copies the messages for which `keep` is true."""
    with open(source, "rb") as stream, open(target, "wb") as out:
        writer = Writer(out)
        writer.start(profile="ros2")
        channels = {}
        for schema, channel, message in make_reader(stream).iter_messages(log_time_order=False):
            if not keep(channel.topic, message):
                continue
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, known)
            writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time, message.sequence)
        writer.finish()


def test_a_simulated_run_is_replayed_to_the_bit(run):
    text = pb3dp("replay", run / "run.mcap")
    assert text.endswith("equal to the bit\n")
    for kind in ("estimates", "filter", "commands", "decisions"):
        count, differing = compared(text, kind)
        assert count >= 29 and differing == 0, text


def test_a_live_run_with_threads_is_replayed_to_the_bit(live):
    text = pb3dp("replay", live)
    assert text.endswith("equal to the bit\n"), text
    assert compared(text, "estimates")[0] >= 60 and compared(text, "commands")[0] >= 700, text


def test_without_images_only_the_control_is_replayed(live):
    text = pb3dp("replay", live, "--without-images")
    assert text.endswith("equal to the bit\n"), text
    assert compared(text, "estimates") == (0, 0)
    assert compared(text, "decisions")[0] >= 390


def test_a_changed_gain_changes_commands_and_no_estimate(live):
    text = pb3dp("replay", live, "--set", "servo.feed_forward.orientation_per_s=12", expect=3)
    assert compared(text, "estimates")[1] == 0 and compared(text, "commands")[1] > 0, text
    assert "first at" in text and "recorded: vs-robot: move" in text, text


def test_another_method_gives_other_estimates(run):
    text = pb3dp("replay", run / "run.mcap", "--method", "published", expect=3)
    count, differing = compared(text, "estimates")
    assert differing > count / 2, text


def test_a_replay_can_be_recorded_and_replayed(run, tmp_path):
    pb3dp("replay", run / "run.mcap", "--set", "servo.feed_forward.orientation_per_s=12", "--record", tmp_path / "what_if.mcap", expect=3)
    text = pb3dp("replay", tmp_path / "what_if.mcap")
    assert text.endswith("equal to the bit\n") and "missing" not in text, text
    assert "a replay of" in text and compared(text, "estimates")[0] >= 29, text


STARTS = 4


def tracking_run(base, file):
    """A recorded run with threads that has followed its target for a second; how long its start takes depends on the computer.

    If the computer stands still meanwhile, the arms stop, as they must: the run is started again.
    """
    args = ["run", "--config", "hil", "--stop-after", "20", "--out", base / "out", "--record", file]
    for _ in range(STARTS):
        file.unlink(missing_ok=True)
        process = subprocess.Popen([PB3DP, *map(str, args)], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        told = []
        for line in process.stderr:
            told.append(line)
            if line.rstrip().endswith(" s  tracking"):
                time.sleep(1)
                if process.poll() is None:
                    return process
        process.communicate(timeout=60)
        assert "PB3DP-ARM-" in "".join(told), "".join(told)
    raise AssertionError("".join(told))


def test_a_run_that_was_killed_is_replayed_up_to_its_end(tmp_path):
    file = tmp_path / "killed.mcap"
    process = tracking_run(tmp_path, file)
    process.kill()
    process.communicate(timeout=60)
    text = pb3dp("replay", file)
    assert text.endswith("equal to the bit\n"), text
    assert compared(text, "decisions")[0] > 50, text


def test_a_run_that_ends_with_a_fault_is_replayed_to_the_bit(tmp_path):
    """The computer stands still: the arms stop, and the run ends with their fault."""
    file = tmp_path / "stalled.mcap"
    process = tracking_run(tmp_path, file)
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.4)
    process.send_signal(signal.SIGCONT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 1 and "PB3DP-ARM-" in told, told
    text = pb3dp("replay", file)
    assert text.endswith("equal to the bit\n"), text
    assert compared(text, "decisions")[0] > 50, text
    # The newest seconds at the fault are a page, too.
    pb3dp("report", tmp_path / "out/fault.mcap", "--out", tmp_path / "report")


def test_images_that_are_missing_are_named(live, tmp_path):
    seen = []

    def keep(topic, _message):
        if topic == "/left/image_raw":
            seen.append(topic)
            return len(seen) != 40
        return True

    file = tmp_path / "gap.mcap"
    copied(live, file, keep)
    text = pb3dp("replay", file)
    assert "missing: " in text and "the images of pair" in text, text
    # Later estimates are not compared, since the tracker has not seen the pair; the control is.
    assert compared(text, "estimates") == (39, 0), text
    assert text.endswith("equal to the bit, but inputs are missing\n"), text
    assert compared(text, "decisions")[0] >= 390 and compared(text, "commands")[1] == 0, text


def test_a_target_that_was_initialised_before_the_images_is_followed_from_the_next_initialisation(live, tmp_path):
    seen = []

    def keep(topic, _message):
        seen.append(topic)
        return not topic.endswith("image_raw") or seen.count(topic) > 5

    file = tmp_path / "late.mcap"
    copied(live, file, keep)
    text = pb3dp("replay", file)
    # There is no other initialisation; nothing is compared with a target that was initialised elsewhere.
    assert compared(text, "estimates") == (0, 0) and compared(text, "commands")[1] == 0, text


def test_changes_without_effect_are_refused(run):
    for change in (["--without-images", "--method", "published"], ["--set", "scene.target=card"]):
        done = subprocess.run([PB3DP, "replay", run / "run.mcap", *change], capture_output=True, text=True, check=False)
        assert done.returncode == 1 and "--set " in done.stderr and "this key" in done.stderr, done.stderr


def test_a_refused_change_names_the_recording_and_the_key(run):
    done = subprocess.run([PB3DP, "replay", run / "run.mcap", "--set", "servo.nonsense=3"], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and f"{run / 'run.mcap'}:\n  servo.nonsense: unknown key" in done.stderr, done.stderr
    assert "pb3dp-replay" not in done.stderr, done.stderr


def test_damage_is_told(run, tmp_path):
    data = bytearray((run / "run.mcap").read_bytes())
    middle = len(data) // 2
    data[middle:middle + 100] = bytes(byte ^ 0x55 for byte in data[middle:middle + 100])
    file = tmp_path / "damaged.mcap"
    file.write_bytes(data)
    done = subprocess.run([PB3DP, "replay", file], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "damaged" in done.stderr, done.stderr
    text = pb3dp("recover", file, expect=1)
    assert "what followed is lost" in text, text


def test_several_runs_in_a_folder_are_refused(run, live, tmp_path):
    for number, file in enumerate((run / "run.mcap", live)):
        (tmp_path / f"{number}.mcap").symlink_to(file)
    done = subprocess.run([PB3DP, "replay", tmp_path], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "several runs" in done.stderr, done.stderr


def test_a_new_folder_is_created_and_only_a_file_is_divided(tmp_path):
    args = ["run", "--config", "sim", "--set", "scene.target=card", "--set", "run.pace=fast", "--set", "estimator.compare=[]",
            "--stop-after", "1", "--out", tmp_path / "out", "--rotate-mb", "20"]
    done = subprocess.run([PB3DP, *args, "--record", tmp_path / "sequence"], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "FILE.mcap" in done.stderr, done.stderr
    pb3dp(*args, "--record", tmp_path / "new/long/run.mcap")
    assert len(list((tmp_path / "new/long").iterdir())) > 1
    text = pb3dp("replay", tmp_path / "new/long")
    assert text.endswith("equal to the bit\n") and compared(text, "estimates")[0] >= 29, text


def test_what_is_no_run_is_refused(run, tmp_path):
    file = tmp_path / "images.mcap"
    copied(run / "run.mcap", file, lambda topic, _: topic != "/pb3dp/begin")
    for command in ("replay", "report"):
        done = subprocess.run([PB3DP, command, file, *(["--out", tmp_path / "o"] if command == "report" else [])],
                              capture_output=True, text=True, check=False)
        assert done.returncode == 1 and "/pb3dp/begin" in done.stderr and "pb3dp track" in done.stderr, done.stderr


def test_the_report_of_a_recording_has_the_figures_of_the_run(tmp_path):
    pb3dp("run", "--config", "sim", "--set", "scene.target=card", "--set", "run.pace=fast", "--stop-after", 1.5,
          "--out", tmp_path / "out", "--record", tmp_path / "run.mcap")
    pb3dp("report", tmp_path / "run.mcap", "--out", tmp_path / "report")
    then, now = (json.loads((tmp_path / folder / "summary.json").read_text())["summary"] for folder in ("out", "report"))
    # The compared methods estimate again, as fast as the computer is now.
    for summary in (then, now):
        for method in summary["methods"][1:]:
            method["latency_p50_millis"] = method["latency_p99_millis"] = None
    assert then == now
    for table in ("estimates.csv", "timeseries.csv"):
        assert (tmp_path / "out" / table).read_text() == (tmp_path / "report" / table).read_text(), table
    assert (tmp_path / "out/settings.toml").read_text() == (tmp_path / "report/settings.toml").read_text()
    page = (tmp_path / "report/report.html").read_text()
    assert '<figure class="plot">' in page and "recording " in page


def rows(table):
    """The rows, without the wanted pose: it depends on the first estimate of the run."""
    with table.open(newline="") as text:
        return [{key: value for key, value in row.items() if not key.startswith("wanted_")} for row in csv.DictReader(text)]


def test_the_middle_of_a_run_is_reported_as_it_was_recorded(tmp_path):
    """As the newest seconds at a fault: without the begin of the run."""
    pb3dp("run", "--config", "sim", "--set", "scene.target=card", "--set", "run.pace=fast", "--set", "estimator.compare=[]", "--stop-after", 1.5,
          "--out", tmp_path / "out", "--record", tmp_path / "long/run.mcap", "--rotate-mb", "10")
    continuation = sorted((tmp_path / "long").iterdir())[1]
    text = pb3dp("report", continuation, "--out", tmp_path / "report")
    assert "its control is shown as recorded" in text, text
    for table in ("estimates.csv", "timeseries.csv"):
        whole, part = (rows(tmp_path / folder / table) for folder in ("out", "report"))
        first, last = (float(part[end]["t_s"]) for end in (0, -1))
        assert 4 < len(part) < len(whole) and first > 0.1, table
        assert part == [row for row in whole if first <= float(row["t_s"]) <= last], table
    summary = json.loads((tmp_path / "report/summary.json").read_text())["summary"]
    whole = json.loads((tmp_path / "out/summary.json").read_text())["summary"]
    assert summary["supervisor"]["share_by_state"].keys() <= {"selecting", "approaching", "tracking"}, summary["supervisor"]
    first = float(part[0]["t_s"])
    changes = [note for note in whole["supervisor"]["transitions"] if first <= note["t_s"] <= float(part[-1]["t_s"])]
    assert changes and summary["supervisor"]["transitions"] == changes
    # Its control cannot be replayed.
    done = subprocess.run([PB3DP, "replay", continuation], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "pb3dp report" in done.stderr, done.stderr

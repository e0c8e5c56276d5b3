//! A person at a terminal beside an arm that is not emulated and moves by `pb3dp arm` or `identify`, or nobody.

use std::fs::File;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use pb3dp_geometry::{Pose, so3};
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink as _;
use pb3dp_record::stops::{ArmOfPoses, WantedPoses, save_poses};
use pb3dp_test_support::{beside_each_other, program_lines, programs_in_real_time_beside_others};
use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};

use crate::real_time::arm::{Cell, START_DEG, WITHOUT_IMAGES};

/// A jog of 17 s.
const JOG: [&str; 7] = ["arm", "jog", "--arm", "vs", "--axis", "4", "--by=-20"];

/// Settings that need no commissioning record.
const WITHOUT_RECORD: [&str; 12] = [
    "--set",
    "arms.first_run=true",
    "--set",
    "arms.speed_scale=0.25",
    "--set",
    "supervisor.policies.target_lost.resume=by-operator",
    "--set",
    "supervisor.policies.position_jump.resume=by-operator",
    "--set",
    "supervisor.policies.orientation_jump.resume=by-operator",
    "--set",
    "supervisor.policies.outlier.resume=by-operator",
];

/// A command that moves an arm, with a terminal as its standard input.
struct Moving {
    program: Child,
    terminal: Option<Pty>,
    lines_read: Vec<String>,
    written: [Receiver<String>; 2],
}

impl Moving {
    /// The name is typed when it is asked for.
    fn start(cell: &Cell, args: &[&str], settings: &[&str]) -> Self {
        let terminal = Pty::open().unwrap();
        let input = File::open(terminal.path()).unwrap();
        // Line by line, as a person's terminal.
        let mut settings_of_line = tcgetattr(&input).unwrap();
        settings_of_line.local_modes |= LocalModes::ICANON;
        tcsetattr(&input, OptionalActions::Now, &settings_of_line).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_pb3dp"));
        command.args(args).arg("--config").arg(cell.config()).args(settings);
        command.arg("--move").arg("--out").arg(cell.folder.path().join("out"));
        command.stdin(input).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut program = command.spawn().unwrap();
        let written = [program_lines(program.stdout.take().unwrap()), program_lines(program.stderr.take().unwrap())];
        let mut moving = Self { program, terminal: Some(terminal), lines_read: Vec::new(), written };
        moving.wait_for("ype vs-robot");
        // What was typed before the prompt does not count.
        std::thread::sleep(Duration::from_millis(300));
        moving.say("vs-robot\n");
        moving
    }

    fn say(&mut self, text: &str) {
        let terminal = self.terminal.as_mut().unwrap();
        assert_eq!(terminal.try_write(text.as_bytes()), Ok(text.len()));
    }

    fn read(&mut self) {
        self.lines_read.extend(self.written.iter().flat_map(Receiver::try_iter));
    }

    fn wait_for(&mut self, text: &str) {
        let begin = Instant::now();
        while !self.lines_read.iter().any(|line| line.contains(text)) {
            assert!(begin.elapsed() < Duration::from_secs(90), "{text:?} was not written: {:#?}", self.lines_read);
            std::thread::sleep(Duration::from_millis(20));
            self.read();
        }
    }

    /// Waits until a joint has moved by this angle.
    fn wait_until_it_moves(&mut self, cell: &mut Cell, by_deg: f64) {
        let (begin, (before, _)) = (Instant::now(), cell.joints());
        let moved = |now: Vec<f64>| now.iter().zip(&before).any(|(now, before)| (now - before).abs() > by_deg);
        while !moved(cell.joints().0) {
            self.read();
            let has_ended = self.program.try_wait().unwrap().is_some();
            assert!(
                !has_ended && begin.elapsed() < Duration::from_secs(60),
                "it does not move: {:#?}",
                self.lines_read
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Waits until the program has ended; what it has written, its exit code, and how long that took.
    fn end(mut self, within: Duration) -> (String, Option<i32>, Duration) {
        let begin = Instant::now();
        let status = loop {
            if let Some(status) = self.program.try_wait().unwrap() {
                break status;
            }
            self.read();
            assert!(begin.elapsed() < within, "it goes on: {:#?}", self.lines_read);
            std::thread::sleep(Duration::from_millis(10));
        };
        let took = begin.elapsed();
        std::thread::sleep(Duration::from_millis(200));
        self.read();
        (self.lines_read.join("\n"), status.code(), took)
    }
}

impl Drop for Moving {
    fn drop(&mut self) {
        self.program.kill().ok();
        self.program.wait().ok();
    }
}

/// Ctrl-C was the only way to stop a jog, and every word was ignored.
#[test]
fn what_means_stop_ends_a_jog_and_another_line_does_not() {
    programs_in_real_time_beside_others(|| {
        beside_each_other(["STOP!\n", "hold it\n", "\x1b", "q\n", "\x04", "closed"], |text| {
            let mut cell = Cell::start(&["--pose-deg", START_DEG]);
            let mut jog = Moving::start(&cell, &JOG, &[]);
            jog.wait_until_it_moves(&mut cell, 0.2);
            jog.say("go on\n");
            jog.wait_until_it_moves(&mut cell, 0.5);
            match text {
                "closed" => drop(jog.terminal.take()),
                text => jog.say(text),
            }
            let (lines_read, code, _) = jog.end(Duration::from_secs(5));
            let ending = match text {
                "\x04" | "closed" => "ended by the end of standard input".to_owned(),
                text => format!("ended by {:?}, which was typed", text.trim_end()),
            };
            let is_stopped = lines_read.contains(&ending) && lines_read.contains("the stop order given");
            assert!(is_stopped && code == Some(1), "{text:?} {code:?}: {lines_read}");
            assert!(cell.joints().1, "{text:?}: all brakes are closed");
            cell.arm.quit();
        });
    });
}

/// A jog of 17 s, and nobody beside the arm.
#[test]
fn an_arm_beside_which_nobody_presses_enter_stops() {
    programs_in_real_time_beside_others(|| {
        let mut cell = Cell::start(&["--pose-deg", START_DEG]);
        let settings = ["--set", "supervisor.operator_key_within_s=5"];
        let mut jog = Moving::start(&cell, &JOG, &settings);
        jog.wait_for("press Enter at least every 5 s");
        for _ in 0..2 {
            jog.wait_for("are you there? press Enter now");
            jog.lines_read.clear();
            jog.say("\n");
        }
        let (lines_read, code, took) = jog.end(Duration::from_secs(8));
        assert!(took > Duration::from_secs(3), "{took:?}");
        for part in [
            "are you there?",
            "operator_silent: the newest sign of life",
            "limit 5.000 s",
            "the stop order given",
            "PB3DP-SUP-005",
        ] {
            assert!(lines_read.contains(part), "{part:?} is missing in: {lines_read}");
        }
        assert!(code == Some(1) && cell.joints().1, "{code:?}");
        cell.arm.quit();
    });
}

/// A tour of minutes, and the motion in front of a target.
#[test]
fn what_means_stop_and_silence_end_a_tour_and_a_measured_motion() {
    let turned = so3::exp(&[0.0, std::f64::consts::FRAC_PI_2, 0.0].into());
    let pose = |y_m| Pose::from_parts([0.66, y_m, 0.25].into(), turned);
    let folder = tempfile::tempdir().unwrap();
    let poses = folder.path().join("poses.toml");
    let wanted = WantedPoses { arm: ArmOfPoses::Vs, poses: vec![pose(0.12), pose(-0.12), pose(0.12)] };
    save_poses(&poses, &wanted).unwrap();
    let visit = ["arm", "visit", "--emulated-board", "9x6:20", "--poses", poses.to_str().unwrap()];
    let identify = [&["identify", "delay"], &WITHOUT_IMAGES[..], &WITHOUT_RECORD].concat();
    programs_in_real_time_beside_others(|| {
        let cases = [(&visit[..], true), (&identify, true), (&visit, false), (&identify, false)];
        beside_each_other(cases, |(args, speaks)| {
            let (settings, parts, within_s): (&[&str], &[&str], u64) = match speaks {
                true => (&[], &["ended by \"please stop\", which was typed: stopping both arms"], 20),
                false => (
                    &["--set", "supervisor.operator_key_within_s=5"],
                    &["are you there?", "operator_silent: the newest"],
                    40,
                ),
            };
            let mut cell = Cell::start(&["--pose-deg", START_DEG]);
            let mut moving = Moving::start(&cell, args, settings);
            if speaks {
                moving.wait_until_it_moves(&mut cell, 0.2);
                moving.say("please stop\n");
            }
            let (lines_read, code, _) = moving.end(Duration::from_secs(within_s));
            assert!(parts.iter().all(|part| lines_read.contains(part)), "{args:?}: {lines_read}");
            assert!(code == Some(130) && cell.joints().1, "{args:?} {code:?}: {lines_read}");
            cell.arm.quit();
        });
    });
}

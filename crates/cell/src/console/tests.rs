//! Tests of the console.

mod selecting_tests;

use std::io::{BufReader, PipeWriter, pipe};
use std::path::Path;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Instant;

use pb3dp_estimation_core::region::Region;
use pb3dp_hal_clock::VirtualClock;
use pb3dp_servo::Mode;
use pb3dp_servo::supervisor::{
    ArmCondition, ArmInput, Cause, Detail, Event, Innovation, Inputs, Refusal, RefusedFor, State, Supervisor,
};
use pb3dp_setup::setup::read_setup;

use super::answering::{ASK, DISCARDED, RESULTS_EVERY};
use super::reading::LINE_MAX;
use super::*;
use crate::person::command_of;

const NOW: MonotonicTime = MonotonicTime::from_nanos(9);

/// Collects the written answers, one by one.
struct Written(Sender<String>);

impl Write for Written {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.0.send(String::from_utf8_lossy(bytes).into_owned()).ok();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// A console with the given input, its answers, and its interrupt flag.
fn console(lines: impl BufRead + Send + 'static) -> (Console, Receiver<String>, Arc<AtomicBool>) {
    let (written, answers) = channel();
    let interrupt = Arc::new(AtomicBool::new(false));
    let clock = Arc::new(VirtualClock::new());
    clock.sleep_until(MonotonicTime::from_nanos(5));
    (
        Console::start(
            clock,
            lines,
            Written(written),
            ConsoleOptions { interrupt: Arc::clone(&interrupt), prompt: "", targets: None },
        )
        .unwrap(),
        answers,
        interrupt,
    )
}

fn options() -> ConsoleOptions {
    ConsoleOptions { interrupt: Arc::default(), prompt: "", targets: None }
}

fn typed() -> (BufReader<std::io::PipeReader>, PipeWriter) {
    let (reader, writer) = pipe().unwrap();
    (BufReader::new(reader), writer)
}

fn wait_until(what: impl Fn() -> bool) {
    let begin = Instant::now();
    while !what() {
        assert!(begin.elapsed() < Duration::from_secs(30));
        std::thread::sleep(Duration::from_millis(1));
    }
}

pub fn decision() -> Decision {
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../../configs/sim.toml");
    let config = read_setup(Path::new(file)).unwrap().supervisor;
    let inputs = Inputs {
        operator: OperatorInput::default(),
        controller: Mode::Idle,
        innovation: Innovation::NoneNew,
        target_covariance: None,
        images_late_s: None,
        estimate: None,
        frame: None,
        range_end: None,
        smallest_singular_value: None,
        arms: [ArmInput { state: ArmCondition::Disabled, measured_at: None }; 2],
    };
    Supervisor::new(config).unwrap().step(&inputs, NOW)
}

fn command(console: &mut Console) -> Option<OperatorCommand> {
    console.listen(None, NOW).request.map(|request| request.command)
}

/// As [`console`], with both arms enabled; also returns the writer for commands.
fn begun() -> (Console, PipeWriter, Receiver<String>, Arc<AtomicBool>) {
    let (lines, writer) = typed();
    let (mut console, answers, interrupt) = console(lines);
    assert_eq!(console.listen(None, NOW).request, None);
    (console, writer, answers, interrupt)
}

#[test]
fn a_console_passes_commands_on_in_order_and_ends_the_run_after_its_end() {
    let (mut console, mut writer, answers, interrupt) = begun();
    write!(writer, "select\n start \n\nstatus\ngo\nresume").unwrap();
    drop(writer);
    let text: String = answers.iter().collect();
    assert!(text.contains("not started yet") && text.contains("unknown command \"go\": use select"), "{text}");
    assert!(text.ends_with("end of input: stopping both arms, then writing the report\n"), "{text}");
    wait_until(|| interrupt.load(Ordering::SeqCst) && console.shared.is_closed.load(Ordering::SeqCst));
    let later = MonotonicTime::from_nanos(70);
    let listened = [0; 4].map(|_| console.listen(None, later));
    let commands = listened.map(|input| input.request.map(|request| (request.command, request.at)));
    assert_eq!(
        commands,
        [
            Some((OperatorCommand::Select, NOW)),
            Some((OperatorCommand::Start, NOW)),
            Some((OperatorCommand::Resume, NOW)),
            None
        ]
    );
    assert_eq!(listened[2].heartbeat_at, Some(NOW), "a closed console gives no sign of life");
}

#[test]
fn a_stop_typed_in_a_hurry_is_a_stop_and_a_start_must_be_exact() {
    use OperatorCommand::{Hold, HoldHand, Start, Stop};
    for line in [
        "stop",
        "STOP",
        "Stop",
        "sToP",
        "Stop!",
        "stop now",
        "stop.",
        "  stop",
        "!stop",
        "stop hand",
        "stop: hold",
        "hold, stop",
        "please stop",
        "do not stop",
        "é stop",
        "e-stop",
        "E-STOP",
        "estop",
        "halt",
        "Halt!",
        "start stop",
        "\x1b[Astop",
        "\x1bOPstop",
        "\x1b[15~STOP",
        "\x1bstop",
        "st\x1b[Dop",
        "\0stop\x07",
    ] {
        assert_eq!(command_of(line), Some(Stop), "{line:?}");
    }
    for line in ["Hold", "HOLD it", "hold", "hold hands", "Hold hand", "hold hand!", "\x1b[Dhold", "please hold"] {
        assert_eq!(command_of(line), Some(Hold), "{line:?}");
    }
    assert_eq!(command_of("hold hand"), Some(HoldHand), "only exactly this lets the arm with the target move on");
    assert_eq!(["start", "\x1b[Astart"].map(command_of), [Some(Start); 2]);
    for line in [
        "START",
        "start now",
        "start.",
        "Resume",
        "reset!",
        "stopping",
        "qstop",
        "restart",
        "\x08start",
        "sta\x08rt",
        "",
    ] {
        assert_eq!(command_of(line), None, "{line:?}");
    }
}

/// Suspended by SIGSTOP or with its machine: what was typed meanwhile is read, and dated, after it.
#[test]
fn commands_typed_while_the_program_was_suspended_are_discarded_but_not_stop_and_hold() {
    use OperatorCommand::{Hold, Reset, Start, Stop};
    let (lines, mut writer) = typed();
    let (written, answers) = channel();
    let clock = Arc::new(VirtualClock::new());
    let reading: Arc<dyn Clock> = clock.clone();
    let mut console = Console::start(reading, lines, Written(written), options()).unwrap();
    let at = MonotonicTime::from_secs_f64;
    let mut say = |console: &Console, line: &str, seconds: f64| {
        clock.sleep_until(at(seconds));
        writeln!(writer, "{line}").unwrap();
        wait_until(|| !console.commands.is_empty() || console.shared.hold.number.load(Ordering::SeqCst) > 0);
    };
    let command =
        |console: &mut Console, seconds: f64| console.listen(None, at(seconds)).request.map(|request| request.command);
    assert_eq!(command(&mut console, 1.0), None);
    // A late step is not a suspension.
    say(&console, "start", 1.19);
    assert_eq!(command(&mut console, 1.19), Some(Start));
    // Read before the first step after the pause, and after it.
    say(&console, "reset", 2.0);
    assert_eq!([2.001, 2.01].map(|seconds| command(&mut console, seconds)), [None; 2]);
    assert_eq!(answers.recv_timeout(Duration::from_secs(30)).unwrap().trim(), DISCARDED);
    say(&console, "reset", 2.1);
    assert_eq!(command(&mut console, 2.1), None);
    say(&console, "hold", 2.2);
    assert_eq!(command(&mut console, 2.2), Some(Hold));
    say(&console, "stop\nhold", 2.25);
    assert_eq!(command(&mut console, 2.25), Some(Stop));
    assert_eq!([2.26, 2.4].map(|seconds| command(&mut console, seconds)), [Some(Hold), None]);
    say(&console, "reset", 2.5);
    assert_eq!(command(&mut console, 2.5), Some(Reset));
    // The supervisor has found a clock step that the times of the steps do not show.
    let cause = Cause { condition: Condition::ClockStepped, value: 0.1, threshold: 0.05, detail: Detail::None };
    let (from, to) = (State::Tracking, State::Holding);
    let transition = Transition { at: at(2.6), from, to, event: Event::HoldFound, cause: Some(cause) };
    console.show(&Decision { transition: Some(transition), ..decision() });
    say(&console, "reset", 2.65);
    assert_eq!(command(&mut console, 2.65), None);
}

#[test]
fn every_command_gets_its_result_as_an_answer() {
    let (mut console, mut writer, answers, _) = begun();
    writeln!(writer, "start").unwrap();
    wait_until(|| !console.commands.is_empty());
    assert_eq!(command(&mut console), Some(OperatorCommand::Start));
    let unchanged = decision();
    assert_eq!((unchanged.refused, unchanged.transition), (None, None));
    console.show(&unchanged);
    // A step without a command has no result.
    console.show(&unchanged);
    drop((console, writer));
    let text: String = answers.iter().collect();
    assert!(text.contains("start: no change, the state is idle\n"), "{text}");
    assert_eq!(text.matches("no change").count(), 1, "{text}");
}

#[test]
fn commands_during_enabling_are_kept_or_refused_at_once() {
    let (lines, mut writer) = typed();
    let (mut console, answers, interrupt) = console(lines);
    writeln!(writer, "start\nselect\nresume\nreset\nstatus\nhold\nselect").unwrap();
    let mut text = String::new();
    while text.matches("queued").count() < 3 {
        text += &answers.recv().unwrap();
    }
    for command in ["start", "resume", "reset"] {
        let refusal = format!("{command} refused: both arms are still being enabled");
        assert!(text.contains(&refusal), "{text}");
    }
    assert!(text.contains("not started yet: both arms are being enabled"), "{text}");
    // Ten seconds later: each command is stamped now, and hold has overtaken the first select.
    let later = NOW + Duration::from_secs(10);
    let commands = [0; 3].map(|_| console.listen(None, later).request.map(|request| (request.command, request.at)));
    assert_eq!(commands, [Some((OperatorCommand::Hold, later)), Some((OperatorCommand::Select, later)), None]);
    assert!(!interrupt.load(Ordering::SeqCst));
    // From now on each command counts at the time of its input.
    writeln!(writer, "start").unwrap();
    wait_until(|| !console.commands.is_empty());
    assert_eq!(console.listen(None, later).request.map(|request| request.command), Some(OperatorCommand::Start));
}

#[test]
fn stop_breaks_off_the_switching_on_of_both_arms() {
    let (lines, mut writer) = typed();
    let (_console, answers, interrupt) = console(lines);
    writeln!(writer, "stop").unwrap();
    assert!(answers.recv().unwrap().contains("enabling aborted"));
    wait_until(|| interrupt.load(Ordering::SeqCst));
}

#[test]
fn an_open_console_is_a_sign_of_life() {
    let (lines, writer) = typed();
    let (mut console, _answers, interrupt) = console(lines);
    assert_eq!(console.listen(None, NOW), OperatorInput { heartbeat_at: Some(NOW), ..OperatorInput::default() });
    assert!(!interrupt.load(Ordering::SeqCst));
    drop(writer);
    wait_until(|| console.shared.is_closed.load(Ordering::SeqCst));
    assert_eq!(console.listen(None, MonotonicTime::from_nanos(70)).heartbeat_at, Some(NOW));
}

/// For arms that are not emulated: an open console proves nothing, a line proves that somebody is there.
#[test]
fn a_console_with_keys_falls_silent_when_nobody_types_and_asks_before() {
    let (lines, mut writer) = typed();
    let (written, answers) = channel();
    let clock = Arc::new(VirtualClock::new());
    let reading: Arc<dyn Clock> = clock.clone();
    let within = Duration::from_secs(30);
    let console = Console::start(reading, lines, Written(written), options()).unwrap();
    assert!(!console.can_fall_silent());
    let mut console = console.with_keys(within);
    assert!(console.can_fall_silent());
    let begin = MonotonicTime::from_nanos(1_000_000_000);
    let after = |seconds| begin + Duration::from_secs(seconds);
    let moving = Decision { state: State::Tracking, ..decision() };
    let listened = |console: &mut Console, seconds| {
        let listened = console.listen(Some(&moving), after(seconds));
        assert_eq!(listened.silent_after, Some(within));
        listened.heartbeat_at
    };
    assert_eq!([0, 19].map(|seconds| listened(&mut console, seconds)), [Some(begin); 2]);
    assert!(answers.recv_timeout(RESULTS_EVERY * 3).is_err(), "asked too early");
    assert_eq!(listened(&mut console, 20), Some(begin));
    // An answer is written in several parts.
    let asked = || answers.recv_timeout(Duration::from_secs(30)).unwrap().trim() == ASK;
    wait_until(asked);
    // Enter is enough, and the next silence is asked for again.
    clock.sleep_until(after(25));
    writeln!(writer).unwrap();
    wait_until(|| console.shared.typed_nanos.load(Ordering::SeqCst) > 0);
    assert_eq!([26, 44, 60].map(|seconds| listened(&mut console, seconds)), [Some(after(25)); 3]);
    wait_until(asked);
    // Nobody is asked while no arm may move.
    let held = Decision { state: State::Holding, no_arm_may_move: true, ..decision() };
    clock.sleep_until(after(70));
    writeln!(writer).unwrap();
    wait_until(|| console.shared.typed_nanos.load(Ordering::SeqCst) > after(69).as_nanos());
    console.listen(Some(&held), after(95));
    assert!(!console.shared.asks_for_key.load(Ordering::SeqCst));
}

#[test]
fn stop_and_hold_find_room_behind_any_number_of_commands_and_overtake_them() {
    let (mut console, mut writer, answers, _) = begun();
    // More commands than the queue holds, but no more refusals than the answer queue holds.
    for _ in 0..40 {
        writeln!(writer, "start").unwrap();
    }
    writeln!(writer, "hold hand\nhold\nstop\nquit").unwrap();
    let mut text = String::new();
    while !text.contains("stopping both arms") {
        text += &answers.recv().unwrap();
    }
    assert!(text.contains("start refused: 16 commands are waiting"), "{text}");
    let commands = [0; 4].map(|_| command(&mut console));
    let urgent = [OperatorCommand::Stop, OperatorCommand::Hold, OperatorCommand::HoldHand];
    assert_eq!(commands, [Some(urgent[0]), Some(urgent[1]), Some(urgent[2]), None]);
    // Later commands are taken again.
    writeln!(writer, "reset").unwrap();
    wait_until(|| !console.commands.is_empty());
    assert_eq!([0; 2].map(|_| command(&mut console)), [Some(OperatorCommand::Reset), None]);
}

#[test]
fn invalid_text_and_endless_lines_are_no_commands_and_close_nothing() {
    let long = [b"x".repeat(LINE_MAX as usize), b"start\n".to_vec()].concat();
    let lines = [b"st\xffart\n\xfe\xfe\n".to_vec(), long, b"select\n".to_vec()].concat();
    let (mut console, answers, _) = console(std::io::Cursor::new(lines));
    let text: String = answers.iter().collect();
    assert!(text.contains("unknown command \"st\u{fffd}art\"") && text.contains("longer than 1024 bytes"), "{text}");
    assert_eq!([0; 2].map(|_| command(&mut console)), [Some(OperatorCommand::Select), None]);
}

#[test]
fn a_stop_anywhere_in_a_line_that_is_too_long_is_a_stop() {
    let (mut console, mut writer, answers, _) = begun();
    let long = |c: &str| c.repeat(3 * LINE_MAX as usize);
    let edge = |before: usize| " ".repeat(LINE_MAX as usize - before);
    for line in [
        format!("STOP{}", long("!")),
        format!("stop{}", long(" ")),
        format!("{}stop", long(" ")),
        format!("{}stop{}", edge(2), long(" ")),
        format!("{}\x1b[Astop", edge(2)),
        format!("{}hold{}stop", edge(200), long("x ")),
    ] {
        writeln!(writer, "{line}").unwrap();
        wait_until(|| console.shared.stop.number.load(Ordering::SeqCst) > 0);
        // The end of the line was read as well.
        writeln!(writer, "select").unwrap();
        wait_until(|| !console.commands.is_empty());
        assert_eq!(command(&mut console), Some(OperatorCommand::Stop), "{line:?}");
        while command(&mut console).is_some() {}
    }
    while answers.try_recv().is_ok() {}
    writeln!(writer, "start {}", "x".repeat(LINE_MAX as usize)).unwrap();
    let refused = answers.recv_timeout(Duration::from_secs(30)).unwrap();
    assert!(refused.contains("longer than 1024 bytes"), "{refused}");
    assert_eq!([0; 2].map(|_| command(&mut console)), [None; 2]);
}

#[test]
fn commands_of_a_person_who_reads_no_answers_are_obeyed() {
    let ((lines, mut writer), (unread, full)) = (typed(), pipe().unwrap());
    let mut console = Console::start(Arc::new(VirtualClock::new()), lines, full, options()).unwrap();
    assert_eq!(command(&mut console), None);
    // More than a pipe and the answer queue hold.
    for _ in 0..4000 {
        writeln!(writer, "what is the matter with you?").unwrap();
    }
    writeln!(writer, "stop").unwrap();
    wait_until(|| console.shared.stop.number.load(Ordering::SeqCst) > 0);
    assert_eq!(command(&mut console), Some(OperatorCommand::Stop));
    // Dropped answers are reported once the output is read.
    let mut read = BufReader::new(unread).lines().map(|line| line.unwrap());
    let answered = read.find(|line| {
        writeln!(writer, "status").unwrap();
        line.contains("earlier answers dropped")
    });
    assert!(answered.is_some());
}

#[test]
fn messages_during_a_read_are_shown_in_the_next_step() {
    let (lines, _writer) = typed();
    let (mut console, ..) = console(lines);
    let shared = Arc::clone(&console.shared);
    let reading = shared.shown.lock().unwrap();
    console.tell(Some("an overcurrent".to_owned()));
    drop(reading);
    assert_eq!(shared.shown.lock().unwrap().trouble, None);
    let decision = decision();
    console.show(&decision);
    assert_eq!(shared.shown.lock().unwrap().trouble.as_deref(), Some("an overcurrent"));
    let reading = shared.shown.lock().unwrap();
    console.tell(None);
    console.show(&decision);
    drop(reading);
    console.show(&decision);
    let shown = shared.shown.lock().unwrap();
    assert!(shown.trouble.is_none() && shown.decision.is_some());
}

/// After a failed enabling: the answer comes by itself, and a refused command repeats which arm it was.
#[test]
fn a_late_result_is_answered_at_once_and_a_refusal_names_the_trouble() {
    let (mut console, mut writer, answers, _) = begun();
    let trouble = "tc-robot: enable: the drives do not answer";
    console.answer(format!("enabling failed: {trouble}"));
    let mut text = String::new();
    while !text.contains("enabling failed: tc-robot") {
        text += &answers.recv().unwrap();
    }
    console.tell(Some(trouble.to_owned()));
    writeln!(writer, "start").unwrap();
    wait_until(|| !console.commands.is_empty());
    let last = decision();
    console.listen(Some(&last), NOW);
    let refused = Refusal { command: OperatorCommand::Start, because: RefusedFor::State(State::Idle) };
    console.show(&Decision { refused: Some(refused), ..last });
    text.clear();
    while !text.contains(trouble) {
        text += &answers.recv().unwrap();
    }
    assert!(text.contains("start refused: "), "{text}");
}

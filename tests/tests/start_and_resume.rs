//! Ways to start or resume wrongly, over the whole program in virtual time: docs/start-and-resume.md lists them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests may fail the test")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState};
use pb3dp_hal_middleware::LimiterStatistics;
use pb3dp_orchestrator::config::setup::{Leader, Setup, read_setup};
use pb3dp_orchestrator::run::channels::Plan;
use pb3dp_orchestrator::run::experiment::{Ended, conduct};
use pb3dp_orchestrator::run::operator::Operator;
use pb3dp_orchestrator::run::report;
use pb3dp_orchestrator::run::summary::{RunSummary, summarize};
use pb3dp_orchestrator::run::supervision::TransitionNote;
use pb3dp_orchestrator::wiring::{DrivenArm, Parts, wire};
use pb3dp_servo::supervisor::{Decision, OperatorInput, Said, Word};
use system_tests::repository;

/// The first command may lead away from where the arm is by no more than this, rad.
const FIRST_COMMAND_MAX_RAD: f64 = 0.01;

/// A setup without pictures whose arm carries the target.
fn setup() -> Setup {
    let mut setup = read_setup(&repository().join("configs/sim.toml")).unwrap();
    setup.compared.clear();
    setup.leader = Leader::Geometric(setup.geometric.unwrap());
    setup
}

/// A person who says these words at these times (seconds), and is there until he falls silent.
struct Person {
    words: Vec<(f64, Word)>,
    silent: (f64, f64),
    told: Arc<Mutex<Vec<String>>>,
}

impl Operator for Person {
    fn listen(&mut self, _last: Option<&Decision>, now: MonotonicTime) -> OperatorInput {
        let now_s = now.seconds_since(MonotonicTime::ZERO);
        let is_due = self.words.first().is_some_and(|(at_s, _)| *at_s <= now_s);
        let said = is_due.then(|| Said { word: self.words.remove(0).1, at: now });
        let (from_s, until_s) = self.silent;
        let heard_s = if (from_s..until_s).contains(&now_s) { from_s } else { now_s };
        OperatorInput { said, heard_at: Some(MonotonicTime::from_secs_f64(heard_s)) }
    }

    fn show(&mut self, decision: &Decision) {
        self.told.lock().unwrap().extend(decision.refused.map(|refused| refused.to_string()));
    }

    fn tell(&mut self, trouble: Option<String>) {
        self.told.lock().unwrap().extend(trouble);
    }

    fn is_person(&self) -> bool {
        true
    }
}

/// What an arm was told, and where it was then.
type Told = Arc<Mutex<Vec<(f64, JointCommand, Option<JointState>)>>>;

/// An arm with an emergency stop, which is pressed from one time to another.
struct Stoppable {
    inner: Box<dyn DrivenArm>,
    clock: Arc<dyn Clock>,
    pressed: (f64, f64),
    latched: AtomicBool,
    told: Told,
}

impl Stoppable {
    fn now_s(&self) -> f64 {
        self.clock.now().seconds_since(MonotonicTime::ZERO)
    }

    fn is_pressed(&self) -> bool {
        let is_pressed = (self.pressed.0..self.pressed.1).contains(&self.now_s());
        self.latched.fetch_or(is_pressed, Ordering::SeqCst);
        is_pressed
    }

    fn is_latched(&self) -> bool {
        self.is_pressed() || self.latched.load(Ordering::SeqCst)
    }

    fn refusal(&self) -> ArmError {
        ArmError::new(ArmErrorKind::Fault, "the emergency stop of the test")
    }
}

impl Arm for Stoppable {
    fn info(&self) -> &ArmInfo {
        self.inner.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let is_latched = self.is_latched();
        let measured = self.inner.exchange(if is_latched { JointCommand::Hold } else { command });
        self.told.lock().unwrap().push((self.now_s(), command, measured.as_ref().ok().copied()));
        if is_latched && command != JointCommand::Hold { Err(self.refusal()) } else { measured }
    }
}

impl ArmPower for Stoppable {
    fn state(&self) -> ArmState {
        if self.is_latched() { ArmState::EStop } else { self.inner.state() }
    }

    fn enable(&mut self) -> Result<(), ArmError> {
        if self.is_latched() { Err(self.refusal()) } else { self.inner.enable() }
    }

    fn stop(&mut self) -> Result<(), ArmError> {
        self.inner.stop()
    }

    fn reset(&mut self) -> Result<(), ArmError> {
        if self.is_pressed() {
            return Err(self.refusal());
        }
        self.latched.store(false, Ordering::SeqCst);
        self.inner.reset()
    }
}

impl DrivenArm for Stoppable {
    fn statistics(&self) -> LimiterStatistics {
        self.inner.statistics()
    }

    fn enable_here(&mut self) -> Result<(), ArmError> {
        if self.is_latched() { Err(self.refusal()) } else { self.inner.enable_here() }
    }
}

/// A run that is over, and what was noticed of it.
struct Seen {
    ended: Ended,
    told: [Told; 2],
    trouble: Vec<String>,
}

const NEVER: (f64, f64) = (f64::INFINITY, f64::INFINITY);

/// Runs with these words, the emergency stop of the hand's arm pressed and the person silent in these times.
fn run(words: &[(f64, Word)], pressed: (f64, f64), silent: (f64, f64), until_s: f64) -> Seen {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let (told, trouble) = ([Told::default(), Told::default()], Arc::<Mutex<Vec<String>>>::default());
    let arm = |inner, pressed, told: &Told| -> Box<dyn DrivenArm> {
        let (clock, told) = (Arc::clone(&parts.clock), Arc::clone(told));
        Box::new(Stoppable { inner, clock, pressed, latched: AtomicBool::new(false), told })
    };
    let (vs, tc) = (arm(parts.vs, pressed, &told[0]), arm(parts.tc, NEVER, &told[1]));
    let operator = Box::new(Person { words: words.to_vec(), silent, told: Arc::clone(&trouble) });
    let parts = Parts { vs, tc, operator, ..parts };
    let ended = conduct(&setup, parts, Some(until_s), None).unwrap();
    let trouble = trouble.lock().unwrap().clone();
    Seen { ended, told, trouble }
}

impl Seen {
    fn transitions(&self) -> Vec<TransitionNote> {
        self.ended.outcome.log.supervision.summary().transitions
    }

    /// Events with their times.
    fn events(&self) -> Vec<(&'static str, f64)> {
        self.transitions().iter().map(|note| (note.event, note.t_s)).collect()
    }

    /// Neither arm is told to move in this time, nor moves at its end.
    fn rests(&self, from_s: f64, until_s: f64) {
        for (told, name) in self.told.iter().zip(["vs-robot", "tc-robot"]) {
            let told = told.lock().unwrap();
            let inside: Vec<_> = told.iter().filter(|(at_s, ..)| (from_s..until_s).contains(at_s)).collect();
            assert!(!inside.is_empty(), "{name} is looked at");
            for (at_s, command, measured) in inside {
                let is_rest = match command {
                    JointCommand::Hold => true,
                    // A latched arm is asked so why it is latched.
                    JointCommand::Velocity(velocity) => velocity.amax() == 0.0,
                };
                assert!(is_rest, "{name} is told to move at {at_s} s: {command:?}");
                let speed = measured.map_or(0.0, |joints| joints.velocity_rad_per_s.amax());
                assert!(*at_s < until_s - 0.1 || speed < 1e-3, "{name} moves at {at_s} s: {speed} rad/s");
            }
        }
    }

    /// The first command after this time leads from where the arm is, and the arm comes from rest.
    fn begins_where_it_is(&self, from_s: f64) {
        let told = self.told[0].lock().unwrap();
        let moves =
            |command: &JointCommand| matches!(command, JointCommand::Velocity(velocity) if velocity.amax() > 0.0);
        let mut first = told.iter().filter(|(at_s, command, _)| *at_s >= from_s && moves(command));
        let (at_s, command, measured) =
            first.next().unwrap_or_else(|| panic!("it goes on: {:?} {:?}", self.transitions(), self.trouble));
        let JointCommand::Velocity(velocity) = command else { panic!("{command:?}") };
        assert!(velocity.amax() * 0.01 < FIRST_COMMAND_MAX_RAD, "{at_s} s: {velocity}");
        assert!(measured.unwrap().velocity_rad_per_s.amax() < 0.05, "{at_s} s: {measured:?}");
        let before = told.iter().rev().find(|(before_s, ..)| before_s < at_s).unwrap().2.unwrap();
        let jump_rad = (measured.unwrap().position_rad - before.position_rad).amax();
        assert!(jump_rad < FIRST_COMMAND_MAX_RAD, "{at_s} s: {jump_rad} rad");
    }

    fn ends_following(&self) {
        assert!(self.ended.how.is_ok(), "{:?}", self.ended.how);
        let last = self.transitions().pop().unwrap();
        assert!(["approaching", "tracking"].contains(&last.to), "{last:?}");
    }
}

const BEGIN: [(f64, Word); 2] = [(0.1, Word::Select), (0.6, Word::Start)];

fn words(more: &[(f64, Word)]) -> Vec<(f64, Word)> {
    BEGIN.iter().chain(more).copied().collect()
}

#[test]
fn where_a_person_leads_nothing_moves_before_the_word() {
    let seen = run(&[], NEVER, NEVER, 3.0);
    seen.rests(0.0, 3.0);
    assert!(seen.events().is_empty());
    let seen = run(&[(0.1, Word::Select)], NEVER, NEVER, 3.0);
    seen.rests(0.0, 3.0);
    let seen = run(&[(0.1, Word::Start), (0.2, Word::Resume), (0.3, Word::Reset)], NEVER, NEVER, 2.0);
    seen.rests(0.0, 2.0);
    assert!(seen.events().is_empty());
}

#[test]
fn a_person_selects_starts_holds_and_resumes() {
    let seen = run(&words(&[(3.0, Word::Hold), (5.0, Word::Resume)]), NEVER, NEVER, 8.0);
    let names: Vec<&str> = seen.events().iter().map(|(event, _)| *event).filter(|event| *event != "left").collect();
    assert_eq!(names[..2], ["select", "start"]);
    assert!(names.contains(&"hold") && names.contains(&"resume"), "{names:?}");
    seen.begins_where_it_is(0.5);
    seen.begins_where_it_is(4.9);
    seen.ends_following();
}

#[test]
fn a_reset_is_refused_while_the_emergency_stop_is_pressed_and_leads_on_behind_it() {
    let more = [(3.5, Word::Reset), (4.5, Word::Reset), (5.0, Word::Select), (6.0, Word::Start)];
    let seen = run(&words(&more), (3.0, 4.0), NEVER, 9.0);
    let events = seen.events();
    let at = |wanted: &str| -> Vec<f64> {
        events.iter().filter(|(event, _)| *event == wanted).map(|(_, at_s)| *at_s).collect()
    };
    assert!((at("fault-found")[0] - 3.0).abs() < 0.03, "{events:?}");
    let [reset_s] = at("reset")[..] else { panic!("one reset is obeyed: {events:?}") };
    assert!((reset_s - 4.5).abs() < 0.03, "{events:?}");
    assert!(seen.trouble.iter().any(|trouble| trouble.contains("vs-robot: reset")), "{:?}", seen.trouble);
    seen.rests(3.5, 6.0);
    seen.begins_where_it_is(5.9);
    seen.ends_following();
}

#[test]
fn a_released_emergency_stop_starts_nothing_by_itself() {
    let seen = run(&BEGIN, (3.0, 4.0), NEVER, 8.0);
    seen.rests(3.5, 8.0);
    assert_eq!(seen.transitions().pop().unwrap().to, "fault");
    assert!(seen.ended.how.is_ok(), "where a person leads a fault does not end the run");
}

#[test]
fn a_start_behind_an_emergency_stop_without_a_selection_is_refused() {
    let seen = run(&words(&[(4.5, Word::Reset), (5.0, Word::Start), (5.5, Word::Resume)]), (3.0, 4.0), NEVER, 8.0);
    seen.rests(3.5, 8.0);
    assert_eq!(seen.transitions().pop().unwrap().to, "idle");
}

#[test]
fn a_selection_in_a_fault_is_refused() {
    let seen = run(&words(&[(4.5, Word::Select), (5.0, Word::Start)]), (3.0, 4.0), NEVER, 7.0);
    seen.rests(3.5, 7.0);
    assert_eq!(seen.transitions().pop().unwrap().to, "fault");
}

#[test]
fn a_stop_by_word_lasts_until_reset_selection_and_start() {
    let more = [(3.0, Word::Stop), (4.0, Word::Start), (4.5, Word::Reset), (5.0, Word::Select), (6.0, Word::Start)];
    let seen = run(&words(&more), NEVER, NEVER, 9.0);
    seen.rests(3.5, 6.0);
    seen.begins_where_it_is(5.9);
    seen.ends_following();
}

#[test]
fn a_person_who_falls_silent_and_speaks_again_has_to_reset() {
    let seen = run(&BEGIN, NEVER, (3.0, 5.0), 8.0);
    let stopped = seen.transitions().pop().unwrap();
    assert_eq!(stopped.to, "stopped");
    assert!(stopped.t_s > 3.9 && stopped.t_s < 4.2, "{stopped:?}");
    seen.rests(4.6, 8.0);
    let seen = run(&words(&[(6.0, Word::Reset), (6.5, Word::Select), (7.5, Word::Start)]), NEVER, (3.0, 5.0), 10.0);
    seen.rests(4.6, 7.5);
    seen.begins_where_it_is(7.4);
    seen.ends_following();
}

#[test]
fn a_second_emergency_stop_behind_the_reset_stops_again() {
    let again = [(4.5, Word::Reset), (5.0, Word::Select), (6.0, Word::Start)];
    // It is pressed again while both arms wait for the start.
    let seen = run(&words(&again), (3.0, 4.0), NEVER, 5.8);
    seen.rests(3.5, 5.8);
    let seen = run(&words(&again), (5.5, 9.0), NEVER, 9.0);
    seen.rests(6.1, 9.0);
    assert_eq!(seen.transitions().pop().unwrap().to, "fault");
}

/// Nobody resets where the command leads: the run ends, and its report says why.
#[test]
fn a_fault_that_ends_a_run_is_on_top_of_its_report() {
    let setup = setup();
    let parts = wire(&setup).unwrap();
    let plan = Plan::of(&setup.experiment.motion, &*parts.experiment);
    let (clock, told) = (Arc::clone(&parts.clock), Told::default());
    let vs = Stoppable { inner: parts.vs, clock, pressed: (3.0, 9.0), latched: AtomicBool::new(false), told };
    let Ended { outcome, how } = conduct(&setup, Parts { vs: Box::new(vs), ..parts }, None, None).unwrap();
    let failure = format!("{:#}", how.unwrap_err());
    assert!(failure.contains("vs-robot") && failure.contains("the emergency stop of the test"), "{failure}");
    assert!(outcome.log.control.len() > 290, "{} steps", outcome.log.control.len());
    let summary = RunSummary { ended_by: Some(failure), ..summarize(&outcome.log, &plan) };
    let folder = tempfile::tempdir().unwrap();
    report::write(folder.path(), &outcome, &summary, (&[], &plan.world_from_axes)).unwrap();
    let page = std::fs::read_to_string(folder.path().join("report.html")).unwrap();
    let place = |text: &str| page.find(text).unwrap_or_else(|| panic!("{text} is not in the report"));
    assert!(place("The run has ended before its time") < place("Target and hand"));
    assert!(place("the emergency stop of the test") < place("Target and hand"));
    let figures = std::fs::read_to_string(folder.path().join("summary.json")).unwrap();
    assert!(figures.contains("\"ended_by\": \"") && figures.contains("the emergency stop of the test"));
}

/// The page lists at least 50 ways, each with a test that exists.
#[test]
fn each_way_of_the_page_has_its_test() {
    let page = std::fs::read_to_string(repository().join("docs/start-and-resume.md")).unwrap();
    let rows = page.lines().filter_map(|line| {
        let cells: Vec<&str> = line.strip_prefix("| ")?.split(" | ").collect();
        let number: usize = cells.first()?.trim().parse().ok()?;
        let [file, name] = cells.last()?.trim_end_matches(" |").trim_matches('`').split("::").collect::<Vec<_>>()[..]
        else {
            panic!("row {number} names no test: {line}")
        };
        Some((number, file.to_owned(), name.to_owned()))
    });
    let mut count = 0;
    for (number, file, name) in rows {
        count += 1;
        assert_eq!(number, count, "the rows are numbered in order");
        let source =
            std::fs::read_to_string(repository().join(&file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        assert!(
            source.contains(&format!("#[test]\nfn {name}()"))
                || source.contains(&format!("    #[test]\n    fn {name}()")),
            "{file} has no test {name}"
        );
    }
    assert!(count >= 50, "{count} ways");
}

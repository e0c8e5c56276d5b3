//! The panel as operator: order of its commands, signs of life, and troubles shown.

use pb3dp_geometry::Pose;
use pb3dp_servo::supervisor::{ConditionSet, Why};

use super::*;
use crate::control_link::ReportingEnds;

fn at(millis: u64) -> MonotonicTime {
    MonotonicTime::from_nanos(millis * 1_000_000)
}

fn decision(state: State) -> Decision {
    let permission = if state.is_moving() { Permission::Move { share: 1.0 } } else { Permission::Hold };
    Decision {
        permission,
        state,
        why: Why::Moving { state },
        rearm: false,
        search: false,
        found: ConditionSet::default(),
        no_arm_may_move: !state.is_moving(),
        is_ready: false,
        transition: None,
        refused: None,
    }
}

struct Bench {
    link: Arc<ControlLink>,
    operator: PanelOperator,
    reports: ReportingEnds,
    now: u64,
}

impl Bench {
    fn new() -> Self {
        let (link, ends, reports) = ControlLink::new();
        let link = Arc::new(link);
        let mut bench = Self { operator: PanelOperator::new(link.clone(), ends), link, reports, now: 1000 };
        assert_eq!(bench.step(State::Idle), None);
        bench
    }

    /// One control step in this state; returns the command.
    fn step(&mut self, state: State) -> Option<OperatorCommand> {
        self.now += 10;
        let last = decision(state);
        let input = self.operator.listen(Some(&last), at(self.now));
        assert_eq!(input.silent_after, Some(SILENT_AFTER));
        self.operator.show(&last);
        input.request.map(|request| request.command)
    }

    fn queue(&mut self, command: OperatorCommand) -> u64 {
        let id = self.link.next_id();
        let shown_state = self.link.number.load(Ordering::SeqCst);
        assert!(self.link.queue(GivenCommand { id, command, at: at(self.now), shown_state }));
        id
    }

    fn urgent(&mut self, command: OperatorCommand) {
        let id = self.link.next_id();
        self.link.slot_of(command).unwrap().give(id, at(self.now));
    }

    fn results(&mut self) -> Vec<(u64, &'static str)> {
        let name_of = |outcome: &Outcome| match outcome {
            Outcome::Decided(_) => "decided",
            Outcome::OtherState => "other state",
            Outcome::Overtaken => "overtaken",
            Outcome::Suspended => "suspended",
        };
        std::iter::from_fn(|| self.reports.results.pop().ok())
            .map(|taken| (taken.id, name_of(&taken.outcome)))
            .collect()
    }
}

#[test]
fn stop_comes_before_everything_and_drops_what_was_given_before() {
    let mut bench = Bench::new();
    let (select, start) = (bench.queue(OperatorCommand::Select), bench.queue(OperatorCommand::Start));
    bench.urgent(OperatorCommand::HoldHand);
    bench.urgent(OperatorCommand::Hold);
    bench.urgent(OperatorCommand::Stop);
    let later = bench.queue(OperatorCommand::Reset);
    assert_eq!(bench.step(State::Idle), Some(OperatorCommand::Stop));
    assert_eq!(bench.step(State::Stopped), Some(OperatorCommand::Hold));
    assert_eq!(bench.step(State::Stopped), Some(OperatorCommand::HoldHand));
    assert_eq!(bench.step(State::Stopped), None);
    let results = bench.results();
    assert!(results.contains(&(select, "overtaken")) && results.contains(&(start, "overtaken")), "{results:?}");
    assert!(results.contains(&(later, "other state")), "it was given on the state before the stop: {results:?}");
}

#[test]
fn a_select_while_an_arm_moves_waits_for_the_hold_and_a_stop_ends_it() {
    let mut bench = Bench::new();
    let select = bench.queue(OperatorCommand::Select);
    assert_eq!(bench.step(State::Tracking), Some(OperatorCommand::Hold));
    assert_eq!(bench.step(State::Holding), Some(OperatorCommand::Select));
    assert_eq!(bench.results(), [(0, "decided"), (select, "decided")]);
    let select = bench.queue(OperatorCommand::Select);
    assert_eq!(bench.step(State::Tracking), Some(OperatorCommand::Hold));
    bench.urgent(OperatorCommand::Stop);
    assert_eq!(bench.step(State::Holding), Some(OperatorCommand::Stop));
    assert_eq!(bench.step(State::Stopped), None, "the target is not selected after the stop");
    assert!(bench.results().contains(&(select, "overtaken")));
}

#[test]
fn commands_from_before_a_pause_are_discarded_but_not_stop() {
    let mut bench = Bench::new();
    let select = bench.queue(OperatorCommand::Select);
    bench.urgent(OperatorCommand::Stop);
    bench.now += 500;
    assert_eq!(bench.step(State::Idle), Some(OperatorCommand::Stop));
    assert_eq!(bench.step(State::Stopped), None);
    assert_eq!(bench.results().last(), Some(&(select, "overtaken")));
    let select = bench.queue(OperatorCommand::Select);
    bench.now += 500;
    assert_eq!(bench.step(State::Idle), None);
    assert_eq!(bench.results(), [(select, "suspended")]);
}

#[test]
fn a_sign_of_life_is_never_in_the_future_and_motion_requests_arrive() {
    let mut bench = Bench::new();
    let input = |bench: &mut Bench| bench.operator.listen(None, at(bench.now)).heartbeat_at;
    assert_eq!(input(&mut bench), None);
    bench.link.set_heartbeat_at(Some(at(bench.now + 3)));
    assert_eq!(input(&mut bench), Some(at(bench.now)));
    bench.link.set_heartbeat_at(Some(at(0)));
    assert_eq!(input(&mut bench), Some(at(0)));
    bench.link.set_heartbeat_at(None);
    assert_eq!(input(&mut bench), None);
    bench.link.set_speed_share(0.25);
    let shifted = Pose::from_translation(nalgebra::Vector3::new(0.01, 0.0, 0.0));
    bench.link.set_jog(shifted);
    input(&mut bench);
    assert_eq!(bench.operator.motion(), MotionRequest { speed_share: 0.25, hand_from_hand_shifted: shifted });
}

#[test]
fn the_newest_trouble_arrives_although_nobody_reads_for_a_while() {
    let mut bench = Bench::new();
    for number in 0..40 {
        bench.operator.tell(Some(number.to_string()));
    }
    while bench.reports.troubles.pop().is_ok() {}
    bench.step(State::Idle);
    assert_eq!(bench.reports.troubles.pop(), Ok(Some("39".to_owned())));
}

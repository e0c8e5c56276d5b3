//! The model permits what docs/supervisor.md permits, and nothing else.

use super::*;

/// Control steps of 10 ms, and a confident pair every 30 ms that is 70 ms old, and older if it is late.
#[derive(Clone)]
struct Cell {
    model: WhoMayMove,
    /// True time, and what the clock of the control loop adds.
    t_s: f64,
    shown_s: f64,
    pairs: bool,
    pair: Pair,
    late_s: f64,
    hears: bool,
    heartbeat_s: f64,
    disabled_s: f64,
    count: u64,
}

impl Cell {
    fn new(has_person: bool) -> Self {
        let pair = Pair {
            number: 0,
            exposed_s: -0.07,
            skew_s: 0.0,
            target: 1,
            has_pose: true,
            is_confident: true,
            sigma: [0.001; 2],
        };
        let model = WhoMayMove::new(has_person, 10.0);
        let (t_s, shown_s, heartbeat_s, disabled_s, count) = (0.0, 0.0, 0.0, 0.0, 0);
        Self { model, t_s, shown_s, pairs: true, pair, late_s: 0.0, hears: true, heartbeat_s, disabled_s, count }
    }

    fn step(&mut self) {
        (self.t_s, self.count) = (self.t_s + 0.01, self.count + 1);
        let now_s = self.t_s + self.shown_s;
        if self.pairs && self.count.is_multiple_of(3) {
            (self.pair.number, self.pair.exposed_s) = (self.pair.number + 1, self.t_s - 0.07 - self.late_s);
            self.model.saw(self.pair);
        }
        if self.hears {
            self.heartbeat_s = now_s;
        }
        let heartbeat_s = Some(self.heartbeat_s);
        self.model.stepped(&Moment { now_s, true_s: self.t_s, heartbeat_s, disabled_s: self.disabled_s });
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds * 100.0).round() as u32 {
            self.step();
        }
    }

    fn say(&mut self, command: Command) {
        self.say_late(command, 0.0);
    }

    fn say_late(&mut self, command: Command, late_s: f64) {
        self.model.commanded(command, self.t_s + 0.01 + self.shown_s - late_s);
        self.step();
    }

    /// Hand, target arm.
    fn may(&self) -> [bool; 2] {
        let hand = self.model.hand_may_go() && !self.model.is_hand_inhibited(self.t_s);
        [hand, self.model.target_may_go()]
    }

    /// A cell whose operator has started the motion.
    fn going() -> Self {
        let mut cell = Self::new(true);
        cell.run(0.5);
        cell.say(Command::Select);
        cell.run(0.5);
        cell.say(Command::Start);
        assert_eq!(cell.may(), [true; 2]);
        cell
    }
}

#[test]
fn nothing_moves_before_the_start_and_select_alone_starts_nothing() {
    let mut cell = Cell::new(true);
    for command in [Command::Start, Command::Resume, Command::Reset, Command::Select, Command::Resume] {
        cell.run(0.5);
        cell.say(command);
        assert_eq!(cell.may(), [false; 2], "{command:?}");
    }
    cell.run(0.5);
    cell.say(Command::Start);
    assert_eq!(cell.may(), [true; 2]);
    // Without a person the target arm follows its path from the beginning.
    assert_eq!(Cell::new(false).may(), [false, true]);
}

#[test]
fn a_start_needs_poses_of_the_selected_target_for_some_time() {
    let mut cell = Cell::new(true);
    cell.run(0.5);
    cell.say(Command::Select);
    cell.run(0.15);
    cell.say(Command::Start);
    assert!(!cell.may()[0]);
    cell.run(0.5);
    cell.say(Command::Start);
    assert!(cell.may()[0]);
}

#[test]
fn a_refused_command_has_no_effect() {
    let mut cell = Cell::new(true);
    cell.run(0.5);
    cell.say(Command::Select);
    cell.run(0.5);
    cell.model.commanded(Command::Start, cell.t_s);
    cell.model.refused();
    cell.step();
    assert_eq!(cell.may(), [false; 2]);
}

#[test]
fn hold_holds_both_arms_and_hold_hand_one() {
    for (command, target) in [(Command::Hold, false), (Command::HoldHand, true)] {
        let mut cell = Cell::going();
        cell.say(command);
        assert_eq!(cell.may(), [false, target], "{command:?}");
        cell.run(2.0);
        assert_eq!(cell.may(), [false, target], "{command:?}");
        cell.say(Command::Start);
        assert_eq!(cell.may(), [false, target], "a start needs a selection");
        cell.say(Command::Resume);
        assert_eq!(cell.may(), [true; 2]);
    }
    // `hold hand` after `hold` releases nothing, and neither does a selection.
    let mut cell = Cell::going();
    cell.say(Command::Hold);
    cell.say(Command::HoldHand);
    assert_eq!(cell.may(), [false; 2]);
    cell.say(Command::Select);
    cell.run(1.0);
    assert_eq!(cell.may(), [false; 2]);
}

#[test]
fn a_command_that_is_late_or_older_than_the_hold_has_no_effect() {
    let mut cell = Cell::going();
    cell.say(Command::Hold);
    cell.run(0.3);
    cell.say_late(Command::Resume, 0.35);
    assert!(!cell.may()[0], "given before the hold");
    cell.run(2.0);
    cell.say_late(Command::Resume, 0.55);
    assert!(!cell.may()[0], "too old");
    cell.say_late(Command::Resume, 0.45);
    assert!(cell.may()[0]);
}

#[test]
fn after_a_stop_reset_select_and_start_must_follow() {
    let mut cell = Cell::going();
    cell.say(Command::Stop);
    for command in [Command::Resume, Command::Select, Command::Start, Command::Reset, Command::Start, Command::Select] {
        cell.run(0.5);
        cell.say(command);
        assert_eq!(cell.may(), [false; 2], "{command:?}");
    }
    assert_eq!(cell.model.resets(), 1);
    cell.run(0.5);
    cell.say(Command::Start);
    assert_eq!(cell.may(), [true; 2]);
    cell.model.latched();
    assert_eq!((cell.may(), cell.model.is_latched()), ([false; 2], true));
    cell.say(Command::Resume);
    assert_eq!(cell.may(), [false; 2]);
}

#[test]
fn a_silence_stops_both_arms() {
    let mut cell = Cell::going();
    cell.hears = false;
    cell.run(0.95);
    assert_eq!(cell.may(), [true; 2]);
    cell.run(0.1);
    assert!(cell.model.is_latched());
    cell.hears = true;
    cell.run(1.0);
    assert_eq!(cell.may(), [false; 2]);
}

#[test]
fn after_a_step_of_the_clock_and_disabled_drives_both_arms_wait_for_the_operator() {
    for change in [
        (|cell: &mut Cell| cell.shown_s += 0.5) as fn(&mut Cell),
        |cell| cell.shown_s -= 0.05,
        |cell| cell.disabled_s = 0.2,
    ] {
        let mut cell = Cell::going();
        change(&mut cell);
        cell.step();
        assert_eq!(cell.may(), [false; 2]);
        (cell.disabled_s, cell.shown_s) = (0.0, 0.0);
        cell.run(2.0);
        assert_eq!(cell.may(), [false; 2]);
        cell.say(Command::Resume);
        assert_eq!(cell.may(), [true; 2]);
    }
    let mut cell = Cell::going();
    cell.shown_s += 0.15;
    cell.run(0.5);
    assert_eq!(cell.may(), [true; 2], "a step of 0.16 s is allowed");
    // The clock stays behind the measurements.
    cell.shown_s = -0.3;
    cell.run(2.0);
    cell.say(Command::Resume);
    assert_eq!(cell.may(), [false; 2]);
}

#[test]
fn another_target_is_followed_only_after_a_command() {
    let mut cell = Cell::going();
    cell.pair.target = 2;
    cell.run(0.5);
    assert_eq!(cell.may(), [false, true]);
    cell.say(Command::Resume);
    assert_eq!(cell.may(), [false, true], "the other target is still followed");
    cell.pair.target = 1;
    cell.run(0.5);
    assert_eq!(cell.may(), [false, true], "nothing resumes by itself");
    cell.say(Command::Resume);
    assert_eq!(cell.may(), [true; 2]);
    // A start that was given while another target was followed.
    cell.say(Command::Hold);
    cell.say(Command::Select);
    cell.run(1.0);
    cell.pair.target = 3;
    cell.run(0.25);
    cell.say_late(Command::Start, 0.4);
    assert!(!cell.may()[0]);
    cell.say(Command::Start);
    assert_eq!((cell.may()[0], cell.model.started()), (true, Some(3)));
}

/// The hand holds while a condition is active, and resumes 0.2 s of confident poses after it.
#[test]
fn conditions_inhibit_the_hand_until_they_have_been_gone_for_some_time() {
    type Change = fn(&mut Cell);
    let cases: [(&str, Change, f64); 5] = [
        ("no pairs", |cell| cell.pairs = false, 0.3),
        ("no confident pose", |cell| cell.pair.is_confident = false, 0.3),
        ("exposures", |cell| cell.pair.skew_s = -0.006, 0.16),
        ("uncertain position", |cell| cell.pair.sigma = [0.021, 0.0], 0.26),
        ("uncertain orientation", |cell| cell.pair.sigma = [0.0, 0.11], 0.26),
    ];
    for (name, change, within_s) in cases {
        let mut cell = Cell::going();
        let pair = cell.pair;
        change(&mut cell);
        cell.run(within_s);
        assert_eq!(cell.may(), [false, true], "{name}");
        cell.run(0.3);
        let number = cell.pair.number;
        (cell.pairs, cell.pair) = (true, Pair { number, ..pair });
        cell.run(0.2);
        assert!(!cell.may()[0], "{name}: too soon");
        cell.run(0.1);
        assert_eq!(cell.may(), [true; 2], "{name}");
    }
    let mut cell = Cell::going();
    cell.pair.number -= 5;
    cell.run(0.04);
    assert!(!cell.may()[0], "order of the images");
}

#[test]
fn a_hand_searches_once_for_some_time_and_not_while_it_is_held() {
    let mut cell = Cell::going();
    cell.pairs = false;
    cell.run(0.9);
    assert!(!cell.model.may_search(cell.t_s));
    cell.run(0.1);
    assert!(cell.model.may_search(cell.t_s));
    cell.run(10.0);
    assert!(!cell.model.may_search(cell.t_s));
    let mut cell = Cell::going();
    cell.say(Command::HoldHand);
    cell.pairs = false;
    cell.run(2.0);
    assert!(!cell.model.may_search(cell.t_s));
}

/// A hand that holds because pairs do not come, which is reported as a stall.
fn stalled() -> Cell {
    let mut cell = Cell::going();
    cell.run(1.5);
    stall(&mut cell);
    cell
}

/// Pairs do not come any more, and a stall is reported in the step from which on the hand is inhibited.
fn stall(cell: &mut Cell) {
    cell.pairs = false;
    while !cell.model.is_hand_inhibited(cell.t_s) {
        assert!(cell.t_s < 10.0);
        let before = cell.clone();
        cell.step();
        if cell.model.is_hand_inhibited(cell.t_s) {
            *cell = before;
            cell.model.reported(true);
            cell.step();
        }
    }
}

/// The next pair comes with the report that the stall is over.
fn over(cell: &mut Cell) {
    cell.pairs = true;
    while !(cell.count + 1).is_multiple_of(3) {
        cell.count += 1;
    }
    cell.model.reported(false);
    cell.step();
}

#[test]
fn a_stall_ends_as_soon_as_pairs_come_and_only_if_it_is_reported() {
    let mut cell = stalled();
    assert!(!cell.may()[0]);
    cell.run(0.15);
    assert!(!cell.may()[0]);
    over(&mut cell);
    assert_eq!(cell.may(), [true; 2]);
    // The same without a report that it is over.
    let mut cell = stalled();
    cell.pairs = true;
    cell.run(0.05);
    assert!(!cell.may()[0]);
    // A hold that is not reported as a stall.
    let mut cell = Cell::going();
    cell.pairs = false;
    cell.run(0.3);
    over(&mut cell);
    assert!(!cell.may()[0]);
    cell.run(0.3);
    assert!(cell.may()[0]);
}

#[test]
fn a_stall_that_is_long_or_soon_after_another_one_is_a_hold() {
    let mut cell = stalled();
    cell.run(0.32);
    over(&mut cell);
    assert!(!cell.may()[0], "longer than 0.3 s");
    for (pause_s, may_go) in [(0.5, false), (1.3, true)] {
        let mut cell = stalled();
        over(&mut cell);
        cell.run(pause_s - 0.2);
        stall(&mut cell);
        cell.run(0.1);
        assert!(!cell.may()[0], "no pairs");
        over(&mut cell);
        assert_eq!(cell.may()[0], may_go, "{pause_s} s after the last one");
    }
}

/// Whatever else inhibits motion makes a stall a hold, even if it is gone when the pairs come.
#[test]
fn another_condition_or_a_command_makes_a_stall_a_hold() {
    type Change = fn(&mut Cell);
    let cases: [(&str, Change); 4] = [
        ("exposures", |cell| cell.pair.skew_s = 0.006),
        ("uncertain position", |cell| cell.pair.sigma = [0.021, 0.0]),
        ("order of the images", |cell| cell.pair.number -= 5),
        ("another target", |cell| cell.pair.target = 2),
    ];
    for (name, change) in cases {
        let mut cell = stalled();
        let pair = cell.pair;
        change(&mut cell);
        over(&mut cell);
        assert!(!cell.may()[0], "{name}");
        cell.pair = Pair { number: cell.pair.number.max(pair.number), ..pair };
        over(&mut cell);
        assert!(!cell.may()[0], "{name}");
    }
    for command in [Command::Hold, Command::HoldHand, Command::Stop] {
        let mut cell = stalled();
        cell.say(command);
        over(&mut cell);
        cell.run(2.0);
        assert!(!cell.may()[0], "{command:?}");
    }
}

/// A line may deliver a command after a later one.
#[test]
fn commands_given_before_a_later_hold_or_stop_permit_nothing() {
    let mut cell = Cell::going();
    cell.say(Command::Hold);
    cell.run(0.5);
    cell.say(Command::HoldHand);
    cell.say_late(Command::Resume, 0.1);
    assert_eq!(cell.may(), [false; 2]);
    cell.say(Command::Resume);
    assert_eq!(cell.may(), [true; 2]);
    cell.say(Command::Stop);
    cell.run(0.5);
    cell.say(Command::Stop);
    cell.say_late(Command::Reset, 0.1);
    assert!(cell.model.is_latched());
}

#[test]
fn doubts_about_late_poses_do_not_add_to_their_age() {
    type Change = fn(&mut Pair);
    let doubts: [Change; 2] = [|pair| pair.sigma = [0.03, 0.0], |pair| pair.skew_s = 0.006];
    for doubt in doubts {
        let mut cell = Cell::going();
        cell.late_s = 0.12;
        cell.run(1.0);
        assert!(cell.may()[0], "late");
        doubt(&mut cell.pair);
        cell.run(0.06);
        assert!(cell.may()[0]);
        cell.run(0.06);
        assert!(!cell.may()[0]);
    }
}

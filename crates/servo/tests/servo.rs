//! Controller and supervisor as one.

use crate::common::{Cell, IDEAL, config, rotation};
use crate::supervisor::bench;
use nalgebra::Vector3;
use pb3dp_kinematics::JointState;
use pb3dp_servo::supervisor::{OperatorCommand, OperatorRequest, State, Supervisor};
use pb3dp_servo::{Command, Servo, ServoInput, ServoStep};

/// A hand that waits beside a target at rest; the arm executes no command.
struct Waiting {
    cell: Cell,
    servo: Servo,
    resting: JointState,
}

impl Waiting {
    fn new(soft_start_s: f64) -> Self {
        let mut config = config();
        config.speed.soft_start_s = soft_start_s;
        let cell = Cell::new(config, IDEAL, 0.0);
        let supervisor = Supervisor::new(bench::config()).unwrap();
        let servo = Servo::new(cell.controller.clone(), supervisor);
        Self { resting: cell.joints, cell, servo }
    }

    /// One cycle of 2 ms.
    fn step(&mut self, command: Option<OperatorCommand>, speed_share: f64) -> ServoStep {
        let target = self.cell.target_for_hand_moved(Vector3::new(0.05, -0.04, 0.03), rotation(0.1, 0.2, -0.1));
        // Delivers the images; the controller of the cell itself is not used.
        self.cell.step(&target);
        self.cell.joints = JointState { at: self.cell.now(), ..self.resting };
        let now = self.cell.now();
        let good = bench::good(now.seconds_since(pb3dp_geometry::MonotonicTime::from_nanos(0)));
        let mut operator = good.operator;
        operator.request = command.map(|command| OperatorRequest { command, at: now });
        let input = ServoInput {
            joints: &self.cell.joints,
            observation: self.cell.newest.as_ref(),
            estimate: good.estimate,
            frame: good.frame,
            operator,
            speed_share,
            arms: good.arms,
        };
        self.servo.step(&input, now)
    }

    /// Cycles at rest until `start` is accepted; returns its step.
    fn start(&mut self, speed_share: f64) -> ServoStep {
        self.step(Some(OperatorCommand::Select), speed_share);
        for _ in 0..500 {
            assert_eq!(self.step(None, speed_share).command, Command::Hold);
        }
        let step = self.step(Some(OperatorCommand::Start), speed_share);
        assert_eq!(step.decision.state, State::Approaching, "{}", step.decision.why);
        step
    }
}

#[test]
fn the_command_is_that_of_the_controller_times_the_share_of_the_operator() {
    let mut waiting = Waiting::new(0.0);
    waiting.start(1.0);
    for (share, expected) in [(1.0, 1.0), (0.25, 0.25), (7.0, 1.0), (-1.0, 0.0), (f64::NAN, 0.0)] {
        let step = waiting.step(None, share);
        let (Command::Velocity(wanted), Command::Velocity(permitted)) = (step.control.command, step.command) else {
            panic!("{}", step.decision.why)
        };
        assert!(wanted.amax() > 0.05 && permitted == wanted * expected, "{share}: {permitted} of {wanted}");
    }
    let held = waiting.step(Some(OperatorCommand::Hold), 1.0);
    assert_eq!((held.command, held.decision.state), (Command::Hold, State::Holding));
}

/// The time before the start, in which the supervisor permits nothing, does not count for the soft start of the controller.
#[test]
fn a_hand_that_was_not_permitted_to_move_starts_softly() {
    let mut waiting = Waiting::new(0.5);
    let Command::Velocity(first) = waiting.start(1.0).command else { panic!("no command") };
    assert!(first.amax() < 1e-9, "{} rad/s in the first step", first.amax());
}

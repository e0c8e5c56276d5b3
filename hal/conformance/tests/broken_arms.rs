//! Each rule of the arm suite detects an arm that breaks it, and a good arm passes.

use std::sync::Arc;
use std::task::Poll;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState, PowerOrder,
};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::{ArmExpectations, ArmHooks, Report, arm_suite};
use pb3dp_kinematics::JointVector;

const CYCLE: Duration = Duration::from_millis(10);

/// The defect of an arm; one at a time.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Defect {
    None,
    NoCycle,
    StartsEnabled,
    HoldFailsWhileDisabled,
    MovesWhileDisabled,
    NotEnabledByAnotherName,
    EnableFails,
    EnableJerks,
    GivesUpInMotion,
    EnablesTwice,
    SignFlipped,
    JointsSwapped,
    WrapsAngles,
    MeasuresNoVelocity,
    HoldRunsOn,
    TimeGoesBack,
    TimeRunsAhead,
    SampleNotFinite,
    Slow,
    AcceptsNan,
    RunsOnAfterRejection,
    FaultsAfterRejection,
    IgnoresLostReplies,
    RunsOnAfterLostReply,
    DeafAfterLostReply,
    StopKeepsDrivesOn,
    StopRunsOn,
    SecondStopFails,
    FaultIsForgotten,
    FaultRunsOn,
    EStopIsAFault,
    EnableClearsFault,
    StopClearsFault,
    ResetsTooEarly,
    ClearsItself,
    ResetEnables,
    ResetFails,
}

/// Joints that follow at once: the simplest possible arm.
struct TestArm {
    defect: Defect,
    info: ArmInfo,
    clock: Arc<VirtualClock>,
    state: ArmState,
    position: JointVector,
    velocity: JointVector,
    at: MonotonicTime,
    cause: Option<ArmState>,
    lose_reply: bool,
    deaf: bool,
    stops: u32,
    exchanges: u64,
}

impl TestArm {
    fn new(defect: Defect, clock: &Arc<VirtualClock>) -> Self {
        let cycle = if defect == Defect::NoCycle { Duration::ZERO } else { CYCLE };
        Self {
            defect,
            info: ArmInfo { name: format!("{defect:?}"), cycle },
            clock: Arc::clone(clock),
            state: if defect == Defect::StartsEnabled { ArmState::Enabled } else { ArmState::Disabled },
            position: JointVector::from([0.1, 0.2, 0.3, 0.4, std::f64::consts::PI - 0.01, 0.6, 0.7]),
            velocity: JointVector::zeros(),
            at: clock.now(),
            cause: None,
            lose_reply: false,
            deaf: false,
            stops: 0,
            exchanges: 0,
        }
    }

    fn is(&self, defect: Defect) -> bool {
        self.defect == defect
    }

    fn advance(&mut self) {
        let now = self.clock.now();
        self.position += self.velocity * now.seconds_since(self.at);
        self.at = now;
    }

    fn rest_unless(&mut self, defect: Defect) {
        self.advance();
        if !self.is(defect) {
            self.velocity = JointVector::zeros();
        }
    }

    fn happen(&mut self, state: ArmState) {
        self.rest_unless(Defect::FaultRunsOn);
        self.cause = Some(state);
        self.state = if self.is(Defect::EStopIsAFault) { ArmState::Fault } else { state };
        if self.is(Defect::FaultIsForgotten) {
            self.state = ArmState::Enabled;
        }
    }

    fn remove_cause(&mut self) {
        self.cause = None;
        if self.is(Defect::ClearsItself) {
            self.state = ArmState::Disabled;
        }
    }

    fn refuse(&self, kind: ArmErrorKind) -> ArmError {
        ArmError::new(kind, format!("{kind:?} of {}", self.info.name))
    }

    fn accept(&mut self, command: JointCommand) -> Result<JointVector, ArmErrorKind> {
        let JointCommand::Velocity(velocity) = command else {
            if self.is(Defect::HoldFailsWhileDisabled) && self.state == ArmState::Disabled {
                return Err(ArmErrorKind::NotEnabled);
            }
            return Ok(if self.is(Defect::HoldRunsOn) { self.velocity } else { JointVector::zeros() });
        };
        if !self.is(Defect::AcceptsNan) && !velocity.iter().all(|x| x.is_finite()) {
            return Err(ArmErrorKind::Rejected);
        }
        match self.state {
            ArmState::Enabled if self.is(Defect::GivesUpInMotion) && self.exchanges > 100 => Err(ArmErrorKind::Timeout),
            ArmState::Enabled if self.deaf => Err(ArmErrorKind::Timeout),
            ArmState::Enabled => Ok(velocity.map(|x| if x.is_finite() { x } else { 0.0 })),
            ArmState::Disabled if self.is(Defect::MovesWhileDisabled) => {
                self.velocity = velocity;
                Err(ArmErrorKind::NotEnabled)
            }
            ArmState::Disabled if self.is(Defect::NotEnabledByAnotherName) => Err(ArmErrorKind::Rejected),
            ArmState::Disabled => Err(ArmErrorKind::NotEnabled),
            ArmState::Fault | ArmState::EStop => Err(ArmErrorKind::Fault),
        }
    }

    fn measured(&self) -> JointState {
        let mut sample = JointState { at: self.at, position_rad: self.position, velocity_rad_per_s: self.velocity };
        match self.defect {
            Defect::SignFlipped => sample.position_rad[2] = -sample.position_rad[2],
            Defect::JointsSwapped => sample.position_rad.swap_rows(5, 6),
            Defect::WrapsAngles => {
                sample.position_rad[4] = sample.position_rad[4].sin().atan2(sample.position_rad[4].cos());
            }
            Defect::MeasuresNoVelocity => sample.velocity_rad_per_s = JointVector::zeros(),
            Defect::TimeGoesBack if self.exchanges % 5 == 4 => sample.at = sample.at - Duration::from_millis(50),
            Defect::TimeRunsAhead => sample.at = sample.at + Duration::from_millis(50),
            Defect::SampleNotFinite => sample.velocity_rad_per_s[3] = f64::NAN,
            _ => {}
        }
        sample
    }
}

impl Arm for TestArm {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        self.exchanges += 1;
        self.advance();
        if self.is(Defect::Slow) && self.exchanges == 5 {
            self.clock.sleep_until(self.at + 3 * CYCLE);
        }
        if std::mem::take(&mut self.lose_reply) && !self.is(Defect::IgnoresLostReplies) {
            self.rest_unless(Defect::RunsOnAfterLostReply);
            self.deaf = self.is(Defect::DeafAfterLostReply);
            return Err(self.refuse(ArmErrorKind::Timeout));
        }
        match self.accept(command) {
            Ok(velocity) => {
                let sample = self.measured();
                self.velocity = velocity;
                Ok(JointState { velocity_rad_per_s: sample.velocity_rad_per_s, ..sample })
            }
            Err(kind) => {
                if !self.is(Defect::MovesWhileDisabled) && !self.is(Defect::FaultRunsOn) {
                    self.rest_unless(Defect::RunsOnAfterRejection);
                }
                if kind == ArmErrorKind::Rejected && self.is(Defect::FaultsAfterRejection) {
                    self.state = ArmState::Fault;
                }
                Err(self.refuse(kind))
            }
        }
    }
}

impl ArmPower for TestArm {
    fn state(&self) -> ArmState {
        self.state
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        let done = match order {
            PowerOrder::Enable(_) | PowerOrder::BeginEnable(_) => self.enable_drives(),
            PowerOrder::PollEnable | PowerOrder::BeginStop => Ok(()),
            PowerOrder::Stop => self.stop_drives(),
            PowerOrder::Reset => self.clear_latch(),
        };
        done.map(Poll::Ready)
    }
}

impl TestArm {
    fn enable_drives(&mut self) -> Result<(), ArmError> {
        match self.state {
            _ if self.is(Defect::EnableFails) => return Err(self.refuse(ArmErrorKind::Rejected)),
            ArmState::Disabled => {}
            ArmState::Enabled if self.is(Defect::EnablesTwice) => {}
            ArmState::Fault | ArmState::EStop if self.is(Defect::EnableClearsFault) => {}
            ArmState::Enabled => return Err(self.refuse(ArmErrorKind::Rejected)),
            ArmState::Fault | ArmState::EStop => return Err(self.refuse(ArmErrorKind::Fault)),
        }
        if self.is(Defect::EnableJerks) {
            self.velocity[1] = 0.1;
        }
        self.state = ArmState::Enabled;
        Ok(())
    }

    fn stop_drives(&mut self) -> Result<(), ArmError> {
        self.stops += 1;
        self.rest_unless(Defect::StopRunsOn);
        let latched = matches!(self.state, ArmState::Fault | ArmState::EStop) && !self.is(Defect::StopClearsFault);
        if !latched && !self.is(Defect::StopKeepsDrivesOn) {
            self.state = ArmState::Disabled;
        }
        if self.is(Defect::SecondStopFails) && self.stops > 1 {
            return Err(self.refuse(ArmErrorKind::Rejected));
        }
        Ok(())
    }

    fn clear_latch(&mut self) -> Result<(), ArmError> {
        let too_early = self.cause.is_some() && !self.is(Defect::ResetsTooEarly);
        if too_early || self.is(Defect::ResetFails) {
            return Err(self.refuse(ArmErrorKind::Fault));
        }
        if matches!(self.state, ArmState::Fault | ArmState::EStop) {
            self.state = if self.is(Defect::ResetEnables) { ArmState::Enabled } else { ArmState::Disabled };
        }
        Ok(())
    }
}

fn suite(defect: Defect) -> Report {
    let clock = Arc::new(VirtualClock::new());
    let hooks = ArmHooks::<TestArm> {
        lose_reply: Some(Box::new(|arm| arm.lose_reply = true)),
        raise_fault: Some(Box::new(|arm| arm.happen(ArmState::Fault))),
        remove_fault_cause: Some(Box::new(TestArm::remove_cause)),
        press_e_stop: Some(Box::new(|arm| arm.happen(ArmState::EStop))),
        release_e_stop: Some(Box::new(TestArm::remove_cause)),
    };
    let expectations = ArmExpectations { speed_rad_per_s: 0.1, settles_within: Duration::from_millis(200) };
    arm_suite(|| TestArm::new(defect, &clock), clock.as_ref(), &expectations, &hooks)
}

#[test]
fn a_good_arm_passes() {
    suite(Defect::None).assert_passed();
}

#[test]
fn each_defect_breaks_its_rule() {
    let defects = [
        (Defect::NoCycle, "info-is-real"),
        (Defect::StartsEnabled, "starts-disabled"),
        (Defect::HoldFailsWhileDisabled, "hold-always-works"),
        (Defect::MovesWhileDisabled, "velocity-needs-enable"),
        (Defect::NotEnabledByAnotherName, "velocity-needs-enable"),
        (Defect::EnableFails, "enables-at-rest"),
        (Defect::EnableJerks, "enables-at-rest"),
        (Defect::GivesUpInMotion, "unexpected-error"),
        (Defect::EnablesTwice, "enable-only-from-disabled"),
        (Defect::SignFlipped, "moves-as-told"),
        (Defect::JointsSwapped, "moves-as-told"),
        (Defect::WrapsAngles, "moves-as-told"),
        (Defect::MeasuresNoVelocity, "moves-as-told"),
        (Defect::HoldRunsOn, "hold-comes-to-rest"),
        (Defect::TimeGoesBack, "samples-in-order"),
        (Defect::TimeRunsAhead, "samples-in-order"),
        (Defect::SampleNotFinite, "samples-in-order"),
        (Defect::Slow, "returns-in-time"),
        (Defect::AcceptsNan, "not-finite-is-rejected"),
        (Defect::RunsOnAfterRejection, "error-cancels-motion"),
        (Defect::FaultsAfterRejection, "error-cancels-motion"),
        (Defect::FaultsAfterRejection, "goes-on-after-an-error"),
        (Defect::IgnoresLostReplies, "lost-reply-is-a-timeout"),
        (Defect::RunsOnAfterLostReply, "error-cancels-motion"),
        (Defect::DeafAfterLostReply, "goes-on-after-an-error"),
        (Defect::StopKeepsDrivesOn, "stop-disables"),
        (Defect::StopRunsOn, "stop-disables"),
        (Defect::SecondStopFails, "stop-is-harmless-again"),
        (Defect::FaultIsForgotten, "fault-latches"),
        (Defect::FaultRunsOn, "fault-latches"),
        (Defect::EStopIsAFault, "e-stop-latches"),
        (Defect::EnableClearsFault, "enable-only-from-disabled"),
        (Defect::StopClearsFault, "fault-latches"),
        (Defect::StopClearsFault, "e-stop-latches"),
        (Defect::ResetsTooEarly, "reset-needs-the-cause-gone"),
        (Defect::ClearsItself, "fault-latches"),
        (Defect::ResetEnables, "reset-leads-to-disabled"),
        (Defect::ResetFails, "reset-leads-to-disabled"),
    ];
    for (defect, rule) in defects {
        let report = suite(defect);
        assert!(report.breaks(rule), "{rule} was not caught; {report}");
    }
}

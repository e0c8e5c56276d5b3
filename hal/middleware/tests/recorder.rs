//! The flight recorder around a mock arm.

#![allow(clippy::unwrap_used, reason = "helpers of tests")]

use std::sync::Arc;
use std::sync::mpsc::channel;

use pb3dp_arm_pa10_emulation::mock::MockArm;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::mocks::MockScriptedArm;
use pb3dp_hal_middleware::{FlightLog, Recorded, RecordedRequest};
use pb3dp_kinematics::JointVector;

use crate::common::{CYCLE, assert_contract, mock_arm, velocity};

fn recorded(clock: &Arc<VirtualClock>, entries: usize) -> (Recorded<MockArm>, FlightLog) {
    let log = FlightLog::with_capacity(entries);
    let arm = mock_arm(clock, JointVector::from([0.2, -0.5, 0.3, 1.1, -0.7, 0.9, 0.1]));
    (Recorded::new(arm, Arc::clone(clock) as Arc<dyn Clock>, log.clone()), log)
}

#[test]
fn the_last_exchanges_are_kept_with_what_came_of_them() {
    let clock = Arc::new(VirtualClock::new());
    let (mut arm, log) = recorded(&clock, 5);
    assert_eq!(log.entries(), []);
    arm.enable().unwrap();
    let entries = log.entries();
    assert_eq!(
        (entries[0].asked, entries[0].answer, entries[0].state),
        (RecordedRequest::Enable, Ok(None), ArmState::Enabled)
    );
    for k in 1..=20 {
        clock.sleep_until(clock.now() + CYCLE);
        if k == 20 {
            arm.arm().faults().raise_fault("overcurrent in E1");
        }
        let _ = arm.exchange(velocity(2, 0.01 * f64::from(k)));
    }
    let entries = log.entries();
    assert_eq!(entries.len(), 5, "no more than the log holds");
    for (entry, k) in entries.iter().zip(16..) {
        assert_eq!(entry.at, MonotonicTime::ZERO + CYCLE * k);
        assert_eq!(entry.asked, RecordedRequest::Exchange(velocity(2, 0.01 * f64::from(k))));
    }
    let measured = entries[3].answer.unwrap().unwrap();
    assert!(measured.velocity_rad_per_s[2] > 0.05 && measured.at == entries[3].at, "{measured:?}");
    assert_eq!((entries[4].answer, entries[4].state), (Err(ArmErrorKind::Fault), ArmState::Fault));
    arm.exchange(JointCommand::Hold).unwrap();
    arm.stop().unwrap();
    assert!(arm.reset().is_err());
    let last: Vec<_> = log.entries().into_iter().skip(2).map(|entry| (entry.asked, entry.answer.is_ok())).collect();
    assert_eq!(
        last,
        [
            (RecordedRequest::Exchange(JointCommand::Hold), true),
            (RecordedRequest::Stop, true),
            (RecordedRequest::Reset, false)
        ]
    );
}

#[test]
fn an_arm_that_refuses_to_begin_is_reported_and_kept() {
    let log = FlightLog::with_capacity(5);
    let mut arm = MockScriptedArm::new();
    arm.expect_power().times(1).returning(|_| Err(ArmError::new(ArmErrorKind::Fault, "latched")));
    arm.expect_state().return_const(ArmState::Fault);
    let mut arm = Recorded::new(arm, Arc::new(VirtualClock::new()), log.clone());
    assert_eq!(arm.begin_enable().unwrap_err().kind(), ArmErrorKind::Fault);
    let kept: Vec<_> = log.entries().into_iter().map(|entry| (entry.asked, entry.answer, entry.state)).collect();
    assert_eq!(kept, [(RecordedRequest::Enable, Err(ArmErrorKind::Fault), ArmState::Fault)]);
}

#[test]
fn recorded_mock_arm_keeps_the_contract() {
    let clock = Arc::new(VirtualClock::new());
    let make = || recorded(&clock, 100).0;
    assert_contract(&clock, make, |arm| arm.arm());
}

#[test]
fn a_listener_gets_the_measurements_and_no_failures() {
    let clock = Arc::new(VirtualClock::new());
    let (arm, _) = recorded(&clock, 5);
    let (sender, samples) = channel();
    let mut arm = arm.with_listener(Some(Box::new(move |sample| sender.send(*sample).unwrap())));
    assert!(arm.exchange(velocity(2, 0.3)).is_err(), "not enabled");
    arm.enable().unwrap();
    clock.sleep_until(clock.now() + CYCLE);
    let measured = arm.exchange(velocity(2, 0.3)).unwrap();
    assert_eq!(samples.try_iter().collect::<Vec<_>>(), [measured]);
}

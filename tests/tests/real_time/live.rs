//! The whole loop in real time: emulated arms behind gateways on pseudo-terminals, simulated cameras on the arms. On a
//! machine with too much load cycles are late, and an arm without commands stops: then each run is repeated.

use std::path::Path;

use pb3dp_arm_pa10::driver::DriverState;
use pb3dp_bag::pairs::decoded;
use pb3dp_bag::reader::Bag;
use pb3dp_bag::recent::{Recent, RecentOptions};
use pb3dp_bag::run_messages::RunEnd;
use pb3dp_bag::sinks::Sinks;
use pb3dp_bag::topics::ours;
use pb3dp_cell::experiment;
use pb3dp_cell::log::RunLog;
use pb3dp_estimation::estimator::Method;
use pb3dp_recording::pairs::About;
use pb3dp_recording::run::{RecordTo, record_run};
use pb3dp_servo::{Gains, LawConfig, PublishedConfig, TargetFilterConfig};
use pb3dp_setup::setup::{ArmLink, Pace, Setup, read_setup};
use pb3dp_sim::trajectory::Channel;
use pb3dp_test_support::programs_in_real_time_beside_others;
use pb3dp_wiring::{Wired, wire, wire_watched};
use system_tests::repository;

use crate::closed_loop::support::{Pixels, errors, quick_setup, run};

/// A quick setup whose arms are connected as in `configs/hil.toml`.
fn hil_setup() -> Setup {
    let hil = read_setup(&repository().join("configs/hil.toml")).unwrap();
    let mut setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::X]);
    setup.pace = Pace::Live;
    (setup.rig.arms.vs.link, setup.rig.arms.tc.link) = (hil.rig.arms.vs.link, hil.rig.arms.tc.link);
    assert!(setup.rig.arms.vs.link != ArmLink::InProcess && setup.rig.arms.tc.link != ArmLink::InProcess);
    setup
}

/// The reference is the error of the law without feed-forward in simulated time: a loaded machine skips images.
fn with_published_law(mut setup: Setup) -> Setup {
    let gains = Gains { position_per_s: 8.0, velocity: 0.0, orientation_per_s: 16.0, angular_velocity: 0.0 };
    let target_filter = TargetFilterConfig {
        position_time_constant_s: 0.03,
        orientation_time_constant_s: 0.03,
        ..TargetFilterConfig::default()
    };
    setup.controller.law = LawConfig::Published(PublishedConfig { gains, target_filter });
    setup
}

fn followed(log: &RunLog) -> (f64, f64) {
    let moving = errors(log, 1.0, 2.5);
    (moving.rms_mm, moving.max_mm)
}

#[test]
fn a_hand_follows_through_serial_lines_as_in_simulated_time() {
    let simulated =
        followed(&run(&with_published_law(quick_setup(Method::Direct, Pixels::Few, &[Channel::X])), None).log);
    let setup = hil_setup();
    programs_in_real_time_beside_others(|| {
        let Wired { parts, monitors, .. } = wire_watched(&setup).unwrap();
        let log = experiment::run(&setup, parts, None, None).unwrap().log;
        for (name, monitor) in &monitors {
            let arm = monitor.snapshot();
            let is_well = arm.latched.is_none() && arm.state == DriverState::Connected;
            assert!(is_well, "{name} ends {:?} {:?}", arm.state, arm.latched);
        }
        let (rms_mm, max_mm) = followed(&log);
        let as_simulated = rms_mm < 1.5 * simulated.0 && max_mm < 1.5 * simulated.1;
        assert!(as_simulated, "{rms_mm} and {max_mm} mm, simulated {simulated:?}");
        let names: Vec<&str> = log.cycles.iter().map(|cycle| cycle.name.as_str()).collect();
        assert_eq!(names, ["capture", "estimation", "control", "recording", "vs-robot", "tc-robot"]);
        for cycle in &log.cycles {
            let cycles_min = if cycle.period_millis > 30.0 { 60 } else { 200 };
            assert!(cycle.cycles > cycles_min && cycle.late_p50_millis <= cycle.late_p99_millis, "{cycle:?}");
        }
    });
}

#[test]
fn an_alarm_of_one_arm_ends_the_run_with_both_at_rest() {
    let setup = hil_setup();
    programs_in_real_time_beside_others(|| {
        let parts = wire(&setup).unwrap();
        // Enabling both arms takes up to 3 s; then the target moves after a second.
        parts.emulated[1].command_line("in 5s alarm 4 0x0e").unwrap();
        let cell = parts.cell.clone();
        let clock = parts.clock.clone();
        let folder = tempfile::tempdir().unwrap();
        // A run that was killed has left this one.
        let older = folder.path().join("fault.mcap");
        std::fs::write(&older, "older").unwrap();
        let recent = Recent::start(RecentOptions::default()).unwrap();
        let to = RecordTo { sinks: Sinks::new(None, Some(recent), None), faults: folder.path().to_owned() };
        let parts = record_run(&About::default(), &setup, parts, to).unwrap();
        let Err(error) = experiment::run(&setup, parts, None, None) else { panic!("the run must fail") };
        assert_eq!(std::fs::read(older).unwrap(), b"older");
        tells_of_the_fault(&folder.path().join("fault-2.mcap"), &format!("{error:#}"));
        let message = format!("{error:#}");
        for (name, site) in [("vs-robot", &cell.vs), ("tc-robot", &cell.tc)] {
            let mut joints = site.joints.simulated().unwrap().lock().unwrap();
            joints.advance_to(clock.now());
            let speed = joints.state().velocity_rad_per_s.amax();
            assert!(speed < 1e-3, "{name} at {speed} rad/s after: {message}");
        }
        // On a machine that is late an arm may have stopped earlier because of that.
        assert!(message.contains("tc-robot") && message.contains("over-current"), "{message}");
    });
}

/// The file of a fault has the images, the control steps up to the failure, and its words.
fn tells_of_the_fault(file: &Path, message: &str) {
    let bag = Bag::open(file).unwrap();
    assert!(!bag.is_unfinished());
    let count = |name: &str| bag.topics().iter().find(|topic| topic.name == name).map_or(0, |topic| topic.messages);
    assert!(count(ours::STEPS) > 50 && count(ours::PAIRS) > 10, "{:?}", bag.topics());
    assert!(count(ours::LEFT_IMAGE) > 10 && count(ours::LEFT_IMAGE) == count(ours::RIGHT_IMAGE), "{:?}", bag.topics());
    assert_eq!([ours::SETUP, ours::BEGIN, ours::CALIBRATION, ours::END].map(count), [1; 4]);
    let ends = bag.messages_on(&[ours::END]).unwrap();
    let ends: Vec<RunEnd> = ends.map(|message| decoded(&message.unwrap()).unwrap()).collect();
    assert_eq!(ends[0].failure, message);
}

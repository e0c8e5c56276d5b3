//! A part fails in the middle of a run: the arms stop, and the recording up to then is complete.

use pb3dp_cell::experiment;
use pb3dp_estimation::estimator::Method;
use pb3dp_record::dataset::load_sequence;
use pb3dp_sim::trajectory::Channel;
use pb3dp_wiring::wire;

use crate::closed_loop::support::*;
use system_tests::watched::watched;

/// Runs until one arm fails in the middle of the target's first move.
fn check(which: &str) {
    let setup = quick_setup(Method::Direct, Pixels::Few, &[Channel::X]);
    let (parts, vs, tc) = watched(wire(&setup).unwrap());
    let (cell, clock) = (parts.cell.clone(), parts.clock.clone());
    let failing = if which == "vs-robot" { &vs } else { &tc };
    *failing.fail_after.lock().unwrap() = Some(151);
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("recording");
    let failure = experiment::run(&setup, parts, None, Some(&recording));
    let message = format!("{:#}", failure.err().expect("the run must fail"));
    assert!(message.contains(which) && message.contains("the link was cut by the test"), "{message}");

    let moved = vs
        .measured
        .lock()
        .unwrap()
        .iter()
        .chain(tc.measured.lock().unwrap().iter())
        .any(|joints| joints.velocity_rad_per_s.amax() > 0.01);
    assert!(moved, "the failure must occur during a motion");
    for (name, site) in [("vs-robot", &cell.vs), ("tc-robot", &cell.tc)] {
        let mut plant = site.joints.simulated().unwrap().lock().unwrap();
        plant.advance_to(clock.now());
        // The arm's own speed limit for closing the brakes; without the stop the speed is 0.35 rad/s here.
        let speed = plant.state().velocity_rad_per_s.amax();
        assert!(speed < 1e-3, "{name} must be stationary after the failure of {which}, moves at {speed} rad/s");
    }
    assert!(load_sequence(&recording).unwrap().frames() > 40, "the recording before the failure is complete");
}

#[test]
fn the_failure_of_the_following_arm_stops_both() {
    check("vs-robot");
}

#[test]
fn the_failure_of_the_carrying_arm_stops_both() {
    check("tc-robot");
}

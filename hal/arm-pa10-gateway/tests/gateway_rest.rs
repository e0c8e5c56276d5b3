//! The interpolation of speeds ends at the commanded speed, however often the host repeats its command.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10_protocol::codec::{ArmCommand, ControlMessage, ServoWord};
use pb3dp_arm_pa10_protocol::gateway_protocol::{DriveMode, GatewayMessage, GatewayState};
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, HOST_CYCLE, TICK, ms};
use pb3dp_kinematics::JointVector;

/// The last message on the bus.
fn sent(bench: &Bench) -> ArmCommand {
    match bench.sent.last().unwrap().message {
        ControlMessage::Cyclic(command) => command,
        other => panic!("{other:?}"),
    }
}

/// Each command arrived a little before the last cycle of the interpolation, so a small speed remained each time, and closing the
/// brakes was refused although the host had commanded speed 0 five times.
#[test]
fn brakes_may_close_after_the_host_has_asked_for_rest_for_five_cycles() {
    for phase in 0..4 {
        let mut bench = Bench::new();
        bench.lead_to(GatewayState::Moving);
        (0..phase).for_each(|_| bench.tick());
        let fast = JointVector::from([1.0, -1.0, 2.0, -2.0, 6.0, -6.2, 6.2]);
        bench.command_for(DriveMode::Follow, fast, ms(50));
        bench.command_for(DriveMode::Follow, JointVector::zeros(), HOST_CYCLE * 5);
        let answer = bench.ask(bench.command(DriveMode::Braked, JointVector::zeros()));
        assert!(matches!(answer, GatewayMessage::State(_)), "phase {phase}: {answer:?}");
    }
}

/// The servo need not hold an axis that its brake holds.
#[test]
fn brakes_may_stay_closed_on_an_arm_that_is_uncontrollable() {
    let mut bench = Bench::new();
    bench.start();
    bench.controller.servo[1] = ServoWord(0x8000);
    bench.run(ms(4));
    let answer = bench.ask(bench.command(DriveMode::Braked, JointVector::zeros()));
    assert!(matches!(answer, GatewayMessage::State(_)), "{answer:?}");
    assert_eq!(bench.state(), GatewayState::Started);
}

/// One host cycle after a command, exactly its speeds are sent.
#[test]
fn a_speed_that_is_repeated_is_reached_within_one_cycle_of_the_host() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    let fast = JointVector::from([1.0, -1.0, 2.0, -2.0, 6.0, -6.2, 6.2]);
    bench.command_for(DriveMode::Follow, fast, ms(20));
    bench.run(TICK * 4);
    assert_eq!(sent(&bench).velocity_rad_per_s(), fast);
}

/// After a gap in which the watchdog has reduced the speed, the speed is interpolated and does not jump.
#[test]
fn a_speed_that_has_faded_comes_back_on_a_line() {
    let mut bench = Bench::new();
    bench.lead_to(GatewayState::Moving);
    let speed = JointVector::repeat(1.0);
    bench.command_for(DriveMode::Follow, speed, ms(50));
    bench.run(ms(30));
    let faded = sent(&bench).velocity_rad_per_s()[0];
    assert!((0.1..0.6).contains(&faded), "{faded}");
    bench.tell(bench.command(DriveMode::Follow, speed));
    bench.run(ms(2));
    let first = sent(&bench).velocity_rad_per_s()[0];
    assert!(first < faded + 0.35, "{faded} to {first} in a cycle");
    bench.run(HOST_CYCLE);
    assert!((sent(&bench).velocity_rad_per_s()[0] - 1.0).abs() < 1e-9);
}

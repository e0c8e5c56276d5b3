//! Neither the exchange of a moving arm nor its thread allocates on the heap.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use pb3dp_allocation_count::{leave_this_thread_out, requests_of_all_threads};
use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, trip_line};
use pb3dp_arm_pa10::driver::DriverConfig;
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Geometry, HostLimits};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_test_support::far_end::FarEnd;
use pb3dp_arm_pa10_test_support::gateway::FakeGateway;
use pb3dp_hal_api::{Arm, ArmErrorKind, ArmPower, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink;
use pb3dp_kinematics::JointVector;

pub fn exchanges() {
    const CYCLE: Duration = Duration::from_millis(10);
    const ASIDE: [f64; 6] = [0.55, 0.2, 0.4, 0.7, 0.85, 0.3];
    let format = WireFormat::BigEndian6x10;
    let pty = Pty::open().unwrap();
    let serial = SerialConfig { path: pty.name().to_owned(), baud: 460_800, cycle: CYCLE };
    let far = FarEnd::serve_after(Box::new(pty), FakeGateway::new(ArmId(2), format), leave_this_thread_out);
    let link = GatewayLinkConfig {
        arm: ArmId(2),
        format,
        geometry: Geometry::Unknown,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    };
    let config = Pa10ArmConfig::new("arm", DriverConfig::with_cycle(CYCLE), link);
    let seat = trip_line(1).unwrap().remove(0);
    let mut arm = Pa10Arm::open(config, Box::new(serial), Arc::new(SystemClock::new()), seat).unwrap_or_else(|error| {
        panic!("{error}: {:?}", std::error::Error::source(&error));
    });
    let monitor = arm.monitor();
    // On a loaded machine the link may pass the warm-up only after several tries.
    assert!((0..20).any(|_| arm.enable().is_ok()));
    let velocity = JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]));
    let exchange = |arm: &mut Pa10Arm, cycle: i32| {
        let command = if cycle % 50 == 20 { JointCommand::Hold } else { velocity };
        std::thread::sleep(CYCLE);
        // A loaded machine may be late.
        arm.exchange(command).map(|_| ()).map_err(|error| match error.kind() {
            ArmErrorKind::Timeout => (),
            _ => panic!("{error}"),
        })
    };
    for cycle in 0..20 {
        let _ = exchange(&mut arm, cycle);
    }
    let (mut quiet, mut late) = (0, 0);
    for cycle in 0..300 {
        if cycle % 50 == 30 {
            // An exchange that waits for its measurement stays in step with the arm afterwards, and two lost answers do not make
            // it late. Out of step it is late. The necessary offset depends on the machine.
            std::thread::sleep(CYCLE.mul_f64(ASIDE[cycle as usize / 50]));
            far.line.drop_answers.store(2, Ordering::SeqCst);
        }
        let before = requests_of_all_threads();
        let answer = exchange(&mut arm, cycle);
        assert_eq!(requests_of_all_threads(), before, "exchange {cycle}: {answer:?}");
        *(if answer.is_ok() { &mut quiet } else { &mut late }) += 1;
        let _ = std::hint::black_box((monitor.snapshot(), monitor.jitter()));
    }
    assert!(quiet > 200 && late > 0, "{quiet} exchanges, {late} late");
    let probe = requests_of_all_threads();
    drop(std::hint::black_box(Box::new([0u8; 64])));
    assert!(requests_of_all_threads() > probe, "the counter counts");
}

//! Two real arms over pseudo-terminals, which stop each other by themselves, with their coupling.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, TripSeat, trip_line};
use pb3dp_arm_pa10::driver::DriverConfig;
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, MockServerConfig};
use pb3dp_arm_pa10_emulation::mock_controller::{MockControllerConfig, Script, pa10_joints};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Firmware, Geometry, HostLimits, MotionLimits};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::Pose;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_middleware::{Coupled, CoupledArmConfig, Guard, couple};
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_kinematics::{ArmPart, ArmShape, Capsule, Carrier, Chain, JointVector};
use pb3dp_sim::joint_dynamics::JointPlant;
use pb3dp_test_support::in_real_time_beside_others;

use crate::common::{CYCLE, guard_config, limits, velocity};

const FORMAT: WireFormat = WireFormat::BigEndian6x10;
const LONG: Duration = Duration::from_secs(20);

type CellArm = Coupled<Guard<Box<Pa10Arm>>>;

fn start_rad() -> JointVector {
    JointVector::from([0.1, 0.5, 0.0, 1.0, 0.0, 0.6, 0.0])
}

fn server(arm: ArmId, clock: &Arc<dyn Clock>) -> MockServer {
    let plant = JointPlant::new(pa10_joints().unwrap(), start_rad(), clock.now()).unwrap();
    let gateway = GatewayConfig::new(arm, FORMAT, Firmware::new("test").unwrap(), MotionLimits::WIDEST);
    let realtime = Realtime { priority: Some(45), locks_memory: false, cpu: None };
    let config = MockServerConfig {
        controller: MockControllerConfig::new(FORMAT),
        seed: 0,
        script: Script::default(),
        realtime,
    };
    MockServer::start(config, MockFace::Pty(gateway), Arc::new(Mutex::new(plant)), Arc::clone(clock)).unwrap()
}

fn arm(arm: ArmId, server: &MockServer, seat: TripSeat, clock: &Arc<dyn Clock>) -> Pa10Arm {
    let link = GatewayLinkConfig {
        arm,
        format: FORMAT,
        geometry: Geometry::Unknown,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    };
    let port = server.port(SerialConfig { path: server.address(), baud: 921_600, cycle: CYCLE });
    let config = Pa10ArmConfig::new(&format!("arm-{}", arm.0), DriverConfig::with_cycle(CYCLE), link);
    Pa10Arm::open(config, Box::new(port), Arc::clone(clock), seat).unwrap()
}

fn coupled_config(y_m: f64) -> CoupledArmConfig {
    let urdf = include_str!("../../../../configs/robots/pa10_gen2.urdf");
    let capsule = Capsule { ends_m: [[0.0, 0.0, 0.0].into(), [0.0, 0.0, 0.1].into()], radius_m: 0.07 };
    let tool = ArmPart { name: "tool".to_owned(), carrier: Carrier::Flange, capsule };
    CoupledArmConfig {
        chain: Chain::from_urdf_str(urdf, "base_link", "flange").unwrap(),
        shape: ArmShape::new(vec![tool]).unwrap(),
        world_from_base: Pose::from_parts(Vector3::new(0.0, y_m, 0.7), nalgebra::UnitQuaternion::identity()),
        limits: limits(0.6),
        reaction_time: Duration::from_millis(65),
        command_timeout: Duration::from_millis(60),
        fade: None,
    }
}

/// On a loaded machine the link may pass the warm-up only after several tries.
fn enable(arms: &mut [CellArm; 2]) {
    let begin = Instant::now();
    loop {
        let enabled: Result<(), ArmError> = arms.iter_mut().try_for_each(|arm| match arm.state() {
            ArmState::Enabled => Ok(()),
            _ => arm.enable(),
        });
        let Err(error) = enabled else { return };
        assert!(begin.elapsed() < LONG, "{error}");
        for _ in 0..2 {
            arms.iter_mut().for_each(|arm| drop(arm.reset()));
        }
    }
}

fn both_are(arms: &mut [CellArm; 2], state: ArmState) {
    let begin = Instant::now();
    while arms.iter().any(|arm| arm.arm().state() != state) {
        assert!(begin.elapsed() < LONG, "{:?}", arms.each_ref().map(|arm| arm.state()));
        for arm in arms.iter_mut() {
            let _ = arm.exchange(JointCommand::Hold);
        }
        std::thread::sleep(CYCLE);
    }
}

/// The trip line stops the other arm before the coupling detects the fault; the coupling must not treat this as a second failure.
#[test]
fn the_arm_that_failed_is_reset_first_and_at_the_first_try() {
    in_real_time_beside_others(|| {
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let servers = [server(ArmId(1), &clock), server(ArmId(2), &clock)];
        let mut seats = trip_line(2).unwrap().into_iter();
        let mut guarded = |i: usize| {
            let arm = arm(ArmId(i as u8 + 1), &servers[i], seats.next().unwrap(), &clock);
            Guard::new(Box::new(arm), limits(0.1), guard_config()).unwrap()
        };
        let pair = ((guarded(0), coupled_config(0.0)), (guarded(1), coupled_config(1.6)));
        let (one, two) = couple(pair.0, pair.1, 0.05, &clock).unwrap();
        let mut arms = [one, two];
        for failed in [0, 1] {
            let other = 1 - failed;
            enable(&mut arms);
            servers[failed].command_line("alarm 4 0x0e").unwrap();
            both_are(&mut arms, ArmState::Fault);
            // Both arms have detected the stop, the waiting one first.
            for which in [other, failed, other] {
                assert_eq!(arms[which].exchange(velocity(0, 0.01)).unwrap_err().kind(), ArmErrorKind::Fault);
            }
            assert!(arms[other].is_stopped_by_other() && !arms[failed].is_stopped_by_other());
            servers[failed].command_line("alarm 4 off").unwrap();
            let error = arms[other].reset().unwrap_err();
            assert!(error.to_string().contains("still stopped"), "{error}");
            arms[failed].reset().unwrap_or_else(|error| panic!("the one that failed, first: {error}"));
            arms[other].reset().unwrap_or_else(|error| panic!("then the other one: {error}"));
            assert_eq!(arms.each_ref().map(|arm| arm.state()), [ArmState::Disabled; 2]);
        }
    });
}

//! A gateway that starts has no information about its arm: the previous gateway may have died during motion.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests")]

use pb3dp_arm_pa10::driver::DriverState;
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, pa10_joints};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::codec::{
    ArmCommand, AxisCommand, ControlMessage, ServoWord, SpeedCounts, Supervision, WireFormat,
};
use pb3dp_arm_pa10_protocol::gateway_protocol::{Firmware, GatewayState, MotionLimits, StopCause};
use pb3dp_arm_pa10_test_support::chain::{ARM, Chain};
use pb3dp_arm_pa10_test_support::gateway_bench::{Bench, config, ms};
use pb3dp_arm_pa10_test_support::{bus_bench, gateway_bench as bench};
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{JointMechanics, JointPlant};

fn uniform(command: AxisCommand) -> ControlMessage {
    ControlMessage::Cyclic(ArmCommand::uniform(command, Supervision::default()))
}

/// Speed 0 with closed brakes and servos on for the brake time, then servos off if there were answers, then E; then C again: once
/// to see whether the controller answers, or with closed brakes while there is no answer.
#[test]
fn brakes_have_their_time_to_close_before_e() {
    for (answers, alarm) in [(true, 0), (false, 0), (true, 0x00E0), (true, 0x0110)] {
        for format in WireFormat::ALL {
            let mut bench = Bench::silent(config(format));
            bench.gateway = Gateway::new(config(format), bench.now).unwrap();
            bench.controller.answers = answers;
            bench.controller.servo[3] = ServoWord(alarm);
            bench.run(ms(300));
            let begin = bench.sent[0].at;
            let is_braked = |sent: &&bench::Sent| sent.message == uniform(AxisCommand::Braked);
            let braked = bench.sent.iter().take_while(is_braked).count();
            let lasted = bench.sent[braked].at.saturating_since(begin);
            assert!(lasted >= ms(200) && lasted <= ms(203), "{lasted:?}");
            assert!(bench.sent[..braked].windows(2).all(|two| two[1].at.saturating_since(two[0].at) == bench::CYCLE));
            let rest: Vec<_> = bench.sent[braked..].iter().map(|sent| sent.message).collect();
            if answers {
                assert_eq!(rest, [uniform(AxisCommand::Off), ControlMessage::End, uniform(AxisCommand::Off)]);
            } else {
                assert_eq!(rest[..3], [ControlMessage::End; 3]);
                assert!(rest.len() > 30 && rest[3..].iter().all(|message| *message == uniform(AxisCommand::Braked)));
            }
            assert_eq!(bench.gateway.status().stop_unacknowledged, !answers);
            assert_eq!((bench.state(), bench.cause()), (GatewayState::Idle, StopCause::None));
        }
    }
}

/// An axis counts as driven from more than half of the slowest motion that an operator requests, 0.01 rad/s.
#[test]
fn an_arm_counts_as_found_in_motion_above_50_counts() {
    for (counts, cause) in
        [(50, StopCause::None), (-50, StopCause::None), (51, StopCause::HostSilent), (-51, StopCause::HostSilent)]
    {
        let mut bench = Bench::silent(config(WireFormat::BigEndian6x10));
        bench.controller.speed = SpeedCounts(counts);
        bench.gateway = Gateway::new(config(WireFormat::BigEndian6x10), bench.now).unwrap();
        bench.run(ms(400));
        assert_eq!(bench.cause(), cause, "{counts}");
    }
}

/// A controller without a time-out continues with the last speeds until it receives another message.
#[test]
fn an_arm_that_goes_on_moving_is_stopped_by_the_next_gateway() {
    for format in WireFormat::ALL {
        let start_rad = JointVector::from([0.1, 0.7, 0.2, 0.9, 0.1, 0.5, 0.1]);
        let plant = JointPlant::new(pa10_joints().unwrap(), start_rad, bus_bench::START).unwrap();
        let joints = plant.with_mechanics(JointMechanics::default()).unwrap();
        let mut chain = Chain::new(format, None, joints);
        chain.prepare();
        chain.wanted = Some(JointVector::from([0.1, -0.2, 0.1, 0.2, 0.3, 0.2, 0.3]));
        chain.run(ms(600));
        assert_eq!(chain.driver.state(), DriverState::Moving);
        let (_, speed) = chain.controller.true_joints();
        assert!(speed.amax() > 0.25, "{speed}");
        // Gateway and host are killed, and the gateway is started again.
        chain.frozen = true;
        let config = GatewayConfig::new(ARM, format, Firmware::new("test gateway 2").unwrap(), MotionLimits::WIDEST);
        chain.gateway = Gateway::new(config, chain.now).unwrap();
        let (before, _) = chain.controller.true_joints();
        let (mut released, mut ended) = (false, None);
        for _ in 0..600 {
            chain.run(ms(1));
            let (_, speed) = chain.controller.true_joints();
            let is_control = chain.controller.mode() == ControlMode::Control;
            released |= !is_control && !chain.controller.is_braked();
            ended = ended.or((!is_control).then(|| speed.amax()));
        }
        assert!(!released && chain.controller.is_braked());
        assert_eq!(ended, Some(0.0), "{format}: at rest before the control mode ends");
        let (after, speed) = chain.controller.true_joints();
        let way_deg = (after - before).amax().to_degrees();
        assert!(speed.amax() == 0.0 && way_deg < 3.0, "{format}: {way_deg} degrees");
        // The next user of the gateway must see this.
        let status = chain.gateway.status();
        assert_eq!((status.state, status.cause), (GatewayState::Fault, StopCause::HostSilent));
    }
}

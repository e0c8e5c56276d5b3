//! A real arm over a pseudo-terminal, with a gateway that answers and does not move.

use std::sync::Arc;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::{ArmMonitor, ArmOpenError, Pa10Arm, Pa10ArmConfig, TripSeat, trip_line};
use pb3dp_arm_pa10::driver::{DriverConfig, DriverState, LimitsCheck, Trip};
use pb3dp_arm_pa10::serial::SerialConfig;
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Geometry, HostLimits, HostMessage};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, JointCommand};
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::pty::Pty;
use pb3dp_hal_platform::transport::ByteLink;
use pb3dp_kinematics::JointVector;

use crate::far_end::FarEnd;
use crate::gateway::FakeGateway;

pub const CYCLE: Duration = Duration::from_millis(10);
pub const FORMAT: WireFormat = WireFormat::BigEndian6x10;

pub fn config(arm: u8) -> Pa10ArmConfig {
    let limit = JointVector::repeat(3.0);
    let limits = LimitsCheck::Compare { lower_rad: -limit, upper_rad: limit, tolerance_rad: 1e-4 };
    let driver = DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) };
    let link = GatewayLinkConfig {
        arm: ArmId(arm),
        format: FORMAT,
        geometry: Geometry::SecondGeneration,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    };
    Pa10ArmConfig::new(&format!("arm-{arm}"), driver, link)
}

pub fn serial(pty: &Pty) -> SerialConfig {
    let path = pty.name().to_owned();
    SerialConfig { path, baud: 460_800, cycle: CYCLE }
}

pub fn seat() -> TripSeat {
    trip_line(1).unwrap().remove(0)
}

/// An arm over a pseudo-terminal with its gateway.
pub struct Rig {
    pub arm: Pa10Arm,
    pub far: FarEnd,
}

pub fn open_at(pty: &Pty, arm: u8, seat: TripSeat) -> Result<Pa10Arm, ArmOpenError> {
    Pa10Arm::open(config(arm), Box::new(serial(pty)), Arc::new(SystemClock::new()), seat)
}

pub fn rig_with(arm: u8, seat: TripSeat, clock: Arc<SystemClock>) -> Rig {
    let pty = Pty::open().unwrap();
    let connector = serial(&pty);
    let far = FarEnd::serve(Box::new(pty), FakeGateway::new(ArmId(arm), FORMAT));
    let arm = Pa10Arm::open(config(arm), Box::new(connector), clock, seat);
    Rig { arm: arm.map_err(|error| error.to_string()).unwrap(), far }
}

pub fn rig() -> Rig {
    rig_with(2, seat(), Arc::new(SystemClock::new()))
}

pub fn velocity() -> JointCommand {
    JointCommand::Velocity(JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7]))
}

impl Rig {
    /// Repeats a command for some cycles. On a loaded machine answers may be late.
    pub fn exchange(&mut self, command: JointCommand, cycles: u32) {
        for _ in 0..cycles {
            std::thread::sleep(CYCLE);
            match self.arm.exchange(command) {
                Err(error) if error.kind() != ArmErrorKind::Timeout => panic!("{error}"),
                _ => {}
            }
        }
    }

    /// On a loaded machine the link may pass the warm-up only after several tries.
    pub fn enable(&mut self) {
        for _ in 0..20 {
            match self.arm.enable() {
                Ok(()) => return,
                Err(error) if error.to_string().contains("the brakes stay closed") => {}
                Err(error) => panic!("{error}"),
            }
        }
        panic!("the machine is too loaded to enable an arm");
    }

    pub fn enable_and_move(&mut self) {
        self.enable();
        self.exchange(velocity(), 10);
        assert_eq!(self.monitor().snapshot().state, DriverState::Moving);
    }

    pub fn monitor(&self) -> ArmMonitor {
        self.arm.monitor()
    }

    /// Waits until the arm is stopped; returns how long it took.
    pub fn wait_until_stopped(&mut self) -> Duration {
        let begin = Instant::now();
        while !self.monitor().snapshot().state.is_latched() {
            assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", self.monitor().snapshot());
            std::thread::sleep(Duration::from_micros(200));
        }
        begin.elapsed()
    }

    /// Commands motion until the arm is stopped.
    pub fn exchange_until_stopped(&mut self) -> ArmError {
        let begin = Instant::now();
        loop {
            std::thread::sleep(CYCLE);
            match self.arm.exchange(velocity()) {
                Err(error) if error.kind() == ArmErrorKind::Fault => return error,
                _ => assert!(begin.elapsed() < Duration::from_secs(5)),
            }
        }
    }

    pub fn trip(&self) -> Trip {
        self.monitor().snapshot().latched.unwrap().trip
    }

    pub fn messages(&self) -> Vec<HostMessage> {
        self.far.gateway.lock().unwrap().messages.clone()
    }
}

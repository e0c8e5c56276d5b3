//! Driver, link and gateway in virtual time, with injectable faults of the line between them.

use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, Driver, DriverConfig, DriverState, LimitsCheck, Request, Trip};
use pb3dp_arm_pa10::link::{GatewayLink, LinkError};
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Geometry, HostLimits};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

pub use crate::gateway::FakeGateway;

pub const CYCLE: Duration = Duration::from_millis(10);
/// Step of the virtual time.
pub const TICK: Duration = Duration::from_micros(500);

pub const ARM: ArmId = ArmId(2);

pub const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

pub fn velocity() -> JointVector {
    JointVector::from([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7])
}

pub fn link_config(format: WireFormat) -> GatewayLinkConfig {
    GatewayLinkConfig {
        arm: ARM,
        format,
        geometry: Geometry::SecondGeneration,
        cycle: CYCLE,
        limits: HostLimits::WIDEST,
        signals: StatusSignals::ORCA,
    }
}

/// The arms here have limits of 3 rad on all axes.
pub fn driver_config() -> DriverConfig {
    let limit = JointVector::repeat(3.0);
    let limits = LimitsCheck::Compare { lower_rad: -limit, upper_rad: limit, tolerance_rad: 1e-4 };
    DriverConfig { limits, ..DriverConfig::with_cycle(CYCLE) }
}

/// Turns the bytes of one direction into the delivered bytes, each with its delay. Both directions of a good line take 2 ms
/// together.
pub type Line = Box<dyn FnMut(Way, Vec<u8>) -> Vec<(Duration, Vec<u8>)>>;

/// Direction of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    ToGateway,
    ToHost,
}

/// A line without faults.
pub fn good_line() -> Line {
    Box::new(|way, bytes| vec![(if way == Way::ToHost { ms(2) } else { Duration::ZERO }, bytes)])
}

/// Driver, link and gateway in virtual time.
pub struct Rig {
    pub driver: Driver,
    pub link: GatewayLink,
    pub gateway: FakeGateway,
    pub now: MonotonicTime,
    /// Inserted before the next bytes from the gateway.
    pub noise: Vec<u8>,
    pub line: Line,
    /// Lag of the gateway's clock.
    pub gateway_behind: Duration,
    under_way: Vec<(MonotonicTime, Vec<u8>)>,
}

impl Rig {
    pub fn new(format: WireFormat) -> Self {
        let config = link_config(format);
        let mut rig = Self {
            driver: Driver::new(driver_config()).unwrap(),
            link: GatewayLink::new(config),
            gateway: FakeGateway::new(ARM, format),
            now: MonotonicTime::from_nanos(5_000_000_000),
            noise: Vec::new(),
            line: good_line(),
            gateway_behind: Duration::from_secs(4),
            under_way: Vec::new(),
        };
        rig.open();
        rig
    }

    pub fn open(&mut self) {
        self.link.open(self.now);
        self.run(ms(10));
        assert!(self.link.hello().is_some());
    }

    pub fn run(&mut self, time: Duration) {
        let end = self.now + time;
        while self.now < end {
            self.tick();
        }
    }

    fn tick(&mut self) {
        let now = self.now;
        let arrived = self.under_way.extract_if(.., |(at, _)| *at <= now).collect::<Vec<_>>();
        for (_, bytes) in arrived {
            self.link.handle_bytes(now, &bytes, &mut self.driver);
        }
        self.link.handle_timeout(now, &mut self.driver);
        if let Some(transmit) = self.driver.poll_transmit(now) {
            match self.link.send(now, &transmit, self.driver.activity()) {
                Ok(()) | Err(LinkError::NotOpen) => {}
                Err(error) => panic!("{error}"),
            }
        }
        self.gateway.clock_us = (now - self.gateway_behind).as_nanos() / 1000;
        while let Some(bytes) = self.link.poll_output(now) {
            // A delayed request delays its answer as well.
            for (delay, bytes) in (self.line)(Way::ToGateway, bytes.as_slice().to_vec()) {
                let mut answer = std::mem::take(&mut self.noise);
                answer.extend(self.gateway.answer(&bytes));
                for (back, answer) in (self.line)(Way::ToHost, answer) {
                    self.under_way.push((now + delay + back, answer));
                }
            }
        }
        self.now = now + TICK;
    }

    pub fn request(&mut self, request: Request) {
        self.driver.handle_request(self.now, request).unwrap();
    }

    pub fn settle(&mut self) {
        for _ in 0..40_000 {
            if self.driver.activity() == Activity::None {
                return;
            }
            self.tick();
        }
        panic!("{:?}", self.driver);
    }

    pub fn lead_to_moving(&mut self) {
        self.request(Request::Connect);
        self.settle();
        self.lead_on_to_moving();
    }

    /// From the state connected on.
    pub fn lead_on_to_moving(&mut self) {
        for request in [Request::Enable, Request::ReleaseBrakes] {
            self.request(request);
            self.settle();
        }
        for _ in 0..10 {
            self.request(Request::Move(velocity()));
            self.run(CYCLE);
        }
        assert_eq!(self.driver.state(), DriverState::Moving);
    }

    pub fn trip(&self) -> Trip {
        self.driver.latched().unwrap().trip
    }
}

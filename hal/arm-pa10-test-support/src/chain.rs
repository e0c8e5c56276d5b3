//! The whole chain in virtual time: driver, link, a line of bytes, the gateway, the bus, the emulated controller and its joints.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, Driver, DriverConfig, DriverState, Request};
use pb3dp_arm_pa10::link::{GatewayLink, LinkError};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockController, MockControllerConfig};
use pb3dp_arm_pa10_gateway::gateway::{Gateway, GatewayConfig};
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{ArmId, Firmware, Geometry, HostLimits, MotionLimits};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

use crate::bus_bench::{AT_REST_RAD_PER_S, HOST_CYCLE, START, letter};

pub const ARM: ArmId = ArmId(2);

/// Delay of the line in one direction: frames of 100 bytes at 921600 baud.
const LINE_DELAY: Duration = Duration::from_micros(1200);

/// Direction of bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    ToGateway,
    ToHost,
}

/// Turns the bytes of one frame into the delivered bytes, each with its delay.
pub type Spoil = Box<dyn FnMut(Way, Vec<u8>) -> Vec<(Duration, Vec<u8>)>>;

pub struct Chain {
    pub driver: Driver,
    pub link: GatewayLink,
    pub gateway: Gateway,
    pub controller: MockController,
    pub plant: Arc<Mutex<JointPlant>>,
    pub now: MonotonicTime,
    pub wanted: Option<JointVector>,
    pub next_host_cycle: MonotonicTime,
    /// The host process is frozen.
    pub frozen: bool,
    pub spoil: Option<Spoil>,
    /// The controller answers C only in its control mode.
    pub only_in_control: bool,
    /// Letters of the messages that the gateway sent.
    pub letters: String,
    line: Vec<(MonotonicTime, Way, Vec<u8>)>,
    /// Bytes of the host that the gateway has not read yet.
    pub unread: VecDeque<u8>,
}

impl Chain {
    pub fn new(format: WireFormat, watchdog: Option<Duration>, joints: JointPlant) -> Self {
        let plant = Arc::new(Mutex::new(joints));
        let controller = MockControllerConfig { watchdog, ..MockControllerConfig::new(format) };
        let firmware = Firmware::new("test gateway 1").unwrap();
        let link = GatewayLinkConfig {
            arm: ARM,
            format,
            geometry: Geometry::Unknown,
            cycle: HOST_CYCLE,
            limits: HostLimits::WIDEST,
            signals: StatusSignals::ORCA,
        };
        let mut chain = Self {
            driver: Driver::new(DriverConfig::with_cycle(HOST_CYCLE)).unwrap(),
            link: GatewayLink::new(link),
            gateway: Gateway::new(GatewayConfig::new(ARM, format, firmware, MotionLimits::WIDEST), START).unwrap(),
            controller: MockController::new(controller, Arc::clone(&plant), 1, START).unwrap(),
            plant,
            now: START,
            wanted: None,
            next_host_cycle: START,
            frozen: false,
            spoil: None,
            only_in_control: false,
            letters: String::new(),
            line: Vec::new(),
            unread: VecDeque::new(),
        };
        // The stop order at the start of a gateway.
        chain.run(Duration::from_millis(250));
        chain.open();
        chain.request(Request::Connect);
        chain.settle();
        chain
    }

    pub fn open(&mut self) {
        self.link.open(self.now);
        self.run(Duration::from_millis(20));
        assert!(self.link.hello().is_some(), "{:?}", self.link.hello_error());
    }

    pub fn request(&mut self, request: Request) {
        self.driver.handle_request(self.now, request).unwrap();
    }

    pub fn settle(&mut self) {
        let end = self.now + Duration::from_secs(30);
        while self.driver.activity() != Activity::None {
            assert!(self.now < end, "{:?}", self.driver);
            self.run(Duration::from_millis(2));
        }
    }

    pub fn prepare(&mut self) {
        for request in [Request::Enable, Request::ReleaseBrakes] {
            self.request(request);
            self.settle();
        }
        assert_eq!(self.driver.state(), DriverState::Holding, "{:?}", self.driver.latched());
    }

    pub fn run(&mut self, time: Duration) {
        let end = self.now + time;
        loop {
            self.work();
            let host = (self.wanted.is_some() && !self.frozen).then_some(self.next_host_cycle);
            let driver = self.driver.next_deadline().filter(|_| !self.frozen);
            let line = self.line.iter().map(|(at, ..)| *at).min();
            let reads = self.controller.reads_line_again().filter(|_| !self.unread.is_empty());
            let line = [line, reads, self.controller.next_on_line()].into_iter().flatten().min();
            let times = [driver, host, line, self.controller.next_deadline(), Some(self.gateway.next_deadline())];
            let Some(next) = times.into_iter().flatten().min().filter(|next| *next <= end) else { break };
            self.now = next.max(self.now + Duration::from_nanos(1));
        }
        self.now = end;
        self.controller.advance(end);
    }

    /// Processes everything that is due now.
    fn work(&mut self) {
        let now = self.now;
        for (_, way, bytes) in self.line.extract_if(.., |(at, ..)| *at <= now).collect::<Vec<_>>() {
            match way {
                Way::ToGateway => self.unread.extend(bytes),
                Way::ToHost if self.frozen => {}
                Way::ToHost => self.link.handle_bytes(now, &bytes, &mut self.driver),
            }
        }
        self.read_as_gateway();
        if !self.frozen {
            self.work_host();
        }
        while let Some(frame) = self.controller.poll_frame(now) {
            self.gateway.handle_bus_frame(now, &frame);
        }
        if let Some(frame) = self.gateway.poll_bus_frame(now) {
            self.letters.push(letter(&frame));
            let is_deaf = self.only_in_control && self.controller.mode() != ControlMode::Control;
            if !is_deaf || letter(&frame) != 'C' {
                self.controller.handle_frame(now, &frame);
            }
        }
        while let Some(bytes) = self.gateway.poll_host_output(now) {
            self.controller.send_on_line(now, &bytes);
        }
        while let Some(bytes) = self.controller.poll_line(now) {
            self.carry(Way::ToHost, bytes.as_slice());
        }
    }

    fn read_as_gateway(&mut self) {
        let count = self.controller.readable_on_line(self.now).min(self.unread.len());
        let bytes: Vec<u8> = self.unread.drain(..count).collect();
        if !bytes.is_empty() {
            let (now, gateway) = (self.now, &mut self.gateway);
            self.controller.hear_on_line(now, &bytes, |bytes| gateway.handle_host_bytes(now, bytes));
        }
    }

    fn work_host(&mut self) {
        let now = self.now;
        self.link.handle_timeout(now, &mut self.driver);
        if self.wanted.is_some() && now >= self.next_host_cycle {
            self.next_host_cycle = self.next_host_cycle.max(now - HOST_CYCLE) + HOST_CYCLE;
            if let Some(velocity) = self.wanted
                && self.driver.handle_request(now, Request::Move(velocity)).is_err()
            {
                self.wanted = None;
            }
        }
        if let Some(transmit) = self.driver.poll_transmit(now) {
            match self.link.send(now, &transmit, self.driver.activity()) {
                Ok(()) | Err(LinkError::NotOpen) => {}
                Err(error) => panic!("{error}"),
            }
        }
        while let Some(bytes) = self.link.poll_output(now) {
            self.carry(Way::ToGateway, bytes.as_slice());
        }
    }

    fn carry(&mut self, way: Way, bytes: &[u8]) {
        let pieces = match &mut self.spoil {
            Some(spoil) => spoil(way, bytes.to_vec()),
            None => vec![(Duration::ZERO, bytes.to_vec())],
        };
        let due = |late| self.now + LINE_DELAY + late;
        self.line.extend(pieces.into_iter().map(|(late, bytes)| (due(late), way, bytes)));
    }

    pub fn inject(&mut self, line: &str) {
        self.controller.command_line(self.now, line).unwrap();
    }

    pub fn is_at_rest(&self) -> bool {
        let plant = self.plant.lock().unwrap();
        plant.velocity_at(plant.now()).unwrap().amax() < AT_REST_RAD_PER_S
    }
}

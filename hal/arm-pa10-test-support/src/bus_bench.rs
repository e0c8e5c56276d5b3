//! A driver on the bus of an emulated controller, in event-driven virtual time.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10::driver::{Activity, Driver, DriverConfig, DriverState, Request};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockController, MockControllerConfig};
use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{SequenceModulus, WireFormat};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{AxisMode, JointPlant};

use crate::bus_link::BusLink;
pub use crate::plant_config::plant_config;

/// Cycle of the bus.
pub const BUS_CYCLE: Duration = Duration::from_millis(2);

/// Period of the host's velocity commands.
pub const HOST_CYCLE: Duration = Duration::from_millis(10);

/// Below this speed a joint is stationary, rad/s.
pub const AT_REST_RAD_PER_S: f64 = 1e-3;

pub const START: MonotonicTime = MonotonicTime::from_nanos(3_000_000_000);

pub fn home() -> JointVector {
    JointVector::from([0.3, 0.4, -0.2, 1.1, 0.5, 0.7, -0.6])
}

pub fn plant() -> JointPlant {
    JointPlant::new(plant_config(), home(), START).unwrap()
}

pub struct BusBench {
    pub driver: Driver,
    pub link: BusLink,
    pub controller: MockController,
    pub plant: Arc<Mutex<JointPlant>>,
    pub now: MonotonicTime,
    /// Velocity that the host commands in each of its cycles.
    pub wanted: Option<JointVector>,
    pub next_host_cycle: MonotonicTime,
    /// The controller answers C only in its control mode.
    pub only_in_control: bool,
    /// Letters of the sent messages.
    pub letters: String,
}

/// The letter of a message to the controller.
pub fn letter(frame: &[u8]) -> char {
    char::from(arcnet::decode(Route::TO_CONTROLLER, frame).unwrap()[1])
}

/// Every joint is held by its servo, or by a closed brake.
pub fn assert_held(controller: &MockController, place: &str) {
    let modes = controller.axis_modes();
    assert!(!modes.contains(&AxisMode::Free), "{place}: nobody holds {modes:?}");
}

impl BusBench {
    pub fn new(format: WireFormat) -> Self {
        Self::with(DriverConfig::with_cycle(BUS_CYCLE), MockControllerConfig::new(format), 1)
    }

    pub fn with(driver: DriverConfig, controller: MockControllerConfig, seed: u64) -> Self {
        let plant = Arc::new(Mutex::new(plant()));
        let link = BusLink::new(controller.format, SequenceModulus::Modulo128);
        let controller = MockController::new(controller, Arc::clone(&plant), seed, START).unwrap();
        let driver = Driver::new(driver).unwrap();
        let (wanted, only_in_control, letters) = (None, false, String::new());
        let next_host_cycle = START;
        Self { driver, link, controller, plant, now: START, wanted, next_host_cycle, only_in_control, letters }
    }

    /// Moving at this velocity, after the normal sequence.
    pub fn moving(mut self, velocity_rad_per_s: JointVector) -> Self {
        for request in [Request::Connect, Request::Enable, Request::ReleaseBrakes] {
            self.request(request);
            self.settle();
        }
        assert_eq!(self.driver.state(), DriverState::Holding, "{:?}", self.driver.latched());
        self.wanted = Some(velocity_rad_per_s);
        self.next_host_cycle = self.now;
        self
    }

    pub fn request(&mut self, request: Request) {
        self.driver.handle_request(self.now, request).unwrap();
    }

    pub fn settle(&mut self) {
        let end = self.now + Duration::from_secs(15);
        while self.driver.activity() != Activity::None {
            assert!(self.now < end, "{:?}", self.driver);
            self.run(BUS_CYCLE);
        }
    }

    pub fn inject(&mut self, line: &str) {
        self.controller.command_line(self.now, line).unwrap();
    }

    pub fn run(&mut self, time: Duration) {
        let end = self.now + time;
        self.run_until(end, |_| false);
    }

    /// Runs for a time or until a condition; returns whether the condition occurred.
    pub fn run_until(&mut self, end: MonotonicTime, mut happened: impl FnMut(&Self) -> bool) -> bool {
        loop {
            self.work();
            if happened(self) {
                return true;
            }
            let host = self.wanted.is_some().then_some(self.next_host_cycle);
            let next = [self.driver.next_deadline(), self.controller.next_deadline(), host].into_iter().flatten().min();
            let Some(next) = next.filter(|next| *next <= end) else { break };
            self.now = next.max(self.now + Duration::from_nanos(1));
        }
        self.now = end;
        self.controller.advance(end);
        false
    }

    /// Processes everything that is due now.
    fn work(&mut self) {
        if self.wanted.is_some() && self.now >= self.next_host_cycle {
            self.next_host_cycle = self.next_host_cycle + HOST_CYCLE;
            if let Some(velocity) = self.wanted
                && self.driver.handle_request(self.now, Request::Move(velocity)).is_err()
            {
                self.wanted = None;
            }
        }
        while let Some(frame) = self.controller.poll_frame(self.now) {
            self.link.handle_frame(self.now, &frame, &mut self.driver);
        }
        if let Some(transmit) = self.driver.poll_transmit(self.now) {
            let frame = self.link.send(&transmit).unwrap();
            self.letters.push(letter(&frame));
            let is_deaf = self.only_in_control && self.controller.mode() != ControlMode::Control;
            if !is_deaf || letter(&frame) != 'C' {
                self.controller.handle_frame(self.now, &frame);
            }
        }
    }

    /// True speed of the fastest joint, rad/s.
    pub fn speed(&self) -> f64 {
        let plant = self.plant.lock().unwrap();
        plant.velocity_at(plant.now()).unwrap().amax()
    }

    pub fn is_at_rest(&self) -> bool {
        self.speed() < AT_REST_RAD_PER_S
    }
}

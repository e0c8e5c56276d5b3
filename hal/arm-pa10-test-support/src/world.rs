//! In real time: an emulated controller on a thread, and a host (driver and link) on a byte link.

use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_arm_pa10::arm::KeyedTcp;
use pb3dp_arm_pa10::driver::{Activity, Driver, DriverConfig, DriverState, Request};
use pb3dp_arm_pa10::link::{GatewayLink, LinkError};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockController, MockControllerConfig, MockCounters};
use pb3dp_arm_pa10_gateway::bus::{BusPort, FRAME_ROOM};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_gateway::service::{Access, HostSide};
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, AxisMotionLimits, Firmware, GatewayState, Geometry, HostLimits, MotionLimits, SharedKey,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_arm_pa10_protocol::watchdog::CommandWatchdog;
use pb3dp_hal_platform::realtime::{self, Realtime};
use pb3dp_hal_platform::tcp::TcpConfig;
use pb3dp_hal_platform::transport::{ByteLink, wait};
use pb3dp_kinematics::{JointLimits, JointVector};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig};
use pb3dp_test_support::real_time::note_lateness;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

pub const ARM: ArmId = ArmId(2);
pub const FORMAT: WireFormat = WireFormat::BigEndian6x10;

/// A test fails after this time without progress.
pub const LONG: Duration = Duration::from_secs(20);

/// Cycle of the host. All times are several times those of a rig, because the machine may be loaded.
pub const CYCLE: Duration = Duration::from_millis(20);

pub const fn ms(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

pub fn watchdog() -> CommandWatchdog {
    CommandWatchdog::new(ms(100), ms(200)).unwrap()
}

pub fn gateway_config() -> GatewayConfig {
    GatewayConfig {
        cycle: ms(10),
        lateness_allowed: ms(150),
        watchdog: watchdog(),
        ..GatewayConfig::new(ARM, FORMAT, Firmware::new("pb3dp test").unwrap(), MotionLimits::WIDEST)
    }
}

pub fn home() -> JointVector {
    JointVector::from([0.3, 0.4, -0.2, 1.1, 0.5, 0.7, -0.6])
}

pub fn velocity() -> JointVector {
    JointVector::from([0.02, -0.02, 0.03, -0.03, 0.04, -0.04, 0.05])
}

fn plant() -> JointPlant {
    let max = JointVector::repeat(3.0);
    let config = JointPlantConfig {
        limits: JointLimits::new(-max, max, JointVector::repeat(2.0)).unwrap(),
        acceleration_max_rad_per_s2: JointVector::repeat(40.0),
        velocity_time_constant: ms(5),
        command_delay: Duration::ZERO,
        angle_quantum_rad: 0.0,
        history: Duration::from_secs(1),
    };
    JointPlant::new(config, home(), realtime::now()).unwrap()
}

/// Real-time priority where permitted, for threads on which an arm depends.
pub fn hurry() {
    realtime::enter(&Realtime { priority: Some(15), locks_memory: false, cpu: None });
}

/// Observed state of an emulated controller.
#[derive(Clone, Debug)]
pub struct Observed {
    pub counters: MockCounters,
    pub mode: ControlMode,
    pub is_braked: bool,
    pub position_rad: JointVector,
    pub commanded_rad_per_s: JointVector,
}

/// An emulated controller on its own thread.
pub struct Emulation {
    end: Arc<AtomicBool>,
    observed: Arc<Mutex<Option<Observed>>>,
    /// Faults to inject, in the syntax of docs/mock-arm.md.
    lines: Arc<Mutex<Vec<String>>>,
    thread: Option<JoinHandle<MockController>>,
}

impl Emulation {
    pub fn start(port: Box<dyn BusPort>, watchdog: Option<Duration>) -> Self {
        let config = MockControllerConfig { watchdog, ..MockControllerConfig::new(FORMAT) };
        let plant = Arc::new(Mutex::new(plant()));
        Self::carry_on(port, MockController::new(config, plant, 7, realtime::now()).unwrap())
    }

    /// Disconnects the controller from its bus, with the arm in its current state, for a later reconnection.
    pub fn unplug(mut self) -> MockController {
        self.end.store(true, Ordering::SeqCst);
        self.thread.take().unwrap().join().unwrap()
    }

    /// The same controller on another bus.
    pub fn carry_on(mut port: Box<dyn BusPort>, mut mock: MockController) -> Self {
        let end = Arc::new(AtomicBool::new(false));
        let observed = Arc::new(Mutex::new(None));
        let lines = Arc::new(Mutex::new(Vec::<String>::new()));
        let (its_end, its_observed, its_lines) = (Arc::clone(&end), Arc::clone(&observed), Arc::clone(&lines));
        let thread = std::thread::spawn(move || {
            hurry();
            let plant = mock.plant();
            let mut buffer = [0; FRAME_ROOM];
            while !its_end.load(Ordering::SeqCst) {
                while let Ok(Some(length)) = port.try_receive(&mut buffer) {
                    mock.handle_frame(realtime::now(), &buffer[..length]);
                }
                let now = realtime::now();
                mock.advance(now);
                for line in its_lines.lock().unwrap().drain(..) {
                    mock.command_line(now, &line).unwrap();
                }
                while let Some(frame) = mock.poll_frame(now) {
                    // The gateway may have disconnected.
                    let _ = port.try_send(&frame);
                }
                let position_rad = plant.lock().unwrap().position_at(now).unwrap_or_else(home);
                *its_observed.lock().unwrap() = Some(Observed {
                    counters: mock.counters().clone(),
                    mode: mock.mode(),
                    is_braked: mock.is_braked(),
                    position_rad,
                    commanded_rad_per_s: mock.commanded_rad_per_s(),
                });
                let mut fds = [PollFd::from_borrowed_fd(port.fd(), PollFlags::IN)];
                let timeout = Timespec { tv_sec: 0, tv_nsec: 300_000 };
                let count = poll(&mut fds, Some(&timeout));
                note_lateness(realtime::now().saturating_since(now));
                if matches!(count, Ok(1..)) && fds[0].revents().contains(PollFlags::HUP) {
                    std::thread::sleep(ms(1));
                }
            }
            mock
        });
        Self { end, observed, lines, thread: Some(thread) }
    }

    pub fn inject(&self, line: &str) {
        self.lines.lock().unwrap().push(line.to_owned());
    }

    pub fn observed(&self) -> Observed {
        let since = Instant::now();
        loop {
            if let Some(observed) = self.observed.lock().unwrap().clone() {
                return observed;
            }
            assert!(since.elapsed() < LONG, "the emulated controller does not run");
            std::thread::sleep(ms(1));
        }
    }

    pub fn wait_for(&self, what: &str, is: impl Fn(&Observed) -> bool) {
        let since = Instant::now();
        while !is(&self.observed()) {
            assert!(since.elapsed() < LONG, "never {what}: {:?}", self.observed());
            std::thread::sleep(ms(2));
        }
    }
}

impl Drop for Emulation {
    fn drop(&mut self) {
        self.end.store(true, Ordering::SeqCst);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The key of gateways and hosts in tests.
pub fn test_key() -> SharedKey {
    SharedKey::new(b"a secret that only tests know, in 32 bytes or more").unwrap()
}

/// A gateway's TCP port for hosts of this computer with the key of the tests.
pub fn tcp_side() -> (HostSide, SocketAddr) {
    let side = HostSide::listen("127.0.0.1:0".parse().unwrap(), ARM, Access::from_this_computer(test_key())).unwrap();
    let address = side.address().unwrap();
    (side, address)
}

/// A connector to such a port.
pub fn keyed(address: SocketAddr) -> KeyedTcp {
    KeyedTcp { tcp: TcpConfig { address }, key: test_key(), arm: ARM }
}

/// Limits of a slow host, within those of the gateway's shipped file.
pub fn asked_limits() -> MotionLimits {
    let axis = AxisMotionLimits { speed: 1000, acceleration: 200, jerk: 400, lower: -7500, upper: 7500 };
    MotionLimits { axes: [axis; 7] }
}

/// A host: driver and link on a byte link.
pub struct Host {
    pub driver: Driver,
    pub link: GatewayLink,
    pub line: Box<dyn ByteLink>,
    pub is_gone: bool,
    velocity: Option<JointVector>,
}

/// What a host asks of the gateway.
pub fn host_link() -> GatewayLinkConfig {
    GatewayLinkConfig {
        arm: ARM,
        format: FORMAT,
        geometry: Geometry::Unknown,
        // A gateway may be configured with at most 10 ms.
        cycle: ms(10),
        limits: HostLimits { asked: asked_limits(), ..HostLimits::WIDEST },
        signals: StatusSignals::ORCA,
    }
}

impl Host {
    pub fn new(line: Box<dyn ByteLink>) -> Self {
        let config = DriverConfig { watchdog: watchdog(), ..DriverConfig::with_cycle(CYCLE) };
        hurry();
        let (driver, link) = (Driver::new(config).unwrap(), GatewayLink::new(host_link()));
        Self { driver, link, line, is_gone: false, velocity: None }
    }

    /// Sends HELLO until it is answered: a gateway that starts first closes the brakes.
    pub fn open(&mut self) {
        let since = Instant::now();
        while self.link.hello().is_none_or(|hello| hello.state == GatewayState::Stopping) {
            assert!(since.elapsed() < LONG, "nobody answers HELLO: {:?}", self.link.hello_error());
            self.link.open(realtime::now());
            self.run_for(ms(300), |host| host.link.hello().is_some());
            // A gateway disconnects a host that sends HELLO without a pause.
            self.run_for(ms(20), |_| false);
        }
    }

    pub fn request(&mut self, request: Request) {
        self.driver.handle_request(realtime::now(), request).unwrap();
    }

    /// Sends a request and waits until its activity has ended.
    pub fn do_it(&mut self, request: Request) {
        self.velocity = None;
        self.request(request);
        assert!(self.run_for(LONG, |host| host.driver.activity() == Activity::None), "{request:?} does not end");
    }

    pub fn must_be(&self, state: DriverState) {
        let (latched, warm_up) = (self.driver.latched(), self.driver.warm_up_failure());
        assert_eq!(self.driver.state(), state, "{latched:?} {warm_up:?}");
    }

    pub fn lead_to_moving(&mut self) {
        self.do_it(Request::Connect);
        self.lead_on_to_moving();
    }

    pub fn lead_on_to_moving(&mut self) {
        self.must_be(DriverState::Connected);
        self.do_it(Request::Enable);
        self.must_be(DriverState::Enabled);
        self.do_it(Request::ReleaseBrakes);
        self.must_be(DriverState::Holding);
        self.velocity = Some(velocity());
        self.run_for(ms(400), |_| false);
        self.must_be(DriverState::Moving);
    }

    /// Runs for a time or until a condition; returns whether the condition occurred.
    pub fn run_for(&mut self, time: Duration, is: impl Fn(&Self) -> bool) -> bool {
        let since = Instant::now();
        while since.elapsed() < time {
            self.work();
            if is(self) {
                return true;
            }
            let before = realtime::now();
            if self.is_gone {
                std::thread::sleep(ms(1));
            } else {
                wait(Some(self.line.as_ref()), false, None, ms(1));
            }
            note_lateness(realtime::now().saturating_since(before));
        }
        false
    }

    fn work(&mut self) {
        let mut buffer = [0; 512];
        let now = realtime::now();
        match self.line.try_read(&mut buffer) {
            Ok(0) => {}
            Ok(count) => self.link.handle_bytes(now, &buffer[..count], &mut self.driver),
            Err(_) if !self.is_gone => {
                self.is_gone = true;
                self.driver.handle_unplugged(now);
            }
            Err(_) => {}
        }
        self.link.handle_timeout(now, &mut self.driver);
        if let Some(velocity) = self.velocity
            && self.driver.handle_request(now, Request::Move(velocity)).is_err()
        {
            self.velocity = None;
        }
        if let Some(transmit) = self.driver.poll_transmit(now) {
            match self.link.send(now, &transmit, self.driver.activity()) {
                Ok(()) | Err(LinkError::NotOpen) => {}
                Err(error) => panic!("{error}"),
            }
        }
        while let Some(bytes) = self.link.poll_output(now) {
            let mut rest = bytes.as_slice();
            while !rest.is_empty() && !self.is_gone {
                match self.line.try_write(rest) {
                    Ok(count) => rest = &rest[count..],
                    Err(_) => self.is_gone = true,
                }
            }
        }
    }
}

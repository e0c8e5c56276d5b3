//! An arm in the guest: a host, its gateway and an emulated controller, with real lines between them.

use std::error::Error;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use pb3dp_arm_pa10::arm::{Pa10Arm, Pa10ArmConfig, REALTIME, TripSeat};
use pb3dp_arm_pa10::driver::DriverConfig;
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, MockServerConfig};
use pb3dp_arm_pa10_emulation::mock_controller::{MockControllerConfig, Script, pa10_joints};
use pb3dp_arm_pa10_gateway::bus::{BusPort, FrameSocket};
use pb3dp_arm_pa10_gateway::gateway::GatewayConfig;
use pb3dp_arm_pa10_gateway::service::{BusOpener, GatewayServer, GatewayServerConfig, Happened, HostSide};
use pb3dp_arm_pa10_protocol::codec::{StatusSignals, WireFormat};
use pb3dp_arm_pa10_protocol::gateway_protocol::{
    ArmId, Firmware, GatewayState, Geometry, HostLimits, MotionLimits, StopCause,
};
use pb3dp_arm_pa10_protocol::places::GatewayLinkConfig;
use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmPower, ArmState, Clock, JointCommand};
use pb3dp_hal_platform::realtime::{Realtime, enter, now, sleep_until};
use pb3dp_hal_platform::transport::Connector;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::JointPlant;

use crate::serial;

const FORMAT: WireFormat = WireFormat::BigEndian6x10;
pub const BAUD: u32 = 921_600;
pub const CYCLE: Duration = Duration::from_millis(10);

/// Period of messages on the bus. A rig has 2 ms, which would take half of the time of an emulated processor.
const BUS_CYCLE: Duration = Duration::from_millis(4);

/// Allowed lateness of a cycle of the gateway's thread: a kernel without real time runs no thread while it removes a device. A
/// rig has 2 ms.
const LATENESS_ALLOWED: Duration = Duration::from_millis(10);

/// The longest published watchdog time of a controller. The gateway stops the arm earlier.
const CONTROLLER_WATCHDOG: Duration = Duration::from_millis(400);

/// Below this speed a joint is stationary.
const AT_REST_RAD_PER_S: f64 = 1e-3;

/// Socket in place of a bus.
fn socket() -> PathBuf {
    std::env::temp_dir().join("bus")
}

/// The machine's clock, the same for all time measurements here.
struct MachineClock;

impl Clock for MachineClock {
    fn now(&self) -> MonotonicTime {
        now()
    }

    fn sleep_until(&self, deadline: MonotonicTime) {
        while now() < deadline {
            sleep_until(deadline);
        }
    }
}

/// The lines of an arm, and the times of its bus.
pub struct Lines {
    pub arm: ArmId,
    /// From the host to the gateway, and the gateway's end of it.
    pub host: Box<dyn Connector>,
    pub of_host: HostSide,
    /// From the gateway to the controller, and the controller's end of it.
    pub bus: BusOpener,
    pub controller: MockFace,
    pub bus_cycle: Duration,
    pub lateness_allowed: Duration,
}

impl Lines {
    /// Host and gateway at the ends of a serial cable, a socket in place of the bus.
    pub fn serial(host_path: &str, gateway_path: &str) -> Self {
        Self {
            arm: ArmId(2),
            host: Box::new(serial::config(host_path, BAUD, CYCLE)),
            of_host: HostSide::Line(Box::new(serial::config(gateway_path, BAUD, CYCLE))),
            bus: Box::new(|| Ok(Box::new(FrameSocket::connect(&socket())?) as Box<dyn BusPort>)),
            controller: MockFace::BusSocket(socket()),
            bus_cycle: BUS_CYCLE,
            lateness_allowed: LATENESS_ALLOWED,
        }
    }
}

/// Host, gateway, controller and joints.
pub struct Cell {
    pub arm: Pa10Arm,
    pub mock: MockServer,
    gateway: GatewayServer,
    joints: Watcher,
    next: MonotonicTime,
}

fn home() -> JointVector {
    JointVector::from([0.3, 0.4, -0.2, 1.1, 0.5, 0.7, -0.6])
}

fn velocity() -> JointVector {
    JointVector::from([0.05, -0.05, 0.08, -0.06, 0.1, -0.1, 0.2])
}

impl Cell {
    /// With closed brakes.
    pub fn start(lines: Lines, seat: TripSeat) -> Result<Self, Box<dyn Error>> {
        let Lines { arm, host, of_host, bus, controller: face, bus_cycle, lateness_allowed } = lines;
        let clock: Arc<dyn Clock> = Arc::new(MachineClock);
        let plant = Arc::new(Mutex::new(JointPlant::new(pa10_joints()?, home(), now())?));
        let watcher = Watcher::start(Arc::clone(&plant))?;
        let controller =
            MockControllerConfig { watchdog: Some(CONTROLLER_WATCHDOG), ..MockControllerConfig::new(FORMAT) };
        let realtime = |priority| Realtime { priority: Some(priority), ..REALTIME };
        let config = MockServerConfig { controller, seed: 1, script: Script::default(), realtime: realtime(60) };
        let mock = MockServer::start(config, face, plant, Arc::clone(&clock))?;
        let gateway = GatewayConfig {
            cycle: bus_cycle,
            lateness_allowed,
            controller_watchdog: Some(CONTROLLER_WATCHDOG),
            ..GatewayConfig::new(arm, FORMAT, Firmware::new("pb3dp guest").ok_or("a name")?, MotionLimits::WIDEST)
        };
        let gateway = GatewayServer::start(GatewayServerConfig { gateway, realtime: realtime(55) }, bus, of_host)?;
        let link = GatewayLinkConfig {
            arm,
            format: FORMAT,
            geometry: Geometry::Unknown,
            cycle: CYCLE,
            limits: HostLimits::WIDEST,
            signals: StatusSignals::ORCA,
        };
        let config = Pa10ArmConfig::new("guest", DriverConfig::with_cycle(CYCLE), link);
        let arm = Pa10Arm::open(config, host, clock, seat)?;
        Ok(Self { arm, mock, gateway, joints: watcher, next: now() })
    }

    /// Brings the arm to motion from any state.
    pub fn make_move(&mut self) -> Result<(), ArmError> {
        self.arm.reset()?;
        if self.arm.state() == ArmState::Disabled {
            self.arm.enable()?;
        }
        self.next = now();
        for _ in 0..40 {
            self.exchange()?;
        }
        Ok(())
    }

    /// One cycle of motion. A late answer is no error.
    pub fn exchange(&mut self) -> Result<(), ArmError> {
        self.command(JointCommand::Velocity(velocity()))
    }

    fn command(&mut self, command: JointCommand) -> Result<(), ArmError> {
        self.next = (self.next + CYCLE).max(now());
        MachineClock.sleep_until(self.next);
        match self.arm.exchange(command) {
            Err(error) if error.kind() != ArmErrorKind::Timeout => Err(error),
            _ => Ok(()),
        }
    }

    /// One cycle without motion. A late answer is no error.
    pub fn hold(&mut self) -> Result<(), ArmError> {
        self.command(JointCommand::Hold)
    }

    /// Whether the brakes are closed and the joints have been stationary for a while.
    pub fn is_at_rest(&self) -> bool {
        let report = self.mock.report();
        report.is_braked && now().saturating_since(self.joints.last_motion()) > Duration::from_millis(100)
    }

    /// Time of the last motion of a joint.
    pub fn last_motion(&self) -> MonotonicTime {
        self.joints.last_motion()
    }

    pub fn position_rad(&self) -> JointVector {
        self.mock.report().position_rad
    }

    /// Stops by the gateway since the last call: times and causes.
    pub fn gateway_stops(&self) -> Vec<(MonotonicTime, StopCause)> {
        let events = std::iter::from_fn(|| self.gateway.try_event());
        let stop = |at, what| match what {
            Happened::State { to: GatewayState::Fault, cause, .. } => Some((at, cause)),
            _ => None,
        };
        events.filter_map(|event| stop(event.at, event.what)).collect()
    }

    /// Messages of the gateway about its line.
    pub fn gateway_messages(&self) -> Vec<String> {
        std::iter::from_fn(|| self.gateway.try_message()).collect()
    }
}

/// Observes the true joints every millisecond.
struct Watcher {
    last_motion: Arc<AtomicU64>,
    is_over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Watcher {
    fn start(joints: Arc<Mutex<JointPlant>>) -> std::io::Result<Self> {
        let (last_motion, is_over) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicBool::new(false)));
        let (motion, over) = (Arc::clone(&last_motion), Arc::clone(&is_over));
        let work = move || {
            enter(&Realtime { priority: Some(30), locks_memory: false, cpu: None });
            while !over.load(Ordering::Relaxed) {
                let at = now();
                let mut joints = joints.lock().unwrap_or_else(PoisonError::into_inner);
                joints.advance_to(at);
                if joints.state().velocity_rad_per_s.amax() > AT_REST_RAD_PER_S {
                    motion.store(at.as_nanos(), Ordering::Relaxed);
                }
                drop(joints);
                sleep_until(at + Duration::from_millis(1));
            }
        };
        let thread = std::thread::Builder::new().name("watcher".to_owned()).spawn(work)?;
        Ok(Self { last_motion, is_over, thread: Some(thread) })
    }

    fn last_motion(&self) -> MonotonicTime {
        MonotonicTime::from_nanos(self.last_motion.load(Ordering::Relaxed))
    }
}

impl Drop for Watcher {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

//! Two emulated controllers with their true joints, and a `pb3dp gateway` in front of each.

use std::fs::File;
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Result, bail};
use pb3dp_arm_pa10_emulation::line::mock_server::{MockFace, MockServer, MockServerConfig};
use pb3dp_arm_pa10_emulation::mock_controller::{ControlMode, MockControllerConfig, Script, pa10_joints};
use pb3dp_hal_api::Clock;
use pb3dp_hal_clock::SystemClock;
use pb3dp_hal_platform::realtime::Realtime;
use pb3dp_kinematics::JointVector;
use pb3dp_setup::setup::{ArmLink, read_setup};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig};
use system_tests::repository;

use crate::files::Files;

/// Time-out of the controllers: longer than the pauses of a computer that runs five programs which move arms.
const TIME_OUT: Duration = Duration::from_millis(200);
/// A joint is stationary below this speed, rad/s.
const AT_REST_RAD_PER_S: f64 = 2e-3;
/// An arm that tracks moves within this time.
const MOVES_WITHIN: Duration = Duration::from_secs(20);
/// Time in which a gateway opens its port.
const LISTENS_WITHIN: Duration = Duration::from_secs(20);

/// The motion of both arms during a while.
pub struct Motion {
    /// When a joint moved last; none if all were stationary.
    pub last: Option<Instant>,
    /// Whether both arms moved at the same time.
    pub both: bool,
}

/// A process that ends with this.
pub struct Program(Child);

impl Program {
    /// SIGKILL.
    pub fn kill(&mut self) {
        // One that has ended already is no matter.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Both arms up to the TCP ports of their gateways.
pub struct Cell {
    /// The gateways.
    pub gateways: [Program; 2],
    /// Their files.
    pub files: Files,
    program: std::path::PathBuf,
    clock: Arc<dyn Clock>,
    plants: [Arc<Mutex<JointPlant>>; 2],
    controllers: [MockServer; 2],
}

impl Cell {
    /// The arms of `configs/hil.toml` at their start pose, brakes closed.
    pub fn start(program: &Path) -> Result<Self> {
        let address = || TcpListener::bind("127.0.0.1:0").and_then(|listener| listener.local_addr());
        let files = Files::new(program, [address()?, address()?])?;
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let setup = read_setup(&repository().join("configs/hil.toml"))?;
        let arms = [&setup.rig.arms.vs, &setup.rig.arms.tc];
        let plant = |arm: usize| -> Result<_> {
            let config = JointPlantConfig { command_delay: Duration::ZERO, ..pa10_joints()? };
            Ok(Arc::new(Mutex::new(JointPlant::new(config, arms[arm].start_rad, clock.now())?)))
        };
        let plants = [plant(0)?, plant(1)?];
        let controller = |arm: usize| -> Result<_> {
            let ArmLink::Gateway(link, _) = &arms[arm].link else {
                bail!("configs/hil.toml: an arm without a gateway")
            };
            let servo = arms[arm].limits.servo();
            let controller = MockControllerConfig {
                watchdog: Some(TIME_OUT),
                lower_limit_rad: *servo.position_min_rad(),
                upper_limit_rad: *servo.position_max_rad(),
                ..MockControllerConfig::new(link.format)
            };
            let realtime = Realtime { priority: Some(45), locks_memory: false, cpu: None };
            let config = MockServerConfig { controller, seed: 1, script: Script::default(), realtime };
            let face = MockFace::BusSocket(files.bus(arm));
            Ok(MockServer::start(config, face, Arc::clone(&plants[arm]), Arc::clone(&clock))?)
        };
        let controllers = [controller(0)?, controller(1)?];
        let gateways = [gateway(program, &files, 0)?, gateway(program, &files, 1)?];
        Ok(Self { gateways, files, program: program.to_owned(), clock, plants, controllers })
    }

    /// Starts a new gateway in place of a dead one.
    pub fn restart_gateway(&mut self, arm: usize) -> Result<()> {
        self.gateways[arm] = gateway(&self.program, &self.files, arm)?;
        Ok(())
    }

    /// The true joint angles, radians.
    pub fn joints_rad(&self) -> [JointVector; 2] {
        self.states().map(|(position_rad, _)| position_rad)
    }

    /// The true angles and speeds of both arms now.
    fn states(&self) -> [(JointVector, JointVector); 2] {
        self.plants.each_ref().map(|plant| {
            let mut plant = plant.lock().unwrap_or_else(PoisonError::into_inner);
            plant.advance_to(self.clock.now());
            let state = plant.state();
            (state.position_rad, state.velocity_rad_per_s)
        })
    }

    /// Samples the joints every millisecond for a while.
    pub fn watch(&self, for_: Duration) -> Motion {
        let begin = Instant::now();
        let mut motion = Motion { last: None, both: false };
        while begin.elapsed() < for_ {
            let moves = self.states().map(|(_, speed_rad_per_s)| speed_rad_per_s.amax() > AT_REST_RAD_PER_S);
            if moves.contains(&true) {
                motion.last = Some(Instant::now());
            }
            motion.both |= moves == [true, true];
            std::thread::sleep(Duration::from_millis(1));
        }
        motion
    }

    /// Waits for this time, and then until both arms move at once; whether they do.
    pub fn waits_until_it_moves(&self, after: Duration) -> bool {
        std::thread::sleep(after);
        let begin = Instant::now();
        while begin.elapsed() < MOVES_WITHIN {
            if self.watch(Duration::from_millis(5)).both {
                return true;
            }
        }
        false
    }

    /// Whether all brakes of both arms are closed.
    pub fn are_braked(&self) -> bool {
        self.controllers.iter().all(|controller| {
            let report = controller.report();
            report.is_braked && report.mode == ControlMode::Adjustment
        })
    }
}

/// A gateway that listens.
fn gateway(program: &Path, files: &Files, arm: usize) -> Result<Program> {
    let log = File::options().create(true).append(true).open(files.path(&format!("gateway{arm}.log")))?;
    let child = Command::new(program).args(["gateway", "--config"]).arg(files.gateway(arm)).stderr(log).spawn()?;
    let mut gateway = Program(child);
    let address = files.address(arm);
    let begin = Instant::now();
    while TcpStream::connect(address).is_err() {
        let ended = gateway.0.try_wait()?;
        if ended.is_some() || begin.elapsed() > LISTENS_WITHIN {
            let log = std::fs::read_to_string(files.path(&format!("gateway{arm}.log")))?;
            bail!("gateway {arm} does not listen ({ended:?}):\n{log}");
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    Ok(gateway)
}

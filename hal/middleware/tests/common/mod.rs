//! A mock PA-10 for the tests of the wrappers.

#![allow(dead_code, reason = "not every test needs everything")]

use std::sync::{Arc, Mutex};
use std::task::Poll;
use std::time::Duration;

use pb3dp_arm_pa10_emulation::mock::{MockArm, MockArmConfig};
use pb3dp_hal_api::{Arm, ArmError, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState, PowerOrder};
use pb3dp_hal_clock::VirtualClock;
use pb3dp_hal_conformance::{ArmExpectations, ArmHooks, arm_suite};
use pb3dp_hal_middleware::{GuardConfig, LimiterConfig, PA10_MECHANICAL_RANGE_DEG, StartPose};
use pb3dp_kinematics::{Chain, DOF, EffectiveLimits, JointLimits, JointVector, StatedLimits};
use pb3dp_sim::joint_dynamics::{JointPlant, JointPlantConfig, PA10_ANGLE_QUANTUM_RAD};

pub const CYCLE: Duration = Duration::from_millis(10);

fn radians(range_deg: [f64; DOF]) -> JointVector {
    JointVector::from(range_deg).map(f64::to_radians)
}

/// Operating range of a PA-10 in both directions, as in configs/sim.toml: 3 to 7 degrees inside the servo limits.
pub fn operating_range_rad() -> JointVector {
    radians([170.0, 88.0, 168.0, 131.0, 249.0, 159.0, 249.0])
}

/// Mechanical range of a PA-10 in both directions.
pub fn mechanical_range_rad() -> JointVector {
    radians(PA10_MECHANICAL_RANGE_DEG)
}

pub fn servo_limits() -> JointLimits {
    let urdf = include_str!("../../../../configs/robots/pa10_gen2.urdf");
    *Chain::from_urdf_str(urdf, "base_link", "flange").unwrap().limits()
}

pub fn acceleration() -> JointVector {
    JointVector::from([2.0, 2.0, 2.0, 2.0, 5.0, 5.0, 5.0])
}

/// Reaches the maximum acceleration in a twentieth of a second.
pub fn jerk() -> JointVector {
    acceleration() * 20.0
}

/// The mock arm stops after this time without a command.
pub const COMMAND_TIMEOUT: Duration = Duration::from_millis(60);

/// Limits of an arm at this share of its speeds.
pub fn stated(speed_scale: f64) -> StatedLimits {
    StatedLimits {
        servo: servo_limits(),
        operating_min_rad: -operating_range_rad(),
        operating_max_rad: operating_range_rad(),
        speed_scale,
        acceleration_max_rad_per_s2: acceleration(),
        jerk_max_rad_per_s3: jerk(),
    }
}

pub fn limits(speed_scale: f64) -> EffectiveLimits {
    stated(speed_scale).effective().unwrap()
}

/// For an arm with cycles of up to 20 ms, 15 ms of delay and 30 ms of lag.
pub fn limiter_config() -> LimiterConfig {
    LimiterConfig {
        reaction_time: Duration::from_millis(65),
        command_timeout: COMMAND_TIMEOUT,
        fade: None,
        stale_after: Duration::from_millis(50),
        start: StartPose::Anywhere,
    }
}

pub fn guard_config() -> GuardConfig {
    GuardConfig {
        mechanical_min_rad: -mechanical_range_rad(),
        mechanical_max_rad: mechanical_range_rad(),
        ripple_rad_per_s: 0.0,
        delay: Duration::from_millis(15),
        lag: Duration::from_millis(30),
        tracking_error_max_rad: GuardConfig::TRACKING_ERROR_MAX_RAD,
        tracking_error_for: GuardConfig::TRACKING_ERROR_FOR,
    }
}

pub fn velocity(joint: usize, value: f64) -> JointCommand {
    let mut velocity = JointVector::zeros();
    velocity[joint] = value;
    JointCommand::Velocity(velocity)
}

/// The drives have the accelerations that the wrappers assume.
pub fn mock_arm(clock: &Arc<VirtualClock>, start: JointVector) -> MockArm {
    let config = JointPlantConfig {
        limits: servo_limits(),
        acceleration_max_rad_per_s2: acceleration(),
        velocity_time_constant: Duration::from_millis(30),
        command_delay: Duration::from_millis(15),
        angle_quantum_rad: PA10_ANGLE_QUANTUM_RAD,
        history: Duration::from_secs(120),
    };
    let plant = Arc::new(Mutex::new(JointPlant::new(config, start, clock.now()).unwrap()));
    let config = MockArmConfig { name: "vs-robot".to_owned(), cycle: CYCLE, command_timeout: COMMAND_TIMEOUT };
    MockArm::new(config, plant, Arc::clone(clock) as Arc<dyn Clock>)
}

/// A mock arm in a wrapper fulfils the contract of every arm; `arm` is the wrapped one.
pub fn assert_contract<A: Arm + ArmPower + 'static>(
    clock: &VirtualClock,
    make: impl Fn() -> A,
    arm: fn(&A) -> &MockArm,
) {
    let hooks = ArmHooks::<A> {
        lose_reply: Some(Box::new(move |wrapper| arm(wrapper).faults().drop_replies(1))),
        raise_fault: Some(Box::new(move |wrapper| arm(wrapper).faults().raise_fault("overcurrent in E1"))),
        remove_fault_cause: Some(Box::new(move |wrapper| arm(wrapper).faults().remove_fault_cause())),
        press_e_stop: Some(Box::new(move |wrapper| arm(wrapper).faults().press_e_stop())),
        release_e_stop: Some(Box::new(move |wrapper| arm(wrapper).faults().release_e_stop())),
    };
    let expectations = ArmExpectations { speed_rad_per_s: 0.1, settles_within: Duration::from_millis(400) };
    arm_suite(make, clock, &expectations, &hooks).assert_passed();
}

pub type Tamper = Box<dyn FnMut(&mut JointState) + Send>;

/// Records the commands of an arm, and changes its answers.
pub struct Tampered {
    pub arm: MockArm,
    pub commanded: Arc<Mutex<Vec<JointCommand>>>,
    pub tamper: Arc<Mutex<Option<Tamper>>>,
}

impl Arm for Tampered {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        self.commanded.lock().unwrap().push(command);
        let mut sample = self.arm.exchange(command)?;
        if let Some(tamper) = self.tamper.lock().unwrap().as_mut() {
            tamper(&mut sample);
        }
        Ok(sample)
    }
}

impl ArmPower for Tampered {
    fn state(&self) -> ArmState {
        self.arm.state()
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        self.arm.power(order)
    }
}

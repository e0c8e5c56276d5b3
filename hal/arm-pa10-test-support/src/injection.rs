//! Random motions, alarms, and the permitted times until joints are stationary.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use pb3dp_arm_pa10::driver::DriverConfig;
use pb3dp_arm_pa10_emulation::mock_controller::MockControllerConfig;
use pb3dp_arm_pa10_protocol::codec::{CommAlarm, ServoAlarm, WireFormat};
use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;
use pb3dp_sim::joint_dynamics::{JointMechanics, JointPlant};
use pb3dp_sim::noise::{hash, unit};

use crate::bus_bench::{AT_REST_RAD_PER_S, BUS_CYCLE, START, home, plant_config};

/// Random numbers of a test, reproducible by its name and seed.
pub struct Dice {
    pub seed: u32,
    pub count: u32,
}

impl Dice {
    pub fn unit(&mut self) -> f64 {
        self.count += 1;
        unit(hash(&[self.seed, self.count]))
    }

    pub fn below(&mut self, count: usize) -> usize {
        (self.unit() * count as f64) as usize
    }

    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.below(of.len())]
    }

    /// A random velocity at 0.1 to 1.0 of the joints' limits, directed back where a joint is far out.
    pub fn velocity(&mut self, position_rad: &JointVector) -> JointVector {
        let limits = plant_config().limits;
        let scale = 0.1 + 0.9 * self.unit();
        JointVector::from(std::array::from_fn::<f64, 7, _>(|joint| {
            let speed = (2.0 * self.unit() - 1.0) * scale * limits.velocity_max_rad_per_s()[joint];
            if position_rad[joint].abs() > 0.5 { -speed.abs().copysign(position_rad[joint]) } else { speed }
        }))
    }
}

/// How the arm brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Braking {
    /// All axes with their servos.
    Servos,
    /// At least one axis with its brake, after the closing time.
    Brakes,
}

pub fn servo_alarm(dice: &mut Dice, tail: &str) -> String {
    let listed = dice.pick(ServoAlarm::LISTED).code();
    let code = if dice.unit() < 0.2 { 0x20 + dice.below(200) as u8 } else { listed };
    format!("alarm {} 0x{code:02x}{tail}", 1 + dice.below(7))
}

pub fn controller_alarm(dice: &mut Dice, tail: &str) -> String {
    format!("controller-alarm 0x{:02x}{tail}", dice.pick(CommAlarm::LISTED).code())
}

pub fn mechanics() -> JointMechanics {
    JointMechanics { servo_friction_rad_per_s: JointVector::repeat(0.002), ..JointMechanics::default() }
}

/// Joints of an arm with friction, brakes and gravity.
pub fn joints() -> JointPlant {
    JointPlant::new(plant_config(), home() * 0.3, START).unwrap().with_mechanics(mechanics()).unwrap()
}

/// Time in which the joints brake from these speeds.
pub fn braking_time(braking: Braking, velocity: &JointVector) -> Duration {
    let config = plant_config();
    let lag = config.velocity_time_constant.as_secs_f64();
    let ramp = DriverConfig::with_cycle(BUS_CYCLE).emergency_ramp.as_secs_f64();
    let mut longest = 0.0f64;
    for joint in 0..7 {
        let (speed, deceleration) = (velocity[joint].abs(), config.acceleration_max_rad_per_s2[joint]);
        // The ramp of the driver or the maximum deceleration of the drive, then the rest of the lag.
        let behind = speed.min(deceleration * lag);
        let settle = lag * (behind / AT_REST_RAD_PER_S).max(1.0).ln();
        longest = longest.max((speed / deceleration).max(ramp) + settle);
        if braking == Braking::Brakes {
            let closing = MockControllerConfig::new(WireFormat::BigEndian6x10).brake_close.as_secs_f64();
            let fallen = speed + mechanics().gravity_rad_per_s2[joint] * closing;
            longest = longest.max(closing + fallen / mechanics().brake_deceleration_rad_per_s2[joint]);
        }
    }
    Duration::from_secs_f64(longest)
}

/// Time of the last motion of the joints since `since`, in steps of 0.25 ms.
pub fn last_motion(plant: &Arc<Mutex<JointPlant>>, since: MonotonicTime) -> MonotonicTime {
    let plant = plant.lock().unwrap();
    let (mut at, mut last) = (since, since);
    while at <= plant.now() {
        if plant.velocity_at(at).unwrap().amax() >= AT_REST_RAD_PER_S {
            last = at;
        }
        at = at + Duration::from_micros(250);
    }
    last
}

/// Time from the fault to the last motion, and the permitted time.
pub struct Stop {
    pub took: Duration,
    pub allowed: Duration,
}

/// A line of a table of braking times: kind, count, median, 99th percentile, slowest and smallest margin, ms.
pub fn table_line(kind: &str, stops: &[Stop]) -> String {
    let mut times: Vec<f64> = stops.iter().map(|stop| 1e3 * stop.took.as_secs_f64()).collect();
    times.sort_by(f64::total_cmp);
    let part = |part: f64| times[((times.len() - 1) as f64 * part).round() as usize];
    let spare =
        stops.iter().map(|stop| 1e3 * (stop.allowed.as_secs_f64() - stop.took.as_secs_f64())).fold(f64::MAX, f64::min);
    let [median, nearly_all, slowest] = [part(0.5), part(0.99), part(1.0)];
    format!("| {kind} | {} | {median:.0} | {nearly_all:.0} | {slowest:.0} | {spare:.0} |", stops.len())
}

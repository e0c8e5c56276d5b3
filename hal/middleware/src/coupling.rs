//! Two arms in one workcell: a stop of one stops the other, and neither gets a command that leads to a collision.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::Duration;

use pb3dp_geometry::frames::{Base, World};
use pb3dp_geometry::{MonotonicTime, Pose};
use pb3dp_hal_api::{
    Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, JointState, PowerOrder,
};
use pb3dp_kinematics::{ArmShape, Chain, DOF, EffectiveLimits, JointVector, PlacedArm, clearance_within};

use crate::last_command::{CommandFade, LastCommand};
use crate::power::close_brakes;
use crate::shaping::SetPoint;
use crate::stopping::DriveLimits;

/// One of two arms within reach of each other.
#[derive(Clone, Debug)]
pub struct CoupledArmConfig {
    /// Kinematics.
    pub chain: Chain,
    /// Shape with the tool.
    pub shape: ArmShape,
    /// Base pose.
    pub world_from_base: Pose<World, Base>,
    /// Limits: its drives decelerate with these accelerations and jerks.
    pub limits: EffectiveLimits,
    /// Time from a sample until the next command takes effect.
    pub reaction_time: Duration,
    /// The arm stops without a new command for this time.
    pub command_timeout: Duration,
    /// Fading of a command without a successor; `None` if it is valid until the time-out.
    pub fade: Option<CommandFade>,
}

/// Why two arms cannot be coupled.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CoupledError {
    /// The minimum clearance is invalid.
    #[error("minimum clearance between the arms {0} m is not a positive, finite number")]
    LeastRoom(f64),
}

/// Smallest clearance of two coupled arms so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoupledStatistics {
    /// Smallest clearance of any set-point, braking distance included, metres; infinite before the first one.
    pub least_room_m: f64,
    /// Set-points that were refused because of the clearance.
    pub refused: u64,
}

/// A partner whose joints move by less than this is stationary, rad.
const AT_REST_RAD: f64 = 1e-3;

/// Below the minimum clearance an arm may move away if half of its stopping motion is at most this, rad.
const SHORT_WAY_RAD: f64 = 0.02;

/// Arms that hold may come nearer by this, metres: joints swing when they stop, and a creeping joint should be stopped by its guard first.
/// Chosen: a tenth of the smallest usual clearance; the swing of 0.002 rad that a guard allows moves a hand by 2 mm.
const HOLD_SWING_M: f64 = 0.005;

/// One of two coupled arms; [`couple`] creates both.
///
/// * A set-point is `Rejected`, and the arm holds, if the arms could come closer than allowed before both are stationary. If they
///   are closer already and the other one is stationary, an arm may move away.
/// * Both arms are stopped and latched if they come closer than allowed while they hold: a joint creeps or is pushed.
/// * If one arm has a fault, an emergency stop or a lost link, the other one holds from its next exchange on and is latched in
///   `Fault`. The arm that failed must be reset first.
///
/// Use it inside the [`Limiter`](crate::Limiter), so that it sees the commands that are really sent.
pub struct Coupled<A> {
    arm: A,
    side: usize,
    cell: Arc<Mutex<Cell>>,
    clock: Arc<dyn Clock>,
}

struct Cell {
    sides: [Side; 2],
    least_m: f64,
    /// Clearance that arms which hold keep: the allowed one, or the measured one if they were found closer. `None` before it is known.
    held_m: Option<f64>,
    statistics: CoupledStatistics,
}

struct Side {
    name: String,
    cycle: Duration,
    config: CoupledArmConfig,
    drives: DriveLimits,
    newest: Option<JointState>,
    last: LastCommand,
    /// Range of its joints until it is stationary.
    sweep: Option<Sweep>,
    /// Cause of this arm's stop.
    stopped: Option<String>,
    /// Cause of the other arm's stop.
    latched: Option<String>,
}

/// Joint angles around a centre, rad.
#[derive(Clone, Copy, Debug)]
struct Sweep {
    centre_rad: JointVector,
    reach_rad: JointVector,
}

/// Couples two arms whose samples have timestamps of `clock`; their surfaces keep `least_room_m` of clearance.
///
/// # Errors
/// If the minimum clearance is not a positive number.
pub fn couple<A: Arm, B: Arm>(
    (first, first_config): (A, CoupledArmConfig),
    (second, second_config): (B, CoupledArmConfig),
    least_room_m: f64,
    clock: &Arc<dyn Clock>,
) -> Result<(Coupled<A>, Coupled<B>), CoupledError> {
    if !(least_room_m.is_finite() && least_room_m > 0.0) {
        return Err(CoupledError::LeastRoom(least_room_m));
    }
    let cell = Cell {
        sides: [Side::new(first.info(), first_config), Side::new(second.info(), second_config)],
        least_m: least_room_m,
        held_m: None,
        statistics: CoupledStatistics { least_room_m: f64::INFINITY, refused: 0 },
    };
    let cell = Arc::new(Mutex::new(cell));
    let one = Coupled { arm: first, side: 0, cell: Arc::clone(&cell), clock: Arc::clone(clock) };
    let other = Coupled { arm: second, side: 1, cell, clock: Arc::clone(clock) };
    Ok((one, other))
}

impl Side {
    fn new(info: &ArmInfo, config: CoupledArmConfig) -> Self {
        let drives = DriveLimits::braking(&config.limits);
        Self {
            name: info.name.clone(),
            cycle: info.cycle,
            drives,
            last: LastCommand::new(drives, config.command_timeout, config.fade),
            config,
            newest: None,
            sweep: None,
            stopped: None,
            latched: None,
        }
    }

    /// Range of the joints until they stop, with this command and none after it.
    fn sweep(&mut self, set_point: &SetPoint, now: MonotonicTime) -> Option<Sweep> {
        let sample = self.newest?;
        let age = now.saturating_since(sample.at);
        let reaction = self.config.reaction_time + age;
        let peaks = self.last.peaks_since(now - reaction);
        let meanwhile_s = (reaction + self.config.command_timeout).as_secs_f64();
        let velocity = &set_point.velocity;
        let mut ways = [JointVector::zeros(); 2];
        for (side, upwards) in [(0, -1.0), (1, 1.0)] {
            for i in 0..DOF {
                let (speed, change) = (upwards * velocity[i], upwards * set_point.acceleration[i]);
                // Not shorter than the arm's own ramp, which has no jerk limit.
                let braking = self.drives.of(i).way_to_rest(speed, change);
                ways[side][i] = meanwhile_s * peaks[side][i].max(speed).max(0.0) + braking;
            }
        }
        let [down, up] = ways;
        Some(Sweep { centre_rad: sample.position_rad + (up - down) * 0.5, reach_rad: (up + down) * 0.5 })
    }

    /// The set-point of a velocity at this moment.
    fn set_point(&self, velocity: &JointVector, now: MonotonicTime) -> SetPoint {
        let (before, dt) = self.last.at(now, self.cycle, self.newest.as_ref());
        let dt_s = dt.as_secs_f64();
        let most = &self.drives.acceleration;
        let change = (velocity - before.velocity) / dt_s;
        let acceleration =
            if dt_s > 0.0 { change.zip_map(most, |a, most| a.clamp(-most, most)) } else { before.acceleration };
        SetPoint { velocity: *velocity, acceleration }
    }

    fn resting(&self) -> Option<Sweep> {
        self.newest.map(|sample| Sweep { centre_rad: sample.position_rad, reach_rad: JointVector::zeros() })
    }
}

impl Cell {
    /// Clearance between two sweeps, one of each arm, and the nearest parts.
    fn room(&self, side: usize, own: &Sweep, other: &Sweep) -> (f64, String) {
        let sides = [&self.sides[side], &self.sides[1 - side]];
        let [own_frames, other_frames] = [(0, own), (1, other)]
            .map(|(i, sweep): (usize, &Sweep)| sides[i].config.chain.joint_frames(&sweep.centre_rad));
        let placed = |i: usize, frames| {
            let CoupledArmConfig { shape, world_from_base, .. } = &sides[i].config;
            PlacedArm { shape, world_from_base, frames }
        };
        let (one, two) = (placed(0, &own_frames), placed(1, &other_frames));
        let room = clearance_within((&one, &own.reach_rad), (&two, &other.reach_rad));
        if room.distance_m >= self.least_m {
            return (room.distance_m, String::new());
        }
        (room.distance_m, format!("its {} and the {} of arm {}", room.first, room.second, sides[1].name))
    }

    /// Why a set-point must not be sent, if so.
    fn refusal(&mut self, side: usize, set_point: &SetPoint, now: MonotonicTime) -> Option<String> {
        let is_rest = set_point.velocity == JointVector::zeros();
        let own = self.sides[side].sweep(set_point, now);
        let (Some(own), Some(other)) = (own, self.sides[1 - side].sweep) else {
            let unknown = if own.is_none() { side } else { 1 - side };
            let name = &self.sides[unknown].name;
            return (!is_rest).then(|| format!("the pose of arm {name} is unknown; exchange with it first"));
        };
        let (room_m, which) = self.room(side, &own, &other);
        if room_m >= self.least_m || is_rest || self.leads_away(side, &own, &other) {
            self.statistics.least_room_m = self.statistics.least_room_m.min(room_m);
            // From here on the other arm must take it into account.
            self.sides[side].sweep = Some(own);
            return None;
        }
        self.statistics.refused += 1;
        Some(format!(
            "{which} could come within {:.0} mm of each other before both arms stop, the minimum clearance is {:.0} mm",
            room_m * 1e3,
            self.least_m * 1e3
        ))
    }

    /// Why arms that hold must be stopped, if so: they have come closer than allowed, or than they were found.
    fn nearing(&mut self, side: usize) -> Option<String> {
        let (own, other) = (self.sides[side].resting()?, self.sides[1 - side].resting()?);
        let (room_m, which) = self.room(side, &own, &other);
        let kept_m = self.held_m.map_or(room_m, |held_m| held_m.max(room_m)).min(self.least_m);
        self.held_m = Some(kept_m);
        (room_m < kept_m - HOLD_SWING_M).then(|| {
            format!(
                "{which} are {:.0} mm apart although this arm holds, the minimum clearance is {:.0} mm: a joint creeps or is pushed",
                room_m * 1e3,
                self.least_m * 1e3
            )
        })
    }

    /// Whether every part of a short stopping motion leads away from the other, stationary arm.
    fn leads_away(&self, side: usize, own: &Sweep, other: &Sweep) -> bool {
        let Some(here) = self.sides[side].resting() else { return false };
        if other.reach_rad.amax() > AT_REST_RAD || own.reach_rad.amax() > SHORT_WAY_RAD {
            return false;
        }
        let way_rad = (own.centre_rad - here.centre_rad) * 2.0;
        let room_m = self.room(side, &here, other).0;
        for part in [1.0 / 3.0, 2.0 / 3.0, 1.0] {
            let centre_rad: JointVector = here.centre_rad + way_rad * part;
            let there = Sweep { centre_rad, reach_rad: here.reach_rad };
            if self.room(side, &there, other).0 <= room_m {
                return false;
            }
        }
        true
    }

    /// Records the stop of this arm, and stops the other one.
    fn stop_both(&mut self, side: usize, reason: &str) {
        if self.sides[side].stopped.is_none() {
            self.sides[side].stopped = Some(reason.to_owned());
        }
        let text = format!("arm {} stopped: {reason}", self.sides[side].name);
        self.sides[1 - side].latched.get_or_insert(text);
    }
}

impl<A> Coupled<A> {
    /// The wrapped arm, read-only.
    pub fn arm(&self) -> &A {
        &self.arm
    }

    /// Smallest clearance of both arms so far.
    pub fn statistics(&self) -> CoupledStatistics {
        self.cell().statistics
    }

    fn cell(&self) -> MutexGuard<'_, Cell> {
        self.cell.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn latched(&self) -> Option<String> {
        self.cell().sides[self.side].latched.clone()
    }
}

impl<A: Arm + ArmPower> Coupled<A> {
    fn error(&self, kind: ArmErrorKind, text: &str) -> ArmError {
        ArmError::new(kind, format!("coupling of arm {}: {text}", self.arm.info().name))
    }

    fn stopped_error(&self, reason: &str) -> ArmError {
        self.error(ArmErrorKind::Fault, &format!("{reason}; remove the cause, reset that arm, then this one"))
    }

    fn check_latched(&self) -> Result<(), ArmError> {
        self.latched().map_or(Ok(()), |reason| Err(self.stopped_error(&reason)))
    }

    /// It is at rest where it was enabled, perhaps too near to the other one.
    fn note_enabled(&self) {
        let mut cell = self.cell();
        cell.sides[self.side].last.note_rest();
        cell.held_m = None;
    }

    /// Its range until it stops was known before, and is valid until the next sample.
    fn note_stop(&self) {
        let now = self.clock.now();
        self.cell().sides[self.side].last.note_hold(now);
    }

    /// It is no longer stopped by itself; its latch ends unless the other one is still stopped.
    fn note_reset(&self) -> Result<(), ArmError> {
        let mut cell = self.cell();
        cell.sides[self.side].stopped = None;
        if let Some(reason) = cell.sides[1 - self.side].stopped.clone() {
            let name = cell.sides[1 - self.side].name.clone();
            drop(cell);
            let text = format!("arm {name} is still stopped ({reason}); reset that arm, then this one");
            return Err(self.error(ArmErrorKind::Fault, &text));
        }
        cell.sides[self.side].latched = None;
        cell.sides[self.side].last.note_rest();
        cell.held_m = None;
        Ok(())
    }

    /// Forwards a hold, and stops both arms if they come closer meanwhile.
    fn hold(&mut self, now: MonotonicTime) -> Result<JointState, ArmError> {
        let sample = self.forward(JointCommand::Hold, now)?;
        if self.arm.state() != ArmState::Enabled || self.latched().is_some() {
            return Ok(sample);
        }
        let Some(reason) = self.cell().nearing(self.side) else { return Ok(sample) };
        let mut cell = self.cell();
        cell.stop_both(self.side, &reason);
        cell.sides[self.side].latched.get_or_insert(reason.clone());
        drop(cell);
        Err(self.error(ArmErrorKind::Fault, &format!("{reason}; both arms are stopped")))
    }

    /// Forwards a command and evaluates the result.
    fn forward(&mut self, command: JointCommand, now: MonotonicTime) -> Result<JointState, ArmError> {
        let answer = self.arm.exchange(command);
        let state = self.arm.state();
        // Arms may stop each other by themselves, and faster than this: only the one that failed must be reset first.
        let by_other = self.arm.is_stopped_by_other();
        let mut cell = self.cell();
        let side = &mut cell.sides[self.side];
        match (&answer, command) {
            (Ok(_), JointCommand::Velocity(velocity)) => {
                let set_point = side.set_point(&velocity, now);
                side.last.note_velocity(now, set_point);
            }
            _ => side.last.note_hold(now),
        }
        if let Ok(sample) = &answer
            && sample.position_rad.iter().all(|angle| angle.is_finite())
        {
            side.newest = Some(*sample);
        }
        let (in_force, _) = side.last.at(now, side.cycle, side.newest.as_ref());
        side.sweep = side.sweep(&in_force, now);
        let failure = answer
            .as_ref()
            .err()
            .filter(|error| matches!(error.kind(), ArmErrorKind::Fault | ArmErrorKind::Disconnected));
        match (failure, state) {
            _ if by_other => {}
            (Some(error), _) => cell.stop_both(self.side, &error.to_string()),
            (None, ArmState::Fault) => cell.stop_both(self.side, "it is in a fault"),
            (None, ArmState::EStop) => {
                cell.stop_both(self.side, "an emergency stop, dead-man switch or limit switch stopped it")
            }
            (None, ArmState::Disabled | ArmState::Enabled) => {}
        }
        drop(cell);
        answer
    }
}

impl<A: Arm + ArmPower> Arm for Coupled<A> {
    fn info(&self) -> &ArmInfo {
        self.arm.info()
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let now = self.clock.now();
        let JointCommand::Velocity(velocity) = command else { return self.hold(now) };
        if let Some(reason) = self.latched() {
            self.forward(JointCommand::Hold, now)?;
            return Err(self.stopped_error(&reason));
        }
        if self.cell().sides[self.side].newest.is_none() {
            // Its position has not been measured yet.
            self.forward(JointCommand::Hold, now)?;
        }
        let refusal = {
            let mut cell = self.cell();
            let set_point = cell.sides[self.side].set_point(&velocity, now);
            cell.refusal(self.side, &set_point, now)
        };
        if let Some(reason) = refusal {
            self.forward(JointCommand::Hold, now)?;
            return Err(self.error(ArmErrorKind::Rejected, &format!("{reason}; the arm holds")));
        }
        self.forward(command, now)
    }
}

impl<A: Arm + ArmPower> ArmPower for Coupled<A> {
    fn state(&self) -> ArmState {
        match self.arm.state() {
            ArmState::EStop => ArmState::EStop,
            _ if self.latched().is_some() => ArmState::Fault,
            state => state,
        }
    }

    fn is_stopped_by_other(&self) -> bool {
        let own = &self.cell().sides[self.side];
        own.stopped.is_none() && (own.latched.is_some() || self.arm.is_stopped_by_other())
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        match order {
            PowerOrder::Enable(_) | PowerOrder::BeginEnable(_) | PowerOrder::PollEnable => self.check_latched()?,
            PowerOrder::BeginStop | PowerOrder::Stop => self.note_stop(),
            PowerOrder::Reset if self.latched().is_some() => close_brakes(&mut self.arm)?,
            PowerOrder::Reset => {}
        }
        let progress = self.arm.power(order)?;
        match order {
            PowerOrder::Enable(_) => self.note_enabled(),
            PowerOrder::PollEnable if progress.is_ready() => self.note_enabled(),
            PowerOrder::Reset => self.note_reset()?,
            _ => {}
        }
        Ok(progress)
    }
}

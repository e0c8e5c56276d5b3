//! An arm without hardware: simulated joints behind the state machine of a real arm, with faults on request.
//!
//! The joints are a shared [`JointPlant`], so that a simulated camera sees the same arm; time comes from an injected clock. A
//! caller may advance the shared plant to the present time of the clock, not beyond.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Poll;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_hal_api::{Arm, ArmError, ArmErrorKind, ArmInfo, ArmPower, ArmState, Clock, JointCommand, PowerOrder};
use pb3dp_kinematics::{DOF, JointState, JointVector};
use pb3dp_sim::joint_dynamics::JointPlant;

/// An arm whose joints are all slower than this stands still, rad/s: the brakes close, the drives can be enabled.
const AT_REST_RAD_PER_S: f64 = 1e-3;

/// An arm that still moves after this time never stops.
const STOP_TIMEOUT: Duration = Duration::from_secs(10);

/// Identity of the mock arm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MockArmConfig {
    /// Name for messages: `vs-robot`.
    pub name: String,
    /// Expected time between two exchanges; also the time-out of a lost reply.
    pub cycle: Duration,
    /// The arm stops and latches a fault if a velocity has no successor for longer than this.
    pub command_timeout: Duration,
}

/// A PA-10 without hardware.
pub struct MockArm {
    info: ArmInfo,
    shared: Arc<Shared>,
}

/// Injects faults into a [`MockArm`] from any thread: events of its environment, and an operator at the emergency stop.
#[derive(Clone)]
pub struct MockArmFaults {
    shared: Arc<Shared>,
}

struct Shared {
    config: MockArmConfig,
    plant: Arc<Mutex<JointPlant>>,
    clock: Arc<dyn Clock>,
    control: Mutex<Control>,
}

struct Control {
    state: ArmState,
    /// Cause of the state `Fault`, for messages.
    reason: String,
    /// A fault with a present cause cannot be reset.
    fault_persists: bool,
    e_stop_pressed: bool,
    replies_to_drop: u32,
    /// The link is lost, until a reset finds it connected again.
    unplugged: bool,
    plugged_in: bool,
    /// Time of the last accepted velocity without a successor.
    moving_since: Option<MonotonicTime>,
}

impl MockArm {
    /// A disabled arm with these joints.
    pub fn new(config: MockArmConfig, plant: Arc<Mutex<JointPlant>>, clock: Arc<dyn Clock>) -> Self {
        let control = Control {
            state: ArmState::Disabled,
            reason: String::new(),
            fault_persists: false,
            e_stop_pressed: false,
            replies_to_drop: 0,
            unplugged: false,
            plugged_in: true,
            moving_since: None,
        };
        let info = ArmInfo { name: format!("{} (pa10 mock)", config.name), cycle: config.cycle };
        Self { info, shared: Arc::new(Shared { config, plant, clock, control: Mutex::new(control) }) }
    }

    /// A handle that injects faults into this arm.
    pub fn faults(&self) -> MockArmFaults {
        MockArmFaults { shared: Arc::clone(&self.shared) }
    }

    /// The joints, to share with other observers of this arm.
    pub fn plant(&self) -> Arc<Mutex<JointPlant>> {
        Arc::clone(&self.shared.plant)
    }
}

impl MockArmFaults {
    /// Presses the emergency stop: the arm stops and latches. It stays pressed until [`Self::release_e_stop`].
    pub fn press_e_stop(&self) {
        let mut control = self.shared.control();
        control.e_stop_pressed = true;
        self.shared.latch(&mut control, ArmState::EStop, "the emergency stop was pressed");
    }

    /// Releases the emergency stop; the state stays latched until it is reset.
    pub fn release_e_stop(&self) {
        self.shared.control().e_stop_pressed = false;
    }

    /// A fault of the arm, such as an overcurrent: the arm stops and latches. The cause stays until [`Self::remove_fault_cause`].
    pub fn raise_fault(&self, reason: &str) {
        let mut control = self.shared.control();
        control.fault_persists = true;
        self.shared.latch(&mut control, ArmState::Fault, reason);
    }

    /// The cause of a fault is gone; the state stays latched until it is reset.
    pub fn remove_fault_cause(&self) {
        self.shared.control().fault_persists = false;
    }

    /// Loses the next `count` replies.
    pub fn drop_replies(&self, count: u32) {
        self.shared.control().replies_to_drop = count;
    }

    /// Breaks the link; the arm stops by itself.
    pub fn unplug(&self) {
        let mut control = self.shared.control();
        (control.unplugged, control.plugged_in) = (true, false);
        self.shared.latch(&mut control, ArmState::Fault, "the link broke");
    }

    /// Connects the cable again; a reset restores the link.
    pub fn plug(&self) {
        self.shared.control().plugged_in = true;
    }
}

impl Shared {
    fn control(&self) -> MutexGuard<'_, Control> {
        self.control.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Always locked after `control`, never before it.
    fn plant(&self) -> MutexGuard<'_, JointPlant> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn error(&self, kind: ArmErrorKind, text: impl std::fmt::Display) -> ArmError {
        ArmError::new(kind, format!("arm {} (pa10 mock): {text}", self.config.name))
    }

    /// Stops at once and latches; a fault does not replace an emergency stop.
    fn latch(&self, control: &mut Control, state: ArmState, reason: &str) {
        if control.state != ArmState::EStop {
            control.state = state;
            control.reason = reason.to_owned();
        }
        control.moving_since = None;
        self.halt();
    }

    fn halt(&self) {
        let mut plant = self.plant();
        plant.halt(self.clock.now());
    }

    fn check_link(&self, control: &Control) -> Result<(), ArmError> {
        if control.unplugged {
            return Err(self.error(ArmErrorKind::Disconnected, "the link is gone; check the cable and connect again"));
        }
        Ok(())
    }

    /// The drives detect missing commands by themselves; here it is recorded at the next call.
    fn check_watchdog(&self, control: &mut Control, now: MonotonicTime) {
        let Some(last) = control.moving_since else { return };
        let silent = now.saturating_since(last);
        if silent > self.config.command_timeout {
            let reason = format!("no command for {silent:?}, the limit is {:?}", self.config.command_timeout);
            self.latch(control, ArmState::Fault, &reason);
        }
    }

    /// The velocity for the drives, if the state of the arm accepts the command.
    fn accept(&self, control: &Control, command: JointCommand) -> Result<JointVector, ArmError> {
        let JointCommand::Velocity(velocity) = command else { return Ok(JointVector::zeros()) };
        let limits = *self.plant().config().limits.velocity_max_rad_per_s();
        for joint in 0..DOF {
            let (value, limit) = (velocity[joint], limits[joint]);
            // The margin is rounding.
            if !value.is_finite() || value.abs() > limit * (1.0 + 1e-9) {
                let text =
                    format!("axis {}: command {value} rad/s is not within +-{limit} rad/s; the arm holds", joint + 1);
                return Err(self.error(ArmErrorKind::Rejected, text));
            }
        }
        match control.state {
            ArmState::Enabled => Ok(velocity),
            ArmState::Disabled => Err(self.error(ArmErrorKind::NotEnabled, "disabled; enable it first")),
            ArmState::Fault | ArmState::EStop => Err(self.latched(control)),
        }
    }

    fn latched(&self, control: &Control) -> ArmError {
        self.error(ArmErrorKind::Fault, format!("stopped: {}; remove the cause, then reset", control.reason))
    }
}

impl Arm for MockArm {
    fn info(&self) -> &ArmInfo {
        &self.info
    }

    fn exchange(&mut self, command: JointCommand) -> Result<JointState, ArmError> {
        let shared = &self.shared;
        let mut control = shared.control();
        shared.check_link(&control)?;
        let now = shared.clock.now();
        shared.check_watchdog(&mut control, now);
        let accepted = shared.accept(&control, command);
        let reply_lost = control.replies_to_drop > 0;
        let velocity =
            if reply_lost { JointVector::zeros() } else { *accepted.as_ref().unwrap_or(&JointVector::zeros()) };
        control.replies_to_drop = control.replies_to_drop.saturating_sub(1);
        let moves = velocity != JointVector::zeros();
        control.moving_since = moves.then_some(now);

        let mut plant = shared.plant();
        plant.advance_to(now);
        let measured = plant.state();
        let commanded = if moves {
            plant.command_for(now, velocity, shared.config.command_timeout)
        } else {
            plant.command(now, velocity)
        };
        commanded.map_err(|e| ArmError::caused_by(ArmErrorKind::Rejected, "the joints refused the command", e))?;
        drop((plant, control));

        accepted?;
        if reply_lost {
            shared.clock.sleep_until(now + shared.config.cycle);
            let text = format!("no reply within {:?}; the arm holds", shared.config.cycle);
            return Err(shared.error(ArmErrorKind::Timeout, text));
        }
        Ok(measured)
    }
}

impl ArmPower for MockArm {
    fn state(&self) -> ArmState {
        let mut control = self.shared.control();
        self.shared.check_watchdog(&mut control, self.shared.clock.now());
        control.state
    }

    fn power(&mut self, order: PowerOrder) -> Result<Poll<()>, ArmError> {
        let done = match order {
            PowerOrder::Enable(_) | PowerOrder::BeginEnable(_) => self.enable_drives(),
            PowerOrder::PollEnable | PowerOrder::BeginStop => Ok(()),
            PowerOrder::Stop => self.stop_drives(),
            PowerOrder::Reset => self.clear_latch(),
        };
        done.map(Poll::Ready)
    }
}

impl MockArm {
    fn enable_drives(&self) -> Result<(), ArmError> {
        let shared = &self.shared;
        let mut control = shared.control();
        shared.check_link(&control)?;
        match control.state {
            ArmState::Disabled => {}
            ArmState::Enabled => return Err(shared.error(ArmErrorKind::Rejected, "already enabled")),
            ArmState::Fault | ArmState::EStop => return Err(shared.latched(&control)),
        }
        let mut plant = shared.plant();
        plant.advance_to(shared.clock.now());
        let speed = plant.state().velocity_rad_per_s.amax();
        if speed > AT_REST_RAD_PER_S {
            let text = format!("still moving at {speed} rad/s; wait for it to come to rest, then enable");
            return Err(shared.error(ArmErrorKind::Rejected, text));
        }
        control.state = ArmState::Enabled;
        Ok(())
    }

    fn stop_drives(&self) -> Result<(), ArmError> {
        let shared = &self.shared;
        {
            let mut control = shared.control();
            shared.check_link(&control)?;
            if control.state == ArmState::Enabled {
                control.state = ArmState::Disabled;
            }
            control.moving_since = None;
            shared.halt();
        }
        let deadline = shared.clock.now() + STOP_TIMEOUT;
        loop {
            let now = shared.clock.now();
            let mut plant = shared.plant();
            plant.advance_to(now);
            let speed = plant.state().velocity_rad_per_s.amax();
            drop(plant);
            if speed <= AT_REST_RAD_PER_S {
                return Ok(());
            }
            if now >= deadline {
                let text =
                    format!("still moving at {speed} rad/s {STOP_TIMEOUT:?} after the stop; use the emergency stop");
                return Err(shared.error(ArmErrorKind::Fault, text));
            }
            shared.clock.sleep_until(now + shared.config.cycle.max(Duration::from_millis(1)));
        }
    }

    fn clear_latch(&self) -> Result<(), ArmError> {
        let shared = &self.shared;
        let mut control = shared.control();
        control.unplugged &= !control.plugged_in;
        shared.check_link(&control)?;
        if control.e_stop_pressed {
            return Err(
                shared.error(ArmErrorKind::Fault, "the emergency stop is still pressed; release it, then reset")
            );
        }
        if control.fault_persists {
            let text = format!("the fault is still present ({}); remove its cause, then reset", control.reason);
            return Err(shared.error(ArmErrorKind::Fault, text));
        }
        if matches!(control.state, ArmState::Fault | ArmState::EStop) {
            control.state = ArmState::Disabled;
            control.reason.clear();
        }
        Ok(())
    }
}

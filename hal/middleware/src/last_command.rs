//! The last command to an arm, and how the arm continues it without a successor.

use std::collections::VecDeque;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::{DOF, JointState, JointVector};

use crate::shaping::SetPoint;
use crate::stopping::DriveLimits;

/// Capacity for set-points; with more within the reaction time, the oldest two are merged.
const REMEMBERED_MAX: usize = 128;

/// Fading of a velocity without a successor: all joints by the same factor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandFade {
    /// Age of the command at which fading begins.
    pub begins_after: Duration,
    /// Age at which the velocity is zero.
    pub ends_after: Duration,
}

impl CommandFade {
    /// Remaining part of a set-point of this age. Its decrease is that of the watchdog and not an acceleration to continue with.
    fn of(&self, set_point: &SetPoint, age: Duration) -> SetPoint {
        let left_s = self.ends_after.saturating_sub(age).as_secs_f64();
        let all_s = self.ends_after.saturating_sub(self.begins_after).as_secs_f64();
        let part = if left_s > 0.0 { (left_s / all_s).min(1.0) } else { 0.0 };
        SetPoint { velocity: set_point.velocity * part, acceleration: JointVector::zeros() }
    }
}

/// The last command, and the set-points that the measured angles may not show yet.
pub(crate) struct LastCommand {
    drives: DriveLimits,
    command_timeout: Duration,
    fade: Option<CommandFade>,
    kind: Kind,
    /// Time of the last sent command.
    at: MonotonicTime,
    recent: VecDeque<InForce>,
}

#[derive(Clone, Copy)]
enum Kind {
    Rest,
    Velocity(SetPoint),
    /// The arm's own ramp from this velocity on: each joint separately.
    Hold {
        since: MonotonicTime,
        from_rad_per_s: JointVector,
    },
}

/// Largest speeds downwards and upwards since a time, rad/s, 0 or more.
struct InForce {
    from: MonotonicTime,
    speeds: [JointVector; 2],
}

impl LastCommand {
    /// Starts without a command, for drives with these ramps that stop after this time-out, and fade before it if they do.
    pub(crate) fn new(drives: DriveLimits, command_timeout: Duration, fade: Option<CommandFade>) -> Self {
        Self {
            drives,
            command_timeout,
            fade,
            kind: Kind::Rest,
            at: MonotonicTime::ZERO,
            recent: VecDeque::with_capacity(REMEMBERED_MAX),
        }
    }

    /// The present set-point and its age: at most the command time-out. `first` without a command.
    ///
    /// `measured` shows the position on a ramp of the arm's own.
    pub(crate) fn at(
        &self,
        now: MonotonicTime,
        first: Duration,
        measured: Option<&JointState>,
    ) -> (SetPoint, Duration) {
        let since = now.saturating_since(self.at);
        match self.kind {
            Kind::Rest => (SetPoint::rest(), first),
            Kind::Velocity(set_point) => match self.fade {
                Some(fade) if since > fade.begins_after => (fade.of(&set_point, since), first),
                _ => self.followed(set_point, since, (first, measured)),
            },
            Kind::Hold { since: began, from_rad_per_s } => {
                let ramp = self.ramp(&from_rad_per_s, now.saturating_since(began), measured);
                (ramp, since.min(self.command_timeout))
            }
        }
    }

    /// A velocity that the arm follows until the time-out, and then stops.
    fn followed(
        &self,
        set_point: SetPoint,
        since: Duration,
        (first, measured): (Duration, Option<&JointState>),
    ) -> (SetPoint, Duration) {
        if since <= self.command_timeout {
            return (set_point, since);
        }
        // No command for so long that the arm has stopped by itself.
        (self.ramp(&set_point.velocity, since.saturating_sub(self.command_timeout), measured), first)
    }

    /// State of the arm's own ramp after this time. Some arms stop each joint separately, some all at the same time: between these
    /// two the measured speed is used; without a measurement, the slower ramp.
    fn ramp(&self, from_rad_per_s: &JointVector, elapsed: Duration, measured: Option<&JointState>) -> SetPoint {
        let elapsed_s = elapsed.as_secs_f64();
        let most = &self.drives.acceleration;
        let duration_s = from_rad_per_s.abs().component_div(most).max();
        if elapsed_s >= duration_s {
            return SetPoint::rest();
        }
        let mut ramp = SetPoint::rest();
        for joint in 0..DOF {
            let from = from_rad_per_s[joint];
            let slowest = from.abs() * (1.0 - elapsed_s / duration_s);
            let quickest = (from.abs() - most[joint] * elapsed_s).max(0.0).min(slowest);
            let measured = measured.map_or(f64::INFINITY, |sample| sample.velocity_rad_per_s[joint] * from.signum());
            let speed = measured.clamp(quickest, slowest);
            ramp.velocity[joint] = speed.copysign(from);
            // The ramp ends at rest: only a deceleration that can fade out by then continues, or the joint would turn around.
            let fading = (2.0 * self.drives.jerk[joint] * speed).sqrt();
            ramp.acceleration[joint] = -(from.abs() / duration_s).min(fading).copysign(from);
        }
        ramp
    }

    /// Largest speeds downwards and upwards since a time, rad/s, 0 or more.
    pub(crate) fn peaks_since(&mut self, since: MonotonicTime) -> [JointVector; 2] {
        while self.recent.get(1).is_some_and(|next| next.from <= since) {
            self.recent.pop_front();
        }
        let mut peaks = [JointVector::zeros(); 2];
        for set_point in &self.recent {
            for (peak, speeds) in peaks.iter_mut().zip(&set_point.speeds) {
                *peak = peak.sup(speeds);
            }
        }
        peaks
    }

    pub(crate) fn note_velocity(&mut self, now: MonotonicTime, set_point: SetPoint) {
        self.kind = Kind::Velocity(set_point);
        self.at = now;
        self.remember(now, &set_point.velocity);
    }

    /// The arm holds, by command or after an error.
    pub(crate) fn note_hold(&mut self, now: MonotonicTime) {
        let (in_force, _) = self.at(now, Duration::ZERO, None);
        match self.kind {
            Kind::Hold { .. } if in_force != SetPoint::rest() => {}
            Kind::Hold { .. } | Kind::Rest => self.kind = Kind::Rest,
            Kind::Velocity(_) => self.kind = Kind::Hold { since: now, from_rad_per_s: in_force.velocity },
        }
        self.at = now;
        self.remember(now, &in_force.velocity);
    }

    /// The drives are disabled, or the arm is certainly stationary.
    pub(crate) fn note_rest(&mut self) {
        self.kind = Kind::Rest;
        self.recent.clear();
    }

    fn remember(&mut self, from: MonotonicTime, velocity_rad_per_s: &JointVector) {
        let speeds = [-velocity_rad_per_s, *velocity_rad_per_s].map(|speeds| speeds.map(|speed| speed.max(0.0)));
        if self.recent.len() == REMEMBERED_MAX
            && let Some(oldest) = self.recent.pop_front()
            && let Some(next) = self.recent.front_mut()
        {
            next.from = oldest.from;
            for (kept, speeds) in next.speeds.iter_mut().zip(&oldest.speeds) {
                *kept = kept.sup(speeds);
            }
        }
        self.recent.push_back(InForce { from, speeds });
    }
}

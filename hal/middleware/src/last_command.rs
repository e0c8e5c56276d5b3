//! What an arm was told last, and what it makes of that by itself.

use std::collections::VecDeque;
use std::time::Duration;

use pb3dp_geometry::MonotonicTime;
use pb3dp_kinematics::JointVector;

use crate::shaping::SetPoint;

/// Set-points that are remembered at most. Were there more within the reaction time, the oldest two become one.
const REMEMBERED_MAX: usize = 128;

/// The last command, and the set-points that may not be in the measured angles yet.
pub(crate) struct LastCommand {
    acceleration_max_rad_per_s2: JointVector,
    command_timeout: Duration,
    kind: Kind,
    /// When something was sent last.
    at: MonotonicTime,
    recent: VecDeque<InForce>,
}

#[derive(Clone, Copy)]
enum Kind {
    Rest,
    Velocity(SetPoint),
    /// The arm's own ramp from this velocity on: all joints by the same part.
    Hold {
        since: MonotonicTime,
        from_rad_per_s: JointVector,
    },
}

/// Speeds downwards and upwards that were in force from a moment on, rad/s, 0 or more.
struct InForce {
    from: MonotonicTime,
    speeds: [JointVector; 2],
}

impl LastCommand {
    /// Nothing was sent yet to drives that ramp like this and come to rest by themselves after so long.
    pub(crate) fn new(acceleration_max_rad_per_s2: JointVector, command_timeout: Duration) -> Self {
        Self {
            acceleration_max_rad_per_s2,
            command_timeout,
            kind: Kind::Rest,
            at: MonotonicTime::ZERO,
            recent: VecDeque::with_capacity(REMEMBERED_MAX),
        }
    }

    /// The set-point that is in force, and for how long it was: at most the time-out of commands. `first` if nothing is.
    pub(crate) fn at(&self, now: MonotonicTime, first: Duration) -> (SetPoint, Duration) {
        let since = now.saturating_since(self.at);
        match self.kind {
            Kind::Rest => (SetPoint::rest(), first),
            Kind::Velocity(set_point) if since <= self.command_timeout => (set_point, since),
            // Nobody has told it anything for so long that it came to rest by itself.
            Kind::Velocity(set_point) => (self.ramp(set_point.velocity, since - self.command_timeout), first),
            Kind::Hold { since: began, from_rad_per_s } => {
                (self.ramp(from_rad_per_s, now.saturating_since(began)), since.min(self.command_timeout))
            }
        }
    }

    /// A ramp of the arm's own, so long after its beginning.
    fn ramp(&self, from_rad_per_s: JointVector, elapsed: Duration) -> SetPoint {
        let duration_s = from_rad_per_s.abs().component_div(&self.acceleration_max_rad_per_s2).max();
        let left_s = duration_s - elapsed.as_secs_f64();
        if left_s <= 0.0 {
            return SetPoint::rest();
        }
        let acceleration = from_rad_per_s / -duration_s;
        SetPoint { velocity: acceleration * -left_s, acceleration }
    }

    /// The largest speeds downwards and upwards that were in force since a moment, rad/s, 0 or more.
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

    /// It holds: because it was told to, or because of an error.
    pub(crate) fn note_hold(&mut self, now: MonotonicTime) {
        let (in_force, _) = self.at(now, Duration::ZERO);
        match self.kind {
            Kind::Hold { .. } if in_force != SetPoint::rest() => {}
            Kind::Hold { .. } | Kind::Rest => self.kind = Kind::Rest,
            Kind::Velocity(_) => self.kind = Kind::Hold { since: now, from_rad_per_s: in_force.velocity },
        }
        self.at = now;
        self.remember(now, &in_force.velocity);
    }

    /// Drives off, or at rest for certain.
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

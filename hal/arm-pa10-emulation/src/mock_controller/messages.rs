//! Reaction of the controller to each letter, with the reply.

use pb3dp_arm_pa10_protocol::arcnet::{self, Route};
use pb3dp_arm_pa10_protocol::codec::{
    AngleCounts, ArmReply, Axis, AxisReply, AxisStatus, CommStatus, EepromAxis, Letter, ReplyMessage, ReplyPacket,
    SpeedCounts, TorqueCounts, TorqueScale, WireFormat,
};
use pb3dp_geometry::MonotonicTime;

use super::command::RawCommand;
use super::controller::{ControlMode, MockController};
use super::fault::ReplyFault;

/// As a resolver of a PA-10 has; not used by the emulation.
const RESOLVER_POLES: u16 = 8;

impl MockController {
    /// A packet that has reached the controller.
    pub(super) fn handle_packet(&mut self, now: MonotonicTime, packet: &[u8]) {
        let &[sequence, letter, ref data @ ..] = packet else {
            self.counters.malformed += 1;
            return;
        };
        let understood = match letter {
            b'M' | b'W' | b'P' => {
                self.counters.forbidden += 1;
                return;
            }
            b'T' if !cfg!(feature = "brake-release") => {
                self.counters.forbidden += 1;
                return;
            }
            b'S' if data.is_empty() => Some(self.start()),
            b'E' if data.is_empty() => Some(self.end(now)),
            b'A' if self.config.knows_clear_alarm => self.clear_alarm(data),
            b'R' => self.read_eeprom(data),
            b'C' => self.cyclic(now, data),
            #[cfg(feature = "brake-release")]
            b'T' if data.is_empty() => Some(self.release_brakes(now)),
            _ => None,
        };
        let Some(message) = understood else {
            self.counters.malformed += 1;
            return;
        };
        self.last_message = now;
        self.counters.answered += 1;
        let reply = ReplyPacket { sequence, message }.encode(self.config.format);
        // Replies are created for this format, so they can be encoded.
        if let Ok(frame) = reply.and_then(|packet| arcnet::encode(Route::TO_HOST, &packet)) {
            self.outbox.send(now + self.config.reply_delay, &frame);
        }
    }

    fn start(&mut self) -> ReplyMessage {
        if !self.config.knows_clear_alarm {
            self.panel.clear_all();
        }
        if self.mode == ControlMode::Adjustment {
            self.mode = ControlMode::Control;
            self.watches_dead_man = false;
        }
        ReplyMessage::Done(Letter::Start)
    }

    fn end(&mut self, now: MonotonicTime) -> ReplyMessage {
        self.stop(now);
        ReplyMessage::Done(Letter::End)
    }

    #[cfg(feature = "brake-release")]
    fn release_brakes(&mut self, now: MonotonicTime) -> ReplyMessage {
        self.mode = ControlMode::BrakeRelease;
        let times = self.brake_times();
        self.axes.iter_mut().for_each(|axis| axis.command(now, times, false, false, 0.0));
        ReplyMessage::Done(Letter::ReleaseBrakes)
    }

    /// Clears the alarm of an axis if its cause is gone, and with it that of the controller.
    fn clear_alarm(&mut self, data: &[u8]) -> Option<ReplyMessage> {
        let axis = Axis::from_number(u16::from_be_bytes(data.try_into().ok()?)).ok()?;
        self.panel.servo[axis.index()].clear();
        self.panel.comm.clear();
        Some(ReplyMessage::Done(Letter::ClearAlarm))
    }

    fn read_eeprom(&self, data: &[u8]) -> Option<ReplyMessage> {
        let &[board @ 1..=4, start @ (0 | 32)] = data else { return None };
        let axis = Axis::from_number(u16::from(board) * 2 - 1 + u16::from(start / 32)).ok()?;
        let [negative_limit, positive_limit] = self.limits[axis.index()];
        let poles = RESOLVER_POLES;
        Some(ReplyMessage::Eeprom(EepromAxis { axis, positive_limit, negative_limit, zero_offset_raw: 0, poles }))
    }

    fn cyclic(&mut self, now: MonotonicTime, data: &[u8]) -> Option<ReplyMessage> {
        let Some(command) = RawCommand::decode(self.config.format, data) else {
            // The length of the reply shows the format; the sources do not state whether a controller answers such a command.
            let is_of_other = WireFormat::ALL.into_iter().any(|format| format.command_length() == data.len());
            self.counters.malformed += u64::from(is_of_other);
            return is_of_other.then(|| ReplyMessage::Cyclic(self.measure()));
        };
        self.counters.odd += u64::from(command.is_odd());
        let measured = self.measure();
        if self.mode == ControlMode::Control {
            self.watches_dead_man = command.watches_dead_man;
            self.obey(now, &command, &measured);
            self.watch_dead_man(now);
        }
        let shown = if self.outbox.suffers(ReplyFault::Stale) { self.stale.unwrap_or(measured) } else { measured };
        Some(ReplyMessage::Cyclic(shown))
    }

    fn obey(&mut self, now: MonotonicTime, command: &RawCommand, measured: &ArmReply) {
        let times = self.brake_times();
        let any_alarm = self.panel.servo.iter().any(|memory| memory.shown().is_some());
        for (axis, commanded) in Axis::ALL.into_iter().zip(&command.axes) {
            let index = axis.index();
            let stopped = !self.panel.servo_power
                || self.panel.servo[index].is_tripped()
                || (any_alarm && commanded.stops_with_others);
            if stopped {
                self.axes[index].stop(now, times);
                continue;
            }
            self.counters.released += u64::from(!commanded.brake_on && (!commanded.servo_on || commanded.torque_mode));
            // Torques are not emulated: nothing holds an axis under torque control.
            let servo_on = commanded.servo_on && !commanded.torque_mode;
            let velocity = self.within_limits(axis, measured.axes[index].angle, commanded.velocity_rad_per_s);
            self.axes[index].command(now, times, commanded.brake_on, servo_on, velocity);
        }
    }

    /// The velocity, or 0 if it leads further beyond the limits.
    fn within_limits(&self, axis: Axis, angle: AngleCounts, velocity_rad_per_s: f64) -> f64 {
        let [at_lower, at_upper] = self.at_limits(axis, angle);
        let outwards = (at_upper && velocity_rad_per_s > 0.0) || (at_lower && velocity_rad_per_s < 0.0);
        if outwards { 0.0 } else { velocity_rad_per_s }
    }

    fn at_limits(&self, axis: Axis, angle: AngleCounts) -> [bool; 2] {
        let [lower, upper] = self.limits[axis.index()];
        [angle <= lower, angle >= upper]
    }

    /// The true angle of an axis, as the controller counts it.
    fn counted(&self, axis: Axis, true_rad: f64) -> AngleCounts {
        let counted = AngleCounts::from_rad(axis, true_rad + self.angle_offset_rad[axis.index()]);
        counted.unwrap_or(AngleCounts(i32::MAX))
    }

    /// The present measurement.
    pub(super) fn measure(&self) -> ArmReply {
        let (position, velocity) = self.true_joints();
        let format = self.config.format;
        let scale = TorqueScale::of_format(format);
        let axes = Axis::ALL.map(|axis| {
            let angle = self.counted(axis, position[axis.index()]);
            let [at_lower, at_upper] = self.at_limits(axis, angle);
            let word = self.panel.servo_word(axis, at_upper, at_lower);
            let torque = scale.from_joint_n_m(axis, self.torque_n_m[axis.index()]);
            // The field is limited to 16 bits.
            let counts = (velocity[axis.index()] * 5000.0).round().clamp(f64::from(i16::MIN), f64::from(i16::MAX));
            let (status, speed) = match format {
                WireFormat::LittleEndian5x8 => (AxisStatus::Undocumented(word.0), None),
                WireFormat::BigEndian6x10 => (AxisStatus::Servo(word), Some(SpeedCounts(counts as i16))),
            };
            AxisReply { status, angle, speed, torque: torque.unwrap_or(TorqueCounts(i16::MAX)) }
        });
        let comm = self.panel.comm_word();
        let comm = match format {
            WireFormat::LittleEndian5x8 => CommStatus::Undocumented(comm.0),
            WireFormat::BigEndian6x10 => CommStatus::Comm(comm),
        };
        ArmReply { axes, comm }
    }
}

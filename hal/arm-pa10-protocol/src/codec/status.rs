//! Status words with known meaning.
//!
//! Flags are single bits; alarms are codes in bits 4 to 11. The codes are an enumeration: a test of single bits would take one
//! alarm for another (over-current 0x0E has all bits of the velocity deviation 0x06). Values from Orca. Whether a switch bit means
//! "open" or "pressed" must be looked up on the rig.

use crate::codes::codes;

/// The alarm code within a status word.
const fn code(word: u16) -> u8 {
    ((word & 0x0FF0) >> 4) as u8
}

codes! {
    /// Alarms of one axis.
    ServoAlarm {
        /// Shared memory of the servo board.
        SharedMemory = 0x01, "shared memory";
        /// EEPROM of the servo board.
        Eeprom = 0x02, "EEPROM";
        /// Processor of the servo board.
        Cpu = 0x05, "CPU";
        /// The speed differs from the command.
        VelocityDeviation = 0x06, "velocity deviation";
        /// The two resolvers differ.
        ResolverDeviation = 0x07, "resolver deviation";
        /// Beyond the angle limit.
        PositionLimit = 0x08, "position limit";
        /// Motor torque too large.
        MotorTorque = 0x09, "motor torque";
        /// Power module.
        PowerModule = 0x0A, "power module (IPM)";
        /// Short circuit of the brake.
        BrakeShort = 0x0B, "short circuit of the brake";
        /// Short circuit of the motor's resolver.
        MotorResolverShort = 0x0C, "short circuit of the motor's resolver";
        /// Short circuit of the gear's resolver.
        GearResolverShort = 0x0D, "short circuit of the gear's resolver";
        /// Over-current.
        OverCurrent = 0x0E, "over-current";
        /// Too fast.
        OverVelocity = 0x0F, "over-velocity";
        /// The controller itself calls it unknown.
        Unknown = 0x10, "unknown to the controller";
        /// Emergency stop.
        EmergencyStop = 0x11, "emergency stop";
        /// The dead-man switch was let go.
        DeadManOff = 0x12, "dead-man switch off";
        /// A limit switch opened.
        LimitSwitch = 0x13, "limit switch";
        /// No command came in time.
        CommunicationTimeout = 0xFF, "communication time-out";
    } or Unlisted "alarm"
}

codes! {
    /// Alarms of the controller's communication processor.
    CommAlarm {
        /// EEPROM.
        Eeprom = 0x02, "EEPROM";
        /// The ARCNET chip did not start.
        ArcnetInit = 0x03, "ARCNET start";
        /// Processor.
        Cpu = 0x04, "CPU";
        /// No command came in time.
        HostTimeout = 0x05, "time-out with the host";
        /// Temperature of the power supply.
        PowerTemperature = 0x06, "temperature of the power supply";
        /// The 100 V output.
        Output100V = 0x07, "100 V output";
        /// The controller itself calls it unknown.
        Unknown = 0x10, "unknown to the controller";
        /// Emergency stop.
        EmergencyStop = 0x11, "emergency stop";
        /// The dead-man switch was let go.
        DeadManOff = 0x12, "dead-man switch off";
        /// A limit switch opened.
        LimitSwitch = 0x13, "limit switch";
    } or Unlisted "alarm"
}

/// Status of one axis in format B.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct ServoWord(pub u16);

impl ServoWord {
    /// At the upper angle limit: only motion downwards is sensible. The driver does not act on it: limits are watched by angles,
    /// which both formats tell, before the servo's own limits are reached.
    pub fn at_positive_limit(self) -> bool {
        self.0 & 0x0001 != 0
    }

    /// At the lower angle limit: only motion upwards is sensible.
    pub fn at_negative_limit(self) -> bool {
        self.0 & 0x0002 != 0
    }

    /// The axis does not follow commands.
    pub fn is_uncontrollable(self) -> bool {
        self.0 & 0x4000 != 0
    }

    /// The servo has no power.
    pub fn is_power_off(self) -> bool {
        self.0 & 0x8000 != 0
    }

    /// The alarm, if there is one.
    pub fn alarm(self) -> Option<ServoAlarm> {
        ServoAlarm::from_code(code(self.0))
    }

    /// This word with that alarm, for emulations of a controller.
    #[must_use]
    pub fn with_alarm(self, alarm: ServoAlarm) -> Self {
        Self(self.0 & !0x0FF0 | u16::from(alarm.code()) << 4)
    }
}

/// Status of the communication processor in format B.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct CommWord(pub u16);

impl CommWord {
    /// The dead-man switch is held.
    pub fn is_dead_man_on(self) -> bool {
        self.0 & 0x0001 != 0
    }

    /// The power supply is too warm.
    pub fn is_power_too_warm(self) -> bool {
        self.0 & 0x0002 != 0
    }

    /// The 100 V output is on.
    pub fn is_100_v_output_on(self) -> bool {
        self.0 & 0x0004 != 0
    }

    /// The bit that Orca calls "emergency-stop switch open".
    pub fn is_e_stop_switch_open(self) -> bool {
        self.0 & 0x0008 != 0
    }

    /// The teaching switch.
    pub fn is_teaching_switch_set(self) -> bool {
        self.0 & 0x1000 != 0
    }

    /// The bit that Orca calls "limit switch open".
    pub fn is_limit_switch_open(self) -> bool {
        self.0 & 0x2000 != 0
    }

    /// The arm does not follow commands.
    pub fn is_uncontrollable(self) -> bool {
        self.0 & 0x4000 != 0
    }

    /// The alarm, if there is one.
    pub fn alarm(self) -> Option<CommAlarm> {
        CommAlarm::from_code(code(self.0))
    }

    /// This word with that alarm, for emulations of a controller.
    #[must_use]
    pub fn with_alarm(self, alarm: CommAlarm) -> Self {
        Self(self.0 & !0x0FF0 | u16::from(alarm.code()) << 4)
    }
}

/// Status of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum AxisStatus {
    /// Format A: its bits are explained on page 63 of an operating manual that is not public.
    Undocumented(u16),
    /// Format B.
    Servo(ServoWord),
}

/// Status of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CommStatus {
    /// Format A: meaning not public.
    Undocumented(u16),
    /// Format B.
    Comm(CommWord),
}

impl AxisStatus {
    /// The word as received.
    pub fn word(self) -> u16 {
        match self {
            Self::Undocumented(word) | Self::Servo(ServoWord(word)) => word,
        }
    }
}

impl CommStatus {
    /// The word as received.
    pub fn word(self) -> u16 {
        match self {
            Self::Undocumented(word) | Self::Comm(CommWord(word)) => word,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each bit has one meaning, alone and among all others.
    #[test]
    fn each_bit_of_a_status_word_has_its_own_meaning() {
        let of_comm = |word: CommWord| {
            [
                word.is_dead_man_on(),
                word.is_power_too_warm(),
                word.is_100_v_output_on(),
                word.is_e_stop_switch_open(),
                word.is_teaching_switch_set(),
                word.is_limit_switch_open(),
                word.is_uncontrollable(),
            ]
        };
        let bits = [0x0001, 0x0002, 0x0004, 0x0008, 0x1000, 0x2000, 0x4000];
        for word in (0..16).map(|bit| 1 << bit).flat_map(|bit: u16| [bit, !bit]) {
            assert_eq!(of_comm(CommWord(word)), bits.map(|bit| word & bit != 0), "0x{word:04x}");
        }
        let of_servo = |word: ServoWord| {
            [word.at_positive_limit(), word.at_negative_limit(), word.is_uncontrollable(), word.is_power_off()]
        };
        let bits = [0x0001, 0x0002, 0x4000, 0x8000];
        for word in (0..16).map(|bit| 1 << bit).flat_map(|bit: u16| [bit, !bit]) {
            assert_eq!(of_servo(ServoWord(word)), bits.map(|bit| word & bit != 0), "0x{word:04x}");
        }
    }

    #[test]
    fn an_alarm_replaces_the_one_of_a_word_and_nothing_else() {
        for word in [0x0000, 0x0FF0, 0xF00F, 0xFFFF] {
            let comm = CommWord(word).with_alarm(CommAlarm::EmergencyStop);
            assert_eq!((comm.0, comm.alarm()), (word & 0xF00F | 0x0110, Some(CommAlarm::EmergencyStop)));
            let servo = ServoWord(word).with_alarm(ServoAlarm::EmergencyStop);
            assert_eq!((servo.0, servo.alarm()), (word & 0xF00F | 0x0110, Some(ServoAlarm::EmergencyStop)));
        }
    }
}

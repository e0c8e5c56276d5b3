//! Switches, alarms and the status words that show them (pa10 sources: Orca).

use pb3dp_arm_pa10_protocol::codec::{Axis, CommAlarm, CommWord, ServoAlarm, ServoWord};

const POSITIVE_LIMIT: u16 = 0x0001;
const NEGATIVE_LIMIT: u16 = 0x0002;
const UNCONTROLLABLE: u16 = 0x4000;
const POWER_OFF: u16 = 0x8000;

const DEAD_MAN_ON: u16 = 0x0001;
const POWER_TOO_WARM: u16 = 0x0002;
const OUTPUT_100_V: u16 = 0x0004;
const EMERGENCY_STOP_OPEN: u16 = 0x0008;
const TEACHING: u16 = 0x1000;
const LIMIT_SWITCH_OPEN: u16 = 0x2000;

/// Source of an alarm, the strongest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cause {
    /// The emergency stop.
    EmergencyStop,
    /// A limit switch.
    LimitSwitch,
    /// Anything else.
    Other,
}

impl Cause {
    const COUNT: usize = 3;
}

/// An alarm latches, and cannot be cleared while its cause is present.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct AlarmMemory<A> {
    shown: Option<A>,
    causes: [Option<A>; Cause::COUNT],
    /// The axis or the arm continues.
    only_reported: bool,
}

impl<A: Copy> AlarmMemory<A> {
    const NONE: Self = Self { shown: None, causes: [None; Cause::COUNT], only_reported: false };

    /// An event whose cause is over. The first alarm stays.
    pub fn raise(&mut self, alarm: A) {
        self.shown = self.shown.or(Some(alarm));
        self.only_reported = false;
    }

    /// As [`Self::set_cause`], for an alarm that stops nothing.
    pub fn set_reported_cause(&mut self, alarm: Option<A>) {
        let harmless = self.shown.is_none() || self.only_reported;
        self.set_cause(Cause::Other, alarm);
        self.only_reported = harmless;
    }

    /// Whether an alarm blocks the axis.
    pub fn is_tripped(&self) -> bool {
        self.shown.is_some() && !self.only_reported
    }

    /// A cause appears or disappears.
    pub fn set_cause(&mut self, cause: Cause, alarm: Option<A>) {
        self.causes[cause as usize] = alarm;
        self.shown = alarm.or(self.shown);
        self.only_reported &= alarm.is_none();
    }

    pub fn clear(&mut self) {
        self.shown = self.causes.into_iter().flatten().next();
    }

    pub fn shown(&self) -> Option<A> {
        self.shown
    }
}

/// Switches and alarms of one controller.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Panel {
    pub servo: [AlarmMemory<ServoAlarm>; Axis::COUNT],
    pub comm: AlarmMemory<CommAlarm>,
    pub e_stop_pressed: bool,
    pub dead_man_held: bool,
    pub limit_switch_open: bool,
    pub teaching: bool,
    pub servo_power: bool,
    pub power_too_warm: bool,
}

impl Panel {
    pub fn new() -> Self {
        Self {
            servo: [AlarmMemory::NONE; Axis::COUNT],
            comm: AlarmMemory::NONE,
            e_stop_pressed: false,
            dead_man_held: true,
            limit_switch_open: false,
            teaching: false,
            servo_power: true,
            power_too_warm: false,
        }
    }

    /// The emergency stop, which every axis and the controller show.
    pub fn press_e_stop(&mut self, pressed: bool) {
        self.e_stop_pressed = pressed;
        let (servo, comm) = (pressed.then_some(ServoAlarm::EmergencyStop), pressed.then_some(CommAlarm::EmergencyStop));
        self.servo.iter_mut().for_each(|memory| memory.set_cause(Cause::EmergencyStop, servo));
        self.comm.set_cause(Cause::EmergencyStop, comm);
    }

    /// The same alarm on every axis, and one on the controller, for an event that is over at once.
    pub fn raise_everywhere(&mut self, servo: ServoAlarm, comm: CommAlarm) {
        self.servo.iter_mut().for_each(|memory| memory.raise(servo));
        self.comm.raise(comm);
    }

    pub fn clear_all(&mut self) {
        self.servo.iter_mut().for_each(AlarmMemory::clear);
        self.comm.clear();
    }

    fn is_powered(&self) -> bool {
        self.servo_power && !self.e_stop_pressed
    }

    /// Status word of an axis.
    pub fn servo_word(&self, axis: Axis, at_upper_limit: bool, at_lower_limit: bool) -> ServoWord {
        let memory = &self.servo[axis.index()];
        let mut word = flag(at_upper_limit, POSITIVE_LIMIT) | flag(at_lower_limit, NEGATIVE_LIMIT);
        word |= flag(memory.shown.is_some(), UNCONTROLLABLE) | flag(!self.is_powered(), POWER_OFF);
        let word = ServoWord(word);
        memory.shown.map_or(word, |alarm| word.with_alarm(alarm))
    }

    /// Status word of the controller.
    pub fn comm_word(&self) -> CommWord {
        let mut word = flag(self.dead_man_held, DEAD_MAN_ON) | flag(self.power_too_warm, POWER_TOO_WARM);
        word |= flag(self.is_powered(), OUTPUT_100_V) | flag(self.e_stop_pressed, EMERGENCY_STOP_OPEN);
        word |= flag(self.teaching, TEACHING) | flag(self.limit_switch_open, LIMIT_SWITCH_OPEN);
        word |= flag(self.comm.shown.is_some(), UNCONTROLLABLE);
        let word = CommWord(word);
        self.comm.shown.map_or(word, |alarm| word.with_alarm(alarm))
    }
}

fn flag(set: bool, bit: u16) -> u16 {
    if set { bit } else { 0 }
}

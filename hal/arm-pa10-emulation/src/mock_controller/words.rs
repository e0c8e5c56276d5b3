//! Parses the words of a line to a fault.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::{Axis, CommAlarm, ServoAlarm};

use super::fault::{Fault, LineFault, ReplyFault, Side};

/// The faults other than those of replies, for messages.
const OTHER_NAMES: &str = "delay, deaf, silence, slow, alarm, controller-alarm, e-stop, dead-man, limit-switch, teaching-switch, \
                           power-temperature, servo-power, power, time-out, stuck, runaway, jump, torque, line";

/// Units of time, in seconds.
const TIME_UNITS: [(&str, f64); 5] = [("ns", 1e-9), ("us", 1e-6), ("µs", 1e-6), ("ms", 1e-3), ("s", 1.0)];

/// Three years: more than any clock runs, and exact as a number of microseconds.
const CLOCK_JUMP_MAX: Duration = Duration::from_secs(100_000_000);

/// Why a line is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LineError {
    /// Unknown fault.
    #[error("`{got}` is not a fault; the faults are {}", names())]
    Unknown {
        /// The word found.
        got: String,
    },
    /// The line is incomplete.
    #[error("{what} is missing; write {form}")]
    Missing {
        /// The missing item.
        what: &'static str,
        /// The allowed values.
        form: &'static str,
    },
    /// A word is invalid.
    #[error("{what} is `{got}`; write {form}")]
    Bad {
        /// The expected item.
        what: &'static str,
        /// The word found.
        got: String,
        /// The allowed values.
        form: &'static str,
    },
    /// The line has extra words.
    #[error("unexpected argument `{got}`; remove it")]
    Surplus {
        /// The word found.
        got: String,
    },
}

fn names() -> String {
    let mut names: Vec<_> = ReplyFault::ALL.iter().map(|(_, name)| *name).collect();
    names.push(OTHER_NAMES);
    names.join(", ")
}

/// The words of a line, one after another.
pub(super) struct Words<'a> {
    words: std::str::SplitWhitespace<'a>,
}

impl<'a> Words<'a> {
    /// The words up to a comment.
    pub fn new(line: &'a str) -> Self {
        Self { words: line.split('#').next().unwrap_or_default().split_whitespace() }
    }

    pub fn peek(&self) -> Option<&'a str> {
        self.words.clone().next()
    }

    pub fn skip(&mut self) {
        self.words.next();
    }

    /// The next word, parsed.
    pub fn take<T>(
        &mut self,
        what: &'static str,
        form: &'static str,
        understand: impl FnOnce(&str) -> Option<T>,
    ) -> Result<T, LineError> {
        let word = self.words.next().ok_or(LineError::Missing { what, form })?;
        understand(word).ok_or_else(|| LineError::Bad { what, got: word.to_owned(), form })
    }

    pub fn end(&mut self) -> Result<(), LineError> {
        match self.words.next() {
            Some(got) => Err(LineError::Surplus { got: got.to_owned() }),
            None => Ok(()),
        }
    }

    pub fn duration(&mut self, what: &'static str) -> Result<Duration, LineError> {
        self.take(what, "a time such as 1.5s, 20ms or 300us", parse_time)
    }

    /// Clock step, µs.
    fn jump_us(&mut self) -> Result<i64, LineError> {
        let most = CLOCK_JUMP_MAX.as_secs_f64();
        let understand = |word: &str| number_with_unit(word, &TIME_UNITS).filter(|seconds| seconds.abs() <= most);
        let seconds = self.take("the jump", "a time such as 5s, -3600s or 20ms, of at most three years", understand)?;
        Ok((seconds * 1e6).round() as i64)
    }

    /// One of two words: whether it is the first.
    fn either(&mut self, what: &'static str, form: &'static str, words: [&str; 2]) -> Result<bool, LineError> {
        self.take(what, form, |word| words.iter().position(|known| *known == word).map(|index| index == 0))
    }

    fn on_off(&mut self, what: &'static str) -> Result<bool, LineError> {
        self.either(what, "on or off", ["on", "off"])
    }

    pub fn count(&mut self, what: &'static str) -> Result<u32, LineError> {
        self.take(what, "a whole number such as 3; 0 ends it", |word| word.parse().ok())
    }

    fn axis(&mut self) -> Result<Axis, LineError> {
        self.take("the axis", "1 to 7, from the base", |word| Axis::from_number(word.parse().ok()?).ok())
    }

    /// A code, or `None` for `off`.
    fn code(&mut self) -> Result<Option<u8>, LineError> {
        self.take("the alarm", "its code, such as 0x0e, or off when its cause is gone", |word| match word {
            "off" => Some(None),
            _ => {
                let code = match word.strip_prefix("0x") {
                    Some(digits) => u8::from_str_radix(digits, 16),
                    None => word.parse(),
                };
                code.ok().filter(|code| *code != 0).map(Some)
            }
        })
    }

    fn only_reported(&mut self) -> Result<bool, LineError> {
        if self.peek().is_none() {
            return Ok(false);
        }
        self.take("the last word", "reported, or nothing", |word| (word == "reported").then_some(true))
    }

    /// The fault that the rest of the line describes.
    pub fn fault(&mut self) -> Result<Fault, LineError> {
        let name = self.words.next().ok_or(LineError::Missing { what: "the fault", form: "its name" })?;
        let fault = self.fault_named(name)?;
        self.end()?;
        Ok(fault)
    }

    fn fault_named(&mut self, name: &str) -> Result<Fault, LineError> {
        if let Some((kind, _)) = ReplyFault::ALL.into_iter().find(|(_, known)| *known == name) {
            return Ok(Fault::Reply { kind, count: self.count("the number of replies")? });
        }
        Ok(match name {
            "delay" => Fault::Delay { count: self.count("the number of replies")?, by: self.duration("the delay")? },
            "deaf" => Fault::Deaf { count: self.count("the number of messages")? },
            "silence" => Fault::Silence(self.on_off("silence")?),
            "slow" => Fault::Slow(self.duration("the delay")?),
            "alarm" => {
                let (axis, code) = (self.axis()?, self.code()?);
                let alarm = code.and_then(ServoAlarm::from_code);
                Fault::ServoAlarm { axis, alarm, only_reported: self.only_reported()? }
            }
            "controller-alarm" => {
                let alarm = self.code()?.and_then(CommAlarm::from_code);
                Fault::ControllerAlarm { alarm, only_reported: self.only_reported()? }
            }
            "e-stop" => {
                let pressed = self.either("the emergency stop", "press or release", ["press", "release"])?;
                Fault::EmergencyStop { pressed }
            }
            "dead-man" => {
                Fault::DeadMan { held: self.either("the dead-man switch", "hold or release", ["hold", "release"])? }
            }
            "limit-switch" => {
                Fault::LimitSwitch { open: self.either("the limit switch", "open or close", ["open", "close"])? }
            }
            "teaching-switch" => Fault::TeachingSwitch { on: self.on_off("the teaching switch")? },
            "power-temperature" => {
                let high = self.either("the temperature", "high or normal", ["high", "normal"])?;
                Fault::PowerTemperature { high }
            }
            "servo-power" => Fault::ServoPower { on: self.on_off("the servo power")? },
            "power" => Fault::Power { on: self.on_off("the power")? },
            "time-out" => Fault::TimeOut,
            "stuck" => Fault::Stuck { axis: self.axis()?, on: self.on_off("stuck")? },
            "runaway" => {
                let axis = self.axis()?;
                let form = "a speed such as 0.5rad/s or 30deg/s, or off";
                let velocity_rad_per_s = self.take("the speed", form, |word| match word {
                    "off" => Some(None),
                    _ => number_with_unit(word, &[("rad/s", 1.0), ("deg/s", 1f64.to_radians())]).map(Some),
                })?;
                Fault::Runaway { axis, velocity_rad_per_s }
            }
            "jump" => {
                let axis = self.axis()?;
                let units = [("rad", 1.0), ("deg", 1f64.to_radians())];
                let understand = |word: &str| number_with_unit(word, &units).filter(|rad| rad.abs() <= 1000.0);
                let by_rad = self.take("the angle", "an angle such as 0.02rad or 1.5deg", understand)?;
                Fault::Jump { axis, by_rad }
            }
            "torque" => {
                let axis = self.axis()?;
                let understand = |word: &str| number_with_unit(word, &[("Nm", 1.0)]);
                Fault::Torque { axis, torque_n_m: self.take("the torque", "a torque such as 50Nm", understand)? }
            }
            "line" => Fault::Line(self.line_fault()?),
            _ => return Err(LineError::Unknown { got: name.to_owned() }),
        })
    }

    fn line_fault(&mut self) -> Result<LineFault, LineError> {
        let form = "drop, duplicate, reorder, corrupt, truncate, wrong-arm, delay, slow, silence, deaf, slow-reader, host-clock \
                    or gateway-clock";
        let name = self.take("the fault of the line", form, |word| Some(word.to_owned()))?;
        let any_frame = ReplyFault::ALL.into_iter().filter(|(kind, _)| kind.is_of_any_frame());
        if let Some((kind, _)) = any_frame.into_iter().find(|(_, known)| *known == name) {
            return Ok(LineFault::Answers { kind, count: self.count("the number of frames")? });
        }
        Ok(match name.as_str() {
            "wrong-arm" => LineFault::WrongArm { count: self.count("the number of frames")? },
            "delay" => LineFault::Delay { count: self.count("the number of frames")?, by: self.duration("the delay")? },
            "slow" => LineFault::Slow(self.duration("the delay")?),
            "silence" => LineFault::Silence(self.on_off("silence")?),
            "deaf" => LineFault::Deaf(self.on_off("deaf")?),
            "slow-reader" => {
                let form = "bytes per second such as 600B/s, or off";
                let bytes_per_second = self.take("the rate", form, |word| match word {
                    "off" => Some(None),
                    _ => word.strip_suffix("B/s")?.parse().ok().map(Some),
                })?;
                LineFault::SlowReader { bytes_per_second }
            }
            "host-clock" => LineFault::ClockJump { side: Side::Host, by_us: self.jump_us()? },
            "gateway-clock" => LineFault::ClockJump { side: Side::Gateway, by_us: self.jump_us()? },
            _ => return Err(LineError::Bad { what: "the fault of the line", got: name, form }),
        })
    }
}

/// A time in the notation of scripts: `1.5s`, `20ms`, `300us`; `None` if the text is not a time.
pub fn parse_time(text: &str) -> Option<Duration> {
    Duration::try_from_secs_f64(number_with_unit(text, &TIME_UNITS)?).ok()
}

/// A number with one of these units, in base units.
fn number_with_unit(word: &str, units: &[(&str, f64)]) -> Option<f64> {
    let split = |(unit, factor): &(&str, f64)| {
        // "1e5s" is a number with a unit, "infs" is none.
        let number = word.strip_suffix(unit)?;
        let plain = number.ends_with(|last: char| last.is_ascii_digit() || last == '.');
        let value: f64 = if plain { number.parse().ok()? } else { return None };
        Some(value * factor).filter(|value| value.is_finite())
    };
    units.iter().find_map(split)
}

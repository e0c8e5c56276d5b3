//! Signals in status words: the bits that show an emergency stop, a limit switch, a released dead-man switch or missing power.

use std::num::NonZeroU16;

/// A signal that stops the arm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Signal {
    /// The emergency stop is pressed.
    EmergencyStop,
    /// A limit switch is open.
    LimitSwitch,
    /// The dead-man switch is released.
    DeadMan,
    /// The servos have no power.
    Power,
}

/// A status word of the controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum StatusWord {
    /// That of the controller.
    Controller,
    /// That of each axis: one axis suffices.
    Axes,
}

/// Bits that show a signal: one bit at its level suffices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SignalBits {
    /// Where the bits are.
    pub word: StatusWord,
    /// The bits.
    pub mask: NonZeroU16,
    /// Whether the signal sets the bits, or clears them.
    pub is_set: bool,
}

/// How a signal is noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SignalSource {
    /// Unknown: no brake may open.
    Unknown,
    /// By bits of a status word.
    Bits(SignalBits),
    /// By a wired input of the gateway, which stops the arm by itself.
    Wired,
    /// The arm has no such switch.
    Absent,
}

/// How each signal is noticed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct StatusSignals([SignalSource; Signal::COUNT]);

/// Signals that reach a gateway by wired inputs: one bit each, in the order of [`Signal::ALL`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct WiredSignals(u8);

/// Why a text does not state how a signal is noticed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoSignalSource {
    /// Another form.
    #[error(
        "{0:?} is not the source of a signal: write \"controller 0x0008 set\" (status word \"controller\" or \"axes\", bits, \"set\" or \
         \"clear\"), \"wired\", \"absent\" or \"unknown\""
    )]
    Form(String),
    /// A mask without a bit.
    #[error("{0:?} has no bit: the signal would never be noticed; `pb3dp arm signals` finds the bits")]
    NoBit(String),
}

impl Signal {
    /// Number of signals.
    pub const COUNT: usize = 4;
    /// All signals.
    pub const ALL: [Self; Self::COUNT] = [Self::EmergencyStop, Self::LimitSwitch, Self::DeadMan, Self::Power];

    /// Key in configuration files.
    pub const fn key(self) -> &'static str {
        match self {
            Self::EmergencyStop => "emergency_stop",
            Self::LimitSwitch => "limit_switch",
            Self::DeadMan => "dead_man",
            Self::Power => "power",
        }
    }

    /// Whether an arm may lack the switch.
    pub const fn may_be_absent(self) -> bool {
        matches!(self, Self::LimitSwitch | Self::DeadMan)
    }
}

impl std::fmt::Display for Signal {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::EmergencyStop => "emergency stop",
            Self::LimitSwitch => "limit switch",
            Self::DeadMan => "dead-man switch",
            Self::Power => "servo power",
        })
    }
}

impl SignalBits {
    const fn new(word: StatusWord, mask: u16, is_set: bool) -> Option<Self> {
        match NonZeroU16::new(mask) {
            Some(mask) => Some(Self { word, mask, is_set }),
            None => None,
        }
    }

    /// Whether this word shows the signal.
    pub fn is_shown_by(&self, word: u16) -> bool {
        let level = if self.is_set { word } else { !word };
        level & self.mask.get() != 0
    }
}

impl StatusSignals {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self([SignalSource::Unknown; Signal::COUNT]);

    /// The bits of format B by Orca's header `mhidefs.h`, which the emulation uses in both formats: emergency-stop switch open, limit
    /// switch open, dead-man on, power off. With another polarity on a real arm the brakes do not open.
    pub const ORCA: Self = Self([
        SignalSource::of(StatusWord::Controller, 0x0008, true),
        SignalSource::of(StatusWord::Controller, 0x2000, true),
        SignalSource::of(StatusWord::Controller, 0x0001, false),
        SignalSource::of(StatusWord::Axes, 0x8000, true),
    ]);

    /// The source of a signal.
    pub fn get(&self, signal: Signal) -> SignalSource {
        self.0[signal as usize]
    }

    /// These signals with another source of one.
    #[must_use]
    pub fn with(mut self, signal: Signal, source: SignalSource) -> Self {
        self.0[signal as usize] = source;
        self
    }

    /// The signals with this source.
    pub fn from(&self, source: SignalSource) -> impl Iterator<Item = Signal> {
        let signals = *self;
        Signal::ALL.into_iter().filter(move |signal| signals.get(*signal) == source)
    }

    /// The signals of switches that this word shows: the word of an axis, or that of the controller.
    pub fn shown_by(&self, is_axis: bool, word: u16) -> impl Iterator<Item = Signal> {
        let (signals, kind) = (*self, if is_axis { StatusWord::Axes } else { StatusWord::Controller });
        [Signal::EmergencyStop, Signal::LimitSwitch, Signal::DeadMan].into_iter().filter(move |signal| {
            matches!(signals.get(*signal), SignalSource::Bits(bits) if bits.word == kind && bits.is_shown_by(word))
        })
    }

    /// The signals that nobody would notice.
    pub fn unknown(&self) -> impl Iterator<Item = Signal> {
        self.from(SignalSource::Unknown)
    }
}

impl SignalSource {
    /// Bits of a status word; unknown without a bit.
    const fn of(word: StatusWord, mask: u16, is_set: bool) -> Self {
        match SignalBits::new(word, mask, is_set) {
            Some(bits) => Self::Bits(bits),
            None => Self::Unknown,
        }
    }
}

impl WiredSignals {
    /// The signals in the lower four bits.
    pub fn from_bits(bits: u8) -> Self {
        Self(bits & ((1 << Signal::COUNT) - 1))
    }

    /// One bit for each signal.
    pub fn bits(self) -> u8 {
        self.0
    }

    /// Whether this signal reaches the gateway by a wired input.
    pub fn has(self, signal: Signal) -> bool {
        self.0 >> signal as u8 & 1 == 1
    }
}

impl std::str::FromStr for SignalSource {
    type Err = NoSignalSource;

    fn from_str(text: &str) -> Result<Self, NoSignalSource> {
        let words: Vec<_> = text.split_whitespace().collect();
        let no = || NoSignalSource::Form(text.to_owned());
        match words[..] {
            ["unknown"] => Ok(Self::Unknown),
            ["wired"] => Ok(Self::Wired),
            ["absent"] => Ok(Self::Absent),
            [word, mask, level] => {
                let word = match word {
                    "controller" => StatusWord::Controller,
                    "axes" => StatusWord::Axes,
                    _ => return Err(no()),
                };
                let is_set = match level {
                    "set" => true,
                    "clear" => false,
                    _ => return Err(no()),
                };
                let mask = mask.strip_prefix("0x").and_then(|digits| u16::from_str_radix(digits, 16).ok());
                let bits = SignalBits::new(word, mask.ok_or_else(no)?, is_set);
                bits.map(Self::Bits).ok_or_else(|| NoSignalSource::NoBit(text.to_owned()))
            }
            _ => Err(no()),
        }
    }
}

impl std::fmt::Display for SignalSource {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Unknown => f.write_str("unknown"),
            Self::Wired => f.write_str("wired"),
            Self::Absent => f.write_str("absent"),
            Self::Bits(SignalBits { word, mask, is_set }) => {
                let word = if *word == StatusWord::Controller { "controller" } else { "axes" };
                write!(f, "{word} 0x{mask:04x} {}", if *is_set { "set" } else { "clear" })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_reads_as_it_is_written_and_a_mask_needs_a_bit() {
        for text in ["controller 0x0008 set", "axes 0x8000 clear", "wired", "absent", "unknown"] {
            assert_eq!(text.parse::<SignalSource>().unwrap().to_string(), text);
        }
        assert_eq!(
            "axes 0x0000 set".parse::<SignalSource>().unwrap_err(),
            NoSignalSource::NoBit("axes 0x0000 set".into())
        );
        for wrong in ["", "0x0008", "controller 8 set", "controller 0x10000 set", "arm 0x1 set", "axes 0x1 open"] {
            assert_eq!(wrong.parse::<SignalSource>().unwrap_err(), NoSignalSource::Form(wrong.into()));
        }
    }

    #[test]
    fn one_bit_at_its_level_shows_the_signal() {
        let bits = |text: &str| match text.parse() {
            Ok(SignalSource::Bits(bits)) => bits,
            other => panic!("{other:?}"),
        };
        let (set, clear) = (bits("controller 0x0011 set"), bits("controller 0x0011 clear"));
        assert_eq!([0x0000, 0x0001, 0x0011, 0xFFEE].map(|word| set.is_shown_by(word)), [false, true, true, false]);
        assert_eq!([0x0000, 0x0001, 0x0011, 0xFFFF].map(|word| clear.is_shown_by(word)), [true, true, false, false]);
    }
}

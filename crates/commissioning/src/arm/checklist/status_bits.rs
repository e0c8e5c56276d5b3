//! Which bits of the status words a switch changes.

use pb3dp_arm_pa10::driver::ArmCondition;
use pb3dp_arm_pa10_protocol::codec::{Axis, Signal, SignalBits, SignalSource, StatusWord, WireFormat};

/// Alarm code and "uncontrollable" in the words of format B: they last until an alarm is cleared.
const ALARM_BITS_B: u16 = 0x4FF0;

/// The status words of one measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Words {
    /// Of the controller.
    pub controller: u16,
    /// Of each axis.
    pub axes: [u16; Axis::COUNT],
}

/// The words before, while and after a switch was actuated.
#[derive(Clone, Debug, Default)]
pub struct Observed {
    /// Before.
    pub before: Vec<Words>,
    /// While it was actuated.
    pub during: Vec<Words>,
    /// After.
    pub after: Vec<Words>,
}

/// Bits that show a signal and nothing else, or why there are none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Changes {
    /// Bits that changed and came back, controller before axes, set before cleared.
    pub usable: Vec<SignalBits>,
    /// Bits that changed and did not come back.
    pub not_back: [u16; 2],
    /// Bits that changed by themselves.
    pub unstable: [u16; 2],
}

/// Why no bits can be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Ambiguous {
    /// Nothing changed.
    #[error("no bit of a status word changed")]
    NoBit,
    /// Only bits changed that also change by themselves.
    #[error("only bits changed that also change by themselves (controller 0x{:04x}, axes 0x{:04x})", .0[0], .0[1])]
    BySelf([u16; 2]),
    /// Only bits changed that stayed.
    #[error("only bits changed that did not come back (controller 0x{:04x}, axes 0x{:04x})", .0[0], .0[1])]
    NotBack([u16; 2]),
}

/// The bits for a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// No other signal changes them.
    Own(SignalBits),
    /// This other signal changes them, too.
    Shared(SignalBits, Signal),
}

impl Words {
    /// The words of a measurement.
    pub fn of(condition: &ArmCondition) -> Self {
        Self { controller: condition.comm.word(), axes: condition.axes.map(|status| status.word()) }
    }

    /// Bits that are set in one of the words of this kind, and bits that are set in all of them.
    fn any_and_all(&self, kind: StatusWord) -> [u16; 2] {
        match kind {
            StatusWord::Controller => [self.controller; 2],
            StatusWord::Axes => self.axes.iter().fold([0, !0], |[any, all], word| [any | word, all & word]),
        }
    }

    /// The bits in which two measurements differ.
    fn difference(&self, other: &Self, kind: StatusWord) -> u16 {
        match kind {
            StatusWord::Controller => self.controller ^ other.controller,
            StatusWord::Axes => self.axes.iter().zip(&other.axes).fold(0, |bits, (one, two)| bits | (one ^ two)),
        }
    }
}

impl Observed {
    /// The bits that changed.
    pub fn changes(&self, format: WireFormat) -> Changes {
        let kinds = [StatusWord::Controller, StatusWord::Axes];
        let ignored = if format == WireFormat::BigEndian6x10 { ALARM_BITS_B } else { 0 };
        let between =
            |words: &[Words], kind| words.windows(2).fold(0, |bits, pair| bits | pair[0].difference(&pair[1], kind));
        let unstable = kinds.map(|kind| between(&self.before, kind) | between(&self.after, kind));
        let not_back = kinds.map(|kind| match (self.before.last(), self.after.last()) {
            (Some(before), Some(after)) => before.difference(after, kind),
            _ => !0,
        });
        let usable = kinds.iter().zip(unstable.iter().zip(&not_back)).flat_map(|(kind, (unstable, not_back))| {
            let excluded = ignored | unstable | not_back;
            // Outside the actuation no word may show the signal; during it each measurement has to.
            let calm = self.before.iter().chain(&self.after).map(|words| words.any_and_all(*kind));
            let [never_set, always_set] =
                calm.fold([!0, !0], |[never, always], [any, all]| [never & !any, always & all]);
            let actuated = self.during.iter().map(|words| words.any_and_all(*kind));
            let [set, cleared] = actuated.fold([!0, !0], |[set, cleared], [any, all]| [set & any, cleared & !all]);
            [(never_set & set, "set"), (always_set & cleared, "clear")]
                .map(|(bits, level)| bits_of(*kind, bits & !excluded, level))
        });
        Changes { usable: usable.flatten().collect(), not_back, unstable }
    }
}

/// The bits of a source, if there are any.
fn bits_of(kind: StatusWord, mask: u16, level: &str) -> Option<SignalBits> {
    let mask = std::num::NonZeroU16::new(mask)?;
    Some(SignalBits { word: kind, mask, is_set: level == "set" })
}

impl Changes {
    /// The changes, if one of them can show the signal.
    ///
    /// # Errors
    /// Why none can.
    pub fn check(self) -> Result<Self, Ambiguous> {
        match (self.usable.is_empty(), self.unstable, self.not_back) {
            (false, ..) => Ok(self),
            (true, [0, 0], [0, 0]) => Err(Ambiguous::NoBit),
            (true, [0, 0], stayed) => Err(Ambiguous::NotBack(stayed)),
            (true, unstable, _) => Err(Ambiguous::BySelf(unstable)),
        }
    }

    /// The bits for the signal beside those of other signals: its own ones, or else the first ones. `None` without any.
    pub fn choose<'a>(&self, others: impl Iterator<Item = (Signal, &'a Self)> + Clone) -> Option<Choice> {
        let with = |bits: &SignalBits, other: &Self| {
            let same = |one: &&SignalBits| (one.word, one.is_set) == (bits.word, bits.is_set);
            other.usable.iter().find(same).map_or(0, |one| one.mask.get() & bits.mask.get())
        };
        let own = |bits: &SignalBits| {
            let shared = others.clone().fold(0, |shared, (_, other)| shared | with(bits, other));
            bits_of(bits.word, bits.mask.get() & !shared, if bits.is_set { "set" } else { "clear" })
        };
        if let Some(own) = self.usable.iter().find_map(own) {
            return Some(Choice::Own(own));
        }
        let first = self.usable.first()?;
        let (signal, _) = others.clone().find(|(_, other)| with(first, other) != 0)?;
        Some(Choice::Shared(*first, signal))
    }
}

impl std::fmt::Display for Changes {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let usable: Vec<_> = self.usable.iter().map(|bits| SignalSource::Bits(*bits).to_string()).collect();
        write!(f, "changed: {}", if usable.is_empty() { "nothing usable".to_owned() } else { usable.join(", ") })?;
        for (what, [controller, axes]) in [("stayed", self.not_back), ("changed by itself", self.unstable)] {
            if (controller, axes) != (0, 0) {
                write!(f, "; {what}: controller 0x{controller:04x}, axes 0x{axes:04x}")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: WireFormat = WireFormat::LittleEndian5x8;

    fn words(controller: u16, axes: u16) -> Words {
        Words { controller, axes: [axes; Axis::COUNT] }
    }

    fn observed(before: &[Words], during: Words, after: &[Words]) -> Observed {
        Observed { before: before.to_vec(), during: vec![during; 2], after: after.to_vec() }
    }

    fn texts(changes: &Changes) -> Vec<String> {
        changes.usable.iter().map(|bits| SignalSource::Bits(*bits).to_string()).collect()
    }

    #[test]
    fn bits_that_change_and_come_back_are_found_in_both_directions() {
        let calm = [words(0x0005, 0); 2];
        let mut one_axis = words(0x0008, 0);
        one_axis.axes[3] = 0x0010;
        let changes = observed(&calm, one_axis, &calm).changes(A).check().unwrap();
        assert_eq!(texts(&changes), ["controller 0x0008 set", "controller 0x0005 clear", "axes 0x0010 set"]);
    }

    #[test]
    fn an_ambiguous_result_is_refused() {
        let calm = [words(1, 0); 2];
        let refused =
            |before: &[Words], during, after: &[Words]| observed(before, during, after).changes(A).check().unwrap_err();
        assert_eq!(refused(&calm, calm[0], &calm), Ambiguous::NoBit);
        assert_eq!(refused(&calm, words(9, 0), &[words(9, 0); 2]), Ambiguous::NotBack([8, 0]));
        assert_eq!(refused(&[words(1, 0), words(9, 0), words(1, 0)], words(9, 0), &calm), Ambiguous::BySelf([8, 0]));
        // The other bits remain usable.
        let changes = observed(&calm, words(0x19, 0), &[words(0x11, 0); 2]).changes(A).check().unwrap();
        assert_eq!((texts(&changes), changes.not_back), (vec!["controller 0x0008 set".to_owned()], [0x10, 0]));
    }

    #[test]
    fn alarms_of_format_b_are_no_switches() {
        let calm = [words(1, 0); 2];
        let changes = observed(&calm, words(0x4119, 0xC110), &calm).changes(WireFormat::BigEndian6x10);
        assert_eq!(texts(&changes), ["controller 0x0008 set", "axes 0x8000 set"]);
    }

    #[test]
    fn bits_of_two_causes_need_a_word_of_the_operator() {
        let calm = [words(0x0005, 0); 2];
        let e_stop = observed(&calm, words(0x0009, 0x8000), &calm).changes(A);
        let power = observed(&calm, words(0x0001, 0x8000), &calm).changes(A);
        let source = |choice| match choice {
            Choice::Own(bits) | Choice::Shared(bits, _) => SignalSource::Bits(bits).to_string(),
        };
        let own = e_stop.choose([(Signal::Power, &power)].into_iter()).unwrap();
        assert!(matches!(own, Choice::Own(_)));
        assert_eq!(source(own), "controller 0x0008 set");
        let shared = power.choose([(Signal::EmergencyStop, &e_stop)].into_iter()).unwrap();
        assert!(matches!(shared, Choice::Shared(_, Signal::EmergencyStop)));
        assert_eq!(source(shared), "controller 0x0004 clear");
    }
}

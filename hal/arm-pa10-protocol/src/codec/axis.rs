//! The seven axes and their two ways of being numbered.

use super::CodecError;

/// One axis of a seven-axis arm.
///
/// In memory axes count from 0 at the base, as joints do everywhere in this program; on the wire (alarms to clear) they count
/// from 1. Sources disagree on the names of the axes, so only numbers are ever compared.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Axis {
    index: u8,
}

impl Axis {
    /// Number of axes.
    pub const COUNT: usize = 7;

    /// All axes, from the base on.
    pub const ALL: [Self; Self::COUNT] = {
        let mut all = [Self { index: 0 }; Self::COUNT];
        let mut index = 0;
        while index < Self::COUNT {
            all[index].index = index as u8;
            index += 1;
        }
        all
    };

    /// The axis with this number on the wire, 1 to 7.
    ///
    /// # Errors
    /// If there is no such axis: 0 is none.
    pub fn from_number(number: u16) -> Result<Self, CodecError> {
        let index = usize::from(number).checked_sub(1);
        index.and_then(|index| Self::ALL.get(index)).copied().ok_or(CodecError::AxisNumber { got: number })
    }

    /// The joint, 0 to 6 from the base.
    pub fn index(self) -> usize {
        usize::from(self.index)
    }

    /// The number on the wire, 1 to 7.
    pub fn number(self) -> u8 {
        self.index + 1
    }

    /// The manufacturer's name: S1, S2, S3, E1, E2, W1, W2.
    pub fn name(self) -> &'static str {
        ["S1", "S2", "S3", "E1", "E2", "W1", "W2"][self.index()]
    }
}

impl std::fmt::Display for Axis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "axis {} ({})", self.number(), self.name())
    }
}

impl std::fmt::Debug for Axis {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

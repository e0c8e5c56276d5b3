//! Sequence numbers, by which a reply is known to answer the last message and not an earlier one.

/// After how many messages the sequence number starts again at 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SequenceModulus {
    /// 0 to 0x7F (Orca).
    Modulo128,
    /// 0 to 0xFF (SDU).
    Modulo256,
}

impl SequenceModulus {
    /// The number of a message, from any count of messages.
    pub fn reduce(self, count: u64) -> u8 {
        let mask: u8 = match self {
            Self::Modulo128 => 0x7F,
            Self::Modulo256 => 0xFF,
        };
        count.to_le_bytes()[0] & mask
    }
}

/// Counts messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SequenceCounter {
    modulus: SequenceModulus,
    next: u8,
}

impl SequenceCounter {
    /// Starts at 0.
    pub fn new(modulus: SequenceModulus) -> Self {
        Self { modulus, next: 0 }
    }

    /// The number of the next message: never that of the message before.
    pub fn take(&mut self) -> u8 {
        let taken = self.next;
        self.next = self.modulus.reduce(u64::from(taken) + 1);
        taken
    }
}

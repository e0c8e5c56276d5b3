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
    /// The number of a message, from the count of messages before it.
    pub fn reduce(self, count: u64) -> u8 {
        let mask: u8 = match self {
            Self::Modulo128 => 0x7F,
            Self::Modulo256 => 0xFF,
        };
        count.to_le_bytes()[0] & mask
    }
}

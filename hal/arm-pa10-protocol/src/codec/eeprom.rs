//! The table that each axis has in the EEPROM of its servo board, read only (SDU).
//!
//! Four boards, two axes each; the table of an axis is 32 words. The reply repeats board and start and then holds words of 16
//! bits, little-endian. How long the reply is on a given arm is not known: what is needed must be there.

use super::{AngleCounts, Axis, ByteBuffer, CodecError};

/// Words per axis.
const TABLE_WORDS: u8 = 32;
/// Words up to here are used.
const WORDS_NEEDED: usize = 29;
const POSITIVE_LIMIT: usize = 19;
const NEGATIVE_LIMIT: usize = 21;
const ZERO_OFFSET: usize = 23;
const POLES: usize = 28;
/// A software limit beyond two turns is none.
const LIMIT_MAX_COUNTS: i32 = 2 * super::COUNTS_PER_TURN;

/// What the EEPROM says of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EepromAxis {
    /// Which axis.
    pub axis: Axis,
    /// Upper software limit.
    pub positive_limit: AngleCounts,
    /// Lower software limit.
    pub negative_limit: AngleCounts,
    /// Offset of the mechanical zero, as stored; its unit is not documented.
    pub zero_offset_raw: i32,
    /// Poles of the resolver, as stored.
    pub poles: u16,
}

/// Board (1 to 4) and start (0 or 32) of an axis.
pub(super) fn place(axis: Axis) -> [u8; 2] {
    let index = axis.number() - 1;
    [index / 2 + 1, index % 2 * TABLE_WORDS]
}

/// The axis whose table is at a place.
pub(super) fn axis_at(board: u8, start: u8) -> Result<Axis, CodecError> {
    let found = Axis::ALL.into_iter().find(|axis| place(*axis) == [board, start]);
    found.ok_or(CodecError::EepromPlace { board, start })
}

impl EepromAxis {
    pub(super) fn encode<const LENGTH_MAX: usize>(&self, out: &mut ByteBuffer<LENGTH_MAX>) {
        let mut words = [0u16; TABLE_WORDS as usize];
        [words[POSITIVE_LIMIT], words[POSITIVE_LIMIT + 1]] = high_first(self.positive_limit.0);
        [words[NEGATIVE_LIMIT], words[NEGATIVE_LIMIT + 1]] = high_first(self.negative_limit.0);
        [words[ZERO_OFFSET + 1], words[ZERO_OFFSET]] = high_first(self.zero_offset_raw);
        words[POLES] = self.poles;
        out.extend(&place(self.axis));
        for word in words {
            out.extend(&word.to_le_bytes());
        }
    }

    pub(super) fn decode(asked: Axis, data: &[u8]) -> Result<Self, CodecError> {
        let expected = 2 + 2 * WORDS_NEEDED;
        if data.len() < expected {
            return Err(CodecError::Length { letter: 'R', got: data.len(), expected });
        }
        if data[..2] != place(asked) {
            return Err(CodecError::EepromOfOtherAxis { axis: asked, board: data[0], start: data[1] });
        }
        let word = |index: usize| u16::from_le_bytes([data[2 + 2 * index], data[3 + 2 * index]]);
        let read = Self {
            axis: asked,
            positive_limit: AngleCounts(from_words(word(POSITIVE_LIMIT), word(POSITIVE_LIMIT + 1))),
            negative_limit: AngleCounts(from_words(word(NEGATIVE_LIMIT), word(NEGATIVE_LIMIT + 1))),
            zero_offset_raw: from_words(word(ZERO_OFFSET + 1), word(ZERO_OFFSET)),
            poles: word(POLES),
        };
        let (low, high) = (read.negative_limit, read.positive_limit);
        if !(low.0 < 0 && high.0 > 0 && low.0 >= -LIMIT_MAX_COUNTS && high.0 <= LIMIT_MAX_COUNTS) {
            let (negative_deg, positive_deg) = (low.to_rad().to_degrees(), high.to_rad().to_degrees());
            return Err(CodecError::EepromLimits { axis: asked, negative_deg, positive_deg });
        }
        Ok(read)
    }
}

/// Two words of a 32-bit number, the high one first.
fn high_first(value: i32) -> [u16; 2] {
    let bytes = value.to_be_bytes();
    [u16::from_be_bytes([bytes[0], bytes[1]]), u16::from_be_bytes([bytes[2], bytes[3]])]
}

fn from_words(high: u16, low: u16) -> i32 {
    ((u32::from(high) << 16) | u32::from(low)).cast_signed()
}

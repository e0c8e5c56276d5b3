//! The values of an image with more than 8 bits that become black and white.

use std::fmt;
use std::str::FromStr;

/// The values that become 0 and 255.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ValueRange {
    low: u16,
    high: u16,
}

/// A text that is no range.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{text:?} is no range of values: write LOW,HIGH with 0 <= LOW < HIGH <= 65535, such as 0,4095 for a camera with 12 bits"
)]
pub struct WrongRange {
    text: String,
}

impl ValueRange {
    /// All values.
    pub const FULL: Self = Self { low: 0, high: u16::MAX };

    /// The range from one value to a higher one; `None` otherwise.
    pub fn new(low: u16, high: u16) -> Option<Self> {
        (low < high).then_some(Self { low, high })
    }

    /// The value that becomes 0.
    pub fn low(self) -> u16 {
        self.low
    }

    /// The value that becomes 255.
    pub fn high(self) -> u16 {
        self.high
    }

    /// The 8-bit value of a 16-bit value: the nearest one, 0 below the range and 255 above it.
    pub fn shades(self) -> impl Fn(u16) -> u8 + Copy {
        let scale = 255.0 / f64::from(self.high - self.low);
        // Not `round`, which vector registers do not have. The conversion ends at 255.
        move |value| (f64::from(value.saturating_sub(self.low)) * scale + 0.5) as u8
    }

    /// The 8-bit value of each 16-bit value.
    pub fn table(self) -> Vec<u8> {
        (0..=u16::MAX).map(self.shades()).collect()
    }
}

impl fmt::Display for ValueRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{},{}", self.low, self.high)
    }
}

impl FromStr for ValueRange {
    type Err = WrongRange;

    fn from_str(text: &str) -> Result<Self, WrongRange> {
        let ends =
            text.split_once(',').and_then(|(low, high)| Some((low.trim().parse().ok()?, high.trim().parse().ok()?)));
        ends.and_then(|(low, high)| Self::new(low, high)).ok_or_else(|| WrongRange { text: text.to_owned() })
    }
}

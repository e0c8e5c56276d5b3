//! Stable codes of messages.
//!
//! A message says what is wrong this time, with its value and its limit. Its code stays the same in every release and leads to the cause and
//! the remedy: `pb3dp explain CODE`, and the page docs/reference/messages.md, which is made from the tables of [`codes!`].
//!
//! ```
//! use pb3dp_message_codes::{Coded, codes};
//!
//! enum LensError {
//!     Covered,
//!     Blurred { pixels: f64 },
//! }
//!
//! codes! {
//!     LensError, "Lens" {
//!         Covered = "PB3DP-LENS-001": "The lens cap is on."; "Take it off.";
//!         Blurred = "PB3DP-LENS-002": "The lens is out of focus."; "Focus it, then calibrate again.";
//!     }
//! }
//!
//! assert_eq!(LensError::Blurred { pixels: 3.0 }.message_code().code, "PB3DP-LENS-002");
//! assert_eq!(LensError::CODES.len(), 2);
//! ```

/// The code of a message, with what a person needs to act on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageCode {
    /// `PB3DP-`, the area, and a number in this area. A code that is no longer used is never given to another message.
    pub code: &'static str,
    /// What happened.
    pub cause: &'static str,
    /// What to do about it.
    pub remedy: &'static str,
}

/// A type whose values are messages with codes.
pub trait Coded {
    /// What these messages are about: the heading of their table in the reference.
    const TITLE: &'static str;
    /// The codes of all values.
    const CODES: &'static [MessageCode];

    /// The code of this value.
    fn message_code(&self) -> &'static MessageCode;
}

/// Gives each variant of an enum its code, cause and remedy. A variant without a code does not compile.
#[macro_export]
macro_rules! codes {
    ($type:ty, $title:literal { $($variant:ident = $code:literal: $cause:literal; $remedy:literal;)+ }) => {
        impl $crate::Coded for $type {
            const TITLE: &'static str = $title;
            const CODES: &'static [$crate::MessageCode] =
                &[$($crate::MessageCode { code: $code, cause: $cause, remedy: $remedy }),+];

            fn message_code(&self) -> &'static $crate::MessageCode {
                match self {
                    $(Self::$variant { .. } => {
                        &const { $crate::MessageCode { code: $code, cause: $cause, remedy: $remedy } }
                    })+
                }
            }
        }
    };
}

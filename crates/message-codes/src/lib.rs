//! Stable codes of messages, and the [arguments](Argument) that messages ask for.
//!
//! A message states the present problem with value and limit. Its code is the same in every release and leads to cause and remedy: `pb3dp
//! explain CODE`, and the page docs/reference/messages.md, generated from the tables of [`codes!`].
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

mod argument;

pub use argument::{Argument, spell_arguments};

/// The code of a message, with its cause and remedy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageCode {
    /// `PB3DP-`, the area, and a number within the area. A retired code is never used for another message.
    pub code: &'static str,
    /// Cause of the message.
    pub cause: &'static str,
    /// Remedy.
    pub remedy: &'static str,
}

/// A type whose values are messages with codes.
pub trait Coded {
    /// Subject of these messages: heading of their table in the reference.
    const TITLE: &'static str;
    /// The codes of all values.
    const CODES: &'static [MessageCode];

    /// The code of this value.
    fn message_code(&self) -> &'static MessageCode;
}

/// Assigns code, cause and remedy to each variant of an enum. A variant without a code does not compile.
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

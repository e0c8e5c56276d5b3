//! Numbers of the wires that stand for something.

/// An enumeration of the numbers that a table names. A number that it does not name has no value, unless a variant for such numbers
/// follows the table: then 0 alone has none, and what is shown tells kind and number besides.
macro_rules! codes {
    ($(#[$doc:meta])* $name:ident { $($(#[$variant_doc:meta])* $variant:ident = $code:literal, $text:literal;)* }
        $(or $other:ident $kind:literal)?
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[$variant_doc])* $variant,)*
            $(
                /// A number that no source lists.
                $other(u8),
            )?
        }

        impl $name {
            /// All that have a name.
            pub const LISTED: &[Self] = &[$(Self::$variant,)*];

            /// What a number on the wire stands for.
            pub const fn from_code(code: u8) -> Option<Self> {
                match code {
                    $($code => Some(Self::$variant),)*
                    $(1.. => Some(Self::$other(code)),)?
                    _ => None,
                }
            }

            /// The number on the wire.
            pub const fn code(self) -> u8 {
                match self {
                    $(Self::$variant => $code,)*
                    $(Self::$other(code) => code,)?
                }
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                let text = match self {
                    $(Self::$variant => $text,)*
                    $(Self::$other(_) => "not listed in any source",)?
                };
                $(let text = format_args!("{} 0x{:02x} ({text})", $kind, self.code());)?
                write!(f, "{text}")
            }
        }
    };
}
pub(crate) use codes;

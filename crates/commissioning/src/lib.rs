//! The commands of one arm: `pb3dp arm`, `pb3dp gateway`, `pb3dp mock-arm`.

pub mod arm;
pub mod gateway;
pub mod mock_arm;

/// What commands have to know of the program that runs them.
#[derive(Clone, Copy, Debug)]
pub struct Program {
    /// The commit that it was built from, for reports.
    pub commit: &'static str,
    /// Writes what is left of the log; called before the program ends at once.
    pub last_words: fn(),
}

//! The commands of one arm: `pb3dp arm`, `pb3dp gateway`, `pb3dp mock-arm`.

pub mod arm;
pub mod commissioned;
pub mod gateway;
pub mod mock_arm;

/// Facts about the running program.
#[derive(Clone, Copy, Debug)]
pub struct Program {
    /// Commit that it was built from, for reports.
    pub commit: &'static str,
    /// Flushes the log; called before the program ends at once.
    pub final_flush: fn(),
}

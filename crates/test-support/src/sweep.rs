//! Sweeps in two sizes.

/// The variable with which `cargo xtask test --all` asks for the long sweeps.
const LONG_TESTS: &str = "PB3DP_LONG_TESTS";

/// The size of a sweep: the second where long sweeps are wanted (`cargo xtask test --all`, or the variable `PB3DP_LONG_TESTS`), else the
/// first, which every run of the tests pays for.
pub fn sweep<T>(short: T, long: T) -> T {
    if std::env::var_os(LONG_TESTS).is_some() { long } else { short }
}

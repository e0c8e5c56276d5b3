//! Test sweeps in two sizes.

/// The environment variable with which `cargo xtask test --all` requests the long sweeps.
const LONG_TESTS: &str = "PB3DP_LONG_TESTS";

/// The size of a sweep: `long` if long sweeps are requested (`cargo xtask test --all`, or the variable `PB3DP_LONG_TESTS`),
/// otherwise `short`, which every test run executes.
pub fn sweep<T>(short: T, long: T) -> T {
    if std::env::var_os(LONG_TESTS).is_some() { long } else { short }
}

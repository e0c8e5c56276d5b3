//! Test sweeps in two sizes.

/// The environment variable with which `cargo xtask test --all` requests the long sweeps.
const LONG_TESTS: &str = "PB3DP_LONG_TESTS";

/// The size of a sweep: `long` if long sweeps are requested (`cargo xtask test --all`, or the variable `PB3DP_LONG_TESTS`),
/// otherwise `short`, which every test run executes.
///
/// A number in the variable multiplies the scenes of sweeps that ask for it, see [`scenes`].
pub fn sweep<T>(short: T, long: T) -> T {
    if std::env::var_os(LONG_TESTS).is_some() { long } else { short }
}

/// `count` random scenes from `first` on, or as many times that number as the variable says: `PB3DP_LONG_TESTS=10` for ten times as many.
pub fn scenes(first: u64, count: u64) -> std::ops::Range<u64> {
    let times = std::env::var(LONG_TESTS).ok().and_then(|text| text.parse::<u64>().ok());
    first..first + count * times.unwrap_or(1).max(1)
}

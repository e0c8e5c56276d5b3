//! Integration tests of the file formats.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

mod calibration_files;
mod calibration_refusals;
mod dataset;
mod hand_eye_file;
mod judged_calibration;
mod stops;

/// Each change of a good text is refused with the words beside it.
fn check_changes(good: &str, changes: &[(&str, &str, &str)], refusal: impl Fn(&str) -> String) {
    for (from, to, named) in changes {
        assert!(good.contains(from), "{from} in\n{good}");
        let error = refusal(&good.replacen(from, to, 1));
        assert!(error.contains(named), "{to}: {error}");
    }
}

//! Messages name the options of the program, as its output does; the package names its own arguments instead.

use pb3dp_wiring::message_codes::{Argument, option_of};

/// The argument, or the method, for what a message asks for.
fn in_package(argument: Argument) -> &'static str {
    match argument {
        Argument::DepthRange => "z_range_m",
        Argument::TiltLimit => "tilt_max_rad",
        Argument::VisibleSurface => "Estimator.visible_surface",
        Argument::Skew => "skew_s",
        Argument::Rectified => "rectified=True",
    }
}

/// Options in messages about files and setups, and the arguments in their place. An option with its value comes before the same one without.
const ARGUMENTS: [(&str, &str); 21] = [
    ("--topics LEFT,RIGHT", "topics=(LEFT, RIGHT)"),
    ("--range LOW,HIGH", "value_range=(LOW, HIGH)"),
    ("--calib FILE", "calibration=[FILE]"),
    ("--calib", "calibration=[FILE]"),
    ("--calib-unit mm", "calibration_unit=\"mm\""),
    ("--calib-unit cm", "calibration_unit=\"cm\""),
    ("--calib-unit m", "calibration_unit=\"m\""),
    ("--calib-unit", "calibration_unit"),
    ("--calib-size", "calibrated_size"),
    ("--calib-lens brown", "lens=\"brown\""),
    ("--calib-lens equidistant", "lens=\"equidistant\""),
    ("--calib-lens", "lens"),
    ("--pair-within", "pair_within_s"),
    ("--rate", "rate_hz"),
    ("--range", "value_range"),
    ("--segment 1", "segment=1"),
    ("--segment 2", "segment=2"),
    ("--segment", "segment"),
    ("--region", "region"),
    ("--config", "config"),
    ("--set", "settings"),
];

/// A message for a caller in Python.
pub fn in_python(message: &str) -> String {
    let asked_for = Argument::ALL.map(|argument| (option_of(argument), in_package(argument)));
    let arguments = ARGUMENTS.iter().chain(&asked_for);
    arguments.fold(message.to_owned(), |text, (option, argument)| replaced(&text, option, argument))
}

/// Replaces an option where it is a word of its own, and not a part of a file name or of a longer option.
fn replaced(text: &str, option: &str, argument: &str) -> String {
    let (mut out, mut rest) = (String::with_capacity(text.len()), text);
    while let Some(at) = rest.find(option) {
        let (before, after) = (&rest[..at], &rest[at + option.len()..]);
        let begins = before.chars().next_back().is_none_or(|c| c.is_whitespace() || "(`".contains(c));
        let ends = !after.starts_with(|c: char| c.is_alphanumeric() || "-_/".contains(c));
        out += before;
        out += if begins && ends { argument } else { option };
        rest = after;
    }
    out + rest
}

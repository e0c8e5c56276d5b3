//! Messages of the library name options of the program; the package names its own arguments instead.

/// Options in messages, and the arguments in their place. An option with its value comes before the same one without.
const ARGUMENTS: [(&str, &str); 26] = [
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
    ("--rectified", "rectified=True"),
    ("--pair-within", "pair_within_s"),
    ("--skew", "skew_s"),
    ("--rate", "rate_hz"),
    ("--range", "value_range"),
    ("--segment 1", "segment=1"),
    ("--segment 2", "segment=2"),
    ("--segment", "segment"),
    ("--z-range", "z_range_m"),
    ("--tilt-max", "tilt_max_rad"),
    ("--region", "region"),
    ("--surface", "Estimator.visible_surface"),
    ("--config", "config"),
    ("--set", "settings"),
];

/// A message for a caller in Python.
pub fn in_python(message: &str) -> String {
    ARGUMENTS.iter().fold(message.to_owned(), |text, (option, argument)| replaced(&text, option, argument))
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

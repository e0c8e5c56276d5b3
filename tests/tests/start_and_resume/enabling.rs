//! Arms that cannot be enabled again after a stop.

use super::*;

/// The answer and the refusal name the arm whose drives do not answer, not the first of two disabled ones.
#[test]
fn an_arm_that_cannot_be_enabled_is_named() {
    let more = [
        (3.0, OperatorCommand::Stop),
        (3.5, OperatorCommand::Reset),
        (4.0, OperatorCommand::Select),
        (5.0, OperatorCommand::Start),
        (6.0, OperatorCommand::Select),
        (7.0, OperatorCommand::Start),
    ];
    let seen = Scene { tc_enables_again_s: 5.5, ..scene(&more, &[]) }.run(9.0);
    let told = |text: &str| seen.trouble.iter().position(|told| told.contains(text));
    let failed = told("enabling failed: tc-robot: enable: ").unwrap_or_else(|| panic!("{:?}", seen.trouble));
    assert!(seen.trouble[failed].ends_with("both arms are stopped; remove the cause, then use select"));
    assert!(told("start refused: both arms: drives disabled") > Some(failed), "{:?}", seen.trouble);
    assert_eq!(told("vs-robot: drives disabled"), None, "{:?}", seen.trouble);
    seen.stops(3.0, 7.0);
    seen.ends_following();
}

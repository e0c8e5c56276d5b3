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
    let run = Scene { tc_enables_again_s: 5.5, ..scene(&more, &[]) }.run(9.0);
    let troubles = |text: &str| run.trouble.iter().position(|troubles| troubles.contains(text));
    let failed = troubles("enabling failed: tc-robot: enable: ").unwrap_or_else(|| panic!("{:?}", run.trouble));
    assert!(run.trouble[failed].ends_with("both arms are stopped; remove the cause, then use select"));
    assert!(troubles("start refused: both arms: drives disabled") > Some(failed), "{:?}", run.trouble);
    assert_eq!(troubles("vs-robot: drives disabled"), None, "{:?}", run.trouble);
    run.stops(3.0, 7.0);
    run.ends_following();
}

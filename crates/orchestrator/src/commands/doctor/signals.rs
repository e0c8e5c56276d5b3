//! The signals of the arms: without them a run opens no brake.

use super::needs::Needs;
use pb3dp_cell::finding::Finding;

pub(super) fn check(needs: &Needs) -> Option<Finding> {
    const CHECK: &str = "signals of the arms";
    let unknown = needs.unknown_signals.as_ref()?;
    Some(match unknown[..] {
        [] => Finding::pass(CHECK, "every signal is noticed"),
        _ => Finding::fail(
            CHECK,
            format!("\"unknown\", so no brake opens: {}", unknown.join(", ")),
            "learn them with closed brakes: pb3dp arm signals (docs/commissioning.md)",
        ),
    })
}

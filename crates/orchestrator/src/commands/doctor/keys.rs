//! Keys of lines by TCP.

use super::needs::Needs;
use pb3dp_cell::finding::Finding;

/// Whether the key files can be used, if there is a line by TCP.
pub(super) fn check(needs: &Needs) -> Option<Finding> {
    const CHECK: &str = "key files";
    let advice = "as the message says; if another user runs the gateway or pb3dp, check as that user (docs/gateway.md)";
    Some(match needs.keys.as_ref()? {
        Ok(()) => Finding::pass(CHECK, "the keys of the TCP lines can be used"),
        Err(why) => Finding::fail(CHECK, why, advice),
    })
}

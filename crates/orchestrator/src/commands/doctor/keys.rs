//! Keys of lines by TCP, and sockets between host and gateway on one computer.

use super::needs::Needs;
use pb3dp_cell::finding::Finding;

/// Whether key files and sockets can be used, if there are lines that need them.
pub(super) fn check(needs: &Needs) -> Vec<Finding> {
    let found = [
        (
            "key files",
            &needs.keys,
            "the keys of the TCP lines can be used",
            "as the message says; if another user runs the gateway or pb3dp, check as that user (docs/gateway.md)",
        ),
        (
            "local sockets",
            &needs.sockets,
            "the sockets between host and gateway can be used",
            "as the message says, and start the gateway before the host (docs/gateway.md)",
        ),
    ];
    let finding = |(check, result, good, advice): (_, &Option<Result<(), String>>, _, _)| {
        Some(match result.as_ref()? {
            Ok(()) => Finding::pass(check, good),
            Err(why) => Finding::fail(check, why, advice),
        })
    };
    found.into_iter().filter_map(finding).collect()
}

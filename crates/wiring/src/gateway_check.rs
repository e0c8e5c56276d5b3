//! Gateway properties from its HELLO reply, for the log.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{Geometry, HelloReply};

/// Logs which gateway and arm answered, and warns of properties that cannot be compared.
pub(super) fn tell(name: &str, configured: Geometry, hello: &HelloReply) {
    let ms = |us: u32| f64::from(us) / 1e3;
    let format =
        hello.wire_format.map_or("wire format unknown yet".to_owned(), |format: WireFormat| format.to_string());
    let controller = match hello.controller_watchdog_us {
        0 => "unknown".to_owned(),
        us => format!("{} ms", ms(us)),
    };
    tracing::info!(
        "{name}: gateway {:?}, {format}, geometry {}, {}; slower after {} ms without a command, stopped after {} ms, the \
         controller's watchdog {controller}, brakes {} ms",
        hello.firmware.as_str(),
        hello.geometry,
        hello.state,
        ms(hello.ramp_after_us),
        ms(hello.stop_after_us),
        ms(hello.brake_release_us)
    );
    if let Some(doubt) = geometry_doubt(configured, hello.geometry) {
        tracing::warn!("{name}: {doubt}");
    }
}

/// Refusal if the gateway stops the arm later than the limiter assumes.
pub fn watchdog_refusal(command_timeout: Duration, hello: &HelloReply) -> Option<String> {
    let stop_after = Duration::from_micros(u64::from(hello.stop_after_us));
    (stop_after > command_timeout).then(|| {
        format!(
            "the gateway stops the arm {stop_after:?} after the last command, limit {command_timeout:?} (command_timeout_millis of \
             the arm, which the limiter assumes): raise command_timeout_millis, or lower stop_after_millis in the gateway's \
             file"
        )
    })
}

/// Warning if the configuration or the gateway does not state the geometry.
pub fn geometry_doubt(configured: Geometry, reported: Geometry) -> Option<&'static str> {
    match (configured, reported) {
        (Geometry::Unknown, Geometry::Unknown) => Some(
            "the arm geometry is set neither in the configuration nor at the gateway, so the lengths of the robot description are \
             not checked: measure the arm, then set geometry on both sides",
        ),
        (Geometry::Unknown, _) => Some(
            "the arm geometry is not set in the configuration, so the geometry of the gateway and the lengths of the robot \
             description are not checked: measure the arm, then set geometry",
        ),
        (_, Geometry::Unknown) => Some(
            "the arm geometry is not set at the gateway, so a gateway at an arm of the other generation is not detected: set \
             geometry in the gateway's file",
        ),
        _ => None,
    }
}

//! What a gateway said of itself, for the log of whoever connects to it.

use std::time::Duration;

use pb3dp_arm_pa10_protocol::codec::WireFormat;
use pb3dp_arm_pa10_protocol::gateway_protocol::{Geometry, HelloReply};
use pb3dp_setup::setup::BusLinkConfig;

/// Writes down which gateway and arm answered, and warns of what nobody compares.
pub(super) fn tell(name: &str, configured: Geometry, hello: &HelloReply) {
    let ms = |us: u32| f64::from(us) / 1e3;
    let format =
        hello.wire_format.map_or("a wire format not seen yet".to_owned(), |format: WireFormat| format.to_string());
    let controller = match hello.controller_watchdog_us {
        0 => "not known".to_owned(),
        us => format!("{} ms", ms(us)),
    };
    tracing::info!(
        "{name}: gateway {:?}, {}, {format}, geometry {}, {}; slower after {} ms without a command, stopped after {} ms, the \
         controller's watchdog {controller}, brakes {} ms",
        hello.firmware.as_str(),
        hello.dialect,
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

/// Why an arm may not move behind this gateway, if it may not: it would go on for longer than the limiter leaves room for.
pub fn watchdog_refusal(command_timeout: Duration, hello: &HelloReply) -> Option<String> {
    let stop_after = Duration::from_micros(u64::from(hello.stop_after_us));
    (stop_after > command_timeout).then(|| {
        format!(
            "the gateway stops the arm {stop_after:?} after the last command, command_timeout_millis of the arm says \
             {command_timeout:?}, and the limiter leaves no more room than that: raise it, or lower stop_after_millis in the gateway's \
             file"
        )
    })
}

/// What is not compared, if the configuration or the gateway does not know the geometry.
pub fn geometry_doubt(configured: Geometry, told: Geometry) -> Option<&'static str> {
    match (configured, told) {
        (Geometry::Unknown, Geometry::Unknown) => Some(
            "neither the configuration nor the gateway knows the geometry of the arm, so the lengths of the robot description are \
             compared with nothing: measure the arm, then set geometry on both sides",
        ),
        (Geometry::Unknown, _) => Some(
            "the configuration does not know the geometry of the arm, so neither the gateway's nor the lengths of the robot \
             description are compared with it: set geometry as the arm was measured",
        ),
        (_, Geometry::Unknown) => Some(
            "the gateway is not told the geometry of the arm, so a gateway at an arm of the other generation is not noticed: set \
             geometry in the gateway's file",
        ),
        _ => None,
    }
}

/// What is not known of an arm on a bus of this computer, and no gateway tells.
pub fn bus_doubts(link: &BusLinkConfig) -> impl Iterator<Item = &'static str> {
    let time_out = link.controller_time_out.is_none().then_some(
        "nobody knows after how long without a command the controller stops the arm (bus.controller_time_out_millis = 0): if this \
         program is killed, the arm may go on with its last speeds; find it out on the rig, or put a gateway before the arm",
    );
    let geometry = (link.geometry == Geometry::Unknown).then_some(
        "the configuration does not know the geometry of the arm, so the lengths of the robot description are compared with \
         nothing: measure the arm, then set bus.geometry",
    );
    time_out.into_iter().chain(geometry)
}

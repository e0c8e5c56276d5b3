//! Checks of the images while somebody asks for them: exposure, sharpness, vertical alignment.

use std::time::Duration;

use pb3dp_cell::camera_findings::ImageChecks;
use pb3dp_geometry::MonotonicTime;

use crate::hub::Hub;
use crate::messages::cameras::CameraCheck;
use crate::messages::time_ms;

/// Time between two checks whether the panel ends.
const LOOK: Duration = Duration::from_millis(50);
/// Time between two checks of images; at half of it a page shows no more that a person could read.
const CHECKED_EVERY: Duration = Duration::from_secs(1);
/// Share of one processor that checks may use: large images are checked less often.
const BUSY_SHARE_MAX: f64 = 0.1;

/// Checks until the panel ends.
pub fn run(hub: &Hub) {
    let mut checks = None;
    let mut due: Option<MonotonicTime> = None;
    while !hub.is_over() {
        if !hub.image_checks.wait(LOOK) {
            continue;
        }
        let started = hub.now();
        if due.is_some_and(|due| started < due) {
            hub.image_checks.answer(None);
            continue;
        }
        let Ok(pair) = hub.watched.pairs.get(None) else { continue };
        let rig = hub.about.is_calibrated.then_some(&hub.about.stereo);
        let findings = checks.get_or_insert_with(|| ImageChecks::new(rig)).findings(&[&pair]);
        let millis = |nanos: i64| nanos as f64 * 1e-6;
        hub.image_checks.answer(Some(CameraCheck {
            sequence: pair.sequence,
            time_ms: time_ms(pair.exposed_at),
            skew_ms: millis(pair.skew_nanos),
            skew_worst_ms: millis(hub.watched.pairs.worst_skew_nanos()),
            findings,
        }));
        let busy = hub.now().saturating_since(started);
        due = Some(started + CHECKED_EVERY.max(busy.div_f64(BUSY_SHARE_MAX)));
    }
}

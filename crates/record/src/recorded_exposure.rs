//! The exposure of both cameras in recordings, if the program controls it.

use serde::Serialize;

/// The exposure of a pair: the message of the topic `/pb3dp/exposure`, an object of JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RecordedExposure {
    /// Number of the pair.
    pub sequence: u64,
    /// Exposure time of both cameras, milliseconds.
    pub exposure_millis: f64,
    /// Gain of both cameras, in units of the driver; `None` if the program does not change it.
    pub gain: Option<i32>,
    /// Number of changes since the cameras were opened.
    pub changes: u64,
    /// Factor of the newest change on the exposure time.
    pub factor: f64,
    /// Whether an image may still have the exposure before the newest change.
    pub is_settling: bool,
}

impl RecordedExposure {
    /// The text of the message. A number that is not finite becomes `null`.
    pub fn text(&self) -> String {
        serde_json::json!(self).to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_is_json_also_with_numbers_that_json_does_not_have() {
        let exposure = RecordedExposure {
            sequence: 41,
            exposure_millis: 3.2,
            gain: None,
            changes: 7,
            factor: f64::INFINITY,
            is_settling: true,
        };
        let read: serde_json::Value = serde_json::from_str(&exposure.text()).unwrap();
        let expected = serde_json::json!({
            "sequence": 41, "exposure_millis": 3.2, "gain": null, "changes": 7, "factor": null, "is_settling": true
        });
        assert_eq!(read, expected);
    }
}

//! Topics of our recordings, and the topics of a recording from elsewhere that have the two images.

use crate::messages::{CompressedImage, Image, Message};

/// Topics that a run writes.
pub mod ours {
    /// Left images without compression.
    pub const LEFT_IMAGE: &str = "/left/image_raw";
    /// Right images without compression.
    pub const RIGHT_IMAGE: &str = "/right/image_raw";
    /// Left images as JPEG of the camera.
    pub const LEFT_COMPRESSED: &str = "/left/image_raw/compressed";
    /// Right images as JPEG of the camera.
    pub const RIGHT_COMPRESSED: &str = "/right/image_raw/compressed";
    /// Exposure of both cameras, if the program controls it: an object with the announcement of each change.
    pub const EXPOSURE: &str = "/pb3dp/exposure";
    /// Calibration of the left camera.
    pub const LEFT_INFO: &str = "/left/camera_info";
    /// Calibration of the right camera.
    pub const RIGHT_INFO: &str = "/right/camera_info";
    /// Estimated pose of the target in the frame of the left camera, with covariance.
    pub const POSE: &str = "/pb3dp/pose";
    /// True pose of the target, in simulation.
    pub const TRUTH: &str = "/pb3dp/truth";
    /// Status of each estimate and its reason.
    pub const STATUS: &str = "/pb3dp/status";
    /// Region that the operator marked, in pixels of the left image.
    pub const REGION: &str = "/pb3dp/region";
    /// Changes of state, with the operator's commands that caused them.
    pub const EVENTS: &str = "/pb3dp/events";
    /// The exact calibration, a `calib.json`.
    pub const CALIBRATION: &str = "/pb3dp/calibration";
    /// The settings of the run, a TOML file.
    pub const SETUP: &str = "/pb3dp/setup";
    /// Version of the program.
    pub const VERSION: &str = "/pb3dp/version";
    /// Number of the form of results.
    pub const SCHEMA_VERSION: &str = "/pb3dp/schema_version";
    /// Begin of the run.
    pub const BEGIN: &str = "/pb3dp/begin";
    /// End of the run.
    pub const END: &str = "/pb3dp/end";
    /// Files that the settings name.
    pub const FILES: &str = "/pb3dp/files";
    /// Control steps with all their inputs.
    pub const STEPS: &str = "/pb3dp/steps";
    /// Estimates with all their inputs.
    pub const PAIRS: &str = "/pb3dp/pairs";
    /// Images on which the operator drew, if they are older than the pair that they are used with.
    pub const DRAWN_ON: [&str; 2] = ["/pb3dp/drawn_on/left", "/pb3dp/drawn_on/right"];
    /// Stops of an arm with a pair for a calibration.
    pub const STOPS: &str = "/pb3dp/stops";
    /// Poses of frames, which viewers draw.
    pub const TF: &str = "/tf";
    /// Poses of frames that do not move against each other; a message has all of them.
    pub const TF_STATIC: &str = "/tf_static";
}

/// Whether the messages of a topic of ours describe the whole run: each file, and each viewer, begins with the newest one.
pub fn describes_the_run(topic: &str) -> bool {
    [ours::SETUP, ours::VERSION, ours::SCHEMA_VERSION, ours::CALIBRATION, ours::TF_STATIC, ours::FILES, ours::BEGIN]
        .contains(&topic)
}

/// A topic of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// Its name.
    pub name: String,
    /// Type of its messages, such as `sensor_msgs/msg/Image`.
    pub ros_type: String,
    /// Number of messages.
    pub messages: u64,
}

impl Topic {
    /// Whether it has images that can be read.
    pub fn has_images(&self) -> bool {
        self.ros_type == Image::name() || self.is_compressed()
    }

    /// Whether its images have the format of an image file.
    pub fn is_compressed(&self) -> bool {
        self.ros_type == CompressedImage::name()
    }

    /// Whether its images are rectified, by their name in ROS.
    pub fn is_rectified(&self) -> bool {
        self.name.split('/').any(|part| part.starts_with("image_rect"))
    }

    /// The topic of the calibration that belongs to its images: `camera_info` beside them.
    pub fn camera_info(&self) -> String {
        let images = self.name.strip_suffix("/compressed").unwrap_or(&self.name);
        let (camera, _) = images.rsplit_once('/').unwrap_or(("", images));
        format!("{camera}/camera_info")
    }
}

/// Words for left and right in names of topics and frames.
const SIDES: [[&str; 2]; 6] = [
    ["left", "right"],
    ["cam0", "cam1"],
    ["camera0", "camera1"],
    ["infra1", "infra2"],
    ["image_0", "image_1"],
    ["cam_0", "cam_1"],
];

/// Finds the topics of the left and the right images: two whose names differ in a word for the side only. Images without compression come
/// before compressed ones, those that are not rectified before rectified ones.
///
/// # Errors
/// What is not clear.
pub fn find_pair(topics: &[Topic]) -> Result<[&Topic; 2], String> {
    let images: Vec<&Topic> = topics.iter().filter(|topic| topic.has_images() && topic.messages > 0).collect();
    let partner = |left: &Topic, [here, there]: [&str; 2]| {
        let name = left.name.contains(here).then(|| left.name.replacen(here, there, 1))?;
        images.iter().copied().find(|topic| topic.name == name)
    };
    let mut pairs: Vec<[&Topic; 2]> = Vec::new();
    for left in &images {
        for sides in SIDES {
            if let Some(right) = partner(left, sides).filter(|right| right.ros_type == left.ros_type) {
                pairs.push([left, right]);
                break;
            }
        }
    }
    let rank = |pair: &[&Topic; 2]| (pair[0].is_rectified(), pair[0].is_compressed());
    let best = pairs.iter().map(rank).min();
    pairs.retain(|pair| Some(rank(pair)) == best);
    match (&pairs[..], &images[..]) {
        ([pair], _) => Ok(*pair),
        ([], [_, _, ..]) => Err("no two topics with images differ only in left and right".to_owned()),
        ([], _) => Err("two topics with images are needed".to_owned()),
        _ => Err("several topics could have the left and the right images".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topics(names: &[&str]) -> Vec<Topic> {
        let topic = |name: &&str| {
            let image = if name.ends_with("/compressed") { CompressedImage::name() } else { Image::name() };
            let ros_type = if name.ends_with("info") { "sensor_msgs/msg/CameraInfo".to_owned() } else { image };
            Topic { name: (*name).to_owned(), ros_type, messages: 5 }
        };
        names.iter().map(topic).collect()
    }

    fn found(names: &[&str]) -> Result<[String; 2], String> {
        find_pair(&topics(names)).map(|pair| pair.map(|topic| topic.name.clone()))
    }

    #[test]
    fn the_pair_is_found_by_name() {
        let check = |names: &[&str], left: &str, right: &str| {
            assert_eq!(found(names), Ok([left.to_owned(), right.to_owned()]), "{names:?}");
        };
        check(
            &["/tf", "/right/image_raw", "/left/image_raw", "/left/camera_info"],
            "/left/image_raw",
            "/right/image_raw",
        );
        check(&["/cam0/image_raw", "/cam1/image_raw"], "/cam0/image_raw", "/cam1/image_raw");
        check(
            &["/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw", "/camera/color/image_raw"],
            "/camera/infra1/image_rect_raw",
            "/camera/infra2/image_rect_raw",
        );
        check(
            &["/s/left/image_rect", "/s/right/image_rect", "/s/left/image_raw", "/s/right/image_raw"],
            "/s/left/image_raw",
            "/s/right/image_raw",
        );
        check(
            &["/l/left/image_raw/compressed", "/l/right/image_raw/compressed", "/other"],
            "/l/left/image_raw/compressed",
            "/l/right/image_raw/compressed",
        );
    }

    #[test]
    fn what_is_not_clear_is_refused() {
        assert!(found(&["/left/image_raw"]).unwrap_err().contains("two topics"));
        assert!(found(&["/a/image", "/b/image"]).unwrap_err().contains("differ only"));
        let two = found(&["/a/left/image", "/a/right/image", "/b/left/image", "/b/right/image"]);
        assert!(two.unwrap_err().contains("several"));
    }

    #[test]
    fn a_calibration_is_beside_its_images() {
        let info = |name: &str| topics(&[name])[0].camera_info();
        assert_eq!(info("/a/left/image_raw"), "/a/left/camera_info");
        assert_eq!(info("/a/left/image_raw/compressed"), "/a/left/camera_info");
        assert_eq!(info("images"), "/camera_info");
    }
}

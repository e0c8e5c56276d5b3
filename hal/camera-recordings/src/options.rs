//! What a recording does not state itself; also as arguments of commands.

use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use pb3dp_bag::pairs::PAIR_WITHIN;
use pb3dp_camera_settings::ImageLayout;
use pb3dp_record::value_range::ValueRange;

/// Heading of these options in `--help`.
const HEADING: &str = "Recordings from elsewhere";

/// What a recording does not state itself.
#[derive(Clone, Debug, Args)]
pub struct RecordingOptions {
    /// Topics of the left and the right images in an MCAP file; by default two that differ only in left and right.
    #[arg(long, value_name = "LEFT,RIGHT", help_heading = HEADING)]
    pub topics: Option<Topics>,
    /// Longest time between the images of a pair in MCAP and EuRoC recordings, milliseconds.
    #[arg(long, value_name = "MS", value_parser = parse_pair_within, default_value = "3", help_heading = HEADING)]
    pub pair_within: Duration,
    /// Values that become black and white in images with more than 8 bits, such as 0,4095; measured on the first pair by default.
    #[arg(long, value_name = "LOW,HIGH", help_heading = HEADING)]
    pub range: Option<ValueRange>,
    /// Arrangement of both views in each image of a folder.
    #[arg(long, help_heading = HEADING, value_parser = PossibleValuesParser::new(ImageLayout::ALL.map(ImageLayout::name)).try_map(|name| name.parse::<ImageLayout>()))]
    pub layout: Option<ImageLayout>,
}

impl Default for RecordingOptions {
    fn default() -> Self {
        Self { topics: None, pair_within: PAIR_WITHIN, range: None, layout: None }
    }
}

/// Topics of the left and the right images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topics(pub [String; 2]);

impl FromStr for Topics {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split(',').map(str::trim).collect::<Vec<_>>()[..] {
            [left, right] if !left.is_empty() && !right.is_empty() && left != right => {
                Ok(Self([left.to_owned(), right.to_owned()]))
            }
            _ => Err(format!(
                "{text:?} is not LEFT,RIGHT: two different topics, such as /left/image_raw,/right/image_raw"
            )),
        }
    }
}

fn parse_pair_within(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(millis) if (0.0..=1000.0).contains(&millis) => Ok(Duration::from_secs_f64(millis * 1e-3)),
        _ => Err(format!("{text:?}: must be between 0 and 1000 milliseconds")),
    }
}

//! Image quality: brightness and sharpness.

pub use pb3dp_record::image_quality::{
    BRIGHT, DARK, EDGE_MIN_GREY, EDGES_MIN, Exposure, blur_of, brighter_by_percent, softer_by_px,
};

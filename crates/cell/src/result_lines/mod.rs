//! Results of single pairs and of tracked frames as JSON lines: of `pb3dp estimate`, `pb3dp track` and the Python package.

mod estimate;
pub mod millimetres;
mod track;

pub use estimate::{EstimateLine, SecondPlaneLine, SurfaceLine};
pub use track::TrackLine;

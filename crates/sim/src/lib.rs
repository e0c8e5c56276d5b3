//! The simulated cell: scene, rasteriser, arm dynamics, with exact ground truth.

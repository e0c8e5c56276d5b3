//! Integration tests of the estimation methods.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout, reason = "helpers of tests")]

#[path = "support/abuse.rs"]
mod abuse;
mod calibration_term;
mod coming_back;
mod common;
mod deadline;
mod direct_estimate;
mod direct_estimate_no_allocation;
mod direct_reasons;
mod direct_small_regions;
mod direct_track;
mod direct_track_edges;
mod direct_track_no_allocation;
mod direct_track_priors;
mod direct_track_skew;
mod image_forms;
mod look_alikes;
#[path = "support/moving_plane.rs"]
mod moving_plane;
mod no_allocation;
mod observed_directions;
#[path = "support/painted.rs"]
mod painted;
mod periodic_targets;
mod photometric;
mod photometric_no_allocation;
#[path = "support/plane_pair.rs"]
mod plane_pair;
mod pose_covariance;
mod published_estimate;
mod published_track;
mod published_track_safety;
mod raw_rigs;
mod rig_plan;
mod rig_watch;
mod robustness;
mod shared_regions;
mod small_targets;
mod track_no_surface;
mod visible_surface;

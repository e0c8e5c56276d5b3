//! Test suites that each hardware backend must pass.
//!
//! [`stereo_camera_suite`], [`arm_suite`] and [`clock_suite`] test a backend against the contract that its trait defines "for
//! backend authors" and return a [`Report`] with every broken rule:
//!
//! ```no_run
//! # let camera = pb3dp_hal_conformance::mocks::MockScriptedCamera::new;
//! use pb3dp_hal_conformance::{CameraExpectations, stereo_camera_suite};
//! stereo_camera_suite(camera, &CameraExpectations::recording_of(12)).assert_passed();
//! ```
//!
//! [`mocks`] are scripted doubles of the traits for unit tests. For tests only: no shipped program depends on this crate.

pub mod arm;
pub mod camera;
pub mod clock;
pub mod mocks;
mod report;

pub use arm::{ArmExpectations, ArmHooks, ArmPart, arm_suite, arm_suite_of};
pub use camera::{CameraExpectations, stereo_camera_suite};
pub use clock::clock_suite;
pub use report::{Report, Violation};

#[cfg(doctest)]
#[doc = include_str!("../../../docs/how-to/add-a-camera.md")]
mod add_a_camera {}

#[cfg(doctest)]
#[doc = include_str!("../../../docs/how-to/add-an-arm.md")]
mod add_an_arm {}

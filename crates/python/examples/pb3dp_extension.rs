//! The module of Python as a library of the build of all tests. It is not a program.
//!
//! It is the same source again: a crate that others can link (rlib) would be built twice by maturin.

#[path = "../src/lib.rs"]
mod package;

// The modules name each other by these paths.
use package::{
    arrays, errors, estimate, estimator, images, named_tuples, region, rig, run_step, settings, track, wording,
};

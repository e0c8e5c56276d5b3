//! No code: third-party crates with all features that any package of the workspace needs.
//!
//! Cargo builds a crate with the features that the selected packages need. With this package below every other one, the build of
//! one package, of the program and of all tests has the same features, and nothing is built twice (`cargo xtask check-deps`
//! compares them; docs/adr/0020-builds.md).

//! What all benchmarks share: the circumstances of a measurement, tables of rows of JSON, pages, figures, and work on all cores.
//!
//! A benchmark measures rows of JSON. [`table`] makes the tables of them, [`page`] fills them into a page of docs/benchmarks, whose text
//! is written by hand, and [`figure`] draws.

pub mod circumstances;
pub mod figure;
pub mod limit;
pub mod page;
pub mod parallel;
pub mod table;

//! Wrappers around hardware backends: the limiter.

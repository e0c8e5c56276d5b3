//! Mitsubishi PA-10 arm backends.

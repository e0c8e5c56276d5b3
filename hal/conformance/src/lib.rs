//! One test suite that each hardware backend must pass.

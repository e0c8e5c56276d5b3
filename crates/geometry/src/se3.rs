//! The group of rigid motions: exponential, logarithm, adjoint, Jacobians, interpolation.
//!
//! Tangent vectors are `[rho; phi]`: linear part first (metres), angular part second (radians).

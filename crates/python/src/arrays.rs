//! Arrays of numpy from numbers of the library, and poses from arrays.

use anyhow::{Result, bail};
use nalgebra::{Matrix3, Matrix6, Vector3};
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pb3dp_geometry::{Frame, Pose};
use pyo3::prelude::*;

/// Largest deviation of a given rotation from an orthonormal matrix: one that was printed with six digits is accepted.
const ORTHONORMAL_TO: f64 = 1e-5;

/// A 1-D array.
pub fn vector<'py>(py: Python<'py>, values: &[f64]) -> Bound<'py, PyArray1<f64>> {
    PyArray1::from_slice(py, values)
}

/// A matrix with `columns` columns, from its rows.
pub fn matrix(py: Python<'_>, columns: usize, row_by_row: Vec<f64>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let rows = row_by_row.len() / columns;
    PyArray1::from_vec(py, row_by_row).reshape([rows, columns])
}

/// Colours, N x 3.
pub fn colours(py: Python<'_>, points: impl Iterator<Item = [u8; 3]>) -> PyResult<Bound<'_, PyArray2<u8>>> {
    let flat: Vec<u8> = points.flatten().collect();
    let rows = flat.len() / 3;
    PyArray1::from_vec(py, flat).reshape([rows, 3])
}

/// The 16 numbers of a homogeneous matrix, row by row, translation in metres.
pub fn homogeneous<A: Frame, B: Frame>(pose: &Pose<A, B>) -> [f64; 16] {
    let m = pose.to_homogeneous();
    std::array::from_fn(|k| m[(k / 4, k % 4)])
}

/// A pose as 4x4 matrix.
pub fn pose<'py, A: Frame, B: Frame>(py: Python<'py>, pose: &Pose<A, B>) -> PyResult<Bound<'py, PyArray2<f64>>> {
    matrix(py, 4, homogeneous(pose).to_vec())
}

/// A pose as 4x4 matrix, or `None`.
pub fn pose_if_any<'py, A: Frame, B: Frame>(
    py: Python<'py>,
    known: Option<&Pose<A, B>>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    known.map(|known| pose(py, known)).transpose()
}

/// The rotation of a pose as unit quaternion x, y, z, w.
pub fn quaternion_xyzw<A: Frame, B: Frame>(pose: &Pose<A, B>) -> [f64; 4] {
    let rotation = pose.rotation();
    [rotation.i, rotation.j, rotation.k, rotation.w]
}

/// A covariance as 6x6 matrix.
pub fn covariance<'py>(
    py: Python<'py>,
    covariance: Option<&Matrix6<f64>>,
) -> PyResult<Option<Bound<'py, PyArray2<f64>>>> {
    covariance.map(|known| matrix(py, 6, (0..36).map(|k| known[(k / 6, k % 6)]).collect())).transpose()
}

/// The pose of a 4x4 matrix.
///
/// # Errors
/// Another shape, numbers that are not finite, a rotation that is none; with the name of the argument.
pub fn pose_of<A: Frame, B: Frame>(name: &str, given: &PyReadonlyArray2<'_, f64>) -> Result<Pose<A, B>> {
    if given.shape() != [4, 4] {
        bail!("{name} has the shape {:?}: give a homogeneous matrix of 4x4 numbers", given.shape());
    }
    let m = given.as_array();
    if m.iter().any(|value| !value.is_finite()) {
        bail!("{name} has numbers that are not finite: give a homogeneous matrix");
    }
    let rotation = Matrix3::from_fn(|row, column| m[(row, column)]);
    let off = (rotation * rotation.transpose() - Matrix3::identity()).amax();
    let last = [m[(3, 0)], m[(3, 1)], m[(3, 2)], m[(3, 3)]];
    if off > ORTHONORMAL_TO || rotation.determinant() < 0.0 || last != [0.0, 0.0, 0.0, 1.0] {
        bail!(
            "{name} is no pose: its rotation is not orthonormal (off by {off:.1e}, allowed {ORTHONORMAL_TO:.0e}), or its last row is not 0 0 0 1"
        );
    }
    Ok(Pose::from_rotation_matrix(&rotation, Vector3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)])))
}

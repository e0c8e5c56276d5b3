//! Coloured surface points in PLY files for MeshLab, CloudCompare and Open3D.
//!
//! Binary little-endian; per vertex `x y z` (single precision, millimetres), `nx ny nz` (unit vector) if the normals are known, `sigma`
//! (standard deviation along the ray of the camera, millimetres), `red green blue` (bytes), and `measured` (a byte: 1, or 0 for a point
//! that only its neighbours determine). A comment in the header names the frame and
//! the unit.

use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use nalgebra::{Point3, Vector3};
use pb3dp_geometry::Frame;

/// A point of a surface with its colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, metres, in the frame of the cloud.
    pub position_m: Point3<f64>,
    /// Unit normal, in the frame of the cloud; a cloud has it for all of its points or for none.
    pub normal: Option<Vector3<f64>>,
    /// Standard deviation along the ray on which the camera saw the point, metres.
    pub sigma_m: f64,
    /// Red, green, blue.
    pub rgb: [u8; 3],
    /// Whether the images determine the point; otherwise its neighbours do.
    pub is_measured: bool,
}

/// Why a cloud could not be written.
#[derive(Debug, thiserror::Error)]
pub enum PointCloudError {
    /// A point is not a number.
    #[error("{}: point {index} is not finite; the cloud is not written", file.display())]
    NotFinite {
        /// The file.
        file: PathBuf,
        /// Index of the point.
        index: usize,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The system error.
        source: std::io::Error,
    },
}

const POSITION: [&str; 3] = ["x", "y", "z"];
const NORMAL: [&str; 3] = ["nx", "ny", "nz"];
const SIGMA: [&str; 1] = ["sigma"];
const BYTES: [&str; 4] = ["red", "green", "blue", "measured"];

/// Writes a cloud whose coordinates are in the frame `F`.
///
/// # Errors
/// A point that is not finite, or a file that cannot be written.
pub fn write_ply<F: Frame>(file: &Path, points: &[SurfacePoint]) -> Result<(), PointCloudError> {
    let is_finite = |point: &SurfacePoint| {
        let SurfacePoint { position_m, normal, sigma_m, .. } = point;
        position_m.iter().chain(normal.iter().flat_map(|n| n.iter())).chain([sigma_m]).all(|x| x.is_finite())
    };
    if let Some(index) = points.iter().position(|point| !is_finite(point)) {
        return Err(PointCloudError::NotFinite { file: file.to_path_buf(), index });
    }
    let has_normals = points.iter().all(|point| point.normal.is_some());
    let failed = |source| PointCloudError::Write { file: file.to_path_buf(), source };
    let mut out = BufWriter::new(File::create(file).map_err(failed)?);
    let parts = [header(F::NAME, points.len(), has_normals).into_bytes()];
    let mut parts = parts.into_iter().chain(points.iter().map(|point| vertex(point, has_normals)));
    parts.try_for_each(|part| out.write_all(&part)).and_then(|()| out.flush()).map_err(failed)
}

/// The header of the format (Turk, "The PLY polygon file format", 1994).
fn header(frame: &str, count: usize, has_normals: bool) -> String {
    let normal = if has_normals { &NORMAL[..] } else { &[] };
    let floats = POSITION.iter().chain(normal).chain(&SIGMA).map(|name| format!("property float {name}\n"));
    let bytes = BYTES.iter().map(|name| format!("property uchar {name}\n"));
    let properties: String = floats.chain(bytes).collect();
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment surface measured by pb3dp, frame {frame}, millimetres\n\
         element vertex {count}\n{properties}end_header\n"
    )
}

/// The bytes of a point, in the order of the header.
fn vertex(point: &SurfacePoint, has_normal: bool) -> Vec<u8> {
    let position_mm = point.position_m.coords * 1e3;
    let normal = point.normal.filter(|_| has_normal);
    let floats = position_mm.iter().chain(normal.iter().flat_map(|normal| normal.iter())).copied();
    let floats = floats.chain([1e3 * point.sigma_m]).flat_map(|value| (value as f32).to_le_bytes());
    floats.chain(point.rgb).chain([u8::from(point.is_measured)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use pb3dp_geometry::frames::Model;

    fn points() -> Vec<SurfacePoint> {
        let point = |x: f64, rgb: [u8; 3]| SurfacePoint {
            position_m: Point3::new(x, -0.0125, 0.5),
            normal: Some(Vector3::new(0.0, 0.6, -0.8)),
            sigma_m: 0.0005,
            is_measured: rgb[0] == 255,
            rgb,
        };
        vec![point(0.25, [255, 0, 128]), point(-0.001, [1, 2, 3])]
    }

    /// The bytes of the format, computed by hand: an ASCII header, then 32 bytes per vertex.
    #[test]
    fn the_file_is_what_the_format_says() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("surface.ply");
        write_ply::<Model>(&file, &points()).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        let end = b"end_header\n";
        let at = bytes.windows(end.len()).position(|window| window == end).unwrap() + end.len();
        let header = String::from_utf8(bytes[..at].to_vec()).unwrap();
        let lines: Vec<&str> = header.lines().collect();
        assert_eq!(lines[0..2], ["ply", "format binary_little_endian 1.0"]);
        assert!(header.contains("frame model, millimetres") && lines.contains(&"element vertex 2"), "{header}");
        let properties: Vec<&str> = lines.iter().copied().filter(|line| line.starts_with("property")).collect();
        let names: Vec<&str> = properties.iter().filter_map(|line| line.split(' ').nth(2)).collect();
        assert_eq!(names, ["x", "y", "z", "nx", "ny", "nz", "sigma", "red", "green", "blue", "measured"]);
        assert_eq!(bytes.len() - at, 2 * 32);
        let float = |i: usize| f32::from_le_bytes(bytes[at + i..at + i + 4].try_into().unwrap());
        assert_eq!([float(0), float(4), float(8), float(16), float(24)], [250.0, -12.5, 500.0, 0.6, 0.5]);
        assert_eq!((&bytes[at + 28..at + 32], float(32)), (&[255, 0, 128, 1][..], -1.0));
    }

    #[test]
    fn a_cloud_without_normals_has_no_such_columns() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("surface.ply");
        let points: Vec<_> = points().into_iter().map(|point| SurfacePoint { normal: None, ..point }).collect();
        write_ply::<Model>(&file, &points).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        let header_end = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        assert!(!String::from_utf8_lossy(&bytes[..header_end]).contains("nx"));
        assert_eq!(bytes.len() - header_end, 2 * 20);
        assert_eq!(f32::from_le_bytes(bytes[header_end + 12..header_end + 16].try_into().unwrap()), 0.5);
    }

    #[test]
    fn files_that_cannot_be_written_are_reported() {
        let folder = tempfile::tempdir().unwrap();
        let mut bad = points();
        bad[1].position_m.y = f64::NAN;
        let file = folder.path().join("x.ply");
        assert!(write_ply::<Model>(&file, &bad).unwrap_err().to_string().contains("point 1"));
        assert!(!file.exists());
        let nowhere = folder.path().join("missing/x.ply");
        assert!(write_ply::<Model>(&nowhere, &points()).unwrap_err().to_string().contains("x.ply"));
    }
}

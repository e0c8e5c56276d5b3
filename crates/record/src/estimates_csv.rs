//! `estimates.csv`: a line per estimate, with pose and covariance. Empty cells are unknown.

use std::fmt::Write as _;

use nalgebra::Matrix6;
use pb3dp_geometry::Pose;
use pb3dp_geometry::frames::{CamLeft, Model};

/// An estimate in the units of the program.
#[derive(Clone, Copy, Debug)]
pub struct EstimateRow<'a> {
    /// Mid-exposure, seconds.
    pub t_s: f64,
    /// Status word.
    pub status: &'a str,
    /// From mid-exposure until the controller received the estimate, milliseconds.
    pub age_millis: Option<f64>,
    /// Computing time, milliseconds.
    pub latency_millis: Option<f64>,
    /// Agreement of the images.
    pub fitness: Option<f64>,
    /// The pose.
    pub cam_left_from_model: Option<&'a Pose<CamLeft, Model>>,
    /// Covariance of `xi` = translation (m), then rotation (rad), along the axes of the model: of the pose since the first one.
    pub covariance: Option<&'a Matrix6<f64>>,
    /// The same of the pose, that of the first one included.
    pub pose_covariance: Option<&'a Matrix6<f64>>,
}

/// The first line: `c11` to `c66` is the covariance since the first pose, row by row, in mm and rad, and `p11` to `p66` that of the pose.
pub fn heading() -> String {
    let mut text = String::from("t_s,status,age_ms,latency_ms,fitness,x_mm,y_mm,z_mm,qx,qy,qz,qw");
    for letter in ['c', 'p'] {
        (0..36).for_each(|k| text += &format!(",{letter}{}{}", k / 6 + 1, k % 6 + 1));
    }
    text
}

impl EstimateRow<'_> {
    /// The line, without its end.
    pub fn line(&self) -> String {
        let number = |value: Option<f64>| value.map_or(String::new(), |value| format!("{value:.4}"));
        let (age, latency) = (number(self.age_millis), number(self.latency_millis));
        let mut text = format!("{:.6},{},{age},{latency},{}", self.t_s, self.status, number(self.fitness));
        match self.cam_left_from_model {
            Some(pose) => {
                let (p, q) = (pose.translation_m() * 1e3, pose.rotation());
                let _ = write!(text, ",{:.4},{:.4},{:.4},{:.7},{:.7},{:.7},{:.7}", p.x, p.y, p.z, q.i, q.j, q.k, q.w);
            }
            None => text += &",".repeat(7),
        }
        let unit = |i: usize| if i < 3 { 1e3 } else { 1.0 };
        for covariance in [self.covariance, self.pose_covariance] {
            match covariance {
                Some(c) => (0..36).for_each(|k| {
                    let _ = write!(text, ",{:.6e}", c[(k / 6, k % 6)] * unit(k / 6) * unit(k % 6));
                }),
                None => text += &",".repeat(36),
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;

    #[test]
    fn every_line_has_the_cells_of_the_heading_in_millimetres() {
        let pose = Pose::from_parts(Vector3::new(0.001, -0.02, 0.5), UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3));
        let covariance = Matrix6::from_fn(|row, column| 1e-6 * (10 * row + column) as f64);
        let empty = EstimateRow {
            t_s: 0.25,
            status: "lost",
            age_millis: None,
            latency_millis: None,
            fitness: None,
            cam_left_from_model: None,
            covariance: None,
            pose_covariance: None,
        };
        let known = EstimateRow {
            status: "ok",
            latency_millis: Some(12.5),
            cam_left_from_model: Some(&pose),
            covariance: Some(&covariance),
            pose_covariance: Some(&(covariance * 2.0)),
            ..empty
        };
        let heading = heading();
        let names: Vec<&str> = heading.split(',').collect();
        for row in [empty, known] {
            assert_eq!(row.line().split(',').count(), names.len(), "{}", row.line());
        }
        let line = known.line();
        let cells: Vec<&str> = line.split(',').collect();
        let cell = |name: &str| cells[names.iter().position(|other| *other == name).unwrap()];
        assert_eq!([cell("t_s"), cell("age_ms"), cell("latency_ms")], ["0.250000", "", "12.5000"]);
        assert_eq!([cell("x_mm"), cell("y_mm"), cell("z_mm")], ["1.0000", "-20.0000", "500.0000"]);
        // mm x rad.
        assert_eq!(cell("c15").parse::<f64>().unwrap(), 4e-3);
        assert_eq!(cell("c42").parse::<f64>().unwrap(), 31e-3);
        assert_eq!(cell("p42").parse::<f64>().unwrap(), 62e-3);
    }
}

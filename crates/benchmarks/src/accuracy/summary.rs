//! Statistics of one method on one configuration.

use nalgebra::Matrix3;
use pb3dp_estimation_core::status::Status;
use pb3dp_record::metrics::{median, percentile, rms};
use serde_json::{Value, json};

use super::cell::{Cell, Question};
use super::chi_square::interval;
use super::measure::{Measured, Outcome};

/// Errors below these are never wrong: metres, radians.
const TOLERANCE: (f64, f64) = (2e-3, 3.0 * std::f64::consts::PI / 180.0);

/// Half the width of the target, metres.
const HALF_WIDTH_M: f64 = 0.055;

/// Errors within this many standard deviations of the bound are not wrong either.
const SIGMAS: f64 = 4.0;

/// Row of a table for one method on one configuration; metres and radians.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The configuration.
    pub cell: String,
    /// The method.
    pub method: &'static str,
    /// Number of poses.
    pub count: usize,
    /// Poses with status `ok` or `weak-tilt`.
    pub sure: usize,
    /// Poses with a plane within the tolerance, with any status.
    pub right: usize,
    /// Poses with status `ok` (or `weak-tilt`: depth only) that are wrong.
    pub wrong_ok: usize,
    /// Absolute depth error of the confident answers: median, 95th percentile, rms.
    pub z_m: [f64; 3],
    /// Angle between true and estimated normal of the `ok` answers: the same statistics.
    pub angle_rad: [f64; 3],
    /// The bound: rms over all poses, depth and angle.
    pub bound: Option<[f64; 2]>,
    /// Rms error over the bound of the same answers, depth and angle.
    pub ratio: Option<[f64; 2]>,
    /// Mean normalised squared error over its expected value; 1 is consistent.
    pub nees: Option<f64>,
    /// 95 % interval of [`Self::nees`]: the errors of the pairs are independent.
    pub nees_interval: Option<[f64; 2]>,
    /// CPU time, milliseconds, median.
    pub cpu_millis: f64,
}

impl Summary {
    /// Share of poses with a confident answer.
    pub fn sure_share(&self) -> f64 {
        self.sure as f64 / self.count.max(1) as f64
    }

    /// Share of poses with a right answer.
    pub fn right_share(&self) -> f64 {
        self.right as f64 / self.count.max(1) as f64
    }

    /// Statistics of the method with number `index`.
    pub fn of(cell: &Cell, method: &'static str, index: usize, measured: &[Measured]) -> Self {
        let outcomes: Vec<_> = measured.iter().map(|m| (&m.outcomes[index], m.bound.as_ref())).collect();
        let tolerance = Tolerance::of(cell);
        let sure: Vec<_> = outcomes.iter().filter(|(o, _)| o.status.depth_is_sure() && o.errors.is_some()).collect();
        let z = |(o, _): &&(&Outcome, _)| o.errors.map(|errors| errors.z_m.abs());
        let angle = |(o, _): &&(&Outcome, _)| o.errors.map(|errors| errors.tilt_rad.norm());
        let ok: Vec<_> = sure.iter().copied().filter(|(o, _)| o.status == Status::Ok).collect();
        let z_errors: Vec<f64> = sure.iter().copied().filter_map(|o| z(&o)).collect();
        let angles: Vec<f64> = ok.iter().copied().filter_map(|o| angle(&o)).collect();
        let bound_of = |answers: &[&(&Outcome, Option<&Matrix3<f64>>)]| {
            bound_rms(&answers.iter().filter_map(|(_, bound)| *bound).collect::<Vec<_>>())
        };
        let all_bounds = bound_rms(&outcomes.iter().filter_map(|(_, bound)| *bound).collect::<Vec<_>>());
        let ratio = match (bound_of(&sure), bound_of(&ok), rms(&z_errors), rms(&angles)) {
            (Some([z_bound, _]), Some([_, angle_bound]), Some(z), Some(angle)) => {
                Some([z / z_bound, angle / angle_bound])
            }
            _ => None,
        };
        let nees: Vec<f64> = ok.iter().filter_map(|(o, _)| o.normalised_error).collect();
        let mean_nees = (!nees.is_empty()).then(|| nees.iter().sum::<f64>() / nees.len() as f64);
        let times: Vec<f64> = outcomes.iter().map(|(o, _)| o.cpu_millis).collect();
        Self {
            cell: cell.name.clone(),
            method,
            count: outcomes.len(),
            sure: sure.len(),
            right: outcomes.iter().filter(|(o, bound)| is_right(o, tolerance.with(*bound))).count(),
            wrong_ok: outcomes.iter().filter(|(o, bound)| is_wrong_ok(o, tolerance.with(*bound))).count(),
            z_m: three(&z_errors),
            angle_rad: three(&angles),
            bound: all_bounds,
            ratio,
            nees: mean_nees,
            nees_interval: mean_nees.map(|mean| interval(mean, 3.0 * nees.len() as f64)),
            cpu_millis: median(&times).unwrap_or(f64::NAN),
        }
    }

    /// For the JSON file; millimetres and degrees.
    pub fn to_json(&self) -> Value {
        let millimetres = self.z_m.map(|x| x * 1e3);
        let degrees = self.angle_rad.map(f64::to_degrees);
        json!({
            "cell": self.cell, "method": self.method, "poses": self.count,
            "sure": self.sure, "right": self.right, "wrong_ok": self.wrong_ok,
            "z_mm": {"median": finite(millimetres[0]), "p95": finite(millimetres[1]), "rms": finite(millimetres[2])},
            "angle_deg": {"median": finite(degrees[0]), "p95": finite(degrees[1]), "rms": finite(degrees[2])},
            "bound": self.bound.map(|[z, angle]| json!({"z_mm": z * 1e3, "angle_deg": angle.to_degrees()})),
            "ratio": self.ratio.map(|[z, angle]| json!({"z": z, "angle": angle})),
            "nees": self.nees, "nees_interval": self.nees_interval, "cpu_ms": finite(self.cpu_millis),
        })
    }
}

/// JSON has no NaN.
fn finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn three(errors: &[f64]) -> [f64; 3] {
    let or_none = |value: Option<f64>| value.unwrap_or(f64::NAN);
    [or_none(median(errors)), or_none(percentile(errors, 95.0)), or_none(rms(errors))]
}

fn bound_rms(bounds: &[&Matrix3<f64>]) -> Option<[f64; 2]> {
    let mean = |of: fn(&Matrix3<f64>) -> f64| bounds.iter().map(|b| of(b)).sum::<f64>() / bounds.len() as f64;
    (!bounds.is_empty()).then(|| [mean(|b| b[(0, 0)]).sqrt(), mean(|b| b[(1, 1)] + b[(2, 2)]).sqrt()])
}

/// Tolerances.
#[derive(Clone, Copy, Debug)]
struct Tolerance {
    /// Depth in metres and angle in radians, without the bound.
    fixed: (f64, f64),
    /// Whether to use the bound if there is one.
    bounded: bool,
}

impl Tolerance {
    /// 2 mm and 3 degrees. The plane of a relief is a matter of definition, so a plane within the relief is right.
    fn of(cell: &Cell) -> Self {
        let relief_m = cell.setup.relief_m();
        let fixed = (TOLERANCE.0.max(relief_m), TOLERANCE.1.max(relief_m / HALF_WIDTH_M));
        Self { fixed, bounded: cell.question != Question::Unobservable }
    }

    /// At a pose: four times the bound if that is more.
    fn with(self, bound: Option<&Matrix3<f64>>) -> (f64, f64) {
        let sigma = |variance: f64| SIGMAS * variance.sqrt();
        match bound {
            Some(b) => (self.fixed.0.max(sigma(b[(0, 0)])), self.fixed.1.max(sigma(b[(1, 1)] + b[(2, 2)]))),
            // The plane is not observable: any answer is equally right, unless the configuration tests for this.
            None if self.bounded => (f64::INFINITY, f64::INFINITY),
            None => self.fixed,
        }
    }
}

fn is_right(outcome: &Outcome, (z, angle): (f64, f64)) -> bool {
    outcome.errors.is_some_and(|errors| errors.z_m.abs() <= z && errors.tilt_rad.norm() <= angle)
}

fn is_wrong_ok(outcome: &Outcome, (z, angle): (f64, f64)) -> bool {
    match (outcome.status, outcome.errors) {
        (Status::Ok, Some(errors)) => !(errors.z_m.abs() <= z && errors.tilt_rad.norm() <= angle),
        (Status::WeakTilt | Status::PartlyObserved, Some(errors)) => errors.z_m.is_nan() || errors.z_m.abs() > z,
        // A confident answer without an observable plane is wrong as well.
        (Status::Ok | Status::WeakTilt | Status::PartlyObserved, None) => true,
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Vector2, Vector3};

    use super::super::trial::PlaneErrors;
    use super::*;

    fn outcome(status: Status, z_mm: f64, tilt_deg: f64) -> Outcome {
        let tilt_rad = Vector2::new(0.6, -0.8) * tilt_deg.to_radians();
        let errors = Some(PlaneErrors { z_m: z_mm * 1e-3, tilt_rad });
        Outcome { status, errors, normalised_error: Some(z_mm.abs()), cpu_millis: 2.0 }
    }

    #[test]
    fn confident_errors_are_counted_by_what_the_bound_allows() {
        let bound = Matrix3::from_diagonal(&Vector3::new(1e-6, 1e-6, 1e-6));
        let flat = Tolerance { fixed: TOLERANCE, bounded: true };
        let check = |status, z_mm, tilt_deg, expected| {
            assert_eq!(
                is_wrong_ok(&outcome(status, z_mm, tilt_deg), flat.with(Some(&bound))),
                expected,
                "{z_mm} {tilt_deg}"
            );
        };
        check(Status::Ok, 3.9, 2.9, false);
        check(Status::Ok, -4.1, 0.0, true);
        check(Status::Ok, 0.0, 3.1, true);
        check(Status::WeakTilt, 0.0, 40.0, false);
        check(Status::WeakTilt, 4.1, 0.0, true);
        check(Status::Ambiguous, 400.0, 40.0, false);
        let blind = Tolerance { bounded: false, ..flat };
        assert!(is_wrong_ok(&outcome(Status::Ok, 2.1, 0.0), blind.with(None)));
        assert!(!is_wrong_ok(&outcome(Status::Ok, 2.1, 0.0), flat.with(None)));
        let nothing = Outcome { errors: None, ..outcome(Status::Ok, 0.0, 0.0) };
        assert!(is_wrong_ok(&nothing, flat.with(Some(&bound))));
        let relief = super::super::cells::all().into_iter().find(|cell| cell.name == "relief/10mm").unwrap();
        let relief = Tolerance::of(&relief).with(Some(&bound));
        assert!(!is_wrong_ok(&outcome(Status::Ok, 9.9, 10.0), relief));
        assert!(
            is_wrong_ok(&outcome(Status::Ok, 10.1, 0.0), relief)
                && is_wrong_ok(&outcome(Status::Ok, 0.0, 11.0), relief)
        );
    }

    #[test]
    fn figures_are_those_of_the_errors() {
        let cell = super::super::cells::all().remove(0);
        let bound = Matrix3::from_diagonal(&Vector3::new(4e-6, 1e-6, 3e-6));
        let measured = |status, z_mm, tilt_deg| Measured {
            bound: Some(bound),
            outcomes: vec![outcome(Status::Error, 9.0, 9.0), outcome(status, z_mm, tilt_deg)],
        };
        let all = [
            measured(Status::Ok, -1.0, 0.5),
            measured(Status::Ok, 2.0, 1.0),
            measured(Status::WeakTilt, 3.0, 50.0),
            measured(Status::NotObservable, 90.0, 90.0),
        ];
        let summary = Summary::of(&cell, "some", 1, &all);
        assert_eq!((summary.count, summary.sure, summary.right, summary.wrong_ok), (4, 3, 2, 0));
        assert!((summary.z_m[0] - 2e-3).abs() < 1e-12);
        assert!((summary.angle_rad[0].to_degrees() - 0.75).abs() < 1e-9);
        let [z, angle] = summary.ratio.unwrap();
        assert!((z - (14.0f64 / 3.0).sqrt() / 2.0).abs() < 1e-9, "{z}");
        assert!((angle - (0.625f64.sqrt().to_radians()) / 2e-3).abs() < 1e-9, "{angle}");
        assert_eq!(summary.nees, Some(1.5));
    }
}

//! Statistics of one method on one configuration.

use nalgebra::Matrix3;
use pb3dp_benchmarks::table::Column;
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

/// The columns of the table.
pub const COLUMNS: [Column<'_>; 13] = [
    ("configuration", "{cell}"),
    ("method", "{method}"),
    ("n", "{poses}"),
    ("conf %", "{sure_percent:1}"),
    ("right %", "{right_percent:1}"),
    ("wrong ok", "{wrong_ok}"),
    ("z mm med / p95", "{z_mm.median:3} / {z_mm.p95:3}"),
    ("angle deg med / p95", "{angle_deg.median:3} / {angle_deg.p95:3}"),
    ("bound mm, deg", "{bound.z_mm:3}, {bound.angle_deg:3}"),
    ("rms / bound z", "{ratio.z:2}"),
    ("angle", "{ratio.angle:2}"),
    ("NEES", "{nees:2} ({nees_interval.0:2} to {nees_interval.1:2})"),
    ("ms", "{cpu_ms:2}"),
];

/// The row of the method with number `index` on one configuration.
///
/// `sure`: status `ok` or `weak-tilt`. `z_mm`: absolute depth error of these answers, `angle_deg`: angle between true and estimated normal of
/// the `ok` ones. `bound`: rms over all poses; `ratio`: rms error over the bound of the same answers. The errors of the pairs are
/// independent, so the NEES has an interval of 95 %.
pub fn summary(cell: &Cell, method: &str, index: usize, measured: &[Measured]) -> Value {
    let outcomes: Vec<_> = measured.iter().map(|m| (&m.outcomes[index], m.bound.as_ref())).collect();
    let tolerance = Tolerance::of(cell);
    let sure: Vec<_> = outcomes.iter().filter(|(o, _)| o.status.depth_is_sure() && o.errors.is_some()).collect();
    let ok: Vec<_> = sure.iter().copied().filter(|(o, _)| o.status == Status::Ok).collect();
    let z_mm: Vec<f64> = sure.iter().filter_map(|(o, _)| Some(1e3 * o.errors?.z_m.abs())).collect();
    let angle_deg: Vec<f64> = ok.iter().filter_map(|(o, _)| Some(o.errors?.tilt_rad.norm().to_degrees())).collect();
    let bound_of = |answers: &[&(&Outcome, Option<&Matrix3<f64>>)]| {
        bound_rms(&answers.iter().filter_map(|(_, bound)| *bound).collect::<Vec<_>>())
    };
    let ratio = match (bound_of(&sure), bound_of(&ok), rms(&z_mm), rms(&angle_deg)) {
        (Some([z_bound, _]), Some([_, angle_bound]), Some(z), Some(angle)) => {
            Some(json!({"z": z / z_bound, "angle": angle / angle_bound}))
        }
        _ => None,
    };
    let nees: Vec<f64> = ok.iter().filter_map(|(o, _)| o.normalised_error).collect();
    let mean_nees = (!nees.is_empty()).then(|| nees.iter().sum::<f64>() / nees.len() as f64);
    let times: Vec<f64> = outcomes.iter().map(|(o, _)| o.cpu_millis).collect();
    let count = |is: fn(&Outcome, (f64, f64)) -> bool| {
        outcomes.iter().filter(|(o, bound)| is(o, tolerance.with(*bound))).count()
    };
    let (right, poses) = (count(is_right), outcomes.len());
    let percent = |part: usize| 100.0 * part as f64 / poses.max(1) as f64;
    json!({
        "cell": cell.name, "method": method, "poses": poses, "sure": sure.len(), "right": right, "wrong_ok": count(is_wrong_ok),
        "sure_percent": percent(sure.len()), "right_percent": percent(right),
        "unsure_percent": percent(poses - sure.len()), "missed_percent": percent(poses - right),
        "z_mm": three(&z_mm), "angle_deg": three(&angle_deg),
        "bound": bound_of(&outcomes.iter().collect::<Vec<_>>()).map(|[z, angle]| json!({"z_mm": z, "angle_deg": angle})),
        "ratio": ratio, "nees": mean_nees, "nees_interval": mean_nees.map(|mean| interval(mean, 3.0 * nees.len() as f64)),
        "cpu_ms": median(&times),
    })
}

fn three(errors: &[f64]) -> Value {
    json!({"median": median(errors), "p95": percentile(errors, 95.0), "rms": rms(errors)})
}

/// Millimetres and degrees.
fn bound_rms(bounds: &[&Matrix3<f64>]) -> Option<[f64; 2]> {
    let mean = |of: fn(&Matrix3<f64>) -> f64| bounds.iter().map(|b| of(b)).sum::<f64>() / bounds.len() as f64;
    let angle_rad = || mean(|b| b[(1, 1)] + b[(2, 2)]).sqrt();
    (!bounds.is_empty()).then(|| [1e3 * mean(|b| b[(0, 0)]).sqrt(), angle_rad().to_degrees()])
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
    use pb3dp_benchmarks::table::number;

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
        let row = summary(&cell, "some", 1, &all);
        let counts = ["poses", "sure", "right", "wrong_ok"].map(|key| row[key].as_u64().unwrap());
        assert_eq!(counts, [4, 3, 2, 0]);
        let close = |path: &str, expected: f64| {
            let found = number(&row, path).unwrap();
            assert!((found - expected).abs() < 1e-9, "{path}: {found} {expected}");
        };
        close("z_mm.median", 2.0);
        close("angle_deg.median", 0.75);
        close("bound.z_mm", 2.0);
        close("ratio.z", (14.0f64 / 3.0).sqrt() / 2.0);
        close("ratio.angle", 0.625f64.sqrt().to_radians() / 2e-3);
        close("missed_percent", 50.0);
        close("nees", 1.5);
        let shown = pb3dp_benchmarks::table::row(&COLUMNS, &row);
        assert!(shown.contains("| some | 4 | 75.0 | 50.0 | 0 | 2.000 / ") && !shown.contains('?'), "{shown}");
    }
}

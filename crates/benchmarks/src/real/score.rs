//! Criteria for passed and grossly wrong answers.

use std::rc::Rc;

use pb3dp_record::metrics::Group;
use serde_json::{Value, json};

/// An answer within these passes; if the truth is less certain, its standard deviation counts instead.
const PASS_Z_RATIO: f64 = 0.01;
const PASS_NORMAL_DEG: f64 = 5.0;
/// An answer with larger errors is grossly wrong.
const GROSS_Z_RATIO: f64 = 0.015;
const GROSS_NORMAL_DEG: f64 = 20.0;
/// An answer with status `ok` is wrong if it is off by more than these, and by more standard deviations, the truth's included.
const WRONG_Z_RATIO: f64 = 0.01;
const WRONG_NORMAL_DEG: f64 = 5.0;
const WRONG_SIGMAS: f64 = 3.0;
/// A stated standard deviation covers an error of at most this many.
const COVERED_SIGMAS: f64 = 2.0;
/// This many standard deviations of the truth are always allowed.
const TRUTH_SIGMAS: f64 = 2.0;

/// Standard deviations of the truth; zero if not given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TruthSigma {
    /// Of the depth, metres.
    pub z_m: f64,
    /// Of the normal, radians.
    pub normal_rad: f64,
}

/// Facts about a case for the results.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseFacts {
    /// Its name.
    pub name: String,
    /// Its group.
    pub group: Group,
    /// `public` or `heldout`.
    pub split: Option<String>,
    /// The data set that the pair comes from.
    pub family: Option<String>,
    /// Its difficulty, as in its file.
    pub hard: Option<&'static str>,
    /// Number of pixels of the region.
    pub region_px: usize,
    /// True depth on the ray of the region's centroid, metres.
    pub z_m: f64,
    /// Standard deviations of the truth.
    pub sigma: TruthSigma,
}

impl CaseFacts {
    /// Whether the normal is judged.
    pub fn is_planar(&self) -> bool {
        self.group != Group::NonPlanar
    }

    /// Grade of an answer with these errors. For a non-planar region only the depth counts.
    pub fn grade(&self, z_m: f64, normal_rad: f64) -> Grade {
        let z_sure = TRUTH_SIGMAS * self.sigma.z_m;
        let normal_sure = TRUTH_SIGMAS * self.sigma.normal_rad;
        let within = |z_ratio: f64, normal_deg: f64| {
            z_m.abs() <= (z_ratio * self.z_m).max(z_sure)
                && (!self.is_planar() || normal_rad <= normal_deg.to_radians().max(normal_sure))
        };
        match (within(PASS_Z_RATIO, PASS_NORMAL_DEG), within(GROSS_Z_RATIO, GROSS_NORMAL_DEG)) {
            (true, _) => Grade::Pass,
            (false, true) => Grade::Near,
            (false, false) => Grade::Gross,
        }
    }
}

/// Grade of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grade {
    /// Depth within 1 % and normal within 5 degrees, or within twice the standard deviation of the truth.
    Pass,
    /// Neither passed nor grossly wrong.
    Near,
    /// Depth error above 1.5 % or normal error above 20 degrees (or twice the standard deviation of the truth).
    Gross,
}

/// The plane from a method, compared with the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// Estimated minus true depth on the ray of the region's centroid, metres.
    pub z_m: f64,
    /// Angle between the normals, radians.
    pub normal_rad: f64,
    /// The depth error as a disparity error, pixels.
    pub disparity_px: Option<f64>,
    /// The method's own standard deviation of depth, metres.
    pub z_sigma_m: Option<f64>,
    /// The method's own standard deviation of the normal, radians.
    pub normal_sigma_rad: Option<f64>,
    /// Median absolute difference from the true disparities inside the region, pixels, and the share within 1 px.
    pub map: Option<(f64, f64)>,
}

/// The visible surface from a method, compared with the true disparities inside the region.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceScore {
    /// Share of the true disparities within 1 px.
    pub within_1px: f64,
    /// Share of its points within two of their standard deviations.
    pub in_2_sigmas: f64,
}

/// Origin of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Maker {
    /// This project.
    Ours,
    /// Another tool.
    Peer,
}

/// One method on one case.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The case.
    pub case: Rc<CaseFacts>,
    /// Name of the method.
    pub method: String,
    /// Origin of the method.
    pub maker: Maker,
    /// Status from the method; other tools have none.
    pub status: Option<&'static str>,
    /// The plane; `None` without an answer.
    pub answer: Option<Answer>,
    /// The visible surface, of non-planar regions; `None` for a method that finds planes only.
    pub surface: Option<SurfaceScore>,
    /// CPU time of one thread from images in memory to the plane, median of the calls, milliseconds.
    pub ms: Option<f64>,
    /// CPU time of the first call, which may include work that is done once per rig.
    pub first_ms: Option<f64>,
    /// CPU time of measurements once per rig or scene, not included in `ms`, milliseconds; `None` if the method has none.
    pub rows_ms: Option<f64>,
}

impl Entry {
    /// Without any result.
    pub fn new(case: &Rc<CaseFacts>, method: &str, maker: Maker) -> Self {
        let (case, method) = (Rc::clone(case), method.to_owned());
        Self { case, method, maker, status: None, answer: None, surface: None, ms: None, first_ms: None, rows_ms: None }
    }

    /// The errors of depth and normal in standard deviations, the truth's included; `None` without one. The normal is judged of planes.
    fn sigmas(&self) -> [Option<f64>; 2] {
        let (Some(answer), truth) = (self.answer, self.case.sigma) else { return [None; 2] };
        let z = answer.z_sigma_m.map(|own| answer.z_m.abs() / own.hypot(truth.z_m));
        let normal = answer.normal_sigma_rad.map(|own| answer.normal_rad / own.hypot(truth.normal_rad));
        [z, normal.filter(|_| self.case.is_planar())]
    }

    /// Whether the stated standard deviations of depth and normal cover the errors.
    pub fn covered(&self) -> [Option<bool>; 2] {
        self.sigmas().map(|sigmas| sigmas.map(|sigmas| sigmas <= COVERED_SIGMAS))
    }

    /// Whether the status is `ok`.
    pub fn is_ok(&self) -> bool {
        self.status == Some("ok")
    }

    /// Whether the status is `ok` and the plane is wrong.
    pub fn is_wrong_ok(&self) -> bool {
        let beyond = self.sigmas().map(|sigmas| sigmas.is_none_or(|sigmas| sigmas > WRONG_SIGMAS));
        self.is_ok()
            && self.answer.is_some_and(|answer| {
                let normal_is_off = self.case.is_planar() && answer.normal_rad.to_degrees() > WRONG_NORMAL_DEG;
                answer.z_m.abs() > WRONG_Z_RATIO * self.case.z_m && beyond[0] || normal_is_off && beyond[1]
            })
    }

    /// The grade of the answer, if there is one.
    pub fn grade(&self) -> Option<Grade> {
        self.answer.map(|answer| self.case.grade(answer.z_m, answer.normal_rad))
    }

    /// Squared errors over their variances, of depth and of normal: the method's own variance plus the truth's. `None`
    /// for a method without standard deviations and for non-planar regions.
    pub fn squared_scores(&self) -> Option<(f64, f64)> {
        let answer = self.answer.filter(|_| self.case.is_planar())?;
        let truth = self.case.sigma;
        let squared = |error: f64, own: f64, truth: f64| error * error / (own * own + truth * truth);
        let z = squared(answer.z_m, answer.z_sigma_m?, truth.z_m);
        let normal = squared(answer.normal_rad, answer.normal_sigma_rad?, truth.normal_rad);
        (z.is_finite() && normal.is_finite()).then_some((z, normal))
    }

    /// The line of the result file, with the keys of the other tools' scripts and some more.
    pub fn to_json(&self) -> Value {
        let (case, answer) = (&self.case, self.answer);
        json!({
            "case": case.name,
            "split": case.split,
            "family": case.family,
            "hard": case.hard,
            "planar": case.is_planar(),
            "method": self.method,
            "region_px": case.region_px,
            "ok": answer.is_some(),
            "status": self.status,
            "grade": self.grade().map(|grade| match grade {
                Grade::Pass => "pass",
                Grade::Near => "near",
                Grade::Gross => "gross",
            }),
            "z_err_mm": answer.map(|a| 1e3 * a.z_m),
            "z_err_pct": answer.map(|a| 100.0 * a.z_m / case.z_m),
            "disp_err_px": answer.and_then(|a| a.disparity_px),
            "normal_err_deg": answer.map(|a| a.normal_rad.to_degrees()),
            "gt_disp_med_abs_px": answer.and_then(|a| a.map).map(|(median, _)| median),
            "gt_disp_within_1px": answer.and_then(|a| a.map).map(|(_, share)| share),
            "surface_within_1px": self.surface.map(|found| found.within_1px),
            "surface_in_2_sigmas": self.surface.map(|found| found.in_2_sigmas),
            "ms": self.ms,
            "first_ms": self.first_ms,
            "rows_ms": self.rows_ms,
            "z_sigma_mm": 1e3 * case.sigma.z_m,
            "normal_sigma_deg": case.sigma.normal_rad.to_degrees(),
            "own_z_sigma_mm": answer.and_then(|a| a.z_sigma_m).map(|sigma| 1e3 * sigma),
            "own_normal_sigma_deg": answer.and_then(|a| a.normal_sigma_rad).map(f64::to_degrees),
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A case at 2 m; standard deviations of the truth in millimetres and degrees.
    pub fn case(name: &str, group: Group, (z_sigma_mm, normal_sigma_deg): (f64, f64)) -> Rc<CaseFacts> {
        Rc::new(CaseFacts {
            name: name.into(),
            group,
            split: Some("public".into()),
            family: None,
            hard: None,
            region_px: 1000,
            z_m: 2.0,
            sigma: TruthSigma { z_m: 1e-3 * z_sigma_mm, normal_rad: normal_sigma_deg.to_radians() },
        })
    }

    /// An answer with errors in millimetres and degrees, and half of the true disparities within 1 px.
    pub fn answer(z_mm: f64, normal_deg: f64) -> Answer {
        Answer {
            z_m: 1e-3 * z_mm,
            normal_rad: normal_deg.to_radians(),
            disparity_px: None,
            z_sigma_m: None,
            normal_sigma_rad: None,
            map: Some((0.9, 0.5)),
        }
    }

    /// An entry of one of our methods.
    pub fn entry(case: &Rc<CaseFacts>, method: &str, answer: Option<Answer>) -> Entry {
        let status = Some(if answer.is_some() { "ok" } else { "not-observable" });
        Entry { status, answer, ms: Some(2.0), first_ms: Some(3.0), ..Entry::new(case, method, Maker::Ours) }
    }

    #[track_caller]
    fn check(case: &CaseFacts, (z_mm, normal_deg): (f64, f64), expected: Grade) {
        assert_eq!(case.grade(1e-3 * z_mm, normal_deg.to_radians()), expected, "{z_mm} mm, {normal_deg} degrees");
    }

    #[test]
    fn one_percent_and_five_degrees_pass_where_the_truth_is_sure() {
        // At 2 m, 1 % is 20 mm and 1.5 % is 30 mm.
        let sure = case("a", Group::Textured, (1.0, 0.5));
        check(&sure, (-19.9, 4.9), Grade::Pass);
        check(&sure, (20.1, 0.0), Grade::Near);
        check(&sure, (0.0, 5.1), Grade::Near);
        check(&sure, (-29.9, 19.9), Grade::Near);
        check(&sure, (30.1, 0.0), Grade::Gross);
        check(&sure, (0.0, 20.1), Grade::Gross);
        check(&sure, (f64::NAN, 0.0), Grade::Gross);
    }

    #[test]
    fn twice_the_uncertainty_of_the_truth_passes_where_that_is_more() {
        let unsure = case("a", Group::Small, (17.0, 11.0));
        check(&unsure, (33.9, 21.9), Grade::Pass);
        check(&unsure, (34.1, 0.0), Grade::Gross);
        check(&unsure, (0.0, 22.1), Grade::Gross);
        let unsure_normal = case("a", Group::Small, (1.0, 4.0));
        check(&unsure_normal, (19.0, 7.9), Grade::Pass);
        check(&unsure_normal, (21.0, 7.9), Grade::Near);
        check(&unsure_normal, (19.0, 8.1), Grade::Near);
    }

    #[test]
    fn of_a_region_that_is_no_plane_only_the_depth_counts() {
        let bent = case("a", Group::NonPlanar, (0.0, 0.0));
        check(&bent, (19.0, 80.0), Grade::Pass);
        check(&bent, (25.0, 0.0), Grade::Near);
        check(&bent, (31.0, 0.0), Grade::Gross);
    }

    #[test]
    fn scores_hold_both_variances() {
        let case = case("a", Group::Boards, (3.0, 0.8));
        let mut one = entry(&case, "m", Some(Answer { z_sigma_m: Some(4e-3), ..answer(10.0, 2.0) }));
        assert_eq!(one.squared_scores(), None, "the normal's is missing");
        one.answer.as_mut().expect("there").normal_sigma_rad = Some(0.6_f64.to_radians());
        // 10 mm over sqrt(3^2 + 4^2) mm is 2, 2 degrees over sqrt(0.8^2 + 0.6^2) degrees is 2: squared 4.
        let (z, normal) = one.squared_scores().expect("complete");
        assert!((z - 4.0).abs() < 1e-9 && (normal - 4.0).abs() < 1e-9, "{z} {normal}");
    }

    #[test]
    fn a_wrong_answer_is_off_by_more_than_it_states() {
        let case = case("a", Group::Boards, (3.0, 0.8));
        let with = |z_mm: f64, z_sigma_mm: f64| {
            let answer = Answer { z_sigma_m: Some(1e-3 * z_sigma_mm), ..answer(z_mm, 2.0) };
            entry(&case, "m", Some(answer))
        };
        // 1 % of 2 m is 20 mm; sqrt(3^2 + 4^2) mm is 5 mm.
        assert_eq!([with(9.0, 4.0), with(11.0, 4.0)].map(|one| one.covered()[0]), [Some(true), Some(false)]);
        assert_eq!(
            [with(21.0, 4.0), with(19.0, 4.0), with(21.0, 7.0)].map(|one| one.is_wrong_ok()),
            [true, false, false]
        );
        assert!(!Entry { status: Some("weak-tilt"), ..with(21.0, 4.0) }.is_wrong_ok());
    }

    #[test]
    fn lines_are_in_millimetres_percent_and_degrees() {
        let case = case("a", Group::Boards, (3.0, 0.8));
        let line = entry(&case, "m", Some(answer(-10.0, 2.0))).to_json();
        let number = |key: &str| line[key].as_f64().expect("a number");
        assert!((number("z_err_mm") + 10.0).abs() < 1e-9 && (number("z_err_pct") + 0.5).abs() < 1e-9);
        assert!((number("normal_err_deg") - 2.0).abs() < 1e-9 && (number("z_sigma_mm") - 3.0).abs() < 1e-9);
        assert_eq!((line["grade"].as_str(), line["ok"].as_bool()), (Some("pass"), Some(true)));
        let silent = entry(&case, "m", None).to_json();
        assert!(silent["z_err_mm"].is_null() && silent["grade"].is_null());
        assert_eq!((silent["status"].as_str(), silent["ok"].as_bool()), (Some("not-observable"), Some(false)));
    }
}

//! Required accuracy of a run, and the rows that miss it.

use pb3dp_benchmarks::table::{Column, at, number};
use serde_json::{Value, json};

/// Limit of a figure in all rows whose name starts with a text.
#[derive(Clone, Copy, Debug)]
struct Limit {
    /// The method to which the limit applies.
    method: &'static str,
    /// Start of the name of a configuration, sequence, ensemble or object.
    start: &'static str,
    /// Name of the figure.
    figure: &'static str,
    /// Its largest value.
    max: f64,
}

/// The limited figures: name, and where they stand in a row. `Nees` is the mean normalised squared error over its expected value, of an
/// ensemble that of the pose; of ensembles it also has a smallest value.
const FIGURES: [(&str, &str); 21] = [
    ("ZMedianMm", "z_mm.median"),
    ("ZP95Mm", "z_mm.p95"),
    ("AngleMedianDeg", "angle_deg.median"),
    ("AngleP95Deg", "angle_deg.p95"),
    ("ZRatio", "ratio.z"),
    ("AngleRatio", "ratio.angle"),
    ("WrongOk", "wrong_ok"),
    ("MissedPercent", "missed_percent"),
    ("UnsurePercent", "unsure_percent"),
    ("Nees", "nees"),
    ("Nees", "pose.nees"),
    ("OneOverNees", "pose.nees"),
    ("XyMedianMm", "xy_mm.median"),
    ("XyP95Mm", "xy_mm.p95"),
    ("RotationMedianDeg", "rotation_deg.median"),
    ("RotationP95Deg", "rotation_deg.p95"),
    ("Lost", "lost"),
    ("FramesUntilBack", "frames_until_back"),
    ("BeyondTwoSigmasDepthPercent", "depth_mm.beyond_two_sigmas_percent"),
    ("BeyondTwoSigmasTiltPercent", "tilt_deg.beyond_two_sigmas_percent"),
    ("StatedOverRmsTilt", "tilt_deg.stated_over_rms"),
];

/// A figure and its largest value.
type Max = (&'static str, f64);

/// The limits. Those of `published` keep the comparison fair: the method must work where it is known to work.
const PAIRS: &[(&str, &str, &[Max])] = &[
    ("published", "target/colourful", &[("UnsurePercent", 10.0), ("ZMedianMm", 1.0), ("AngleMedianDeg", 3.0)]),
    ("published", "unobservable/", &[("WrongOk", 0.0)]),
    (
        "direct",
        "target/colourful",
        &[("ZRatio", 1.25), ("AngleRatio", 1.5), ("ZMedianMm", 0.02), ("AngleMedianDeg", 0.10)],
    ),
    ("direct", "target/crab", &[("ZRatio", 1.25), ("AngleRatio", 1.5), ("ZMedianMm", 0.02), ("AngleMedianDeg", 0.10)]),
    ("direct", "target/red", &[("ZRatio", 1.25), ("AngleRatio", 1.5)]),
    ("direct", "target/grey", &[("ZMedianMm", 0.03), ("AngleMedianDeg", 0.15)]),
    ("direct", "target/faint", &[("ZRatio", 1.5), ("AngleRatio", 2.0)]),
    ("direct", "noise/8", &[("ZRatio", 1.5), ("AngleRatio", 1.5)]),
    ("direct", "glossy/colourful", &[("ZMedianMm", 0.05), ("AngleMedianDeg", 0.25)]),
    ("direct", "glossy/crab", &[("ZMedianMm", 0.05), ("AngleMedianDeg", 0.25)]),
    ("direct", "glossy/grey", &[("ZMedianMm", 0.05), ("AngleMedianDeg", 0.25)]),
    ("direct", "rectangle/", &[("ZMedianMm", 0.15), ("ZP95Mm", 0.5), ("AngleMedianDeg", 0.4), ("AngleP95Deg", 1.0)]),
    ("direct", "occlusion/20%", &[("ZMedianMm", 0.15), ("ZP95Mm", 0.5), ("AngleMedianDeg", 0.4), ("AngleP95Deg", 1.0)]),
    ("direct", "unrectified/", &[("ZRatio", 1.25 * 1.3), ("AngleRatio", 1.5 * 1.3)]),
    ("direct", "cold/colourful", &[("MissedPercent", 0.0)]),
    ("direct", "cold/crab", &[("MissedPercent", 0.0)]),
    ("direct", "cold/red", &[("MissedPercent", 0.0)]),
    ("direct", "cold/grey", &[("MissedPercent", 0.0)]),
    ("direct", "cold/repetitive", &[("MissedPercent", 0.0)]),
    ("direct", "cold/faint", &[("MissedPercent", 5.0)]),
    ("direct", "unobservable/", &[("WrongOk", 0.0)]),
    ("direct", "target/", &[("WrongOk", 0.0), ("Nees", 1.5)]),
];

const NONE: [f64; 2] = [f64::INFINITY; 2];

/// Limits for tracked sequences, median and 95th percentile: across and along the optical axis, mm, and rotation since the first frame,
/// degrees. In all of them only hidden targets may be lost, and no answer may be wrongly `ok`.
const SEQUENCES: [(&str, [[f64; 2]; 3]); 6] = [
    ("track/crab", PLANAR),
    ("track/colourful", PLANAR),
    ("track/grey", PLANAR),
    ("hidden/crab", PLANAR),
    ("track/relief-25mm", [NONE, [0.05, 0.2], [0.25, 0.5]]),
    ("track/shaded-relief-25mm", [NONE, NONE, [1.1, 1.8]]),
];
const PLANAR: [[f64; 2]; 3] = [[0.01, 0.03], [0.04, 0.15], [0.13, 0.35]];

/// A stated standard deviation of a plane is right to 20 %, that of a relief to 40 %: limits of 1 / NEES and NEES.
const NEES_OF_PLANES: [f64; 2] = [1.0 / 0.7, 1.5];
const NEES_OF_RELIEFS: [f64; 2] = [1.0 / 0.5, 2.0];

/// Limits for ensembles: 1 / NEES and NEES of the pose, of a relief that of the motion; along the optical axis, mm, and rotation, degrees. In all
/// of them no target may be lost, and no answer may be wrongly `ok`.
const ENSEMBLES: [(&str, [[f64; 2]; 3]); 8] = [
    ("many/crab", [NEES_OF_PLANES, NONE, NONE]),
    ("many/grey", [NEES_OF_PLANES, NONE, NONE]),
    ("many/colourful", [NEES_OF_PLANES, NONE, NONE]),
    ("many/rectangle", [NEES_OF_PLANES, NONE, NONE]),
    ("many/relief", [NEES_OF_RELIEFS, NONE, NONE]),
    ("exposure/", [NONE, [0.05, 0.18], [0.15, 0.40]]),
    ("skew/1ms", [NONE, [0.05, 0.18], [0.15, 0.40]]),
    ("skew/5ms", [NONE, [0.08, 0.20], [0.15, 0.40]]),
];

/// Objects with limits of their first poses. A relief of 25 mm has none: its sides are hidden from the right camera.
const FIRST_POSES: [&str; 4] = ["first-pose/crab-5", "first-pose/crab-10", "first-pose/potato", "first-pose/box"];

/// All limits.
fn limits() -> Vec<Limit> {
    let direct = |start: &'static str, figure: &'static str, max: f64| Limit { method: "direct", start, figure, max };
    let of_pairs = PAIRS.iter().flat_map(|(method, start, max)| {
        max.iter().map(move |(figure, max)| Limit { method, start, figure, max: *max })
    });
    let mut limits: Vec<Limit> = of_pairs.collect();
    let mut add = |start: &'static str, names: [[&'static str; 2]; 3], max: [[f64; 2]; 3]| {
        limits.extend(names.concat().into_iter().zip(max.concat()).map(|(figure, max)| direct(start, figure, max)));
        limits.extend([direct(start, "Lost", 0.0), direct(start, "WrongOk", 0.0)]);
    };
    let (z, rotation) = (["ZMedianMm", "ZP95Mm"], ["RotationMedianDeg", "RotationP95Deg"]);
    SEQUENCES.iter().for_each(|(start, max)| add(start, [["XyMedianMm", "XyP95Mm"], z, rotation], *max));
    ENSEMBLES.iter().for_each(|(start, max)| add(start, [["OneOverNees", "Nees"], z, rotation], *max));
    limits.push(direct("hidden/crab", "FramesUntilBack", 3.0));
    for start in FIRST_POSES {
        limits.push(direct(start, "BeyondTwoSigmasDepthPercent", 15.0));
        limits.push(direct(start, "BeyondTwoSigmasTiltPercent", 15.0));
        limits.push(direct(start, "StatedOverRmsTilt", 1.6));
    }
    limits.retain(|limit| limit.max.is_finite());
    limits
}

/// A goal that a configuration or sequence of exactly this name does not reach yet, with a ceiling for the meantime.
#[derive(Clone, Copy, Debug)]
struct OpenGoal {
    /// Configuration or sequence.
    name: &'static str,
    /// The quantity, by its name in the tables.
    figure: &'static str,
    /// Its largest value, above the limit.
    ceiling: f64,
}

/// The open goals of the direct method. The page marks them as `open`; a run fails only above the ceiling.
const OPEN: &[OpenGoal] = &[
    OpenGoal { name: "target/faint", figure: "Nees", ceiling: 1.8 },
    // The stated variance is 1.5 times the true one: NEES 0.68 with an interval of 0.61 to 0.77.
    OpenGoal { name: "many/crab", figure: "OneOverNees", ceiling: 1.7 },
    // One of the sequences does not start: its first pair is `ambiguous`.
    OpenGoal { name: "many/relief-10mm", figure: "Lost", ceiling: 20.0 },
];

/// Whether a limit is for this configuration, sequence, ensemble or object.
pub fn has_limit(name: &str) -> bool {
    limits().iter().any(|limit| name.starts_with(limit.start))
}

/// The name of a row.
fn name_of(row: &Value) -> &str {
    let mut names =
        ["cell", "sequence", "ensemble", "first_poses"].into_iter().filter_map(|key| row.get(key)?.as_str());
    names.next().unwrap_or_default()
}

/// The columns of the table of limits.
pub const COLUMNS: [Column<'_>; 6] = [
    ("configuration", "{name}"),
    ("method", "{method}"),
    ("figure", "{figure}"),
    ("measured", "{measured:3}"),
    ("limit", "{max:3}"),
    ("met", "{met}"),
];

/// One check of one row.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Configuration, sequence, ensemble or object.
    pub name: String,
    /// The method.
    pub method: &'static str,
    /// The measured quantity.
    pub figure: &'static str,
    /// The value; NaN without one.
    pub measured: f64,
    /// The largest allowed.
    pub max: f64,
}

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Standing {
    /// The limit is met.
    Kept,
    /// An open goal: not reached, but not above its ceiling.
    Open(f64),
    /// Neither: the limit is missed.
    Broken,
}

impl Check {
    /// The result, see [`Self::holds`].
    pub fn standing(&self, quick: bool) -> Standing {
        if self.holds(quick) {
            return Standing::Kept;
        }
        let is_this =
            |goal: &&OpenGoal| self.method == "direct" && goal.name == self.name && goal.figure == self.figure;
        match OPEN.iter().find(is_this).map(|goal| goal.ceiling) {
            Some(ceiling) if (Self { max: ceiling, ..self.clone() }).holds(quick) => Standing::Open(ceiling),
            _ => Standing::Broken,
        }
    }

    /// Whether the limit is met. With few poses the value may exceed the limit by as much as chance explains.
    fn holds(&self, quick: bool) -> bool {
        // With 32 poses a 95th percentile scatters by a third, and a median or an rms by a seventh.
        let slack = if quick { 1.4 } else { 1.0 };
        self.measured <= self.max * slack
    }

    /// As a row.
    pub fn to_json(&self, quick: bool) -> Value {
        let met = match self.standing(quick) {
            Standing::Kept => "yes".to_owned(),
            Standing::Open(ceiling) => format!("open, at most {ceiling:.3}"),
            Standing::Broken => "no".to_owned(),
        };
        json!({
            "name": self.name, "method": self.method, "figure": self.figure, "measured": self.measured, "max": self.max,
            "kept": self.holds(quick), "open": met.starts_with("open"), "met": met,
        })
    }
}

/// Checks every limit that applies to one of the rows.
pub fn checks(rows: &[Value]) -> Vec<Check> {
    let check = |limit: Limit| {
        let applies = move |row: &&Value| row["method"] == limit.method && name_of(row).starts_with(limit.start);
        rows.iter().filter(applies).map(move |row| Check {
            name: name_of(row).to_owned(),
            method: limit.method,
            figure: limit.figure,
            measured: figure(row, limit.figure),
            max: limit.max,
        })
    };
    limits().into_iter().flat_map(check).collect()
}

/// A figure of a row, by its name.
fn figure(row: &Value, name: &str) -> f64 {
    let places = FIGURES.iter().filter(|(other, _)| *other == name).map(|(_, place)| *place);
    let mut found = places.filter(|place| at(row, place).is_some());
    let value = found.next().and_then(|place| number(row, place)).unwrap_or(f64::NAN);
    if name == "OneOverNees" { 1.0 / value } else { value }
}

#[cfg(test)]
mod tests {
    use super::super::{cells, ensembles, first_pose, sequences};
    use super::*;

    fn names() -> Vec<String> {
        let cells = cells::all().into_iter().map(|cell| cell.name);
        let sequences = sequences::all().into_iter().map(|sequence| sequence.name);
        let ensembles = ensembles::all().into_iter().map(|ensemble| ensemble.common.name);
        let objects = first_pose::OBJECTS.into_iter().map(|(name, _)| name.to_owned());
        cells.chain(sequences).chain(ensembles).chain(objects).collect()
    }

    #[test]
    fn every_limit_concerns_a_row_and_a_known_figure() {
        for limit in limits() {
            assert!(names().iter().any(|name| name.starts_with(limit.start)), "{limit:?}");
            assert!(FIGURES.iter().any(|(name, _)| *name == limit.figure), "{limit:?}");
        }
    }

    #[test]
    fn every_open_goal_is_a_limit_with_a_ceiling_above_it() {
        for goal in OPEN {
            let limits = limits();
            let limit = limits.iter().find(|limit| goal.name.starts_with(limit.start) && limit.figure == goal.figure);
            assert!(names().iter().any(|name| *name == goal.name), "{goal:?}");
            assert!(limit.is_some_and(|limit| limit.max < goal.ceiling), "{goal:?}");
        }
    }

    #[test]
    fn figures_are_found_in_rows_of_every_kind() {
        let rows = [
            json!({"cell": "noise/8", "method": "direct", "ratio": {"z": 1.2, "angle": null}}),
            json!({"ensemble": "many/crab", "method": "direct", "pose": {"nees": 0.5}, "lost": 0, "wrong_ok": 1}),
        ];
        let found = checks(&rows);
        let measured = |figure: &str| found.iter().find(|check| check.figure == figure).unwrap();
        assert_eq!((measured("ZRatio").measured, measured("ZRatio").standing(false)), (1.2, Standing::Kept));
        assert_eq!((measured("OneOverNees").measured, measured("Nees").measured), (2.0, 0.5));
        assert!(measured("AngleRatio").measured.is_nan() && measured("AngleRatio").standing(true) == Standing::Broken);
        assert_eq!((measured("WrongOk").standing(true), found.len()), (Standing::Broken, 6));
    }

    #[test]
    fn what_was_not_measured_does_not_hold() {
        let check = |measured, max| Check { name: "a/b".into(), method: "direct", figure: "ZRatio", measured, max };
        assert!(check(1.2, 1.25).holds(false) && !check(1.3, 1.25).holds(false) && check(1.3, 1.25).holds(true));
        assert!(!check(f64::NAN, 1.25).holds(true), "no answer is no success");
        assert!(!check(1.0, 0.0).holds(true), "one wrong ok is one too many, with any slack");
    }
}

//! Required accuracy of a run, and the rows that miss it.

use super::ensemble_summary::EnsembleSummary;
use super::first_pose::FirstPoses;
use super::sequence_summary::SequenceSummary;
use super::summary::Summary;

/// Measured quantity of a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Figure {
    /// Median of the absolute depth error, mm.
    ZMedianMm,
    /// Its 95th percentile.
    ZP95Mm,
    /// Median of the angle error, degrees.
    AngleMedianDeg,
    /// Its 95th percentile.
    AngleP95Deg,
    /// Rms depth error over the bound.
    ZRatio,
    /// Rms angle error over the bound.
    AngleRatio,
    /// Number of answers that are confident and wrong.
    WrongOk,
    /// Poses without a right answer, percent.
    MissedPercent,
    /// Poses without a confident answer, percent.
    UnsurePercent,
    /// Mean normalised squared error over its expected value, upper limit.
    Nees,
}

/// A limit for all configurations whose name starts with a text.
#[derive(Clone, Copy, Debug)]
pub struct Limit {
    /// The method to which the limit applies.
    pub method: &'static str,
    /// Start of the configuration's name.
    pub cell: &'static str,
    /// The quantity.
    pub figure: Figure,
    /// Its largest value.
    pub max: f64,
}

const fn direct(cell: &'static str, figure: Figure, max: f64) -> Limit {
    Limit { method: "direct", cell, figure, max }
}

const fn published(cell: &'static str, figure: Figure, max: f64) -> Limit {
    Limit { method: "published", cell, figure, max }
}

/// The limits. Those of `published` keep the comparison fair: the method must work where it is known to work.
pub const LIMITS: &[Limit] = &[
    published("target/colourful", Figure::UnsurePercent, 10.0),
    published("target/colourful", Figure::ZMedianMm, 1.0),
    published("target/colourful", Figure::AngleMedianDeg, 3.0),
    published("unobservable/", Figure::WrongOk, 0.0),
    direct("target/colourful", Figure::ZRatio, 1.25),
    direct("target/colourful", Figure::AngleRatio, 1.5),
    direct("target/crab", Figure::ZRatio, 1.25),
    direct("target/crab", Figure::AngleRatio, 1.5),
    direct("target/red", Figure::ZRatio, 1.25),
    direct("target/red", Figure::AngleRatio, 1.5),
    direct("target/colourful", Figure::ZMedianMm, 0.02),
    direct("target/colourful", Figure::AngleMedianDeg, 0.10),
    direct("target/crab", Figure::ZMedianMm, 0.02),
    direct("target/crab", Figure::AngleMedianDeg, 0.10),
    direct("target/grey", Figure::ZMedianMm, 0.03),
    direct("target/grey", Figure::AngleMedianDeg, 0.15),
    direct("target/faint", Figure::ZRatio, 1.5),
    direct("target/faint", Figure::AngleRatio, 2.0),
    direct("noise/8", Figure::ZRatio, 1.5),
    direct("noise/8", Figure::AngleRatio, 1.5),
    direct("glossy/colourful", Figure::ZMedianMm, 0.05),
    direct("glossy/crab", Figure::ZMedianMm, 0.05),
    direct("glossy/grey", Figure::ZMedianMm, 0.05),
    direct("glossy/colourful", Figure::AngleMedianDeg, 0.25),
    direct("glossy/crab", Figure::AngleMedianDeg, 0.25),
    direct("glossy/grey", Figure::AngleMedianDeg, 0.25),
    direct("rectangle/", Figure::ZMedianMm, 0.15),
    direct("rectangle/", Figure::ZP95Mm, 0.5),
    direct("rectangle/", Figure::AngleMedianDeg, 0.4),
    direct("rectangle/", Figure::AngleP95Deg, 1.0),
    direct("occlusion/20%", Figure::ZMedianMm, 0.15),
    direct("occlusion/20%", Figure::ZP95Mm, 0.5),
    direct("occlusion/20%", Figure::AngleMedianDeg, 0.4),
    direct("occlusion/20%", Figure::AngleP95Deg, 1.0),
    direct("unrectified/", Figure::ZRatio, 1.25 * 1.3),
    direct("unrectified/", Figure::AngleRatio, 1.5 * 1.3),
    direct("cold/colourful", Figure::MissedPercent, 0.0),
    direct("cold/crab", Figure::MissedPercent, 0.0),
    direct("cold/red", Figure::MissedPercent, 0.0),
    direct("cold/grey", Figure::MissedPercent, 0.0),
    direct("cold/repetitive", Figure::MissedPercent, 0.0),
    direct("cold/faint", Figure::MissedPercent, 5.0),
    direct("unobservable/", Figure::WrongOk, 0.0),
    direct("target/", Figure::WrongOk, 0.0),
    direct("target/", Figure::Nees, 1.5),
];

/// A goal that a configuration or sequence of exactly this name does not reach yet, with a ceiling for the meantime.
#[derive(Clone, Copy, Debug)]
pub struct OpenGoal {
    /// Configuration or sequence.
    pub name: &'static str,
    /// The quantity, by its name in the tables.
    pub figure: &'static str,
    /// Its largest value, above the limit.
    pub ceiling: f64,
}

/// The open goals of the direct method. The page marks them as `open`; a run fails only above the ceiling.
pub const OPEN: &[OpenGoal] = &[
    OpenGoal { name: "target/faint", figure: "Nees", ceiling: 1.8 },
    // The stated variance is 1.5 times the true one: NEES 0.68 with an interval of 0.61 to 0.77.
    OpenGoal { name: "many/crab", figure: "OneOverNees", ceiling: 1.7 },
    // One of the sequences does not start: its first pair is `ambiguous`.
    OpenGoal { name: "many/relief-10mm", figure: "Lost", ceiling: 20.0 },
];

/// Limits of a method for tracked sequences whose name starts with a text: median and 95th percentile.
#[derive(Clone, Copy, Debug)]
pub struct SequenceLimit {
    /// The method to which the limits apply.
    pub method: &'static str,
    /// Start of the sequence's name.
    pub sequence: &'static str,
    /// Error across the optical axis, mm.
    pub xy_mm: [f64; 2],
    /// Error along the optical axis, mm.
    pub z_mm: [f64; 2],
    /// Rotation error since the first frame, degrees.
    pub rotation_deg: [f64; 2],
}

const NONE: [f64; 2] = [f64::INFINITY; 2];

/// The limits for sequences; in all of them only hidden targets may be lost, and no answer may be wrongly `ok`.
pub const SEQUENCE_LIMITS: &[SequenceLimit] = &[
    planar("track/crab"),
    planar("track/colourful"),
    planar("track/grey"),
    planar("hidden/crab"),
    SequenceLimit {
        method: "direct",
        sequence: "track/relief-25mm",
        xy_mm: NONE,
        z_mm: [0.05, 0.2],
        rotation_deg: [0.25, 0.5],
    },
    SequenceLimit {
        method: "direct",
        sequence: "track/shaded-relief-25mm",
        xy_mm: NONE,
        z_mm: NONE,
        rotation_deg: [1.1, 1.8],
    },
];

const fn planar(sequence: &'static str) -> SequenceLimit {
    SequenceLimit { method: "direct", sequence, xy_mm: [0.01, 0.03], z_mm: [0.04, 0.15], rotation_deg: [0.13, 0.35] }
}

/// Limits of the direct method for ensembles whose name starts with a text.
#[derive(Clone, Copy, Debug)]
pub struct EnsembleLimit {
    /// Start of the ensemble's name.
    pub ensemble: &'static str,
    /// NEES of the pose, of a relief that of the motion: smallest and largest.
    pub nees: [f64; 2],
    /// Error along the optical axis, mm: median, 95th percentile.
    pub z_mm: [f64; 2],
    /// Rotation error since the first frame, degrees.
    pub rotation_deg: [f64; 2],
}

/// A stated standard deviation of a plane is right to 20 %, that of a relief to 40 %.
const NEES_OF_PLANES: [f64; 2] = [0.7, 1.5];
const NEES_OF_RELIEFS: [f64; 2] = [0.5, 2.0];
const ANY: [f64; 2] = [0.0, f64::INFINITY];

/// The limits for ensembles; in all of them no target may be lost, and no answer may be wrongly `ok`.
pub const ENSEMBLE_LIMITS: &[EnsembleLimit] = &[
    EnsembleLimit { ensemble: "many/crab", nees: NEES_OF_PLANES, z_mm: NONE, rotation_deg: NONE },
    EnsembleLimit { ensemble: "many/grey", nees: NEES_OF_PLANES, z_mm: NONE, rotation_deg: NONE },
    EnsembleLimit { ensemble: "many/colourful", nees: NEES_OF_PLANES, z_mm: NONE, rotation_deg: NONE },
    EnsembleLimit { ensemble: "many/rectangle", nees: NEES_OF_PLANES, z_mm: NONE, rotation_deg: NONE },
    EnsembleLimit { ensemble: "many/relief", nees: NEES_OF_RELIEFS, z_mm: NONE, rotation_deg: NONE },
    EnsembleLimit { ensemble: "exposure/", nees: ANY, z_mm: [0.05, 0.18], rotation_deg: [0.15, 0.40] },
    EnsembleLimit { ensemble: "skew/1ms", nees: ANY, z_mm: [0.05, 0.18], rotation_deg: [0.15, 0.40] },
    EnsembleLimit { ensemble: "skew/5ms", nees: ANY, z_mm: [0.08, 0.20], rotation_deg: [0.15, 0.40] },
];

/// Limits of the first poses of an object that is no plane: errors beyond two stated standard deviations, percent, of depth and tilt; median
/// standard deviation over the rms error of the tilt.
const FIRST_POSES_BEYOND_MAX: f64 = 15.0;
const FIRST_POSES_STATED_MAX: f64 = 1.6;

/// The checks of the first poses of an object. A relief of 25 mm is no limit's: its sides are hidden from the right camera.
pub fn checks_of_first_poses(found: &FirstPoses) -> Vec<Check> {
    let [[.., z_within], [_, _, rms, sigma, tilt_within]] = found.figures;
    let check = |figure: &str, measured: f64, max: f64| Check {
        name: found.name.clone(),
        method: "direct",
        figure: figure.to_owned(),
        measured,
        max,
    };
    if !has_limit(&found.name) {
        return Vec::new();
    }
    vec![
        check("BeyondTwoSigmasDepthPercent", 100.0 * (1.0 - z_within), FIRST_POSES_BEYOND_MAX),
        check("BeyondTwoSigmasTiltPercent", 100.0 * (1.0 - tilt_within), FIRST_POSES_BEYOND_MAX),
        check("StatedOverRmsTilt", sigma / rms, FIRST_POSES_STATED_MAX),
    ]
}

/// Objects with limits of their first poses.
const FIRST_POSES: [&str; 4] = ["first-pose/crab-5", "first-pose/crab-10", "first-pose/potato", "first-pose/box"];

/// Whether a limit is for this configuration, sequence or ensemble.
pub fn has_limit(name: &str) -> bool {
    let of_cells = LIMITS.iter().map(|limit| limit.cell);
    let of_sequences = SEQUENCE_LIMITS.iter().map(|limit| limit.sequence);
    let of_ensembles = ENSEMBLE_LIMITS.iter().map(|limit| limit.ensemble);
    let mut starts = of_cells.chain(of_sequences).chain(of_ensembles).chain(FIRST_POSES);
    starts.any(|start| name.starts_with(start))
}

/// One check of one row.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Configuration or sequence.
    pub name: String,
    /// The method.
    pub method: &'static str,
    /// The measured quantity.
    pub figure: String,
    /// The value.
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
    pub fn holds(&self, quick: bool) -> bool {
        // With 32 poses a 95th percentile scatters by a third, and a median or an rms by a seventh.
        let slack = if quick { 1.4 } else { 1.0 };
        self.measured <= self.max * slack
    }
}

impl Figure {
    fn of(self, summary: &Summary) -> f64 {
        let ratio = |index: usize| summary.ratio.map_or(f64::NAN, |ratio| ratio[index]);
        match self {
            Self::ZMedianMm => summary.z_m[0] * 1e3,
            Self::ZP95Mm => summary.z_m[1] * 1e3,
            Self::AngleMedianDeg => summary.angle_rad[0].to_degrees(),
            Self::AngleP95Deg => summary.angle_rad[1].to_degrees(),
            Self::ZRatio => ratio(0),
            Self::AngleRatio => ratio(1),
            Self::WrongOk => summary.wrong_ok as f64,
            Self::MissedPercent => 100.0 * (1.0 - summary.right_share()),
            Self::UnsurePercent => 100.0 * (1.0 - summary.sure_share()),
            Self::Nees => summary.nees.unwrap_or(f64::NAN),
        }
    }
}

/// Checks every limit that applies to one of the rows.
pub fn checks(summaries: &[Summary], sequences: &[SequenceSummary], ensembles: &[EnsembleSummary]) -> Vec<Check> {
    let mut checks = Vec::new();
    for limit in LIMITS {
        let rows = summaries.iter().filter(|row| row.method == limit.method && row.cell.starts_with(limit.cell));
        checks.extend(rows.map(|row| Check {
            name: row.cell.clone(),
            method: row.method,
            figure: format!("{:?}", limit.figure),
            measured: limit.figure.of(row),
            max: limit.max,
        }));
    }
    for limit in SEQUENCE_LIMITS {
        let rows =
            sequences.iter().filter(|row| row.method == limit.method && row.sequence.starts_with(limit.sequence));
        checks.extend(rows.flat_map(|row| sequence_checks(limit, row)));
    }
    for limit in ENSEMBLE_LIMITS {
        let rows = ensembles.iter().filter(|row| row.ensemble.starts_with(limit.ensemble));
        checks.extend(rows.flat_map(|row| ensemble_checks(limit, row)));
    }
    checks
}

fn ensemble_checks(limit: &EnsembleLimit, row: &EnsembleSummary) -> Vec<Check> {
    let check = |figure: &str, measured: f64, max: f64| Check {
        name: row.ensemble.clone(),
        method: row.method,
        figure: figure.to_owned(),
        measured,
        max,
    };
    let nees = row.pose.map_or(f64::NAN, |pose| pose.nees);
    let [low, high] = limit.nees;
    vec![
        check("Nees", nees, high),
        check("OneOverNees", 1.0 / nees, 1.0 / low),
        check("ZMedianMm", row.z_m[0] * 1e3, limit.z_mm[0]),
        check("ZP95Mm", row.z_m[1] * 1e3, limit.z_mm[1]),
        check("RotationMedianDeg", row.rotation_rad[0].to_degrees(), limit.rotation_deg[0]),
        check("RotationP95Deg", row.rotation_rad[1].to_degrees(), limit.rotation_deg[1]),
        check("Lost", row.lost as f64, 0.0),
        check("WrongOk", row.wrong_ok as f64, 0.0),
    ]
    .into_iter()
    .filter(|check| check.max.is_finite())
    .collect()
}

fn sequence_checks(limit: &SequenceLimit, row: &SequenceSummary) -> Vec<Check> {
    let check = |figure: &str, measured: f64, max: f64| Check {
        name: row.sequence.clone(),
        method: row.method,
        figure: figure.to_owned(),
        measured,
        max,
    };
    vec![
        check("XyMedianMm", row.xy_m[0] * 1e3, limit.xy_mm[0]),
        check("XyP95Mm", row.xy_m[1] * 1e3, limit.xy_mm[1]),
        check("ZMedianMm", row.z_m[0] * 1e3, limit.z_mm[0]),
        check("ZP95Mm", row.z_m[1] * 1e3, limit.z_mm[1]),
        check("RotationMedianDeg", row.rotation_rad[0].to_degrees(), limit.rotation_deg[0]),
        check("RotationP95Deg", row.rotation_rad[1].to_degrees(), limit.rotation_deg[1]),
        check("Lost", row.lost as f64, 0.0),
        check("WrongOk", row.wrong_ok as f64, 0.0),
        check("FramesUntilBack", row.frames_until_back.map_or(0.0, |frames| frames as f64), 3.0),
    ]
    .into_iter()
    .filter(|check| check.max.is_finite())
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_limit_concerns_a_cell_or_a_sequence() {
        let cells = super::super::cells::all();
        for limit in LIMITS {
            assert!(cells.iter().any(|cell| cell.name.starts_with(limit.cell)), "{limit:?}");
        }
        let sequences = super::super::sequences::all();
        for limit in SEQUENCE_LIMITS {
            assert!(sequences.iter().any(|sequence| sequence.name.starts_with(limit.sequence)), "{limit:?}");
        }
        let ensembles = super::super::ensembles::all();
        for limit in ENSEMBLE_LIMITS {
            assert!(ensembles.iter().any(|ensemble| ensemble.name.starts_with(limit.ensemble)), "{limit:?}");
        }
    }

    #[test]
    fn every_open_goal_is_a_limit_with_a_ceiling_above_it() {
        let cells = super::super::cells::all();
        let sequences = super::super::sequences::all();
        for goal in OPEN {
            let limit = LIMITS
                .iter()
                .find(|limit| goal.name.starts_with(limit.cell) && format!("{:?}", limit.figure) == goal.figure);
            let is_cell = cells.iter().any(|cell| cell.name == goal.name);
            let is_other = sequences.iter().any(|sequence| sequence.name == goal.name)
                || super::super::ensembles::all().iter().any(|ensemble| ensemble.name == goal.name);
            assert!(is_cell && limit.is_some_and(|limit| limit.max < goal.ceiling) || is_other, "{goal:?}");
        }
    }

    #[test]
    fn what_was_not_measured_does_not_hold() {
        let check =
            |measured, max| Check { name: "a/b".into(), method: "direct", figure: "ZRatio".into(), measured, max };
        assert!(check(1.2, 1.25).holds(false) && !check(1.3, 1.25).holds(false) && check(1.3, 1.25).holds(true));
        assert!(!check(f64::NAN, 1.25).holds(true), "no answer is no success");
        assert!(!check(1.0, 0.0).holds(true), "one wrong ok is one too many, with any slack");
    }
}

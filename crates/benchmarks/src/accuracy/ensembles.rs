//! Ensembles of short sequences, each with its own start, motion and noise: their errors are independent of each other.
//!
//! All frames of one sequence share the errors of its first frame, so one long sequence tells little about a covariance.

use nalgebra::Vector3;
use pb3dp_sim::targets::Paint;

use super::cell::{Backdrop, Condition, RegionKind, Setup, Shape};
use super::random::Random;
use super::sequences::{Motion, OwnMotion, SequenceSpec};

/// Sequences of an ensemble for the consistency of covariances.
const SEQUENCES: usize = 30;
/// Sequences of an ensemble with disturbed cameras: errors of 300 frames in all.
const SEQUENCES_DISTURBED: usize = 10;

/// An ensemble.
#[derive(Clone, Debug, PartialEq)]
pub struct EnsembleSpec {
    /// What its sequences have in common: its name, and all but their motions.
    pub common: SequenceSpec,
    /// Number of sequences.
    pub sequences: usize,
}

fn ensemble(name: &str, setup: Setup, condition: Condition) -> EnsembleSpec {
    // Moments within an exposure are as good as finer pixels, and nine times as slow.
    let (name, motion, fine) = (name.to_owned(), Motion::Still, !condition.has_moments());
    let common = SequenceSpec { name, setup, motion, frames: 30, rate_hz: 30.0, hides: false, fine, condition };
    EnsembleSpec { common, sequences: SEQUENCES_DISTURBED }
}

/// 20 frames in 1.3 s: long enough for turns that need a second view.
fn consistency(name: &str, setup: Setup) -> EnsembleSpec {
    let EnsembleSpec { common, .. } = ensemble(&format!("many/{name}"), setup, Condition::Undisturbed);
    EnsembleSpec { common: SequenceSpec { frames: 20, rate_hz: 15.0, ..common }, sequences: SEQUENCES }
}

fn disturbed(name: &str, condition: Condition) -> EnsembleSpec {
    ensemble(name, Setup::default(), condition)
}

/// All ensembles.
pub fn all() -> Vec<EnsembleSpec> {
    let nominal = Setup::default();
    let mut ensembles: Vec<EnsembleSpec> = [Paint::Crab, Paint::Grey, Paint::Colourful]
        .map(|paint| consistency(paint.name(), Setup { paint, ..nominal }))
        .into();
    let rectangle = Setup { region: RegionKind::Rectangle, backdrop: Backdrop::Sand { gap_m: 0.1 }, ..nominal };
    ensembles.push(consistency("rectangle-100mm-behind", rectangle));
    for relief in [5.0, 10.0, 25.0] {
        let shape = Shape::Crab { relief_m: relief * 1e-3 };
        ensembles.push(consistency(&format!("relief-{relief}mm"), Setup { shape, ..nominal }));
    }
    ensembles.push(disturbed("condition/none", Condition::Undisturbed));
    for (name, only_right) in [("both", false), ("right", true)] {
        let condition = Condition::ExposureSteps { factor: 1.5, only_right };
        ensembles.push(disturbed(&format!("exposure/{name}-1.5x"), condition));
    }
    for millis in [5.0, 10.0] {
        ensembles.push(disturbed(&format!("blur/{millis}ms"), Condition::Blur { exposure_s: millis * 1e-3 }));
    }
    for (name, millis, is_known) in [
        ("skew", 1.0, true),
        ("skew", 5.0, true),
        ("skew", 15.0, true),
        ("skew-unknown", 1.0, false),
        ("skew-unknown", 5.0, false),
    ] {
        let condition = Condition::Skew { delay_s: millis * 1e-3, is_known };
        ensembles.push(disturbed(&format!("{name}/{millis}ms"), condition));
    }
    for millis in [10.0, 20.0] {
        let condition = Condition::RollingShutter { readout_s: millis * 1e-3 };
        ensembles.push(disturbed(&format!("rolling/{millis}ms"), condition));
    }
    ensembles
}

impl EnsembleSpec {
    /// A fifth of the sequences, for a check in minutes.
    pub fn quick(self) -> Self {
        Self { sequences: self.sequences.div_ceil(5), ..self }
    }

    /// One of the sequences.
    pub fn member(&self, seed: u32, index: usize) -> SequenceSpec {
        let name = &self.common.name;
        let motion = Motion::Own(own_motion(&mut Random::of(seed, name, index)));
        SequenceSpec { name: format!("{name} {index}"), motion, ..self.common.clone() }
    }
}

/// A start in the range of the single pairs, and a motion that keeps the whole target in sight of both cameras.
fn own_motion(random: &mut Random) -> OwnMotion {
    let mut any = |limit: f64| random.between(-limit, limit);
    let start_m = Vector3::new(0.05 + any(0.01), any(0.01), 0.525 + any(0.045));
    let (tilt_x, tilt_y) = (any(15.0), any(15.0));
    let start_deg = Vector3::new(tilt_x, tilt_y, any(180.0));
    let mut waves = |low: f64, high: f64| {
        Vector3::from_fn(|_, _| {
            let sign = if random.between(-1.0, 1.0) < 0.0 { -1.0 } else { 1.0 };
            sign * random.between(low, high)
        })
    };
    let (shift_m, turn_deg) = (waves(0.010, 0.025), waves(5.0, 12.0));
    let mut six = |low: f64, high: f64| std::array::from_fn(|_| random.between(low, high));
    OwnMotion {
        start_m,
        start_deg,
        shift_m,
        turn_deg,
        period_s: six(2.5, 4.0),
        phase_rad: six(0.0, std::f64::consts::TAU),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sequences_differ_and_their_targets_stay_in_sight() {
        for ensemble in all() {
            let starts: Vec<_> = (0..ensemble.sequences)
                .map(|index| {
                    let spec = ensemble.member(1, index);
                    let start = spec.cam_left_from_target(0);
                    let mut turned = 0.0f64;
                    for frame in 0..spec.frames {
                        let pose = spec.cam_left_from_target(frame);
                        let place = pose.translation_m();
                        assert!((0.42..0.63).contains(&place.z), "{}: {place}", spec.name);
                        // With half of the target (55 mm), both cameras see 0.43 z to either side of their axes.
                        let side = (place.x.abs().max((place.x - 0.1).abs())) + 0.055;
                        assert!(
                            side < 0.43 * place.z && place.y.abs() + 0.055 < 0.32 * place.z,
                            "{}: {place}",
                            spec.name
                        );
                        turned = turned.max((pose * start.inverse()).rotation_angle_rad().to_degrees());
                    }
                    assert!((3.0..60.0).contains(&turned), "{}: {turned} degrees", spec.name);
                    start.translation_m()
                })
                .collect();
            assert!(starts.iter().enumerate().all(|(i, a)| starts[..i].iter().all(|b| (a - b).norm() > 1e-6)));
        }
    }

    #[test]
    fn the_consistency_of_a_kind_is_judged_by_thirty_sequences() {
        let ensembles = all();
        let many: Vec<_> = ensembles.iter().filter(|spec| spec.common.name.starts_with("many/")).collect();
        assert!(many.len() == 7 && many.iter().all(|spec| spec.sequences >= 30));
        assert!(
            ensembles.iter().enumerate().all(|(i, a)| ensembles[..i].iter().all(|b| a.common.name != b.common.name))
        );
    }
}

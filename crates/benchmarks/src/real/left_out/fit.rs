//! Fits the constants on all scenes but one, and collects what the fits say about the scene that each has not seen.

use std::collections::BTreeSet;

use super::outcomes::{Measurements, Outcome, Setting};

/// A scene that is left out, and the constants fitted without it.
pub struct Fold {
    /// Name of the scene.
    pub scene: String,
    /// What the fit changed.
    pub setting: Setting,
}

/// Result of all fits.
pub struct Fitted {
    /// Outcomes with the present values.
    pub present: Vec<Outcome>,
    /// Outcomes with the values fitted on all cases, these included.
    pub fitted_on: Vec<Outcome>,
    /// Outcome of each case with the values fitted without its scene.
    pub unseen: Vec<Outcome>,
    /// What the fit on all cases changed.
    pub setting: Setting,
    /// The fits without a scene each.
    pub folds: Vec<Fold>,
}

impl Fold {
    /// Name of the place, board or rig of a scene: scenes whose names are equal up to the first digit, or up to a final capital
    /// letter, show the same one and are left out together.
    pub fn name_of(scene: &str) -> String {
        let end = scene.find(|c: char| c.is_ascii_digit()).filter(|&end| end > 0).unwrap_or(scene.len());
        let name = scene[..end].trim_end_matches(['_', '-']);
        let shorter = name.trim_end_matches(|c: char| c.is_ascii_uppercase());
        if shorter.is_empty() { name.to_owned() } else { shorter.to_owned() }
    }
}

/// Every changed constant must pay for itself by this many passes: Akaike's criterion for one parameter.
const CHANGE_LOSS: f64 = 1.0;

/// Greedy descent: at most `changes` times, the change of one constant that lowers the loss most, from the present values on.
/// `scenes` are those of the cases.
///
/// # Errors
/// A case that cannot be loaded.
pub fn fit(measured: &mut Measurements, scenes: &[&str], changes: usize) -> anyhow::Result<Fitted> {
    let names: BTreeSet<&str> = scenes.iter().copied().collect();
    // The fit on all cases has no scene of its own.
    let mut left_out: Vec<Option<&str>> = vec![None];
    left_out.extend(names.iter().copied().map(Some));
    let mut settings: Vec<Setting> = vec![Setting::new(); left_out.len()];
    measured.measure(&[Setting::new()])?;
    let training = |without: Option<&str>, outcomes: &[Outcome]| -> f64 {
        let cases = scenes.iter().zip(outcomes).filter(|(scene, _)| Some(**scene) != without);
        cases.map(|(_, outcome)| outcome.loss).sum()
    };
    for round in 0..changes {
        let bases: BTreeSet<Setting> = settings.iter().filter(|setting| setting.len() == round).cloned().collect();
        eprintln!("round {} of {changes}: {} sets of values to start from", round + 1, bases.len());
        for base in &bases {
            measured.measure(&measured.neighbours(base))?;
        }
        for (without, setting) in left_out.iter().zip(&mut settings) {
            if setting.len() != round {
                continue;
            }
            let own = training(*without, measured.of(setting)) + CHANGE_LOSS * setting.len() as f64;
            let rated = measured.neighbours(setting).into_iter().map(|other| {
                let loss = training(*without, measured.of(&other)) + CHANGE_LOSS * other.len() as f64;
                (loss, other)
            });
            if let Some((best, other)) = rated.min_by(|a, b| a.0.total_cmp(&b.0))
                && best < own
            {
                *setting = other;
            }
        }
    }
    let of = |setting: &Setting| measured.of(setting).to_vec();
    let unseen = |(index, scene): (usize, &&str)| {
        let fold = left_out.iter().position(|name| *name == Some(*scene)).unwrap_or(0);
        measured.of(&settings[fold])[index]
    };
    Ok(Fitted {
        present: of(&Setting::new()),
        fitted_on: of(&settings[0]),
        unseen: scenes.iter().enumerate().map(unseen).collect(),
        setting: settings[0].clone(),
        folds: left_out
            .iter()
            .zip(&settings)
            .filter_map(|(scene, setting)| Some(Fold { scene: (*scene)?.to_owned(), setting: setting.clone() }))
            .collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_of_one_place_are_left_out_together() {
        let names = ["bb201", "delivery_area_1l", "MotorcycleE", "Motorcycle", "zed2_01", "Art", "Rocks1"];
        let expected = ["bb", "delivery_area", "Motorcycle", "Motorcycle", "zed", "Art", "Rocks"];
        assert_eq!(names.map(Fold::name_of), expected);
    }
}

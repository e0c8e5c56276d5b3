//! The constants that choose the surface of a region.

use pb3dp_estimation_direct::estimator::DirectConfig;
use pb3dp_estimation_direct::surface_choice::SurfaceChoice;

/// A constant that the fit may change.
#[derive(Clone, Debug)]
pub struct Constant {
    /// Its name.
    pub name: &'static str,
    /// Its present value.
    pub value: f64,
    /// The values that the fit compares with the present one.
    pub tried: Vec<f64>,
}

/// Where a constant stands in a configuration.
enum Place<'a> {
    Float(&'a mut f64),
    Single(&'a mut f32),
    Byte(&'a mut u8),
    Short(&'a mut u16),
    Count(&'a mut usize),
}
use Place::{Byte, Count, Float, Short, Single};

impl Place<'_> {
    fn get(&self) -> f64 {
        match self {
            Float(value) => **value,
            Single(value) => f64::from(**value),
            Byte(value) => f64::from(**value),
            Short(value) => f64::from(**value),
            Count(value) => **value as f64,
        }
    }

    fn set(self, new: f64) {
        match self {
            Float(value) => *value = new,
            Single(value) => *value = new as f32,
            Byte(value) => *value = new as u8,
            Short(value) => *value = new as u16,
            Count(value) => *value = new as usize,
        }
    }
}

const COUNT: usize = 24;

/// The constants outside of [`SurfaceChoice`]: name, place, and the values tried.
fn places(config: &mut DirectConfig) -> [(&'static str, Place<'_>, [f64; 2]); COUNT] {
    let (cold, verdict) = (&mut config.cold_start, &mut config.verdict);
    let (search, patches, refine) = (&mut cold.search, &mut cold.patches, &mut cold.refine);
    [
        ("search.noise_grey", Float(&mut search.noise), [1.4, 2.8]),
        ("search.penalty_small", Byte(&mut search.penalties.small), [5.0, 12.0]),
        ("search.penalty_large", Byte(&mut search.penalties.large), [28.0, 56.0]),
        ("search.uniqueness", Single(&mut search.winner.uniqueness), [0.025, 0.1]),
        ("search.left_right_max", Short(&mut search.winner.left_right_max), [0.0, 2.0]),
        ("search.tolerance_px", Float(&mut search.hypotheses.tolerance_px), [0.35, 0.7]),
        ("search.distinct_px", Float(&mut search.hypotheses.distinct_px), [0.7, 1.4]),
        ("search.alias_share", Float(&mut search.alias_share), [0.35, 0.7]),
        ("search.quick_area_px", Count(&mut cold.quick_area_px), [4000.0, 9000.0]),
        ("search.search_area_px", Count(&mut cold.search_area_px), [8000.0, 18_000.0]),
        ("search.quick_share_min", Float(&mut cold.quick_share_min), [0.5, 0.75]),
        ("patches.patch_area_px", Count(&mut cold.patch_area_px), [16_000.0, 36_000.0]),
        ("patches.reach", Count(&mut patches.reach), [1.0, 3.0]),
        ("patches.support_px", Float(&mut patches.support_px), [0.28, 0.5]),
        ("refine.erosion_min_px", Float(&mut refine.erosion_min_px), [0.0, 2.0]),
        ("refine.place_sigma_px", Float(&mut refine.place_sigma_px), [0.05, 0.18]),
        ("patches.correlation_min", Float(&mut patches.correlation_min), [0.4, 0.6]),
        ("patches.texture_min", Float(&mut patches.texture_min), [1.0, 3.0]),
        ("patches.gradient_half", Float(&mut patches.gradient_half), [0.5, 2.0]),
        ("status.support_min", Float(&mut verdict.support_min), [0.1, 0.2]),
        ("status.support_sure_min", Float(&mut verdict.support_sure_min), [0.2, 0.4]),
        ("status.alias_score_max", Float(&mut verdict.alias_score_max), [0.75, 0.95]),
        ("status.second_share_max", Float(&mut verdict.second_share_max), [0.5, 0.8]),
        ("status.normal_sigma_max_deg", Float(&mut verdict.normal_sigma_max_deg), [3.5, 7.0]),
    ]
}

/// All constants that are fitted.
pub fn all() -> Vec<Constant> {
    let mut config = DirectConfig::default();
    let choice = config.cold_start.choice;
    let of_config =
        places(&mut config).map(|(name, place, tried)| Constant { name, value: place.get(), tried: tried.into() });
    let of_choice = SurfaceChoice::ALL.iter().map(|known| Constant {
        name: known.name,
        value: (known.get)(&choice),
        tried: known.tried.to_vec(),
    });
    of_config.into_iter().chain(of_choice).collect()
}

/// Sets the constant with this index of [`all`].
pub fn set(config: &mut DirectConfig, index: usize, value: f64) {
    match index.checked_sub(COUNT) {
        Some(index) => (SurfaceChoice::ALL[index].set)(&mut config.cold_start.choice, value),
        None => places(config).into_iter().nth(index).into_iter().for_each(|(_, place, _)| place.set(value)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_constant_is_set_by_itself() {
        let constants = all();
        assert!(constants.len() > 70, "{}", constants.len());
        for (index, constant) in constants.iter().enumerate() {
            let mut config = DirectConfig::default();
            set(&mut config, index, constant.tried[0]);
            let changed = format!("{config:?}") != format!("{:?}", DirectConfig::default());
            assert!(constant.value.is_finite() && changed, "{constant:?}");
        }
    }
}

//! Lens models: the set of estimated distortion coefficients.

use std::fmt;

use pb3dp_geometry::Distortion;

/// A lens model, by its distortion coefficients; fewest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LensModel {
    /// k1.
    Radial1,
    /// k1, k2.
    Radial2,
    /// k1, k2, p1, p2; `radtan` in Kalibr.
    Brown4,
    /// k1, k2, p1, p2, k3; `plumb_bob` in ROS, and OpenCV's default.
    Brown5,
    /// k1, k2, p1, p2, k3, k4, k5, k6; `rational_polynomial` in ROS.
    Rational8,
}

impl LensModel {
    /// All models, fewest coefficients first.
    pub const ALL: [Self; 5] = [Self::Radial1, Self::Radial2, Self::Brown4, Self::Brown5, Self::Rational8];

    /// Its name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Radial1 => "radial-1",
            Self::Radial2 => "radial-2",
            Self::Brown4 => "brown-4",
            Self::Brown5 => "brown-5",
            Self::Rational8 => "rational-8",
        }
    }

    /// The model with this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The names of the estimated coefficients, in the order of [`Distortion`].
    pub fn coefficient_names(self) -> &'static [&'static str] {
        let all: &'static [&'static str] = &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
        &all[..self.coefficient_count()]
    }

    /// Number of estimated coefficients.
    pub fn coefficient_count(self) -> usize {
        match self {
            Self::Radial1 => 1,
            Self::Radial2 => 2,
            Self::Brown4 => 4,
            Self::Brown5 => 5,
            Self::Rational8 => 8,
        }
    }

    /// Distortion with the given coefficients; missing ones are zero, surplus ones are ignored.
    pub(crate) fn lens(self, values: &[f64]) -> Distortion {
        let mut all = [0.0; 8];
        for (to, from) in all.iter_mut().zip(values.iter().take(self.coefficient_count())) {
            *to = *from;
        }
        match self {
            Self::Rational8 => Distortion::BrownConrady8 { coefficients: all },
            _ => {
                let [k1, k2, p1, p2, k3, ..] = all;
                Distortion::BrownConrady5 { coefficients: [k1, k2, p1, p2, k3] }
            }
        }
    }
}

impl fmt::Display for LensModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

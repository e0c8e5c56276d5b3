//! Which coefficients of a lens are estimated.

use std::fmt;

use pb3dp_geometry::Distortion;

/// A lens model: how many coefficients describe the lens, fewest first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum LensModel {
    /// k1.
    Radial1,
    /// k1, k2.
    Radial2,
    /// k1, k2, p1, p2; what Kalibr calls `radtan`.
    Brown4,
    /// k1, k2, p1, p2, k3; what ROS calls `plumb_bob`, and OpenCV's default.
    Brown5,
    /// k1, k2, p1, p2, k3, k4, k5, k6; what ROS calls `rational_polynomial`.
    Rational8,
}

impl LensModel {
    /// All of them, fewest coefficients first.
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

    /// The model of a name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// The names of the coefficients that are estimated, in the order of [`Distortion`].
    pub fn coefficient_names(self) -> &'static [&'static str] {
        let all: &'static [&'static str] = &["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
        &all[..self.coefficient_count()]
    }

    /// How many coefficients are estimated.
    pub fn coefficient_count(self) -> usize {
        match self {
            Self::Radial1 => 1,
            Self::Radial2 => 2,
            Self::Brown4 => 4,
            Self::Brown5 => 5,
            Self::Rational8 => 8,
        }
    }

    /// A lens with the given coefficients; what is missing is zero, what is too much is dropped.
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

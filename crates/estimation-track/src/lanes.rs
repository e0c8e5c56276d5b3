//! Arithmetic on the lanes of a vector, written once for every vector width; see [`pb3dp_estimation_core::wide`].

use std::ops::{Add, AddAssign, Mul, Neg, Sub};

use pb3dp_estimation_core::wide::sum_lanes;

pub(crate) use pb3dp_estimation_core::wide::LANES;

/// Builds the lanes one by one. Not with a closure: closures are not always inlined into functions of wider vectors, and then
/// cost a call per lane.
macro_rules! each_lane {
    ($i:ident => $value:expr) => {{
        let mut lanes = [0.0; $crate::lanes::LANES];
        let mut $i = 0;
        while $i < $crate::lanes::LANES {
            lanes[$i] = $value;
            $i += 1;
        }
        $crate::lanes::Lanes(lanes)
    }};
}
pub(super) use each_lane;

/// Writes an expression once per index instead of looping. The compiler would make such a loop one over vectors of all indices, which
/// gathers and scatters single lanes, and takes ten times as long.
macro_rules! repeated {
    ($i:ident in [$($index:literal),+] => $body:expr) => {
        $({ let $i: usize = $index; $body; })+
    };
}
pub(super) use repeated;

/// One value for each of [`LANES`] points.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub(super) struct Lanes(pub [f32; LANES]);

impl Default for Lanes {
    fn default() -> Self {
        Self::ZERO
    }
}

impl Lanes {
    pub(super) const ZERO: Self = Self([0.0; LANES]);

    #[inline(always)]
    pub(super) fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// `self + a * b`, rounded twice.
    #[inline(always)]
    pub(super) fn plus(self, a: Self, b: Self) -> Self {
        each_lane!(i => self.0[i] + a.0[i] * b.0[i])
    }

    #[inline(always)]
    pub(super) fn scale(self, factor: f32) -> Self {
        each_lane!(i => self.0[i] * factor)
    }

    #[inline(always)]
    pub(super) fn reciprocal(self) -> Self {
        each_lane!(i => 1.0 / self.0[i])
    }

    #[inline(always)]
    pub(super) fn max(self, other: f32) -> Self {
        each_lane!(i => if self.0[i] > other { self.0[i] } else { other })
    }

    /// The sum over the lanes, always in the same order.
    #[inline(always)]
    pub(super) fn sum(&self) -> f32 {
        sum_lanes(&self.0)
    }
}

impl Add for Lanes {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        each_lane!(i => self.0[i] + other.0[i])
    }
}

impl AddAssign for Lanes {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Lanes {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        each_lane!(i => self.0[i] - other.0[i])
    }
}

impl Mul for Lanes {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        each_lane!(i => self.0[i] * other.0[i])
    }
}

impl Neg for Lanes {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        each_lane!(i => -self.0[i])
    }
}

//! Named sums: structs of sums of one kind, accumulated lane by lane in the inner loops and then folded.

use nalgebra::{Matrix3, Vector3};
use pb3dp_estimation_core::wide::LANES;

/// Defines a struct of sums, generic over the type of a sum: lanes, or their total in double precision.
macro_rules! named_sums {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$doc:meta])* $field:ident,)* }) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        $vis struct $name<T> {
            $($(#[$doc])* pub $field: T,)*
        }

        impl $name<[f32; pb3dp_estimation_core::wide::LANES]> {
            $vis const ZERO: Self = Self { $($field: [0.0; pb3dp_estimation_core::wide::LANES],)* };

            /// Folds each sum over its lanes.
            #[inline(always)]
            $vis fn folded(&self) -> $name<f64> {
                $name { $($field: f64::from(pb3dp_estimation_core::wide::sum_lanes(&self.$field)),)* }
            }
        }

        impl std::ops::AddAssign for $name<f64> {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                $(self.$field += other.$field;)*
            }
        }

        /// The sums with their names.
        #[cfg(test)]
        impl IntoIterator for $name<f64> {
            type Item = (&'static str, f64);
            type IntoIter = std::vec::IntoIter<Self::Item>;

            fn into_iter(self) -> Self::IntoIter {
                vec![$((stringify!($field), self.$field)),*].into_iter()
            }
        }
    };
}
pub(crate) use named_sums;

named_sums! {
    /// Normal equations of a plane `p0 + p1 x + p2 y` through votes of weight `w` with residuals `r`.
    pub(crate) struct PlaneSums { w, wx, wy, wxx, wxy, wyy, wr, wrx, wry, }
}

impl PlaneSums<[f32; LANES]> {
    /// Adds the vote at `(x, y)` with weight `w` to a lane; `wr` is the weight times the residual.
    #[inline(always)]
    pub(crate) fn add(&mut self, lane: usize, x: f32, y: f32, w: f32, wr: f32) {
        let (wx, wy) = (w * x, w * y);
        self.w[lane] += w;
        self.wx[lane] += wx;
        self.wy[lane] += wy;
        self.wxx[lane] += wx * x;
        self.wxy[lane] += wx * y;
        self.wyy[lane] += wy * y;
        self.wr[lane] += wr;
        self.wrx[lane] += wr * x;
        self.wry[lane] += wr * y;
    }
}

impl PlaneSums<f64> {
    /// The step of `(p0, p1, p2)` to the minimum; `None` if the votes do not determine it.
    pub(crate) fn step(&self) -> Option<Vector3<f64>> {
        let Self { w, wx, wy, wxx, wxy, wyy, wr, wrx, wry } = *self;
        let h = Matrix3::new(w, wx, wy, wx, wxx, wxy, wy, wxy, wyy);
        Some(h.cholesky()?.solve(&Vector3::new(wr, wrx, wry)))
    }
}

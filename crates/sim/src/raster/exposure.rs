//! Exposures: how the moments of an exposure become an image.

use std::ops::RangeInclusive;

use super::RenderError;
use crate::scene::ScenePoses;

/// How a camera reads its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shutter {
    /// All rows at once: the image is the mean over the moments.
    Global,
    /// Row after row: the first moment is that of row `first`, the last one that of row `last`, with even steps in between.
    /// Rows between two moments blend both; rows outside show the nearest moment.
    Rolling {
        /// Row of the first moment; may lie outside the image.
        first: i32,
        /// Row of the last moment, greater than `first`.
        last: i32,
    },
}

/// Exposure of one camera.
#[derive(Clone, Copy, Debug)]
pub struct Exposure<'a> {
    /// Poses of the scene at the moments, in order; at least one.
    pub moments: &'a [ScenePoses],
    /// How the moments become an image.
    pub shutter: Shutter,
}

impl<'a> Exposure<'a> {
    /// The mean over some moments.
    pub fn global(moments: &'a [ScenePoses]) -> Self {
        Self { moments, shutter: Shutter::Global }
    }

    pub(super) fn check(&self) -> Result<(), RenderError> {
        match self.shutter {
            _ if self.moments.is_empty() => Err(RenderError::NoPoses),
            Shutter::Rolling { first, last } if first >= last => Err(RenderError::Rows { first, last }),
            _ => Ok(()),
        }
    }

    /// Share of a moment in a row, in 256ths; the shares of all moments in a row have the sum 256.
    pub(super) fn share(&self, moment: usize, row: usize) -> u32 {
        let Shutter::Rolling { first, last } = self.shutter else { return 256 };
        let steps = self.moments.len() as f64 - 1.0;
        let place = steps * (row as f64 - f64::from(first)) / f64::from(last - first);
        let place = (256.0 * place.clamp(0.0, steps)).round() as i64;
        (256 - (place - 256 * moment as i64).abs()).max(0) as u32
    }

    /// Rows in which a moment has a share; `None` if there are none.
    pub(super) fn rows(&self, moment: usize, height: usize) -> Option<RangeInclusive<usize>> {
        let mut rows = (0..height).filter(|&row| self.share(moment, row) > 0);
        let first = rows.next()?;
        Some(first..=rows.next_back().unwrap_or(first))
    }
}

#[cfg(test)]
mod tests {
    use pb3dp_geometry::Pose;

    use super::*;

    #[test]
    fn rows_between_two_moments_blend_both() {
        let poses = ScenePoses { world_from_cam_left: Pose::coincident(), world_from_target: Pose::coincident() };
        let moments = [poses; 3];
        let exposure = Exposure { moments: &moments, shutter: Shutter::Rolling { first: 10, last: 30 } };
        let shares = |row: usize| [0, 1, 2].map(|moment| exposure.share(moment, row));
        assert_eq!(shares(0), [256, 0, 0]);
        assert_eq!(shares(10), [256, 0, 0]);
        assert_eq!(shares(15), [128, 128, 0]);
        assert_eq!(shares(20), [0, 256, 0]);
        assert_eq!(shares(40), [0, 0, 256]);
        assert!((0..50).all(|row| shares(row).iter().sum::<u32>() == 256));
        assert_eq!([0, 1, 2].map(|moment| exposure.rows(moment, 50)), [Some(0..=19), Some(11..=29), Some(21..=49)]);
        assert_eq!(exposure.rows(2, 15), None);
        let wrong = Exposure { shutter: Shutter::Rolling { first: 30, last: 30 }, ..exposure };
        assert_eq!(wrong.check(), Err(RenderError::Rows { first: 30, last: 30 }));
        assert_eq!(Exposure::global(&[]).check(), Err(RenderError::NoPoses));
    }
}

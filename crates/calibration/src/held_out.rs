//! Cross-validation of a calibration, and selection of the lens model by its held-out error.

use nalgebra::Vector2;
use pb3dp_geometry::ImageSize;

use crate::board::Chessboard;
use crate::fit::{Fit, View};
use crate::fitted_rig::FitError;
use crate::fitted_rig::VIEWS_MIN;
use crate::lens::LensModel;

/// Number of parts for cross-validation: each part of the views is predicted from the others.
const PARTS: usize = 5;
/// Relative decrease of the held-out error that justifies a model with more coefficients: several times the cost of an
/// unnecessary coefficient (half its share of all observations, about 0.02 % each). Distortion that the model lacks is absorbed
/// by other parameters, first by a rotation of the camera, long before the error reaches 1 %.
const WORTH: f64 = 0.002;

/// The held-out error of one lens model.
#[derive(Clone, Debug, PartialEq)]
pub struct HeldOut {
    /// The model.
    pub lens: LensModel,
    /// Root mean square of the distance between predicted and detected corners in held-out views, px; or why it could not be
    /// computed.
    pub rms_px: Result<f64, FitError>,
}

/// The selected fit and the candidates.
#[derive(Clone, Debug)]
pub struct Chosen<const N: usize> {
    /// The fit to all views.
    pub fit: Fit<N>,
    /// Its held-out error, px.
    pub held_out_rms_px: f64,
    /// All tested models.
    pub tried: Vec<HeldOut>,
}

/// Fits the given lens models, including the board shape, and selects the one with the fewest coefficients whose held-out error
/// is within 0.2 % of the lowest.
///
/// # Errors
/// Too few views, or the error of the last model if none could be fitted.
pub fn choose<const N: usize>(
    views: &[View<N>],
    board: &Chessboard,
    size: ImageSize,
    models: &[LensModel],
) -> Result<Chosen<N>, FitError> {
    if views.len() <= VIEWS_MIN {
        return Err(FitError::Views { given: views.len() });
    }
    let mut fits: Vec<(Fit<N>, f64)> = Vec::new();
    let mut tried = Vec::new();
    for lens in models {
        // Each model starts from the solution of the simpler one before it.
        let fit = match fits.last() {
            Some((simpler, _)) => simpler.near(views, board, *lens),
            // If the views do not determine the board shape, they are not refused; the board is assumed flat.
            None => Fit::new(views, board, size, *lens).map(|flat| flat.with_shape(views).unwrap_or(flat)),
        };
        let rms_px = fit.and_then(|fit| Ok((held_out_rms_px(&fit, views, board)?, fit))).map(|(rms_px, fit)| {
            fits.push((fit, rms_px));
            rms_px
        });
        tried.push(HeldOut { lens: *lens, rms_px });
    }
    let lowest = fits.iter().map(|(_, rms_px)| *rms_px).fold(f64::INFINITY, f64::min);
    match fits.into_iter().find(|(_, rms_px)| *rms_px <= lowest * (1.0 + WORTH)) {
        Some((fit, held_out_rms_px)) => Ok(Chosen { fit, held_out_rms_px, tried }),
        None => {
            let last = tried.pop().and_then(|held_out| held_out.rms_px.err());
            Err(last.unwrap_or(FitError::Views { given: views.len() }))
        }
    }
}

/// Root mean square of the held-out errors for a fit's model, px; view `i` belongs to part `i` modulo the number of parts.
fn held_out_rms_px<const N: usize>(fit: &Fit<N>, views: &[View<N>], board: &Chessboard) -> Result<f64, FitError> {
    let parts = PARTS.min(views.len());
    let (mut sum, mut count) = (0.0, 0_usize);
    for part in 0..parts {
        let (held, given): (Vec<_>, Vec<_>) =
            views.iter().cloned().enumerate().partition(|(index, _)| index % parts == part);
        let views_of = |list: Vec<(usize, View<N>)>| list.into_iter().map(|(_, view)| view).collect::<Vec<_>>();
        let (held, given) = (views_of(held), views_of(given));
        let errors = fit.near(&given, board, fit.lens())?.errors_of_other_views(&held, board)?;
        sum += errors.iter().map(Vector2::norm_squared).sum::<f64>();
        count += errors.len();
    }
    Ok((sum / count.max(1) as f64).sqrt())
}

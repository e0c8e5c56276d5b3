//! Points with one saturated colour: the other two still show the target, for example after a step of the exposure.
//!
//! The channels are an orthonormal rotation of red, green and blue, so a colour is a unit vector `m` of the three channels. Residuals
//! and gradients lose what they have along it, `r - m (m . r)`: least squares then uses the information of the other two colours, and
//! no more. Two of three independent errors are left, so squares are scaled by 3/2 before they are compared with the noise of three.

use pb3dp_estimation_core::wide::LANES;
use pb3dp_estimation_views::colour_planes::OPPONENT_FROM_RGB;

use super::images::{CHANNELS, CLIPPED, Texel};
use super::lanes::Lanes;

/// A colour this bright counts as saturated where a coarser level has saturated pixels: means over pixels do not tell which
/// colour it was. Chosen by hand, not varied: with more, clipped colours count; with less, two colours are left out.
const BRIGHT_GREY: f32 = 200.0;

/// Factor of the squares of a point with two of three colours, and of one with fewer: it fits nothing.
const SCALE_OF_TWO: f32 = 1.5;
const SCALE_OF_ONE: f32 = 1e6;

/// The saturated colour of a sample, by the numbers of [`CLIPPED`]; `None` if there are several.
#[inline(always)]
pub(super) fn one_colour([y, a, b, saturation]: Texel, level: usize) -> Option<u8> {
    let colours = if level == 0 {
        saturation as u8
    } else {
        let m = &OPPONENT_FROM_RGB;
        let mut bright = 0;
        for (k, number) in CLIPPED.iter().enumerate() {
            bright |= number * u8::from(m[0][k] * y + m[1][k] * a + m[2][k] * b >= BRIGHT_GREY);
        }
        bright
    };
    (colours.count_ones() == 1).then_some(colours)
}

/// Whether a point of a group has a saturated colour in one of the images.
#[inline(always)]
pub(super) fn any_clipped([left, right]: [&Lanes; 2]) -> bool {
    (*left + *right).sum() > 0.0
}

/// The saturated colours of a point in either image: both images are also compared with each other.
fn colours_of([left, right]: [&Lanes; 2], point: usize) -> u8 {
    left.0[point] as u8 | right.0[point] as u8
}

/// Leaves the saturated colours out of the residuals of both images. Returns the factors of their squares.
#[inline(never)]
pub(super) fn leave_out(clipped: [&Lanes; 2], residual: &mut [[Lanes; CHANNELS]; 2]) -> Lanes {
    let mut scale = Lanes::splat(1.0);
    for i in 0..LANES {
        let colours = colours_of(clipped, i);
        if colours != 0 {
            scale.0[i] = if colours.count_ones() == 1 { SCALE_OF_TWO } else { SCALE_OF_ONE };
            residual.iter_mut().for_each(|residual| project(residual, i, colours));
        }
    }
    scale
}

/// The gradients of a view without the saturated colours of both images.
#[inline(always)]
pub(super) fn unclipped(clipped: [&Lanes; 2], gradient: &[[Lanes; 2]; CHANNELS]) -> [[Lanes; 2]; CHANNELS] {
    let mut gradient = *gradient;
    if any_clipped(clipped) {
        leave_out_of_gradient(clipped, &mut gradient);
    }
    gradient
}

#[inline(never)]
fn leave_out_of_gradient(clipped: [&Lanes; 2], gradient: &mut [[Lanes; 2]; CHANNELS]) {
    for along in 0..2 {
        let mut channels = gradient.map(|channel| channel[along]);
        for i in 0..LANES {
            project(&mut channels, i, colours_of(clipped, i));
        }
        gradient.iter_mut().zip(channels).for_each(|(channel, projected)| channel[along] = projected);
    }
}

/// Takes the saturated colours of an image out of its channels and those of the view, for a correlation.
#[inline(never)]
pub(super) fn leave_out_of_values(clipped: &Lanes, view: &mut [Lanes; CHANNELS], image: &mut [Lanes; CHANNELS]) {
    for i in 0..LANES {
        let colours = clipped.0[i] as u8;
        if colours != 0 {
            project(view, i, colours);
            project(image, i, colours);
        }
    }
}

/// Takes colours out of the channels of one point.
fn project(channels: &mut [Lanes; CHANNELS], point: usize, colours: u8) {
    for (k, _) in CLIPPED.iter().enumerate().filter(|(_, number)| colours & **number != 0) {
        let along: f32 = (0..CHANNELS).map(|c| OPPONENT_FROM_RGB[c][k] * channels[c].0[point]).sum();
        for (channel, row) in channels.iter_mut().zip(&OPPONENT_FROM_RGB) {
            channel.0[point] -= row[k] * along;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opponent(rgb: [f32; 3]) -> [f32; 3] {
        OPPONENT_FROM_RGB.map(|row| row.iter().zip(rgb).map(|(m, x)| m * x).sum())
    }

    fn lanes(clipped: [u8; 2]) -> [Lanes; 2] {
        clipped.map(|colours| Lanes::splat(f32::from(colours)))
    }

    #[test]
    fn a_saturated_colour_does_not_count_in_either_image() {
        let left_out = |clipped: [u8; 2], red: f32| {
            let mut residual = [[3.0, 1.0], [-2.0, 5.0]].map(|[g, b]| opponent([red, g, b]).map(Lanes::splat));
            let scale = leave_out(lanes(clipped).each_ref(), &mut residual);
            (scale.0[3], residual.map(|side| side.map(|channel| channel.0[3])))
        };
        let (scale, residual) = left_out([0, CLIPPED[0]], -70.0);
        let square = |side: usize| residual[side].iter().map(|r| r * r).sum::<f32>();
        // 3^2 + 1^2 and 2^2 + 5^2.
        assert!((square(0) - 10.0).abs() < 1e-3 && (square(1) - 29.0).abs() < 1e-3, "{residual:?}");
        assert!((scale - 1.5).abs() < 1e-6);
        let (_, other) = left_out([CLIPPED[0], 0], 30.0);
        assert!(residual.iter().flatten().zip(other.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-4));
        assert!(left_out([CLIPPED[0], CLIPPED[2]], 0.0).0 > 1e3, "one colour is too few");
        let steep = [[2.0, 0.0], [3.0, -1.0], [0.5, 4.0]];
        let gradient = unclipped(
            lanes([0, CLIPPED[0]]).each_ref(),
            &std::array::from_fn(|c| steep.map(|g| g[0]).map(Lanes::splat)[c]).map(|g| [g; 2]),
        );
        let along = |k: usize| (0..3).map(|c| OPPONENT_FROM_RGB[c][k] * gradient[c][1].0[5]).sum::<f32>();
        assert!(along(0).abs() < 1e-5 && along(1).abs() > 0.1, "red is left out, green is not: {gradient:?}");
        assert_eq!(left_out([0, 0], 4.0).0, 1.0);
        assert!(any_clipped(lanes([0, 2]).each_ref()) && !any_clipped(lanes([0, 0]).each_ref()));
    }

    #[test]
    fn one_saturated_colour_is_named_and_several_are_refused() {
        let [y, a, b] = opponent([255.0, 120.0, 90.0]);
        assert_eq!(one_colour([y, a, b, 1.0], 0), Some(CLIPPED[0]));
        assert_eq!(one_colour([y, a, b, 3.0], 0), None);
        assert_eq!(one_colour([y, a, b, 0.4], 2), Some(CLIPPED[0]));
        let [y, a, b] = opponent([255.0, 120.0, 240.0]);
        assert_eq!(one_colour([y, a, b, 0.4], 2), None);
    }
}

//! Parsers of command line values.

use crate::hand_eye::RobotSigma;
use crate::lens::LensModel;

use super::LensChoice;

/// `9x6`.
pub(super) fn corners(text: &str) -> Result<[u32; 2], String> {
    two(text, &['x', 'X']).ok_or_else(|| format!("{text:?} is not COLUMNSxROWS; example: 9x6"))
}

/// A length in millimetres.
pub(super) fn millimetres(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 && value <= 1e5 => Ok(value),
        _ => Err(format!("{text:?} is not a length in mm; it must be a number between 0 and 100000")),
    }
}

/// Noise of an arm: millimetres and degrees.
pub(super) fn robot_sigma(text: &str) -> Result<RobotSigma, String> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
    let both = text.split_once(',').and_then(|(mm, degrees)| number(mm).zip(number(degrees)));
    let (mm, degrees) =
        both.ok_or_else(|| format!("{text:?} is not MM,DEG; both must be above zero, for example 0.1,0.02"))?;
    Ok(RobotSigma { translation_m: mm * 1e-3, rotation_rad: degrees.to_radians() })
}

/// The name of a lens model, or `auto`.
pub(super) fn lens(text: &str) -> Result<LensChoice, String> {
    if text == "auto" {
        return Ok(LensChoice::Auto);
    }
    let names = LensModel::ALL.map(LensModel::name).join(", ");
    let model = LensModel::from_name(text).ok_or_else(|| format!("{text:?} is not a lens model; use auto, {names}"))?;
    Ok(LensChoice::Fixed(model))
}

/// `8,0`: a corner of the board.
pub(super) fn corner(text: &str) -> Result<[u32; 2], String> {
    two(text, &[',']).ok_or_else(|| format!("{text:?} is not COLUMN,ROW; example: 8,0"))
}

fn two(text: &str, separators: &[char]) -> Option<[u32; 2]> {
    let (first, second) = text.split_once(separators)?;
    Some([first.trim().parse().ok()?, second.trim().parse().ok()?])
}

/// A number in a TOML file.
pub(super) fn of_toml(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// A list of this many finite numbers in a TOML file.
pub(super) fn list_of_toml<const N: usize>(value: Option<&toml::Value>) -> Option<[f64; N]> {
    let numbers = value?.as_array()?.iter().map(|value| of_toml(value).filter(|number| number.is_finite()));
    numbers.collect::<Option<Vec<_>>>()?.try_into().ok()
}

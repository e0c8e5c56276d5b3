//! Numbers on the command line of `pb3dp rig`, each with its unit and range.

use std::ops::RangeInclusive;

use pb3dp_geometry::ImageSize;

/// Distances of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Span {
    pub(crate) min_mm: f64,
    pub(crate) max_mm: f64,
}

/// Range of distances, mm.
const DISTANCE_MM: RangeInclusive<f64> = 50.0..=10_000.0;

/// Sides of an image, pixels.
const SIDE_PX: RangeInclusive<u32> = 32..=16_384;

/// A number with a unit.
pub(crate) fn number(
    unit: &'static str,
    allowed: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| match text.trim().parse::<f64>() {
        Ok(value) if allowed.contains(&value) => Ok(value),
        Ok(value) if unit == "mm" && value > 0.0 && value < 5.0 && allowed.contains(&(1e3 * value)) => {
            Err(format!("{text:?} is in millimetres; did you mean {}?", 1e3 * value))
        }
        _ => Err(format!("{text:?}: must be a number from {} to {} {unit}", allowed.start(), allowed.end())),
    }
}

pub(crate) fn millimetres(
    allowed: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number("mm", allowed)
}

pub(crate) fn distance() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    millimetres(DISTANCE_MM)
}

pub(crate) fn pixels(
    allowed: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number("px", allowed)
}

pub(crate) fn grey(
    allowed: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number("grey levels", allowed)
}

pub(crate) fn millis(
    allowed: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number("ms", allowed)
}

pub(crate) fn micrometres() -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    number("um", 0.5..=50.0)
}

/// `640x480`.
pub(crate) fn size(text: &str) -> Result<ImageSize, String> {
    let side = |text: &str| text.trim().parse::<u32>().ok().filter(|side| SIDE_PX.contains(side));
    let sides = text.split_once('x').and_then(|(width, height)| Some((side(width)?, side(height)?)));
    sides.map(|(width, height)| ImageSize { width, height }).ok_or_else(|| {
        format!(
            "{text:?} is not WIDTHxHEIGHT with {} to {} pixels each, for instance 640x480",
            SIDE_PX.start(),
            SIDE_PX.end()
        )
    })
}

/// `300,800`.
pub(crate) fn span(text: &str) -> Result<Span, String> {
    let refuse = || format!("{text:?} is not MIN,MAX with MIN < MAX, for instance 300,800");
    let (min, max) = text.split_once(',').ok_or_else(refuse)?;
    let parse = distance();
    let (min_mm, max_mm) = (parse(min)?, parse(max)?);
    if min_mm < max_mm { Ok(Span { min_mm, max_mm }) } else { Err(refuse()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_refused_with_what_is_allowed() {
        let baseline = millimetres(5.0..=2000.0);
        assert_eq!(baseline(" 100"), Ok(100.0));
        assert!(baseline("0.1").unwrap_err().contains("is in millimetres; did you mean 100?"));
        for bad in ["0", "-3", "nan", "inf", "x", "", "2001"] {
            let error = baseline(bad).unwrap_err();
            assert!(error.contains(&format!("{bad:?}")) && error.contains("from 5 to 2000 mm"), "{error}");
        }
        assert!(millis(0.0..=1000.0)("0.001").is_ok() && pixels(0.0..=5.0)("0").is_ok());
    }

    #[test]
    fn sizes_and_spans_are_checked() {
        assert_eq!(size("1280x1024"), Ok(ImageSize { width: 1280, height: 1024 }));
        for bad in ["640", "640x", "0x480", "640x-1", "640x99999", "6.5x3"] {
            assert!(size(bad).unwrap_err().contains("for instance 640x480"), "{bad}");
        }
        assert_eq!(span("300, 800"), Ok(Span { min_mm: 300.0, max_mm: 800.0 }));
        assert!(span("800,300").unwrap_err().contains("MIN < MAX"));
        assert!(span("300").unwrap_err().contains("MIN,MAX"));
        assert!(span("0.3,0.8").unwrap_err().contains("did you mean 300?"));
        assert!(span("300,nan").unwrap_err().contains("from 50 to 10000 mm"));
    }
}

//! Writes a demo report with every kind of content: `cargo run -p pb3dp-record --example report_gallery -- FILE`. The curves are
//! synthetic and only demonstrate the layout.

use std::path::PathBuf;

use pb3dp_record::dataset::load_case;
use pb3dp_record::overlay::{self, Animation, AnimationLimits, Stroke, TextStyle, colors};
use pb3dp_record::report::{LinePlot, Report, ReportImage, Series, SeriesColor, Table};

/// A step of `height` that starts at `start_s` and takes two seconds.
fn step(at_s: f64, start_s: f64, height: f64) -> f64 {
    let s = ((at_s - start_s) / 2.0).clamp(0.0, 1.0);
    height * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)
}

fn panel(axis: usize) -> LinePlot {
    let unit = if axis < 3 { "mm" } else { "deg" };
    let height = if axis < 3 { 100.0 } else { 20.0 };
    let go_s = 3.0 + 10.0 * axis as f64;
    let target = |t: f64| step(t, go_s, height) - step(t, go_s + 5.0, height);
    let wobble = |t: f64| 0.02 * height * ((37.0 * t).sin() + (61.3 * t).cos());
    let sampled = |f: &dyn Fn(f64) -> f64| (0..6300).map(|i| f64::from(i) * 0.01).map(|t| [t, f(t)]).collect();
    let mut plot = LinePlot::new(format!("({})", ["a", "b", "c", "d", "e", "f"][axis]), ("time", "s"), ("x", unit))
        .series(Series::line("target", SeriesColor::Ink, sampled(&target)))
        .series(Series::line("hand", SeriesColor::Red, sampled(&|t| target(t - 0.3) + wobble(t))));
    for mark in 0..12 {
        plot = plot.mark(3.0 + 5.0 * f64::from(mark), format!("({})", mark + 1));
    }
    plot
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = PathBuf::from(std::env::args().nth(1).ok_or("no output file; give its name as the argument")?);
    let cases = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../tests/data/cases");
    let mut strip = Vec::new();
    let mut animation = Animation::new(AnimationLimits { width_max_px: 480, frames_max: 20 });
    for (i, name) in ["bb201_c0", "bb204_c0", "bb207_c0", "bb209_c0"].into_iter().enumerate() {
        let case = load_case(&cases.join(name))?;
        let mut images = case.load_images()?;
        let left = &mut images.left;
        overlay::fill_polygon(left, &case.region_polygon_left_px, colors::REGION, 0.25);
        overlay::polygon(left, &case.region_polygon_left_px, Stroke::of(colors::REGION));
        let [u, v] = case.region_centroid_px.unwrap_or_default();
        overlay::axes(left, [u, v], [[u + 60.0, v + 8.0], [u - 8.0, v + 60.0], [u + 25.0, v + 20.0]]);
        overlay::cross(left, [u, v], 9.0, Stroke::of(colors::ESTIMATE));
        overlay::text(left, [8.0, 8.0], &format!("{name}\ntilt 12.3°"), TextStyle::of(colors::ESTIMATE));
        let both = overlay::side_by_side(&images.left, &images.right);
        animation.push(i as f64, &both);
        strip.push((both, format!("{name}: left with region and axes | right")));
    }
    let animated = file.with_extension("anim.png");
    animation.write(&animated)?;
    let animated = std::fs::read(animated)?;
    let mut images: Vec<_> = strip.iter().map(|(p, caption)| (ReportImage::Photo(p), caption.clone())).collect();
    images.push((ReportImage::EncodedPng(&animated), "the same, animated".into()));
    let panels: Vec<_> = (0..6).map(panel).collect();
    let fitness = (0..60_000).map(|i| [f64::from(i) * 0.001, 0.8 + 0.1 * (f64::from(i) * 0.37).sin()]).collect();
    let table = Table::new(["axis", "rms, mm", "max, mm", "lag, ms"]).row(["x", "1.20", "4.81", "212"]).row([
        "y < z & \"quoted\"",
        "0.98",
        "\u{2212}3.97",
        "208",
    ]);
    Report::new("Report contents")
        .paragraph("Figures, a table, six panels with marks, a long series, images. The curves are synthetic.")
        .figures(&[
            ("position rms", "1.20 mm".into()),
            ("orientation rms", "0.41\u{b0}".into()),
            ("lag", "212 ms".into()),
        ])
        .heading("Table")
        .table(&table)
        .heading("Panels")
        .panels(&panels)
        .heading("One plot")
        .plot(
            &LinePlot::new("Fitness", ("time", "s"), ("fitness", ""))
                .series(Series::line("best individual", SeriesColor::Blue, fitness))
                .series(Series::line("limit", SeriesColor::Orange, vec![[0.0, 0.6], [60.0, 0.6]]).dashed()),
        )
        .heading("Images")
        .images(&images)
        .write(&file)?;
    Ok(())
}

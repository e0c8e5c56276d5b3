//! Self-contained HTML reports: one file, no external resources, readable in light and dark mode.
//!
//! uPlot draws the line plots, with zoom and hover; a page with line plots permits this script and no other.
//!
//! ```
//! use pb3dp_record::report::{LinePlot, Report, Series, SeriesColor, Table};
//!
//! let series = Series::line("hand", SeriesColor::Red, vec![[0.0, 1.0], [0.1, 1.5], [0.2, 1.2]]);
//! let html = Report::new("Run of today")
//!     .paragraph("The hand followed.")
//!     .table(&Table::new(["axis", "rms, mm"]).row(["x", "1.2"]))
//!     .plot(&LinePlot::new("x", ("time", "s"), ("position", "mm")).series(series))
//!     .to_html()?;
//! assert!(html.contains("<figure class=\"plot\">"));
//! # Ok::<(), pb3dp_record::report::ReportError>(())
//! ```

mod bars;
mod base64;
mod image_plot;
mod kept_rows;
mod line_plot;
mod plot_data;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use image::RgbImage;
use sha2::{Digest, Sha256};

pub use bars::Bars;
pub use image_plot::{ImagePlot, VectorAt};
pub use line_plot::{LinePlot, Mark, Series, SeriesColor};

use crate::images::{StoredFormat, encode};
use crate::plain_zero::plain_zero;
use crate::text_file::write_text;

/// Why a report was not written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// An image cannot be encoded.
    #[error("image `{caption}` of the report cannot be encoded; it must have at least one pixel")]
    Image {
        /// Its caption.
        caption: String,
        /// The cause.
        #[source]
        source: image::ImageError,
    },
    /// The file cannot be written.
    #[error("report {} cannot be written; check the folder and the free space", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// The cause.
        #[source]
        source: std::io::Error,
    },
}

/// A table; the first column is left-aligned, the others right-aligned.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Table {
    headings: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table without rows. Units belong in the headings.
    pub fn new<S: Into<String>>(headings: impl IntoIterator<Item = S>) -> Self {
        Self { headings: headings.into_iter().map(Into::into).collect(), rows: Vec::new() }
    }

    /// Adds a row; missing cells stay empty, surplus cells are ignored.
    #[must_use]
    pub fn row<S: Into<String>>(mut self, cells: impl IntoIterator<Item = S>) -> Self {
        let mut row: Vec<String> = cells.into_iter().map(|cell| plain_zero(&cell.into())).collect();
        row.resize(self.headings.len(), String::new());
        self.rows.push(row);
        self
    }
}

/// An image of a report.
#[derive(Clone, Debug)]
pub enum ReportImage<'a> {
    /// Stored as JPEG: photographs.
    Photo(&'a RgbImage),
    /// Stored as PNG: drawings.
    Drawing(&'a RgbImage),
    /// The contents of a PNG file, animated or not, stored unchanged.
    EncodedPng(&'a [u8]),
}

/// The script of a page with line plots, between the elements that contain it.
const SCRIPT: &str = concat!(
    "/*\n",
    include_str!("../../assets/uplot/LICENSE"),
    "*/\n",
    include_str!("../../assets/uplot/uPlot.iife.min.js"),
    include_str!("plots.js")
);

/// A judgement with its colour; the word is always written as well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Meets the recommended limit.
    Good,
    /// Usable.
    Fair,
    /// Not to be used.
    Bad,
}

impl Tone {
    fn class(self) -> &'static str {
        match self {
            Self::Good => "c-green",
            Self::Fair => "c-orange",
            Self::Bad => "c-red",
        }
    }
}

/// A report under construction, from top to bottom. All text is escaped.
#[derive(Debug)]
pub struct Report {
    title: String,
    body: String,
    failed: Option<ReportError>,
    reload_s: Option<u32>,
    has_plots: bool,
}

impl Report {
    /// An empty report.
    pub fn new(title: impl Into<String>) -> Self {
        Self { title: title.into(), body: String::new(), failed: None, reload_s: None, has_plots: false }
    }

    /// A page that reloads itself at this interval, for reports that are updated while they are displayed.
    #[must_use]
    pub fn reloading(mut self, every_s: u32) -> Self {
        self.reload_s = Some(every_s);
        self
    }

    fn add(mut self, html: std::fmt::Arguments<'_>) -> Self {
        // Writing to a String does not fail.
        let _ = self.body.write_fmt(html);
        self.body.push('\n');
        self
    }

    /// Starts a section.
    #[must_use]
    pub fn heading(self, text: &str) -> Self {
        self.add(format_args!("<h2>{}</h2>", escape(text)))
    }

    /// A paragraph.
    #[must_use]
    pub fn paragraph(self, text: &str) -> Self {
        self.add(format_args!("<p>{}</p>", escape(text)))
    }

    /// The verdict in a large line, and the advice, one line each.
    #[must_use]
    pub fn verdict(self, tone: Tone, verdict: &str, what_to_do: &[String]) -> Self {
        let lines: String = what_to_do.iter().map(|line| format!("<li>{}</li>", escape(line))).collect();
        let list = if lines.is_empty() { String::new() } else { format!("<ul>{lines}</ul>") };
        self.add(format_args!(
            "<div class=\"verdict {}\"><strong>{}</strong>{list}</div>",
            tone.class(),
            escape(verdict)
        ))
    }

    /// A row of large figures: name and value with its unit.
    #[must_use]
    pub fn figures(self, figures: &[(&str, String)]) -> Self {
        let tile = |(name, value): &(&str, String)| {
            format!("<div><strong>{}</strong><span>{}</span></div>", escape(&plain_zero(value)), escape(name))
        };
        let tiles: String = figures.iter().map(tile).collect();
        self.add(format_args!("<div class=\"figures\">{tiles}</div>"))
    }

    /// A table.
    #[must_use]
    pub fn table(self, table: &Table) -> Self {
        let cells = |tag: &str, row: &[String]| -> String {
            row.iter().map(|cell| format!("<{tag}>{}</{tag}>", escape(cell))).collect()
        };
        let rows: String = table.rows.iter().map(|row| format!("<tr>{}</tr>", cells("td", row))).collect();
        let head = cells("th", &table.headings);
        self.add(format_args!(
            "<div class=\"wide\" tabindex=\"0\"><table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
        ))
    }

    /// A table that is folded under its title and opens on a click.
    #[must_use]
    pub fn folded(self, title: &str, table: &Table) -> Self {
        let opened = self.add(format_args!("<details><summary>{}</summary>", escape(title)));
        opened.table(table).add(format_args!("</details>"))
    }

    /// A plot over the whole width.
    #[must_use]
    pub fn plot(mut self, plot: &LinePlot) -> Self {
        self.has_plots = true;
        self.add(format_args!("{}", plot.to_html(plot_data::to_html(plot))))
    }

    /// Plots side by side where the window is wide enough, as the panels of a figure.
    #[must_use]
    pub fn panels(mut self, plots: &[LinePlot]) -> Self {
        self.has_plots = true;
        let panels: String = plots.iter().map(|plot| plot.to_html(plot_data::to_html(plot))).collect();
        self.add(format_args!("<div class=\"panels\">{panels}</div>"))
    }

    /// Plots over the image area, side by side where the window is wide enough.
    #[must_use]
    pub fn image_plots(self, plots: &[ImagePlot]) -> Self {
        let panels: String = plots.iter().map(ImagePlot::to_html).collect();
        self.add(format_args!("<div class=\"panels\">{panels}</div>"))
    }

    /// Groups of bars, side by side where the window is wide enough.
    #[must_use]
    pub fn bars(self, groups: &[Bars]) -> Self {
        let panels: String = groups.iter().map(Bars::to_html).collect();
        self.add(format_args!("<div class=\"panels\">{panels}</div>"))
    }

    /// A strip of images with captions.
    #[must_use]
    pub fn images(mut self, images: &[(ReportImage<'_>, String)]) -> Self {
        let mut strip = String::new();
        for (image, caption) in images {
            match image_tag(image, caption) {
                Ok(tag) => strip.push_str(&tag),
                // Kept until the report is written, so that calls can be chained.
                Err(error) => self.failed = self.failed.or(Some(error)),
            }
        }
        self.add(format_args!("<div class=\"strip\">{strip}</div>"))
    }

    /// The whole report.
    ///
    /// # Errors
    /// An image could not be encoded.
    pub fn to_html(mut self) -> Result<String, ReportError> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => Ok(self.page()),
        }
    }

    /// Writes the report.
    ///
    /// # Errors
    /// An image could not be encoded or the file cannot be written.
    pub fn write(self, file: &Path) -> Result<(), ReportError> {
        let html = self.to_html()?;
        write_text(file, &html).map_err(|source| ReportError::Write { file: file.to_owned(), source })
    }

    fn page(&self) -> String {
        let title = escape(&self.title);
        let reload =
            self.reload_s.map_or_else(String::new, |s| format!("<meta http-equiv=\"refresh\" content=\"{s}\">\n"));
        let [script, styles, permitted, notice] = if self.has_plots {
            let hash = base64::encode(&Sha256::digest(SCRIPT));
            let styles = include_str!("../../assets/uplot/uPlot.min.css").to_owned();
            // The script removes it.
            let notice = "<p id=\"needs-scripts\">The plots of this page need scripts: allow them.</p>\n".to_owned();
            [format!("<script>{SCRIPT}</script>\n"), styles, format!("'sha256-{hash}'"), notice]
        } else {
            [String::new(), String::new(), "'none'".to_owned(), String::new()]
        };
        format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n{reload}\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; \
             style-src 'unsafe-inline'; script-src {permitted}\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{styles}\n{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n{notice}{}</main>\n{script}</body>\n</html>\n",
            include_str!("style.css"),
            self.body
        )
    }
}

fn image_tag(image: &ReportImage<'_>, caption: &str) -> Result<String, ReportError> {
    let encoded = |image, format| {
        encode(image, format).map_err(|source| ReportError::Image { caption: caption.to_owned(), source })
    };
    let (kind, data) = match image {
        ReportImage::Photo(image) => ("jpeg", base64::encode(&encoded(image, StoredFormat::Jpeg { quality: 85 })?)),
        ReportImage::Drawing(image) => ("png", base64::encode(&encoded(image, StoredFormat::Png)?)),
        ReportImage::EncodedPng(bytes) => ("png", base64::encode(bytes)),
    };
    let caption = escape(caption);
    Ok(format!(
        "<figure><img alt=\"{caption}\" src=\"data:image/{kind};base64,{data}\"><figcaption>{caption}</figcaption></figure>"
    ))
}

/// Text as HTML content or attribute value.
fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            other => escaped.push(other),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_text_is_escaped_and_nothing_is_loaded() {
        let nasty = "<script>alert('a & \"b\"')</script>";
        let plot = LinePlot::new(nasty, (nasty, nasty), (nasty, nasty))
            .series(Series::line(nasty, SeriesColor::Ink, vec![[0.0, 0.0], [1.0, 1.0]]))
            .mark(0.5, nasty);
        let image = RgbImage::new(4, 3);
        let html = Report::new(nasty)
            .heading(nasty)
            .paragraph(nasty)
            .figures(&[(nasty, nasty.to_owned())])
            .table(&Table::new([nasty]).row([nasty]))
            .panels(&[plot])
            .verdict(Tone::Bad, nasty, &[nasty.to_owned()])
            .image_plots(&[ImagePlot::new(nasty, [4, 3])])
            .bars(&[Bars::new(nasty, 1).bar(nasty, 1.0).limit(nasty, 2.0)])
            .images(&[(ReportImage::Photo(&image), nasty.to_owned())])
            .to_html()
            .unwrap();
        let page = html.replace(SCRIPT, "");
        let starts: Vec<_> = page.match_indices("<script").map(|(at, _)| &page[at..at + 32]).collect();
        assert_eq!(starts, ["<script type=\"application/json\">", "<script></script>\n</body>\n</html"]);
        assert_eq!(page.matches("alert('").count(), 5, "texts of the plot's data, which is not run");
        assert!(html.contains("&lt;script&gt;alert(&#39;a &amp; &quot;b&quot;&#39;)&lt;/script&gt;"));
        assert!(!page.replace("http-equiv", "").contains("http"), "no external resource");
        let without = Report::new(nasty).bars(&[Bars::new(nasty, 1)]).to_html().unwrap();
        assert!(!without.contains("<script") && without.contains("script-src 'none'"), "{without}");
    }

    /// The page would be without zoom otherwise, as a browser refuses the script.
    #[test]
    fn the_script_does_not_end_its_own_element() {
        assert!(!SCRIPT.to_ascii_lowercase().contains("</script") && !SCRIPT.contains("<!--"));
    }

    #[test]
    fn a_page_loads_itself_again_only_if_it_is_asked_to() {
        let html = |report: Report| report.to_html().unwrap();
        assert!(html(Report::new("t").reloading(2)).contains("http-equiv=\"refresh\" content=\"2\""));
        assert!(!html(Report::new("t")).contains("refresh"));
    }

    #[test]
    fn rows_are_as_long_as_the_headings() {
        let table = Table::new(["a", "b"]).row(["1"]).row(["1", "2", "3"]);
        let html = Report::new("t").table(&table).to_html().unwrap();
        assert!(html.contains("<tr><td>1</td><td></td></tr><tr><td>1</td><td>2</td></tr>"));
    }

    #[test]
    fn images_are_embedded_and_an_empty_one_is_refused_by_caption() {
        let image = RgbImage::from_fn(6, 5, |x, y| image::Rgb([x as u8, y as u8, 9]));
        let png = encode(&image, StoredFormat::Png).unwrap();
        let strip = [
            (ReportImage::Drawing(&image), "one".to_owned()),
            (ReportImage::EncodedPng(&png), "two".to_owned()),
            (ReportImage::Photo(&image), "three".to_owned()),
        ];
        let html = Report::new("t").images(&strip).to_html().unwrap();
        assert_eq!(html.matches(&base64::encode(&png)).count(), 2);
        assert_eq!(html.matches("data:image/jpeg;base64,/9j/").count(), 1);
        let empty = RgbImage::new(0, 0);
        let error = Report::new("t")
            .images(&[(ReportImage::Photo(&empty), "frame 3".into())])
            .paragraph("more")
            .to_html()
            .unwrap_err();
        assert!(error.to_string().contains("frame 3"), "{error}");
    }

    #[test]
    fn a_report_that_can_not_be_written_names_its_file() {
        let error = Report::new("t").write(Path::new("/nonexistent/report.html")).unwrap_err();
        assert!(error.to_string().contains("report.html"));
    }
}

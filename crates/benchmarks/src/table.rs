//! Tables of rows of JSON, in Markdown, which a terminal shows as well.

use serde_json::Value;

/// A column: its heading, and the text of its cells, with values of the row in braces.
///
/// `{z_mm.median:3}` is the number at this path with three digits, `{share*100:0}` one that is multiplied first. A cell whose values are
/// all missing is `-`.
pub type Column<'a> = (&'a str, &'a str);

/// The table for a page. Columns without any value are left out.
pub fn markdown(columns: &[Column<'_>], rows: &[Value]) -> String {
    lines(columns, rows).iter().map(|cells| line(cells)).collect()
}

/// The headings and the line below them, for rows that are printed one by one.
pub fn head(columns: &[Column<'_>]) -> String {
    markdown(columns, &[])
}

/// One row with all its columns.
pub fn row(columns: &[Column<'_>], row: &Value) -> String {
    line(&columns.iter().map(|(_, text)| cell(text, row)).collect::<Vec<_>>())
}

fn line(cells: &[String]) -> String {
    format!("| {} |\n", cells.join(" | "))
}

fn lines(columns: &[Column<'_>], rows: &[Value]) -> Vec<Vec<String>> {
    let (mut head, mut rule, mut cells) = (Vec::new(), Vec::new(), vec![Vec::new(); rows.len()]);
    for (heading, text) in columns {
        let column: Vec<String> = rows.iter().map(|row| cell(text, row)).collect();
        if !rows.is_empty() && column.iter().all(|cell| cell == "-") {
            continue;
        }
        let is_number =
            column.first().is_some_and(|cell| cell.starts_with(|c: char| c.is_ascii_digit() || "+-".contains(c)));
        head.push((*heading).to_owned());
        rule.push(if is_number { "---:" } else { "---" }.to_owned());
        cells.iter_mut().zip(column).for_each(|(row, cell)| row.push(cell));
    }
    [head, rule].into_iter().chain(cells).collect()
}

/// The text of one cell.
pub fn cell(text: &str, row: &Value) -> String {
    let (mut filled, mut has_places, mut has_values) = (String::new(), false, false);
    for (index, part) in text.split(['{', '}']).enumerate() {
        if index % 2 == 0 {
            filled.push_str(part);
            continue;
        }
        let value = value(part, row);
        (has_places, has_values) = (true, has_values || value.is_some());
        filled.push_str(value.as_deref().unwrap_or("-"));
    }
    if has_places && !has_values { "-".to_owned() } else { filled }
}

fn value(place: &str, row: &Value) -> Option<String> {
    let (place, digits) = place.split_once(':').map_or((place, None), |(place, digits)| (place, digits.parse().ok()));
    let (path, factor) = place.split_once('*').unwrap_or((place, "1"));
    // A misspelt path must not look like a figure that is missing.
    let Some(value) = at(row, path) else { return Some("?".to_owned()) };
    match (value, digits) {
        (Value::Null, _) => None,
        (Value::Bool(is_true), _) => Some(if *is_true { "yes" } else { "no" }.to_owned()),
        (Value::String(text), _) => Some(text.replace('|', "/")),
        (Value::Number(number), Some(digits)) => {
            let digits: usize = digits;
            let number = number.as_f64()? * factor.parse::<f64>().ok()?;
            Some(format!("{number:.digits$}"))
        }
        (Value::Number(number), None) if number.is_f64() => number.as_f64().map(|number| number.to_string()),
        (other, _) => Some(other.to_string()),
    }
}

/// What stands at a path such as `z_mm.median` or `stages.0`; `None` if the row has no such key. Below a null all is null.
pub fn at<'a>(row: &'a Value, path: &str) -> Option<&'a Value> {
    path.split('.').try_fold(row, |value, key| match value {
        Value::Null => Some(value),
        Value::Array(values) => values.get(key.parse::<usize>().ok()?),
        _ => value.get(key),
    })
}

/// The number at a path, if there is one.
pub fn number(row: &Value, path: &str) -> Option<f64> {
    at(row, path)?.as_f64()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    const COLUMNS: [Column<'_>; 5] = [
        ("what", "{name}"),
        ("z mm med / p95", "{z_m.0*1e3:2} / {z_m.1*1e3:2}"),
        ("lost", "{lost}"),
        ("met", "{met}"),
        ("never", "{never:1}"),
    ];

    #[test]
    fn cells_have_the_values_of_their_paths_with_factor_and_digits() {
        let rows = [
            json!({"name": "a|b", "z_m": [0.00125, 0.5], "lost": 3, "met": true, "never": null}),
            json!({"name": "c", "z_m": null, "lost": null, "met": false, "never": f64::NAN}),
        ];
        let expected = "| what | z mm med / p95 | lost | met |\n| --- | ---: | ---: | --- |\n\
                        | a/b | 1.25 / 500.00 | 3 | yes |\n| c | - | - | no |\n";
        assert_eq!(markdown(&COLUMNS, &rows), expected);
        assert_eq!(row(&COLUMNS, &rows[0]), "| a/b | 1.25 / 500.00 | 3 | yes | - |\n");
    }

    #[test]
    fn a_path_that_no_row_has_is_no_missing_figure() {
        assert_eq!(cell("{z_mm:2}", &json!({"z_m": 1.0})), "?");
        assert_eq!((number(&json!({"a": [1, 2]}), "a.1"), number(&json!({"a": null}), "a.b.c")), (Some(2.0), None));
    }
}

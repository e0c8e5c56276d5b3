//! Our CSV tables as Parquet files for pandas, Polars, DuckDB and MATLAB.
//!
//! A column whose cells are all numbers or empty becomes a nullable `DOUBLE`, any other column a nullable UTF-8 string. An empty cell is
//! null. The file is not compressed.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parquet::basic::{LogicalType, Repetition, Type as PhysicalType};
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::types::{Type, TypePtr};

use crate::text_file::write_whole;

/// Lines per row group; the cells of one group are in memory as slices. Chosen: 65 536 lines of 50 cells take 52 MB. Half as many lines
/// make twice as many groups; twice as many take twice the memory.
const GROUP_LINES: usize = 1 << 16;

/// Why a table could not be written as a Parquet file.
#[derive(Debug, thiserror::Error)]
pub enum ParquetTableError {
    /// The table is empty.
    #[error("{}: not written, because the CSV table has no header line; write the names of the columns in line 1", file.display())]
    NoHeader {
        /// The Parquet file.
        file: PathBuf,
    },
    /// A column has no name, or the name of another column.
    #[error(
        "{}: not written, because line 1 of the CSV table names column {column} `{name}`; give each column a name of its own",
        file.display()
    )]
    ColumnName {
        /// The Parquet file.
        file: PathBuf,
        /// Number of the column, from 1.
        column: usize,
        /// Its name.
        name: String,
    },
    /// A line has too few or too many cells.
    #[error(
        "{}: not written, because the number of cells in line {line} of the CSV table is {cells}, and {columns} in the header; write one \
         cell per column, without commas in a cell",
        file.display()
    )]
    CellCount {
        /// The Parquet file.
        file: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// Cells in this line.
        cells: usize,
        /// Columns of the header.
        columns: usize,
    },
    /// The table cannot be stored in the format.
    #[error("{}: not written, because the table does not fit the Parquet format; use the CSV table", file.display())]
    Encode {
        /// The Parquet file.
        file: PathBuf,
        /// The error of the format.
        source: ParquetError,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written; check the folder and the free space", file.display())]
    Write {
        /// The Parquet file.
        file: PathBuf,
        /// The system error.
        source: io::Error,
    },
}

/// Writes a CSV table as a Parquet file. The table has a header line, commas between cells, no quotes; an empty cell is unknown.
///
/// An interrupted write leaves the old file.
///
/// # Errors
/// A table without a header, with unnamed or repeated columns, with too few or too many cells in a line; a file that cannot be written.
pub fn write_parquet(file: &Path, csv: &str) -> Result<(), ParquetTableError> {
    let table = CsvTable::parse(file, csv)?;
    let bytes = table.encode(GROUP_LINES).map_err(|source| ParquetTableError::Encode { file: file.into(), source })?;
    write_whole(file, &bytes).map_err(|source| ParquetTableError::Write { file: file.into(), source })
}

/// A checked table: every line has a cell per column.
struct CsvTable<'a> {
    columns: Vec<Column<'a>>,
    lines: Vec<&'a str>,
}

struct Column<'a> {
    name: &'a str,
    kind: Kind,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Number,
    Text,
}

impl<'a> CsvTable<'a> {
    fn parse(file: &Path, csv: &'a str) -> Result<Self, ParquetTableError> {
        let mut lines = csv.lines();
        let header = lines
            .next()
            .filter(|header| !header.is_empty())
            .ok_or(ParquetTableError::NoHeader { file: file.into() })?;
        let mut known = BTreeSet::new();
        for (name, column) in header.split(',').zip(1..) {
            if name.is_empty() || !known.insert(name) {
                return Err(ParquetTableError::ColumnName { file: file.into(), column, name: name.into() });
            }
        }
        let mut columns: Vec<_> = header.split(',').map(|name| Column { name, kind: Kind::Number }).collect();
        let lines: Vec<_> = lines.collect();
        for (cells, line) in lines.iter().zip(2..) {
            let count = cells.split(',').count();
            if count != columns.len() {
                return Err(ParquetTableError::CellCount {
                    file: file.into(),
                    line,
                    cells: count,
                    columns: columns.len(),
                });
            }
            for (cell, column) in cells.split(',').zip(&mut columns) {
                if column.kind == Kind::Number && !cell.is_empty() && cell.parse::<f64>().is_err() {
                    column.kind = Kind::Text;
                }
            }
        }
        Ok(Self { columns, lines })
    }

    /// The bytes of the Parquet file.
    fn encode(&self, group_lines: usize) -> Result<Vec<u8>, ParquetError> {
        let mut writer = SerializedFileWriter::new(Vec::new(), self.schema()?, Arc::new(WriterProperties::default()))?;
        for lines in self.lines.chunks(group_lines) {
            let mut cells = vec![Vec::new(); self.columns.len()];
            for line in lines {
                line.split(',').zip(&mut cells).for_each(|(cell, column)| column.push(cell));
            }
            let mut group = writer.next_row_group()?;
            for (column, cells) in self.columns.iter().zip(&cells) {
                let missing = || ParquetError::General(format!("the schema has no column `{}`", column.name));
                column.write(cells, group.next_column()?.ok_or_else(missing)?)?;
            }
            group.close()?;
        }
        writer.into_inner()
    }

    fn schema(&self) -> Result<TypePtr, ParquetError> {
        let fields: Result<Vec<_>, _> = self.columns.iter().map(|column| column.field().map(Arc::new)).collect();
        Type::group_type_builder("table").with_fields(fields?).build().map(Arc::new)
    }
}

impl Column<'_> {
    fn field(&self) -> Result<Type, ParquetError> {
        let (physical, logical) = match self.kind {
            Kind::Number => (PhysicalType::DOUBLE, None),
            Kind::Text => (PhysicalType::BYTE_ARRAY, Some(LogicalType::String)),
        };
        let field = Type::primitive_type_builder(self.name, physical).with_repetition(Repetition::OPTIONAL);
        field.with_logical_type(logical).build()
    }

    fn write(&self, cells: &[&str], mut writer: SerializedColumnWriter<'_>) -> Result<(), ParquetError> {
        // Definition level of an optional value: 1 if there is one.
        let levels: Vec<i16> = cells.iter().map(|cell| i16::from(!cell.is_empty())).collect();
        let known = cells.iter().filter(|cell| !cell.is_empty());
        match self.kind {
            Kind::Number => {
                let numbers: Result<Vec<f64>, _> = known.map(|cell| cell.parse()).collect();
                let numbers = numbers.map_err(|error| ParquetError::External(Box::new(error)))?;
                writer.typed::<DoubleType>().write_batch(&numbers, Some(&levels), None)?;
            }
            Kind::Text => {
                let texts: Vec<ByteArray> = known.map(|&cell| cell.into()).collect();
                writer.typed::<ByteArrayType>().write_batch(&texts, Some(&levels), None)?;
            }
        }
        writer.close()
    }
}

#[cfg(test)]
mod tests {
    use std::error::Error as _;
    use std::fs::{self, File};

    use parquet::file::reader::{FileReader as _, SerializedFileReader};
    use parquet::record::Field;
    use proptest::prelude::*;

    use super::*;

    /// The rows of a Parquet file, each with the names of its columns.
    fn rows(file: &Path) -> Vec<Vec<(String, Field)>> {
        let reader = SerializedFileReader::new(File::open(file).unwrap()).unwrap();
        reader.into_iter().map(|row| row.unwrap().into_columns()).collect()
    }

    /// The rows of a table that went through a Parquet file.
    fn read_back(csv: &str) -> Vec<Vec<(String, Field)>> {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.parquet");
        write_parquet(&file, csv).unwrap();
        rows(&file)
    }

    fn refused(csv: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.parquet");
        let error = write_parquet(&file, csv).unwrap_err().to_string();
        assert!(error.contains("table.parquet"), "{error}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "{csv:?}");
        error
    }

    fn bits(field: &Field) -> Option<u64> {
        match field {
            Field::Double(number) => Some(number.to_bits()),
            Field::Null => None,
            other => panic!("{other:?} is no number"),
        }
    }

    #[test]
    fn numbers_are_doubles_words_are_strings_and_empty_cells_are_null() {
        let rows = read_back(
            "t_s,status,x_mm,empty,mixed\n0.25,ok,-0.0000,,1.5\n\
            -1.783238e-6,,,,half\n1e308,no pose – verloren,5e-324,,\n",
        );
        let names: Vec<_> = rows[0].iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["t_s", "status", "x_mm", "empty", "mixed"]);
        let column = |number: usize| rows.iter().map(|row| row[number].1.clone()).collect::<Vec<_>>();
        let numbers = |number: usize| column(number).iter().map(bits).collect::<Vec<_>>();
        assert_eq!(numbers(0), [0.25, -1.783_238e-6, 1e308].map(|number: f64| Some(number.to_bits())));
        let text = |text: &str| Field::Str(text.into());
        assert_eq!(column(1), [text("ok"), Field::Null, text("no pose – verloren")]);
        assert_eq!(numbers(2), [Some((-0.0_f64).to_bits()), None, Some(5e-324_f64.to_bits())]);
        assert_eq!(numbers(3), [None; 3]);
        assert_eq!(column(4), [text("1.5"), text("half"), Field::Null]);
    }

    #[test]
    fn columns_of_a_table_without_lines_and_ends_of_lines_of_windows_are_kept() {
        assert_eq!(read_back("a,b"), [] as [Vec<_>; 0]);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.parquet");
        write_parquet(&file, "a,b\n").unwrap();
        let reader = SerializedFileReader::new(File::open(&file).unwrap()).unwrap();
        let schema = reader.metadata().file_metadata().schema().get_fields().to_vec();
        assert_eq!(schema.iter().map(|field| field.name()).collect::<Vec<_>>(), ["a", "b"]);
        let rows = read_back("a,b\r\n1,left\r\n");
        assert_eq!((&rows[0][0].1, &rows[0][1].1), (&Field::Double(1.0), &Field::Str("left".into())));
        // The only cell of a line may be empty.
        assert_eq!(
            read_back("a\n\n2\n").iter().map(|row| bits(&row[0].1)).collect::<Vec<_>>(),
            [None, Some(2_f64.to_bits())]
        );
    }

    #[test]
    fn a_table_of_several_row_groups_is_one_table() {
        let lines: String = (0..1000).map(|line| format!("{line},word {}\n", line % 7)).collect();
        let csv = format!("number,word\n{lines}");
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.parquet");
        let bytes = || CsvTable::parse(&file, &csv).unwrap().encode(300).unwrap();
        assert_eq!(bytes(), bytes(), "the same table gives the same file");
        fs::write(&file, bytes()).unwrap();
        assert_eq!(SerializedFileReader::new(File::open(&file).unwrap()).unwrap().num_row_groups(), 4);
        let rows = rows(&file);
        assert_eq!(rows.len(), 1000);
        for (line, row) in rows.iter().enumerate() {
            assert_eq!(
                (&row[0].1, &row[1].1),
                (&Field::Double(line as f64), &Field::Str(format!("word {}", line % 7)))
            );
        }
    }

    #[test]
    fn a_bad_table_is_refused_with_its_line_and_no_file_is_left() {
        for csv in ["", "\n", "\n1,2\n"] {
            assert!(refused(csv).contains("no header line"), "{csv:?}");
        }
        assert!(refused("a,,c\n").contains("names column 2 ``"));
        assert!(refused("a,b,a\n").contains("names column 3 `a`"));
        for (csv, message) in [
            ("a,b\n1,2\n3\n", "in line 3 of the CSV table is 1, and 2 in the header"),
            ("a,b\n1,2,3\n", "in line 2 of the CSV table is 3, and 2 in the header"),
            ("a,b\n1,2\n\n", "in line 3 of the CSV table is 1, and 2 in the header"),
        ] {
            assert!(refused(csv).contains(message), "{}", refused(csv));
        }
    }

    #[test]
    fn a_file_that_cannot_be_written_is_named_with_the_cause() {
        let folder = tempfile::tempdir().unwrap();
        let error = write_parquet(&folder.path().join("missing/table.parquet"), "a\n1\n").unwrap_err();
        assert!(error.to_string().contains("missing/table.parquet: cannot be written"), "{error}");
        assert!(error.source().is_some());
    }

    proptest! {
        #[test]
        fn every_number_is_read_back_to_the_bit(numbers in prop::collection::vec(prop::option::of(prop::num::f64::ANY), 0..200)) {
            let cell = |number: &Option<f64>| number.map_or(String::new(), |number| format!("{number:e}"));
            let csv = format!("a,b\n{}", numbers.iter().map(|number| format!("{},x\n", cell(number))).collect::<String>());
            let found: Vec<_> = read_back(&csv).iter().map(|row| bits(&row[0].1)).collect();
            // The text of a number that is none has neither sign nor payload.
            let expected = numbers.iter().map(|number| number.map(|n| if n.is_nan() { f64::NAN.to_bits() } else { n.to_bits() }));
            prop_assert_eq!(found, expected.collect::<Vec<_>>());
        }

        #[test]
        fn no_text_ends_the_program(csv in "([a-z0-9.,\n\r\" -]|\\PC){0,80}") {
            let folder = tempfile::tempdir().unwrap();
            let _ = write_parquet(&folder.path().join("table.parquet"), &csv);
        }
    }
}

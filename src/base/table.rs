//! A CSV table that a user wrote: its columns in any order, and each wrong cell by its line and column.

use std::str::FromStr;

use csv::StringRecord;

use crate::catalogue::FileFinding::{
    ColumnTwice, MissingColumns, NotANumber, NotCsv, NotFinite, NotPositive, NotUtf8, NotWhole, Unreadable,
};
use crate::diagnostic::{Diagnostic, Finding};

/// How the tables are read: with a header, blanks about a cell left out.
pub fn reader() -> csv::ReaderBuilder {
    let mut reader = csv::ReaderBuilder::new();
    reader.trim(csv::Trim::All);
    reader
}

/// The header of a table.
#[derive(Clone, Copy)]
pub struct Columns<'a> {
    /// The file as the user named it.
    pub file: &'a str,
    /// The names.
    pub header: &'a StringRecord,
}

impl<'a> Columns<'a> {
    /// The places of columns that must be there.
    ///
    /// # Errors
    /// Names all that are absent, or one that is there twice.
    pub fn required<const N: usize>(&self, names: [&str; N]) -> Result<[usize; N], Diagnostic> {
        let mut places = [0; N];
        let mut absent = Vec::new();
        for (place, name) in places.iter_mut().zip(names) {
            match self.optional(name)? {
                Some(at) => *place = at,
                None => absent.push(format!("`{name}`")),
            }
        }
        if absent.is_empty() {
            return Ok(places);
        }
        let there: Vec<&str> = self.header.iter().collect();
        let (absent, header) = (absent.join(", "), there.join(","));
        Err(Diagnostic::line(self.file, 1, MissingColumns { absent, header }))
    }

    /// The place of a column that may be there.
    ///
    /// # Errors
    /// When it is there twice.
    pub fn optional(&self, name: &str) -> Result<Option<usize>, Diagnostic> {
        let mut places = self.header.iter().enumerate().filter(|(_, column)| *column == name);
        match (places.next(), places.next()) {
            (_, Some(_)) => Err(Diagnostic::line(self.file, 1, ColumnTwice { column: name.into() })),
            (first, None) => Ok(first.map(|(at, _)| at)),
        }
    }

    /// A row under this header, of as many cells.
    pub fn row(self, record: &'a StringRecord) -> Row<'a> {
        Row { columns: self, record }
    }
}

/// A row, with what is needed to say where a cell stands.
#[derive(Clone, Copy)]
pub struct Row<'a> {
    columns: Columns<'a>,
    record: &'a StringRecord,
}

impl<'a> Row<'a> {
    /// The text of a cell.
    pub fn text(&self, at: usize) -> &'a str {
        self.record.get(at).unwrap_or("")
    }

    /// A finite number.
    ///
    /// # Errors
    /// When it is none.
    pub fn number(&self, at: usize) -> Result<f64, Diagnostic> {
        match f64::from_str(self.text(at)) {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(self.line(NotFinite { column: self.column(at), cell: self.text(at).into() })),
            Err(_) => Err(self.line(NotANumber { column: self.column(at), cell: self.text(at).into() })),
        }
    }

    /// A length or a standard deviation.
    ///
    /// # Errors
    /// When it is no finite number, or not positive.
    pub fn positive(&self, at: usize) -> Result<f64, Diagnostic> {
        let value = self.number(at)?;
        let wrong = || self.line(NotPositive { column: self.column(at), cell: self.text(at).into() });
        if value > 0.0 { Ok(value) } else { Err(wrong()) }
    }

    /// A number by `read`, of a column that may be absent and a cell that may be empty.
    ///
    /// # Errors
    /// As `read`.
    pub fn given<T>(
        &self,
        at: Option<usize>,
        read: impl FnOnce(usize) -> Result<T, Diagnostic>,
    ) -> Result<Option<T>, Diagnostic> {
        at.filter(|&at| !self.text(at).is_empty()).map(read).transpose()
    }

    /// A whole number from `least`.
    ///
    /// # Errors
    /// When it is none.
    pub fn whole(&self, at: usize, least: u32) -> Result<u32, Diagnostic> {
        match self.text(at).parse() {
            Ok(value) if value >= least => Ok(value),
            _ => Err(self.line(NotWhole { column: self.column(at), cell: self.text(at).into(), least })),
        }
    }

    /// A number from 1 of something that is counted.
    ///
    /// # Errors
    /// When it is none.
    pub fn numbered<T: FromStr>(&self, at: usize) -> Result<T, Diagnostic> {
        let wrong = |_| self.line(NotWhole { column: self.column(at), cell: self.text(at).into(), least: 1 });
        self.text(at).parse().map_err(wrong)
    }

    /// What is wrong with a cell.
    pub fn wrong(&self, at: usize, why: impl std::fmt::Display) -> Diagnostic {
        let name = self.columns.header.get(at).unwrap_or("");
        self.line(format!("column `{name}`: `{}`: {why}", self.text(at)))
    }

    /// What is wrong with the row.
    pub fn line(&self, why: impl Finding) -> Diagnostic {
        let line = self.record.position().map_or(0, |position| position.line() as usize);
        Diagnostic::line(self.columns.file, line, why)
    }

    fn column(&self, at: usize) -> String {
        self.columns.header.get(at).unwrap_or("").to_owned()
    }
}

/// What is wrong with a CSV text.
pub fn wrong_csv(file: &str, error: &csv::Error) -> Diagnostic {
    let line = error.position().map_or(0, |position| position.line() as usize);
    match error.kind() {
        csv::ErrorKind::Io(error) => Diagnostic::file(file, Unreadable { why: error.to_string() }),
        csv::ErrorKind::Utf8 { .. } => Diagnostic::line(file, line, NotUtf8),
        _ => Diagnostic::line(file, line, NotCsv { why: error.to_string() }),
    }
}

//! Reads a table that a user or another program wrote. Delimiter, decimal mark and encoding are detected, columns may be in
//! any order, and an error names the line and column of the cell.

use std::cell;
use std::io::BufRead;
use std::str::FromStr;

use super::text::{Encoding, LineReader};
use crate::base::FileFinding::{
    self, CellCount, ColumnTwice, MissingColumns, NoCell, NotANumber, NotFinite, NotPositive, NotWhole,
    OpenQuote, OtherCase, OtherDecimal, Unreadable, WrittenAs,
};
use crate::diagnostic::{Diagnostic, Finding};

/// Known properties of a table before it is read. `None`: the property is detected.
#[derive(Clone, Debug)]
pub struct TableLayout {
    pub delimiter: Option<Delimiter>,
    /// `.` or `,`.
    pub decimal: Option<char>,
    /// The number of lines to skip before the header, or before the first row if there is no header.
    pub skip_lines: usize,
    /// Whether the first line names the columns.
    pub header: bool,
    /// Lines that begin with this text are skipped.
    pub comment: Option<String>,
}

impl Default for TableLayout {
    fn default() -> Self {
        Self { delimiter: None, decimal: None, skip_lines: 0, header: true, comment: None }
    }
}

/// A table that is read row by row.
pub struct TableReader<'a> {
    lines: LineReader<Box<dyn BufRead + 'a>>,
    layout: TableLayout,
    delimiter: Option<Delimiter>,
    columns: TableColumns,
    /// The last row, or the header.
    record: RowContent,
    /// The text that was read since the last [`Self::take_text`].
    read: String,
    /// The length of all text so far, in bytes of UTF-8.
    bytes: u64,
    ends_with_line: bool,
}

/// The column names, and the properties that all cells share.
struct TableColumns {
    file: String,
    names: Vec<String>,
    /// The line of the header; 0 without a header.
    line: usize,
    /// The decimal mark, once a number has shown it.
    decimal: cell::Cell<Option<char>>,
    delimiter: String,
}

#[derive(Default)]
struct RowContent {
    /// The line where it begins.
    line: usize,
    /// The length of the text before it, in bytes of UTF-8.
    offset: u64,
    text: String,
    cells: Vec<TableCell>,
}

impl<'a> TableReader<'a> {
    /// Reads a text in memory.
    pub fn of(file: &str, text: &'a (impl AsRef<[u8]> + ?Sized)) -> Result<Self, Diagnostic> {
        Self::new(file, text.as_ref(), TableLayout::default())
    }

    /// Reads `source`; messages call it `file`.
    pub fn new(file: &str, source: impl BufRead + 'a, layout: TableLayout) -> Result<Self, Diagnostic> {
        let columns = TableColumns {
            file: file.into(),
            names: Vec::new(),
            line: 0,
            decimal: cell::Cell::new(layout.decimal),
            delimiter: String::new(),
        };
        let mut table = Self {
            lines: LineReader::new(file, Box::new(source)),
            delimiter: layout.delimiter,
            layout,
            columns,
            record: RowContent::default(),
            read: String::new(),
            bytes: 0,
            ends_with_line: true,
        };
        if table.layout.header && table.read_record()? {
            let cells = std::mem::take(&mut table.record.cells);
            table.columns.names = cells.into_iter().map(|cell| cell.text).collect();
            table.columns.line = table.record.line;
        }
        Ok(table)
    }

    /// The file as the user named it.
    pub fn file(&self) -> &str {
        &self.columns.file
    }

    pub fn names(&self) -> &[String] {
        &self.columns.names
    }

    /// The places of columns that must exist.
    pub fn required<const N: usize>(&self, names: [&str; N]) -> Result<[usize; N], Diagnostic> {
        let mut places = [0; N];
        let mut absent = Vec::new();
        for (place, name) in places.iter_mut().zip(names) {
            match self.place(name)? {
                Some(at) => *place = at,
                None => absent.push(format!("`{name}`")),
            }
        }
        if absent.is_empty() {
            return Ok(places);
        }
        if self.columns.names.is_empty() {
            return Err(Diagnostic::file(&self.columns.file, FileFinding::NoText));
        }
        let (absent, header) = (absent.join(", "), self.columns.names.join(", "));
        let delimiter = self.columns.delimiter.clone();
        Err(self.columns.header(MissingColumns { absent, header, delimiter }))
    }

    /// The place of a column that may be missing. A column whose name differs only in upper and lower case is an error: it
    /// would be ignored.
    pub(crate) fn optional(&self, name: &str) -> Result<Option<usize>, Diagnostic> {
        self.other_case(name).map_or_else(|| self.place(name), Err)
    }

    fn place(&self, name: &str) -> Result<Option<usize>, Diagnostic> {
        let mut places = self.columns.names.iter().enumerate().filter(|(_, column)| *column == name);
        match (places.next(), places.next()) {
            (_, Some(_)) => Err(self.columns.header(ColumnTwice { column: name.into() })),
            (Some((at, _)), None) => Ok(Some(at)),
            (None, None) => self.other_case(name).map_or(Ok(None), Err),
        }
    }

    /// The error that a column has this name in other upper and lower case.
    fn other_case(&self, name: &str) -> Option<Diagnostic> {
        let mut names = self.columns.names.iter();
        let column = names.find(|column| column.eq_ignore_ascii_case(name) && *column != name)?.clone();
        Some(self.columns.header(OtherCase { column, name: name.into() }))
    }

    /// The next row; `None` at the end.
    pub fn row(&mut self) -> Result<Option<TableRow<'_>>, Diagnostic> {
        if !self.read_record()? {
            return Ok(None);
        }
        let row = TableRow { columns: &self.columns, record: &self.record };
        let (cells, columns) = (self.record.cells.len(), self.columns.names.len());
        if columns > 0 && cells != columns && self.delimiter != Some(Delimiter::Blanks) {
            let further = self.record.cells.iter().skip(columns);
            // Many programs end each line with a delimiter: empty cells in excess are accepted.
            if cells < columns || further.clone().any(|cell| !cell.text.is_empty()) {
                let delimiter = self.columns.delimiter.clone();
                let at = further.map(|cell| cell.column).next();
                let at = at.unwrap_or_else(|| self.record.text.chars().count() + 1);
                return Err(row.at(at, CellCount { cells, columns, delimiter }));
            }
        }
        Ok(Some(row))
    }

    /// Whether the text that was read so far ends with a whole line.
    pub fn ends_with_line(&self) -> bool {
        self.ends_with_line
    }

    /// The text that was read since the last call, in UTF-8.
    pub fn take_text(&mut self) -> String {
        std::mem::take(&mut self.read)
    }

    /// Reports a detected format, if it is not UTF-8 with commas and decimal points.
    pub fn findings(&self) -> Option<Diagnostic> {
        let delimiter = self.delimiter.filter(|_| self.layout.delimiter.is_none());
        let decimal = self.columns.decimal.get().filter(|_| self.layout.decimal.is_none()).unwrap_or('.');
        let encoding = self.lines.encoding();
        let usual = delimiter.is_none_or(|delimiter| delimiter == Delimiter::Character(','))
            && decimal == '.'
            && encoding == Encoding::Utf8;
        let decimal = self.columns.decimal.get().unwrap_or('.');
        let (encoding, delimiter) = (encoding.name().into(), self.columns.delimiter.clone());
        (!usual).then(|| Diagnostic::file(self.file(), WrittenAs { encoding, delimiter, decimal }))
    }

    /// Reads the next line that is not to be skipped, and the lines into which a quoted cell of it extends.
    fn read_record(&mut self) -> Result<bool, Diagnostic> {
        let mut line = String::new();
        loop {
            line.clear();
            if !self.lines.next(&mut line)? {
                return Ok(false);
            }
            self.read.push_str(&line);
            self.record.offset = self.bytes;
            self.bytes += line.len() as u64;
            self.ends_with_line = line.ends_with('\n');
            let text = line.trim_start_matches('\u{feff}').trim_end_matches(['\n', '\r']);
            let comment = self.layout.comment.as_deref().is_some_and(|begin| text.starts_with(begin));
            if self.lines.number() <= self.layout.skip_lines || text.trim().is_empty() || comment {
                continue;
            }
            // Spreadsheets write and read this line before the header.
            let given = text.strip_prefix("sep=").filter(|_| self.delimiter.is_none());
            if let Some(delimiter) = given.and_then(|given| given.chars().next()) {
                self.delimiter = Some(Delimiter::Character(delimiter));
                continue;
            }
            text.clone_into(&mut self.record.text);
            break;
        }
        self.record.line = self.lines.number();
        let delimiter = *self.delimiter.get_or_insert_with(|| Delimiter::guess(&self.record.text));
        if self.columns.delimiter.is_empty() {
            self.columns.delimiter = delimiter.name();
        }
        while !split(&self.record.text, delimiter, &mut self.record.cells) {
            line.clear();
            if !self.lines.next(&mut line)? {
                return Err(Diagnostic::line(self.file(), self.record.line, OpenQuote));
            }
            self.read.push_str(&line);
            self.bytes += line.len() as u64;
            self.record.text.push('\n');
            self.record.text.push_str(line.trim_end_matches(['\n', '\r']));
        }
        Ok(true)
    }
}

impl TableColumns {
    fn header(&self, finding: FileFinding) -> Diagnostic {
        Diagnostic::line(&self.file, self.line.max(1), finding)
    }
}

/// A row. Its errors name the line and the column.
#[derive(Clone, Copy)]
pub struct TableRow<'a> {
    columns: &'a TableColumns,
    record: &'a RowContent,
}

impl<'a> TableRow<'a> {
    pub fn text(&self, at: usize) -> &'a str {
        self.record.cells.get(at).map_or("", |cell| &cell.text)
    }

    /// The length of the text before the row, in bytes of UTF-8.
    pub fn offset(&self) -> u64 {
        self.record.offset
    }

    /// Refuses a row that is too short to have this cell.
    pub fn has(&self, at: usize) -> Result<(), Diagnostic> {
        match self.record.cells.get(at) {
            Some(_) => Ok(()),
            None => Err(self.at(self.record.text.chars().count() + 1, NoCell { column: at + 1 })),
        }
    }

    /// The text of a cell; a number with a decimal comma is written with a point.
    pub fn plain(&self, at: usize) -> String {
        let comma = self.columns.decimal.get() == Some(',') && self.parsed(at).is_ok();
        if comma { self.text(at).replace(',', ".") } else { self.text(at).to_owned() }
    }

    /// A finite number.
    pub fn number(&self, at: usize) -> Result<f64, Diagnostic> {
        self.has(at)?;
        let value = self.parsed(at).map_err(|finding| self.wrong(at, finding))?;
        // The first decimal mark counts for the whole table.
        if self.columns.decimal.get().is_none() {
            self.columns.decimal.set(self.text(at).chars().find(|mark| matches!(mark, '.' | ',')));
        }
        Ok(value)
    }

    fn parsed(&self, at: usize) -> Result<f64, FileFinding> {
        let (column, cell) = (self.column(at), self.text(at).to_owned());
        let mut marks = cell.chars().filter(|mark| matches!(mark, '.' | ','));
        match (marks.next(), marks.next(), self.columns.decimal.get()) {
            (_, Some(_), _) => return Err(NotANumber { column, cell }),
            (Some(mark), None, Some(decimal)) if mark != decimal => {
                return Err(OtherDecimal { column, cell, decimal });
            }
            _ => {}
        }
        match f64::from_str(&cell.replace(',', ".")) {
            Ok(value) if value.is_finite() => Ok(value),
            Ok(_) => Err(NotFinite { column, cell }),
            Err(_) => Err(NotANumber { column, cell }),
        }
    }

    /// A positive number.
    pub fn positive(&self, at: usize) -> Result<f64, Diagnostic> {
        let value = self.number(at)?;
        let wrong = || self.wrong(at, NotPositive { column: self.column(at), cell: self.text(at).into() });
        if value > 0.0 { Ok(value) } else { Err(wrong()) }
    }

    /// Reads a cell with `read`; `None` if the table has no such column or the cell is empty.
    pub fn given<T>(
        &self,
        at: Option<usize>,
        read: impl FnOnce(usize) -> Result<T, Diagnostic>,
    ) -> Result<Option<T>, Diagnostic> {
        at.filter(|&at| !self.text(at).is_empty()).map(read).transpose()
    }

    /// A whole number of at least `least`.
    pub fn whole(&self, at: usize, least: u32) -> Result<u32, Diagnostic> {
        let value = self.whole_text(at).parse().ok().filter(|value| *value >= least);
        value.ok_or_else(|| self.no_whole(at, least))
    }

    /// A number of a type that counts from 1.
    pub fn numbered<T: FromStr>(&self, at: usize) -> Result<T, Diagnostic> {
        self.whole_text(at).parse().map_err(|_| self.no_whole(at, 1))
    }

    /// The text of a whole number. Other programs write it as `1.0`.
    pub fn whole_text(&self, at: usize) -> &'a str {
        match self.text(at).split_once(['.', ',']) {
            Some((whole, zeros)) if !zeros.is_empty() && zeros.bytes().all(|byte| byte == b'0') => whole,
            _ => self.text(at),
        }
    }

    fn no_whole(&self, at: usize, least: u32) -> Diagnostic {
        self.wrong(at, NotWhole { column: self.column(at), cell: self.text(at).into(), least })
    }

    pub fn wrong(&self, at: usize, why: impl Finding) -> Diagnostic {
        self.at(self.record.cells.get(at).map_or(1, |cell| cell.column), why)
    }

    pub fn line(&self, why: impl Finding) -> Diagnostic {
        Diagnostic::line(&self.columns.file, self.record.line, why)
    }

    fn at(&self, column: usize, why: impl Finding) -> Diagnostic {
        self.line(why).in_line(&self.record.text, column)
    }

    /// The name of a column, or its number if it has no name.
    pub fn column(&self, at: usize) -> String {
        self.columns.names.get(at).cloned().unwrap_or_else(|| (at + 1).to_string())
    }
}

/// Translates an error of the `csv` crate.
#[expect(clippy::wildcard_enum_match_arm, reason = "the crate may add kinds of errors")]
pub fn wrong_csv(file: &str, error: &csv::Error) -> Diagnostic {
    let line = error.position().map_or(0, |position| position.line() as usize);
    let finding = match error.kind() {
        csv::ErrorKind::Io(error) => return Diagnostic::file(file, Unreadable { why: error.to_string() }),
        csv::ErrorKind::Utf8 { .. } => FileFinding::NotText { encoding: Encoding::Utf8.name().into() },
        csv::ErrorKind::UnequalLengths { expected_len, len, .. } => CellCount {
            cells: *len as usize,
            columns: *expected_len as usize,
            delimiter: Delimiter::Character(',').name(),
        },
        csv::ErrorKind::Deserialize { err, .. } => FileFinding::NotACell {
            column: err.field().map_or(0, |field| field as usize + 1),
            why: err.kind().to_string(),
        },
        _ => FileFinding::NotCsv,
    };
    Diagnostic::line(file, line, finding)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delimiter {
    Character(char),
    /// One or more blanks.
    Blanks,
}

impl Delimiter {
    /// Guesses the delimiter from a line, without its quoted cells; a comma if there is only one cell.
    fn guess(line: &str) -> Self {
        let mut quoted = false;
        let outside: String = line
            .chars()
            .filter(|&character| {
                quoted ^= character == '"';
                !quoted
            })
            .collect();
        // Beside a tab or a semicolon, a comma is a decimal comma.
        match ['\t', ';', ','].into_iter().find(|&character| outside.contains(character)) {
            Some(character) => Self::Character(character),
            None if outside.trim().contains(char::is_whitespace) => Self::Blanks,
            None => Self::Character(','),
        }
    }

    fn name(self) -> String {
        match self {
            Self::Character('\t') => "a tab".into(),
            Self::Character(character) => format!("`{character}`"),
            Self::Blanks => "blanks".into(),
        }
    }
}

/// A cell, and the column of the line where it begins (from 1, in characters).
#[derive(Clone, Debug, PartialEq, Eq)]
struct TableCell {
    text: String,
    column: usize,
}

/// Splits a line into trimmed cells. The `csv` crate does not report the column of a cell, which messages point to. A cell in double quotes may hold delimiters, and quotes that are doubled. Returns
/// false if a quote is still open at the end of the line.
fn split(line: &str, delimiter: Delimiter, cells: &mut Vec<TableCell>) -> bool {
    cells.clear();
    let mut open: Option<TableCell> = None;
    let mut quoted = false;
    let mut characters = line.chars().enumerate().peekable();
    while let Some((at, character)) = characters.next() {
        let empty = || TableCell { text: String::new(), column: at + 1 };
        let ends = !quoted
            && match delimiter {
                Delimiter::Character(delimiter) => character == delimiter,
                Delimiter::Blanks => character.is_whitespace(),
            };
        match &mut open {
            _ if ends => match open.take() {
                Some(cell) => cells.push(cell),
                None if delimiter != Delimiter::Blanks => cells.push(empty()),
                None => {}
            },
            Some(cell) if quoted && character == '"' => {
                quoted = characters.next_if(|(_, next)| *next == '"').is_some();
                if quoted {
                    cell.text.push('"');
                }
            }
            Some(cell) => cell.text.push(character),
            None if character == '"' => {
                quoted = true;
                open = Some(empty());
            }
            None if character.is_whitespace() => {}
            None => open.insert(empty()).text.push(character),
        }
    }
    match open {
        Some(cell) => cells.push(cell),
        // A line that ends with a delimiter has one more, empty cell.
        None if delimiter != Delimiter::Blanks => {
            cells.push(TableCell { text: String::new(), column: line.chars().count() + 1 });
        }
        None => {}
    }
    for cell in cells {
        if cell.text.trim().len() < cell.text.len() {
            cell.text = cell.text.trim().to_owned();
        }
    }
    !quoted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_split() {
        let texts = |line: &str, delimiter| -> Vec<(String, usize)> {
            let mut cells = Vec::new();
            assert!(split(line, delimiter, &mut cells));
            cells.into_iter().map(|cell| (cell.text, cell.column)).collect()
        };
        let cell = |text: &str, column| (text.to_owned(), column);
        let by = Delimiter::Character;
        assert_eq!(texts("a; b ;;c", by(';')), [cell("a", 1), cell("b", 4), cell("", 7), cell("c", 8)]);
        assert_eq!(texts("\"0,5\",1,", by(',')), [cell("0,5", 1), cell("1", 7), cell("", 9)]);
        assert_eq!(texts("\"a \"\"b\"\"\",5\"", by(',')), [cell("a \"b\"", 1), cell("5\"", 11)]);
        assert_eq!(texts("  1.0\t 2 ", Delimiter::Blanks), [cell("1.0", 3), cell("2", 8)]);
    }

    #[test]
    fn delimiter_is_guessed_from_a_line() {
        for (line, delimiter) in [
            ("a;b", Delimiter::Character(';')),
            ("0,5;1,5", Delimiter::Character(';')),
            ("a,b\tc", Delimiter::Character('\t')),
            ("\"a;b\",c", Delimiter::Character(',')),
            ("a b", Delimiter::Blanks),
            ("a", Delimiter::Character(',')),
        ] {
            assert_eq!(Delimiter::guess(line), delimiter, "{line}");
        }
    }

    fn rows(text: &str) -> Result<Vec<Vec<f64>>, Diagnostic> {
        let mut table = TableReader::of("t.csv", text)?;
        let places = table.required(["a", "b"])?;
        let mut rows = Vec::new();
        while let Some(row) = table.row()? {
            rows.push(places.iter().map(|at| row.number(*at)).collect::<Result<_, _>>()?);
        }
        Ok(rows)
    }

    fn code(text: &str) -> String {
        rows(text).unwrap_err().code().as_str().to_owned()
    }

    #[test]
    fn delimiter_decimal_and_order_of_columns_are_detected() {
        let expected = vec![vec![1.5, -2.0], vec![1000.25, 3.0]];
        for text in [
            "a,b\n1.5,-2\n1000.25,3\n",
            "b;note;a\n-2;x;1,5\n3;;1000,25\n",
            "sep=;\na;b\n1.5;-2\n\n1000.25;3",
            "a\tb\n1.5\t-2\n1000.25\t3\t\n",
            "a b\n 1.5  -2\n1000.25 3\n",
        ] {
            assert_eq!(rows(text).unwrap(), expected, "{text}");
        }
    }

    #[test]
    fn cells_and_headers_that_do_not_fit_have_their_codes() {
        for (text, expected) in [
            ("a,c\n1,2\n", "E0110"),
            ("", "E0110"),
            ("a,B\n1,2\n", "E0110"),
            ("a,b,a\n1,2,3\n", "E0110"),
            ("a,b\n1,x\n", "E0111"),
            ("a,b\n1,\n", "E0111"),
            ("a;b\n1,5;2.5\n", "E0111"),
            ("a;b\n1.000,5;2\n", "E0111"),
            ("a,b\n1,inf\n", "E0111"),
            ("a,b\n1\n", "E0112"),
            ("a,b\n1,2,3\n", "E0112"),
            ("a,b\n1,\"2\n", "E0112"),
        ] {
            assert_eq!(code(text), expected, "{text}");
        }
    }

    #[test]
    fn whole_and_positive_numbers_are_checked() {
        let mut table = TableReader::of("t.csv", "a,b\n3.0,0\n2.5,-1\n0,7\n").unwrap();
        let row = table.row().unwrap().unwrap();
        assert_eq!(
            (row.whole(0, 3).ok(), row.whole(0, 4).ok(), row.whole(1, 0).ok()),
            (Some(3), None, Some(0))
        );
        assert!(row.positive(0).is_ok() && row.positive(1).is_err());
        assert_eq!(row.numbered::<std::num::NonZeroU32>(0).map(|number| number.get()).ok(), Some(3));
        assert!(row.numbered::<std::num::NonZeroU32>(1).is_err());
        let row = table.row().unwrap().unwrap();
        assert!(row.whole(0, 0).is_err() && row.whole(1, 0).is_err() && row.number(1).is_ok());
        assert!(row.has(1).is_ok() && row.has(2).is_err());
        assert_eq!(row.given(None, |at| row.number(at)).ok(), Some(None));
    }

    #[test]
    fn a_row_knows_where_its_text_begins() {
        let mut table = TableReader::of("t.csv", "a,b\n1,2\n\n3,4\n").unwrap();
        assert_eq!(table.row().unwrap().unwrap().offset(), 4);
        assert_eq!(table.row().unwrap().unwrap().offset(), 9);
        assert!(table.row().unwrap().is_none());
        assert_eq!(table.take_text(), "a,b\n1,2\n\n3,4\n");
    }
}

//! Further columns of a long table: the cells of all rows in one text, rows alike held once.

use std::fmt::Write;

/// Names of further columns, and the cells of the rows that have some.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Further {
    /// The names.
    pub columns: Vec<String>,
    /// The rows' cells as a CSV has them, each after a comma.
    text: String,
    /// Where the cells of each row end.
    ends: Vec<usize>,
}

impl Further {
    /// Of columns by these names, no row yet.
    pub fn new<S: Into<String>>(columns: impl IntoIterator<Item = S>) -> Self {
        Self { columns: columns.into_iter().map(Into::into).collect(), ..Self::default() }
    }

    /// Takes the cells of a row, one for each column; the number that the row keeps, 0 where there is none.
    pub fn add<S: AsRef<str>>(&mut self, cells: impl IntoIterator<Item = S>) -> u32 {
        let start = self.text.len();
        for cell in cells {
            // Writing to a string does not fail.
            let _ = write!(self.text, ",{}", quoted(cell.as_ref()));
        }
        let number = self.ends.len() as u32;
        if self.text[start..] == *self.line(number) {
            self.text.truncate(start);
            return number;
        }
        self.ends.push(self.text.len());
        number + 1
    }

    /// The cells of the row that keeps `number`, as they stood.
    pub fn cells(&self, number: u32) -> Vec<String> {
        // The first cell is empty: it stands before the first comma.
        let mut reader =
            csv::ReaderBuilder::new().has_headers(false).from_reader(self.line(number).as_bytes());
        let first = reader.records().next().and_then(Result::ok);
        first.map_or_else(Vec::new, |record| record.iter().skip(1).map(str::to_owned).collect())
    }

    /// The same as a CSV has them.
    pub(super) fn line(&self, number: u32) -> &str {
        let end = |number: u32| number.checked_sub(1).and_then(|at| self.ends.get(at as usize)).copied();
        match end(number) {
            Some(to) => &self.text[end(number - 1).unwrap_or(0)..to],
            None => "",
        }
    }

    /// The names as a CSV has them.
    pub(super) fn header(&self) -> String {
        self.columns.iter().map(|name| format!(",{}", quoted(name))).collect()
    }
}

/// A cell as CSV, in quotes where it needs them.
fn quoted(cell: &str) -> String {
    if cell.contains(['"', ',', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_come_back_as_they_stood() {
        let rows = [["measure", "1, 2"], ["say \"so\"", ""], ["say \"so\"", ""], ["", "two\nlines"]];
        let mut further = Further::new(["kind", "note"]);
        let numbers = rows.map(|row| further.add(row));
        assert_eq!(numbers, [1, 2, 2, 3]);
        for (number, row) in numbers.iter().zip(rows) {
            assert_eq!(further.cells(*number), row);
        }
        assert_eq!(further.cells(0), Vec::<String>::new());
        assert_eq!(Further::default().add(Vec::<String>::new()), 0);
    }
}

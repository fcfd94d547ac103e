//! Splits a line of a table into cells. The `csv` crate does not report the column of a cell, which messages point to.

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delimiter {
    Character(char),
    /// One or more blanks.
    Blanks,
}

impl Delimiter {
    /// Guesses the delimiter from a line, without its quoted cells; a comma if there is only one cell.
    pub(super) fn guess(line: &str) -> Self {
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

    pub(super) fn name(self) -> String {
        match self {
            Self::Character('\t') => "a tab".into(),
            Self::Character(character) => format!("`{character}`"),
            Self::Blanks => "blanks".into(),
        }
    }
}

/// A cell, and the column of the line where it begins (from 1, in characters).
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TableCell {
    pub(super) text: String,
    pub(super) column: usize,
}

/// Splits a line into trimmed cells. A cell in double quotes may hold delimiters, and quotes that are doubled. Returns
/// false if a quote is still open at the end of the line.
pub(super) fn split(line: &str, delimiter: Delimiter, cells: &mut Vec<TableCell>) -> bool {
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
}

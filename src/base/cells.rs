//! A line of a table, cut into its cells.

/// What separates the cells of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delimiter {
    Character(char),
    /// Any number of blanks.
    Blanks,
}

impl Delimiter {
    /// The one that a line outside of quotes shows; a line of one cell shows none.
    pub(super) fn shown(line: &str) -> Self {
        let mut quoted = false;
        let outside: String = line
            .chars()
            .filter(|&character| {
                quoted ^= character == '"';
                !quoted
            })
            .collect();
        // A decimal comma is no delimiter beside a semicolon or a tab.
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

/// A cell with the column of its line at which it begins, from 1, in characters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Cell {
    pub(super) text: String,
    pub(super) column: usize,
}

/// Cuts a line into its cells, blanks about them left out; whether no quote is left open. A cell in double quotes may
/// hold the delimiter, and a quote as two.
pub(super) fn cut(line: &str, delimiter: Delimiter, cells: &mut Vec<Cell>) -> bool {
    cells.clear();
    let mut open: Option<Cell> = None;
    let mut quoted = false;
    let mut characters = line.chars().enumerate().peekable();
    while let Some((at, character)) = characters.next() {
        let empty = || Cell { text: String::new(), column: at + 1 };
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
        // What follows the last delimiter is a cell as well.
        None if delimiter != Delimiter::Blanks => {
            cells.push(Cell { text: String::new(), column: line.chars().count() + 1 });
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
    fn lines_are_cut() {
        let texts = |line: &str, delimiter| -> Vec<(String, usize)> {
            let mut cells = Vec::new();
            assert!(cut(line, delimiter, &mut cells));
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
    fn a_delimiter_is_shown_by_the_first_line() {
        for (line, delimiter) in [
            ("a;b", Delimiter::Character(';')),
            ("0,5;1,5", Delimiter::Character(';')),
            ("a,b\tc", Delimiter::Character('\t')),
            ("\"a;b\",c", Delimiter::Character(',')),
            ("a b", Delimiter::Blanks),
            ("a", Delimiter::Character(',')),
        ] {
            assert_eq!(Delimiter::shown(line), delimiter, "{line}");
        }
    }
}

//! The layout of a listing: its sections, and its text with blanks in place of the parts that are no code.

use crate::program::CompensationFinding;
use crate::program::text::Text;
use dbbd_model::diagnostic::Diagnostic;

/// A listing in which the parts that are no code (line numbers, remarks, comments in brackets, the header) are replaced
/// by blanks: every byte of the code stays in its place.
pub(super) struct ListingLayout {
    pub(super) name: String,
    pub(super) code: String,
    /// The byte where the statements end and the positions begin.
    pub(super) positions: usize,
    /// The text of the remarks.
    pub(super) remarks: Vec<String>,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Section {
    Header,
    Statements,
    Positions,
    End,
}

impl ListingLayout {
    pub(super) fn new(text: Text<'_>) -> Result<Self, Diagnostic> {
        let head = text.text.lines().find(|line| !line.trim().is_empty()).unwrap_or("");
        let Some(name) =
            head.trim_start().strip_prefix("/PROG").and_then(|rest| rest.split_whitespace().next())
        else {
            let begins = text.beginning();
            return Err(text.wrong(&(0..0), CompensationFinding::NotFanuc { begins }));
        };
        let mut layout = Self {
            name: name.to_ascii_uppercase(),
            code: String::with_capacity(text.text.len()),
            positions: text.text.len(),
            remarks: Vec::new(),
        };
        let (mut section, mut is_inside) = (Section::Header, false);
        for line in text.text.split_inclusive('\n') {
            match line.trim_end() {
                "/MN" => section = Section::Statements,
                "/POS" => {
                    section = Section::Positions;
                    layout.positions = layout.code.len();
                }
                "/END" => section = Section::End,
                _ if section == Section::Statements => {
                    layout.statement(line, &mut is_inside);
                    continue;
                }
                _ if section == Section::Positions => {
                    layout.push_code(line);
                    continue;
                }
                _ => {}
            }
            layout.push_blank(line);
        }
        match section {
            Section::End => Ok(layout),
            Section::Header => {
                let begins = text.beginning();
                Err(text.wrong(&(0..0), CompensationFinding::NotFanuc { begins }))
            }
            Section::Statements | Section::Positions => {
                Err(Diagnostic::file(text.file, CompensationFinding::CutOff { end: "/END".into() }))
            }
        }
    }

    /// Adds a line of a statement; `is_inside` says whether a statement goes on from the line before.
    fn statement(&mut self, line: &str, is_inside: &mut bool) {
        let (number, rest) = numbered(line).unwrap_or(("", line));
        self.push_blank(number);
        if let Some(remark) = remark(rest).filter(|_| !*is_inside) {
            self.remarks.push(remark.to_owned());
            self.push_blank(rest);
            return;
        }
        self.push_code(rest);
        let code = rest.trim_end();
        if !code.is_empty() {
            *is_inside = !code.ends_with(';');
        }
    }

    fn push_blank(&mut self, text: &str) {
        self.code.extend(text.bytes().map(|byte| if byte == b'\n' { '\n' } else { ' ' }));
    }

    /// Adds code without comments in brackets. A sign that no statement has becomes `?`, so that its statement is not
    /// read.
    fn push_code(&mut self, line: &str) {
        let (mut depth, mut is_comment, mut is_text, mut start) = (0_usize, false, false, 0);
        let can_quote = line.matches('\'').count().is_multiple_of(2);
        for (at, c) in line.char_indices() {
            match c {
                '\'' if can_quote => is_text = !is_text,
                '[' if !is_text && !is_comment => (depth, start) = (depth + 1, at + 1),
                ']' if !is_text => (depth, is_comment) = (depth.saturating_sub(1), false),
                ':' if depth > 0 && !is_text && !is_comment => {
                    // `PR[GP1:9]` names a group, not a comment.
                    let before = line.get(start..at).unwrap_or("");
                    is_comment = !before.starts_with("GP");
                    if !is_comment {
                        self.code.truncate(self.code.len() - before.len());
                        self.push_blank(before);
                    }
                    self.code.push(' ');
                    continue;
                }
                _ => {}
            }
            let is_known =
                is_text || c.is_ascii_alphanumeric() || "_$'()[]{},;:.=<>+-*/%|@ \t\r\n".contains(c);
            if is_comment && c != '\n' {
                self.push_blank(line.get(at..at + c.len_utf8()).unwrap_or(""));
            } else if (is_known || c == '\'') && c.is_ascii() && (c != '\'' || can_quote) {
                self.code.push(c);
            } else {
                self.code.extend(std::iter::repeat_n('?', c.len_utf8()));
            }
        }
    }
}

/// The line number with its colon, and the rest of the line; a line that continues a statement has a colon alone.
fn numbered(line: &str) -> Option<(&str, &str)> {
    let digits = line.trim_start().trim_start_matches(|c: char| c.is_ascii_digit());
    let rest = digits.strip_prefix(':')?;
    line.split_at_checked(line.len() - rest.len())
}

/// The text of a remark, in a line without its number.
fn remark(rest: &str) -> Option<&str> {
    let rest = rest.trim();
    let text = rest.strip_prefix('!').or_else(|| rest.strip_prefix("--"))?;
    Some(text.strip_suffix(';').unwrap_or(text).trim_end())
}

/// The text of a remark, in a line with its number.
pub(in crate::program) fn remark_of(line: &str) -> Option<&str> {
    numbered(line).and_then(|(_, rest)| remark(rest))
}

/// The listing with its numbered lines numbered from 1.
pub(in crate::program) fn renumbered(text: &str) -> String {
    let (mut count, mut is_statement) = (0, false);
    let line = |line: &str| {
        match line.trim_end() {
            "/MN" => is_statement = true,
            "/POS" => is_statement = false,
            _ => {}
        }
        match numbered(line).filter(|(number, _)| is_statement && number.trim() != ":") {
            Some((_, rest)) => {
                count += 1;
                format!("{count:4}:{rest}")
            }
            None => line.to_owned(),
        }
    };
    text.split_inclusive('\n').map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LISTING: &str = "/PROG  Abc\r\n/ATTR\r\nCOMMENT = \"x\";\r\n/MN\r\n   1:  !a remark: [ ;\r\n  22:J P[1:near \u{e4}] 5% FINE ;\r\n\
        /POS\r\nP[1:\"App\"]{\r\n   GP1:\r\n\tUF : 0, UT : 1,\tCONFIG : 'N U T, 0, 0, 0'\r\n};\r\n/END\r\n";

    #[test]
    fn code_keeps_its_place() {
        let layout = ListingLayout::new(Text { file: "A.LS", text: LISTING }).unwrap();
        assert_eq!(layout.name, "ABC");
        assert_eq!(layout.code.len(), LISTING.len());
        assert_eq!(layout.code.find("J P[1"), LISTING.find("J P[1"));
        assert_eq!(layout.code.find("CONFIG"), LISTING.find("CONFIG"));
        assert!(
            !layout.code.contains("remark") && !layout.code.contains("near") && !layout.code.contains("App")
        );
        assert_eq!(layout.remarks, ["a remark: ["]);
        assert!(layout.code.get(..layout.positions).is_some_and(|code| code.contains("FINE")));
    }

    #[test]
    fn group_of_a_register_is_no_comment() {
        let text = LISTING.replace("!a remark: [", "PR[GP1:9,3]=(!DI[2])");
        let layout = ListingLayout::new(Text { file: "A.LS", text: &text }).unwrap();
        assert!(layout.code.contains("PR[    9,3]=(?DI[2])"), "{}", layout.code);
    }

    #[test]
    fn lines_are_numbered_from_1() {
        let text = "/MN\n   7:  A ;\n   9:C P[1]\n    :  P[2] FINE ;\n  12:  B ;\n/POS\nP[1]{\n   GP1:\n";
        let wanted = "/MN\n   1:  A ;\n   2:C P[1]\n    :  P[2] FINE ;\n   3:  B ;\n/POS\nP[1]{\n   GP1:\n";
        assert_eq!(renumbered(text), wanted);
    }

    #[test]
    fn listing_without_its_end_is_cut_off() {
        let of = |text: &str| {
            ListingLayout::new(Text { file: "A.LS", text }).err().map(|wrong| wrong.code().as_str())
        };
        assert_eq!(of(LISTING.trim_end().trim_end_matches("/END")), Some("E0980"));
        assert_eq!(of("/PROG A\n"), Some("E0913"));
        assert_eq!(of("MODULE M\n"), Some("E0913"));
    }
}

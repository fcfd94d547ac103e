//! Reads text files line by line in the encoding that their bytes suggest: UTF-16 with a byte order mark or an ASCII
//! character at the beginning, UTF-8, else Windows-1252.

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, BufRead};

use super::catalogue::FileFinding::{CarriageReturns, NotText, Unreadable};
use crate::diagnostic::Diagnostic;

/// The error that a source cannot be read.
pub fn unreadable(file: impl Display) -> impl Fn(io::Error) -> Diagnostic {
    move |error| Diagnostic::file(&file, Unreadable { why: error.to_string() })
}

/// A decimal number without trailing zeros.
pub fn without_end_zeros(number: &str) -> &str {
    if number.contains('.') { number.trim_end_matches('0').trim_end_matches('.') } else { number }
}

/// Whether a character controls a terminal, the lines of a text or the order in which it is read.
pub fn is_control(c: char) -> bool {
    let is_bidirectional = matches!(
        c,
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}'
    );
    is_bidirectional || c.is_control()
}

/// Escapes, as JSON does, what would control a terminal or the order in which a text is read: control characters but line
/// feed and tab, bidirectional controls, and the other separators of lines. Text from files, devices and clients is
/// printed through this.
pub fn escape_controls(text: &str) -> Cow<'_, str> {
    let steers = |c: char| !matches!(c, '\n' | '\t') && is_control(c);
    if !text.contains(steers) {
        return text.into();
    }
    let escaped = |c: char| if steers(c) { format!("\\u{:04x}", u32::from(c)) } else { c.into() };
    text.chars().map(escaped).collect::<String>().into()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    Utf8,
    Utf16Le,
    Utf16Be,
    Windows1252,
}

impl Encoding {
    pub fn name(self) -> &'static str {
        match self {
            Self::Utf8 => "UTF-8",
            Self::Utf16Le | Self::Utf16Be => "UTF-16",
            Self::Windows1252 => "Windows-1252",
        }
    }
}

pub struct LineReader<R> {
    file: String,
    source: R,
    /// The encoding of the text so far. ASCII counts as UTF-8 until another byte appears.
    encoding: Encoding,
    /// The number of lines read.
    number: usize,
    bytes: Vec<u8>,
}

impl<R: BufRead> LineReader<R> {
    pub fn new(file: &str, source: R) -> Self {
        Self { file: file.into(), source, encoding: Encoding::Utf8, number: 0, bytes: Vec::new() }
    }

    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// The number of the last line, from 1.
    pub fn number(&self) -> usize {
        self.number
    }

    /// Appends the next line to `text`, with its line end and, in the first line, the byte order mark. Returns false at the
    /// end of the file.
    ///
    /// # Errors
    /// The file cannot be read, its bytes are not text, or its lines end with a carriage return alone.
    pub fn next(&mut self, text: &mut String) -> Result<bool, Diagnostic> {
        if self.number == 0 {
            let first = self.source.fill_buf().map_err(unreadable(&self.file))?;
            self.encoding = match first {
                [0xff, 0xfe, ..] | [_, 0, ..] => Encoding::Utf16Le,
                [0xfe, 0xff, ..] | [0, _, ..] => Encoding::Utf16Be,
                _ => Encoding::Utf8,
            };
        }
        self.bytes.clear();
        let read = match self.encoding {
            Encoding::Utf16Le | Encoding::Utf16Be => self.read_units(),
            Encoding::Utf8 | Encoding::Windows1252 => {
                self.source.read_until(b'\n', &mut self.bytes).map(|_| ())
            }
        };
        read.map_err(unreadable(&self.file))?;
        if self.bytes.is_empty() {
            return Ok(false);
        }
        self.number += 1;
        let encoding = self.encoding.name();
        self.decode(text).ok_or_else(|| {
            Diagnostic::line(&self.file, self.number, NotText { encoding: encoding.into() })
        })?;
        if self.number == 1 && text.trim_end_matches(['\r', '\n']).contains('\r') {
            return Err(Diagnostic::file(&self.file, CarriageReturns));
        }
        Ok(true)
    }

    /// Reads the bytes of a line of UTF-16, up to and including the two-byte line end.
    fn read_units(&mut self) -> std::io::Result<()> {
        loop {
            // The byte 0x0a may also be one half of another character.
            if self.source.read_until(b'\n', &mut self.bytes)? == 0 {
                return Ok(());
            }
            if self.encoding == Encoding::Utf16Le && self.bytes.len() % 2 == 1 {
                let mut high = [0];
                if std::io::Read::read(&mut self.source, &mut high)? == 1 {
                    self.bytes.push(high[0]);
                }
            }
            let end: [u8; 2] = if self.encoding == Encoding::Utf16Le { [b'\n', 0] } else { [0, b'\n'] };
            if self.bytes.len().is_multiple_of(2) && self.bytes.ends_with(&end) {
                return Ok(());
            }
        }
    }

    /// Appends the decoded bytes to `text`; `None` if they are not text.
    fn decode(&mut self, text: &mut String) -> Option<()> {
        let unit: fn([u8; 2]) -> u16 = match self.encoding {
            Encoding::Utf16Le => u16::from_le_bytes,
            Encoding::Utf16Be => u16::from_be_bytes,
            Encoding::Utf8 | Encoding::Windows1252 => {
                if self.bytes.contains(&0) {
                    return None;
                }
                match std::str::from_utf8(&self.bytes) {
                    Ok(line) => text.push_str(line),
                    Err(_) => {
                        self.encoding = Encoding::Windows1252;
                        for &byte in &self.bytes {
                            text.push(windows_1252(byte)?);
                        }
                    }
                }
                return Some(());
            }
        };
        if !self.bytes.len().is_multiple_of(2) {
            return None;
        }
        let units = self.bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
        for character in char::decode_utf16(units) {
            text.push(character.ok().filter(|character| *character != '\0')?);
        }
        Some(())
    }
}

/// The characters from 0x80 to 0x9f (unicode.org, VENDORS/MICSFT/WINDOWS/CP1252.TXT); a blank marks an unused code.
const CP1252: &str = "€ ‚ƒ„…†‡ˆ‰Š‹Œ Ž  ‘’“”•–—˜™š›œ žŸ";

fn windows_1252(byte: u8) -> Option<char> {
    match byte {
        0x80..=0x9f => CP1252.chars().nth(usize::from(byte - 0x80)).filter(|&character| character != ' '),
        _ => Some(char::from(byte)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The characters are those of Unicode's property Bidi_Control, and its line and paragraph separators.
    #[test]
    fn text_that_steers_a_terminal_is_escaped() {
        assert_eq!(escape_controls("ä 日本\tб\nעברית"), "ä 日本\tб\nעברית");
        assert_eq!(escape_controls("\u{1b}[2J\u{9b}\r\u{7f}"), "\\u001b[2J\\u009b\\u000d\\u007f");
        for steers in "\u{61c}\u{200e}\u{200f}\u{202a}\u{202b}\u{202c}\u{202d}\u{202e}\u{2066}\u{2067}\u{2068}\u{2069}\u{2028}\u{2029}".chars() {
            assert_eq!(escape_controls(&format!("a{steers}b")), format!("a\\u{:04x}b", u32::from(steers)));
        }
        // A joiner is part of words and of pictures.
        assert_eq!(escape_controls("\u{200d}\u{200c}"), "\u{200d}\u{200c}");
    }

    fn lines(bytes: &[u8]) -> Result<(Vec<String>, Encoding), Diagnostic> {
        let mut lines = LineReader::new("t", bytes);
        let (mut all, mut line) = (Vec::new(), String::new());
        while lines.next(&mut line)? {
            all.push(std::mem::take(&mut line));
        }
        Ok((all, lines.encoding()))
    }

    #[test]
    fn encoding_is_detected() {
        // U+010A and U+0A00 contain the byte 0x0a.
        let text = "\u{feff}a \u{10a}\u{a00}\r\nµ \u{1f600}\nend";
        let expected: Vec<&str> = text.split_inclusive('\n').collect();
        let le: Vec<u8> = text.encode_utf16().flat_map(u16::to_le_bytes).collect();
        let be: Vec<u8> = text.encode_utf16().flat_map(u16::to_be_bytes).collect();
        for (bytes, encoding) in
            [(text.as_bytes(), Encoding::Utf8), (&le, Encoding::Utf16Le), (&be, Encoding::Utf16Be)]
        {
            let (found, as_read) = lines(bytes).unwrap();
            assert_eq!(
                (found.iter().map(String::as_str).collect::<Vec<_>>(), as_read),
                (expected.clone(), encoding)
            );
        }
        // Without the mark.
        for (bytes, encoding) in [(&le[2..], Encoding::Utf16Le), (&be[2..], Encoding::Utf16Be)] {
            let (found, as_read) = lines(bytes).unwrap();
            assert_eq!((found.concat().as_str(), as_read), (&text[3..], encoding));
        }
        let (found, encoding) = lines(b"a\n\xb5m \x80 \xdf\n").unwrap();
        assert_eq!((found[1].as_str(), encoding), ("µm € ß\n", Encoding::Windows1252));
        for none in [&b"a\0b"[..], b"\xff\xfea", b"\xff\xfe\x00\xd8", b"\x81", b"a,b\r1,2\r"] {
            assert_eq!(lines(none).unwrap_err().code().as_str(), "E0103", "{none:?}");
        }
    }

    #[test]
    fn zeros_at_the_end_of_a_decimal_number_are_cut() {
        for (number, short) in [("1.500", "1.5"), ("2.000", "2"), ("100", "100"), ("0.010", "0.01")] {
            assert_eq!(without_end_zeros(number), short);
        }
    }
}

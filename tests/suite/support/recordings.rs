//! Recordings of both directions of a line: `fixtures/captures/*.rec`, readable text.

use std::path::PathBuf;

use dbbd_device::protocol::{CommandStep, DecodedItem, ProtocolDefinition};
use dbbd_model::measurement::sample::Sample;

/// An event on the line.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum What {
    /// The host sent these bytes.
    Host(Vec<u8>),
    /// The bar sent these bytes.
    Bar(Vec<u8>),
    /// The bar was unplugged.
    Unplugged,
}

/// A line of a recording.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Line {
    /// Time since the start of the recording, s.
    pub(crate) t_s: f64,
    pub(crate) what: What,
}

/// A recording.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Recording {
    /// Name of the file without its extension: the protocol, and the fault after a `+`.
    pub(crate) name: String,
    /// Description and origin, line by line.
    pub(crate) header: Vec<String>,
    /// Number of bytes of the bar's stream; those before answer the host's commands.
    pub(crate) stream: usize,
    pub(crate) lines: Vec<Line>,
}

pub(crate) fn directory() -> PathBuf {
    [env!("CARGO_MANIFEST_DIR"), "fixtures", "captures"].iter().collect()
}

/// All of them, by name.
pub(crate) fn all() -> Vec<Recording> {
    let files = std::fs::read_dir(directory()).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> =
        files.filter(|path| path.extension().is_some_and(|end| end == "rec")).collect();
    files.sort();
    let read = |path: PathBuf| {
        let name = path.file_stem().unwrap().to_str().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        Recording::parse(name, &text).unwrap_or_else(|line| panic!("{}:{line}", path.display()))
    };
    files.into_iter().map(read).collect()
}

impl Recording {
    pub(crate) fn protocol(&self) -> &str {
        self.name.split('+').next().unwrap()
    }

    pub(crate) fn definition(&self) -> ProtocolDefinition {
        ProtocolDefinition::by_name(self.protocol()).unwrap().unwrap()
    }

    /// The pieces of the bar's stream with their times.
    pub(crate) fn pieces(&self) -> Vec<(f64, Vec<u8>)> {
        let said = |line: &Line| match &line.what {
            What::Bar(bytes) => Some((line.t_s, bytes.clone())),
            _ => None,
        };
        let mut pieces: Vec<(f64, Vec<u8>)> = self.lines.iter().filter_map(said).collect();
        let total: usize = pieces.iter().map(|(_, bytes)| bytes.len()).sum();
        let mut answers = total - self.stream;
        for (_, bytes) in &mut pieces {
            let cut = answers.min(bytes.len());
            bytes.drain(..cut);
            answers -= cut;
        }
        pieces.retain(|(_, bytes)| !bytes.is_empty());
        pieces
    }

    /// The samples of the stream without offsets; `None` if a part of it is no sample, since a repair by
    /// chance would give
    /// others.
    pub(crate) fn samples(&self) -> Option<Vec<Sample>> {
        let (mut decoder, mut decoded) = (self.definition().decoder(), Vec::new());
        self.pieces().iter().for_each(|(_, bytes)| decoder.push(bytes, &mut decoded));
        decoder.interrupt(&mut decoded);
        let sample = |one: &DecodedItem| match one {
            DecodedItem::Sample(sample, _) => Some(Sample { offset: 0, ..*sample }),
            DecodedItem::Fault(_) => None,
        };
        decoded.iter().map(sample).collect()
    }

    /// Number of lines before the stream starts or is requested: commands and their answers.
    pub(crate) fn opening(&self) -> usize {
        let polls = self.definition().poll;
        let asks = |line: &Line| {
            let said = |step: &CommandStep| matches!((step, &line.what), (CommandStep::Send(a), What::Host(b)) if a == b);
            polls.iter().any(said)
        };
        let mut left = self.stream;
        let behind = self.lines.iter().rev().position(|line| {
            if let What::Bar(bytes) = &line.what {
                left = left.saturating_sub(bytes.len());
            }
            left == 0
        });
        let begins = self.lines.len() - behind.map_or(0, |behind| behind + 1);
        self.lines.iter().position(asks).unwrap_or(begins)
    }

    /// The error is the number of an invalid line.
    pub(crate) fn parse(name: &str, text: &str) -> Result<Self, usize> {
        let mut recording = Self { name: name.into(), ..Self::default() };
        for (line, number) in text.lines().zip(1usize..) {
            if let Some(remark) = line.strip_prefix('#') {
                recording.header.push(remark.trim().into());
            } else if let Some(stream) = line.strip_prefix("stream ") {
                recording.stream = stream.parse().map_err(|_| number)?;
            } else {
                recording.lines.push(parse_line(line).ok_or(number)?);
            }
        }
        Ok(recording)
    }

    pub(crate) fn text(&self) -> String {
        let header = self.header.iter().map(|line| format!("# {line}\n"));
        let lines = self.lines.iter().map(|Line { t_s, what }| match what {
            What::Host(bytes) => format!("{t_s:.4} > {}\n", show(bytes)),
            What::Bar(bytes) => format!("{t_s:.4} < {}\n", show(bytes)),
            What::Unplugged => format!("{t_s:.4} x\n"),
        });
        header.chain([format!("stream {}\n", self.stream)]).chain(lines).collect()
    }
}

/// Text in quotation marks, or hexadecimal digits.
fn show(bytes: &[u8]) -> String {
    let plain = |byte: &u8| matches!(byte, b' '..=b'~' | b'\r' | b'\n') && !matches!(byte, b'"' | b'\\');
    if bytes.iter().all(plain) {
        format!("{:?}", String::from_utf8_lossy(bytes))
    } else {
        bytes.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

fn parse_line(line: &str) -> Option<Line> {
    let (t_s, rest) = line.split_once(' ')?;
    let what = match rest.split_at(1) {
        (">", bytes) => What::Host(parse_bytes(bytes.trim())?),
        ("<", bytes) => What::Bar(parse_bytes(bytes.trim())?),
        ("x", "") => What::Unplugged,
        _ => return None,
    };
    Some(Line { t_s: t_s.parse().ok()?, what })
}

fn parse_bytes(text: &str) -> Option<Vec<u8>> {
    if let Some(quoted) = text.strip_prefix('"') {
        let text = quoted.strip_suffix('"')?;
        return Some(text.replace("\\r", "\r").replace("\\n", "\n").into_bytes());
    }
    let digits: Option<Vec<u8>> = text.chars().map(|c| Some(c.to_digit(16)? as u8)).collect();
    Some(digits?.chunks_exact(2).map(|pair| 16 * pair[0] + pair[1]).collect())
}

//! Reads a capture past every damage.

use super::format::{self, Found, HEADER_LEN, MAGIC};
use super::record::{Event, Record, Stamped};

/// What a capture holds, and what of it could not be read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Capture {
    /// The format's version by the file's header; none when the header is damaged.
    pub version: Option<u32>,
    /// The records that are whole, in order.
    pub records: Vec<Stamped>,
    /// What is between them.
    pub damages: Vec<Damage>,
}

/// Bytes of a capture that are no whole record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Offset in the file.
    pub offset: u64,
    /// How many bytes.
    pub bytes: u64,
    /// What is wrong with them.
    pub what: String,
}

impl Capture {
    /// Whether nothing in the file speaks of a capture.
    pub fn is_none(&self) -> bool {
        self.version.is_none() && self.records.is_empty()
    }

    /// Whether the file is of a version that this dbbd does not know.
    pub fn is_newer(&self) -> bool {
        self.version.is_some_and(|version| version > format::VERSION)
    }

    /// The events, in order.
    pub fn events(&self) -> impl Iterator<Item = &Event> {
        self.records.iter().filter_map(|stamped| match &stamped.record {
            Record::Event(event) => Some(event),
            _ => None,
        })
    }

    /// The content of an attachment, the last of that name.
    pub fn attachment(&self, wanted: &str) -> Option<&[u8]> {
        self.records.iter().rev().find_map(|stamped| match &stamped.record {
            Record::Attachment { name, content } if name == wanted => Some(&content[..]),
            _ => None,
        })
    }

    /// Whether the run ended as it should; one that was cut off has no such record.
    pub fn ended(&self) -> bool {
        self.events().any(|event| matches!(event, Event::Ended { .. }))
    }
}

/// Reads the bytes of a capture. Whole records are found again after each damage; no bytes make it fail.
pub fn read(bytes: &[u8]) -> Capture {
    let mut capture = Capture { version: format::version(bytes), ..Capture::default() };
    let mut at = if capture.version.is_some() { HEADER_LEN } else { 0 };
    while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
        match format::decode(rest) {
            Found::Whole(stamped, len) => {
                capture.records.push(stamped);
                at += len;
            }
            found => {
                let len = damaged(rest, &found);
                let what = describe(&found, at, len == rest.len());
                capture.damages.push(Damage { offset: at as u64, bytes: len as u64, what });
                at += len;
            }
        }
    }
    capture
}

/// How many bytes from a damage to the next whole record, or to the end.
fn damaged(rest: &[u8], found: &Found) -> usize {
    // What is understood to its end is passed over whole.
    if let Found::Strange(_, len) = found {
        return *len;
    }
    let mut from = 1;
    while let Some(next) = rest.get(from..).and_then(|tail| position(tail, &MAGIC)) {
        if matches!(format::decode(&rest[from + next..]), Found::Whole(..) | Found::Strange(..)) {
            return from + next;
        }
        from += next + 1;
    }
    rest.len()
}

fn position(bytes: &[u8], wanted: &[u8]) -> Option<usize> {
    bytes.windows(wanted.len()).position(|window| window == wanted)
}

fn describe(found: &Found, at: usize, to_the_end: bool) -> String {
    match found {
        Found::Strange(kind, len) => {
            format!("a record of {len} bytes and kind {kind} whose content is not understood")
        }
        Found::Broken(kind, len) => {
            format!("the checksum of a record of {len} bytes ({}) is wrong", format::kind_name(*kind))
        }
        Found::Short(kind, len) if to_the_end => {
            format!("torn tail: the file ends inside a record of {len} bytes ({})", format::kind_name(*kind))
        }
        Found::Stub if to_the_end => "torn tail: the file ends inside the head of a record".into(),
        Found::Short(kind, _) => format!("the length of a record ({}) is wrong", format::kind_name(*kind)),
        _ if at == 0 => "the file's header is damaged".into(),
        _ => "no record begins here".into(),
    }
}

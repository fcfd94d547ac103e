//! Faults of the decoder: they account for every byte outside of samples.

use serde::{Deserialize, Serialize};

/// Bytes that did not become a sample, and why.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LineFault {
    pub kind: LineFaultKind,
    /// Offset of the first byte in the stream.
    pub offset: u64,
    pub bytes: u64,
    /// Number of adjacent faults of this kind.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub count: u64,
}

fn one() -> u64 {
    1
}

fn is_one(count: &u64) -> bool {
    *count == 1
}

impl LineFault {
    /// Merges the next fault if it is adjacent and of the same kind, else returns it.
    pub fn join(&mut self, next: LineFault) -> Option<LineFault> {
        if next.kind != self.kind || next.offset != self.offset + self.bytes {
            return Some(next);
        }
        self.bytes += next.bytes;
        self.count += next.count;
        None
    }
}

/// Why bytes did not become a sample.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LineFaultKind {
    /// Not a frame of this protocol.
    Framing,
    /// A frame whose check does not match.
    Check,
    /// A frame that is longer than the protocol allows.
    TooLong,
    /// A frame with an intact check whose content has no meaning here.
    Content,
    /// A reading with another number of decimals than before or than the device shows in the unit of the definition.
    OtherUnit,
    /// The device reported that it has no reading, in its own words.
    Reject(String),
    /// An echo, a banner or another record that the definition ignores.
    Ignored,
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(kind: LineFaultKind, offset: u64, bytes: u64) -> LineFault {
        LineFault { kind, offset, bytes, count: 1 }
    }

    #[test]
    fn adjacent_faults_of_one_kind_are_one() {
        let mut first = fault(LineFaultKind::Check, 10, 4);
        assert_eq!(first.join(fault(LineFaultKind::Check, 14, 3)), None);
        assert_eq!(first, LineFault { bytes: 7, count: 2, ..fault(LineFaultKind::Check, 10, 0) });
        let apart = fault(LineFaultKind::Check, 18, 3);
        assert_eq!(first.join(apart.clone()), Some(apart));
        let other = fault(LineFaultKind::Framing, 17, 3);
        assert_eq!(first.join(other.clone()), Some(other));
        assert_eq!((first.bytes, first.count), (7, 2));
    }

    #[test]
    fn single_fault_has_no_count_in_a_file() {
        let text = serde_json::to_string(&fault(LineFaultKind::TooLong, 1, 2)).unwrap();
        assert_eq!(text, r#"{"kind":"too_long","offset":1,"bytes":2}"#);
        assert_eq!(serde_json::from_str::<LineFault>(&text).unwrap().count, 1);
    }
}

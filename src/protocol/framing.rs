//! Cuts a stream into frames and takes a frame's wrapping off.

/// How frames are told apart.
#[derive(Clone, Debug)]
pub(super) enum Framing {
    /// Consistent overhead byte stuffing (Cheshire and Baker, IEEE/ACM Trans. Networking 7(2), 1999).
    Cobs {
        /// Ends a frame and occurs nowhere in it; the stuffed bytes are XORed with it.
        delimiter: u8,
        /// Longest frame, bytes, with the delimiter.
        max_len: usize,
    },
    /// Lines of text.
    Line {
        /// The character that begins a line, where there is one.
        start: Option<u8>,
        /// What ends a line; longer ends first.
        ends: Vec<Vec<u8>>,
        /// Longest line, bytes, with start and end.
        max_len: usize,
    },
}

impl Framing {
    /// Longest frame, bytes, with all its wrapping.
    pub(super) fn max_len(&self) -> usize {
        match self {
            Framing::Cobs { max_len, .. } | Framing::Line { max_len, .. } => *max_len,
        }
    }

    /// Whether the bytes so far are complete: they end a frame.
    pub(super) fn complete(&self, pending: &[u8]) -> bool {
        match self {
            Framing::Cobs { delimiter, .. } => pending.last() == Some(delimiter),
            Framing::Line { ends, .. } => ends.iter().any(|end| pending.ends_with(end)),
        }
    }

    /// What a complete frame carries; none when it is malformed.
    pub(super) fn unwrap(&self, frame: &[u8]) -> Option<Vec<u8>> {
        match self {
            Framing::Cobs { delimiter, .. } => uncobs(frame.strip_suffix(&[*delimiter])?, *delimiter),
            Framing::Line { start, .. } => {
                let body = self.without_end(frame);
                match start {
                    Some(start) => body.strip_prefix(&[*start]).map(<[u8]>::to_vec),
                    None => Some(body.to_vec()),
                }
            }
        }
    }

    /// Whether a complete frame is nothing but its end.
    pub(super) fn empty(&self, frame: &[u8]) -> bool {
        match self {
            Framing::Cobs { .. } => frame.len() == 1,
            Framing::Line { .. } => self.without_end(frame).is_empty(),
        }
    }

    /// Whether a frame may begin at the first of these bytes, after a bad start.
    pub(super) fn may_begin(&self, rest: &[u8], checked: bool) -> bool {
        match self {
            // Only a check can tell a frame from the tail of another.
            Framing::Cobs { .. } => checked && rest.len() > 1,
            Framing::Line { start, .. } => start.is_some() && rest.first() == start.as_ref(),
        }
    }

    /// Wraps content into a frame.
    pub(super) fn wrap(&self, body: &[u8]) -> Vec<u8> {
        match self {
            Framing::Cobs { delimiter, .. } => {
                let mut frame = cobs(body, *delimiter);
                frame.push(*delimiter);
                frame
            }
            Framing::Line { start, ends, .. } => {
                let mut frame: Vec<u8> = start.iter().copied().collect();
                frame.extend_from_slice(body);
                frame.extend(ends.first().into_iter().flatten());
                frame
            }
        }
    }

    fn without_end<'a>(&self, frame: &'a [u8]) -> &'a [u8] {
        match self {
            Framing::Cobs { .. } => frame,
            Framing::Line { ends, .. } => {
                ends.iter().find_map(|end| frame.strip_suffix(&end[..])).unwrap_or(frame)
            }
        }
    }
}

/// Undoes byte stuffing: each block is a code byte n, then n - 1 bytes, then a zero unless n is 255
/// or the block is the last.
fn uncobs(mut stuffed: &[u8], delimiter: u8) -> Option<Vec<u8>> {
    let mut body = Vec::with_capacity(stuffed.len());
    while let Some((code, rest)) = stuffed.split_first() {
        let code = code ^ delimiter;
        let (block, tail) = rest.split_at_checked(usize::from(code.checked_sub(1)?))?;
        body.extend(block.iter().map(|byte| byte ^ delimiter));
        if code < 255 && !tail.is_empty() {
            body.push(0);
        }
        stuffed = tail;
    }
    (!body.is_empty()).then_some(body)
}

fn cobs(body: &[u8], delimiter: u8) -> Vec<u8> {
    let mut stuffed = Vec::with_capacity(body.len() + body.len() / 254 + 1);
    let mut zero_ended = true;
    let mut rest = body;
    while zero_ended || !rest.is_empty() {
        let run = rest.iter().take(254).take_while(|byte| **byte != 0).count();
        let (block, tail) = rest.split_at(run);
        stuffed.push(u8::try_from(run + 1).unwrap_or(u8::MAX));
        stuffed.extend_from_slice(block);
        // A full block has no zero of its own.
        zero_ended = run < 254 && !tail.is_empty();
        rest = if zero_ended { &tail[1..] } else { tail };
    }
    stuffed.iter_mut().for_each(|byte| *byte ^= delimiter);
    stuffed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn stuffing_is_undone(body in prop::collection::vec(prop_oneof![Just(0u8), any::<u8>()], 1..600), delimiter: u8) {
            let stuffed = cobs(&body, delimiter);
            prop_assert!(!stuffed.contains(&delimiter));
            prop_assert_eq!(uncobs(&stuffed, delimiter), Some(body));
        }
    }

    /// The worked examples of the paper's method: blocks of 254 bytes need no zero of their own.
    #[test]
    fn long_runs_are_split_after_254_bytes() {
        assert_eq!(cobs(&[0], 0), [1, 1]);
        assert_eq!(cobs(&[0x11, 0x22, 0, 0x33], 0), [3, 0x11, 0x22, 2, 0x33]);
        let long = vec![7u8; 254];
        let stuffed = cobs(&long, 0);
        assert_eq!((stuffed.len(), stuffed[0]), (255, 255));
    }
}

//! The telegrams of a program that reports its dwells over EthernetKRL.
//!
//! `<Dbb><Pt Run="..." Id="..." Ph="..."/><Ax A1="..." .. A6="..."/></Dbb>`, without a length before it or a
//! terminator behind it. TCP may split the stream anywhere, so bytes are processed one at a time: the telegrams do
//! not depend on the splits. Bytes outside of telegrams are counted and skipped.

use std::collections::BTreeMap;

use crate::recording::RecordingFinding as Finding;
use dbbd_device::axes::{MAX_AXIS_DEG, rsi};
use dbbd_model::robot::AXES;

/// A telegram, which the controller sends at the start and at the end of a dwell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Telegram {
    /// Number of the plan that the program was made from ([`crate::program::krl::run_number`]).
    pub run: u32,
    /// Index of the pose in the plan.
    pub index: u32,
    /// 1 at the start of the dwell, 2 at its end.
    pub phase: u8,
    /// Measured axis angles, degrees.
    pub axes_deg: [f64; AXES],
}

#[derive(Clone, Debug, PartialEq)]
pub enum TelegramResult {
    Telegram(Telegram),
    /// A complete element `<Dbb>..</Dbb>` that is no telegram.
    Malformed(Finding),
}

/// Extracts telegrams from a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct TelegramReader {
    /// Bytes that begin like a telegram.
    pending: Vec<u8>,
    skipped: u64,
}

/// Longest telegram; longer ones are dropped, so that memory stays bounded.
pub const LONGEST_TELEGRAM: usize = 4096;
const BEGIN: &[u8] = b"<Dbb";

impl TelegramReader {
    pub fn push(&mut self, bytes: &[u8]) -> Vec<TelegramResult> {
        bytes.iter().filter_map(|byte| self.byte(*byte)).collect()
    }

    /// Number of bytes of an unfinished telegram.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Number of bytes outside of telegrams; white space does not count.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    fn byte(&mut self, byte: u8) -> Option<TelegramResult> {
        if self.pending.is_empty() && byte != b'<' {
            self.skipped += u64::from(!byte.is_ascii_whitespace());
            return None;
        }
        self.pending.push(byte);
        let len = self.pending.len();
        if byte == b'<' && len <= BEGIN.len() + 1 {
            self.keep(1);
        } else if len <= BEGIN.len() && !BEGIN.starts_with(&self.pending)
            || len == BEGIN.len() + 1 && !after_name(byte)
        {
            self.keep(0);
        } else if len > LONGEST_TELEGRAM {
            let tag = self.pending.iter().rposition(|byte| *byte == b'<').unwrap_or(len);
            let begins = BEGIN.starts_with(&self.pending[tag..]) || starts(&self.pending[tag..]);
            self.keep(if begins { len - tag } else { 0 });
        } else if len > BEGIN.len() && starts(&self.pending[len - BEGIN.len() - 1..]) {
            // The telegram before was cut off.
            self.keep(BEGIN.len() + 1);
        } else if byte == b'>' && ends(&self.pending) {
            let bytes = std::mem::take(&mut self.pending);
            return Some(
                match std::str::from_utf8(&bytes)
                    .map_err(|_| Finding::TelegramNotUtf8)
                    .and_then(read_telegram)
                {
                    Ok(telegram) => TelegramResult::Telegram(telegram),
                    Err(why) => TelegramResult::Malformed(why),
                },
            );
        }
        None
    }

    /// Drops all pending bytes except the last ones.
    fn keep(&mut self, last: usize) {
        let dropped = self.pending.len().saturating_sub(last);
        self.pending.drain(..dropped);
        self.skipped += dropped as u64;
    }
}

/// Whether the bytes are the name of a telegram and a byte that ends it.
fn starts(bytes: &[u8]) -> bool {
    matches!(bytes, [name @ .., after] if name == BEGIN && after_name(*after))
}

/// Whether this byte ends the name of an element.
fn after_name(byte: u8) -> bool {
    byte.is_ascii_whitespace() || matches!(byte, b'>' | b'/')
}

/// Whether the last tag closes the telegram.
fn ends(bytes: &[u8]) -> bool {
    let Some(at) = bytes.iter().rposition(|byte| *byte == b'<') else { return false };
    let tag = bytes[at..].trim_ascii_end();
    let name = tag.strip_suffix(b">").map(<[u8]>::trim_ascii_end);
    name.is_some_and(|name| name == b"</Dbb") || at == 0 && tag.ends_with(b"/>")
}

/// Values of the attributes by element and name.
struct AttributeValues<'a>(BTreeMap<(&'a str, &'a str), &'a str>);

impl<'a> AttributeValues<'a> {
    fn of(text: &'a str) -> Result<Self, Finding> {
        let mut values = BTreeMap::new();
        for tag in text.split('<').skip(1) {
            let inside = tag.split_once('>').ok_or(Finding::TelegramTagOpen)?.0;
            let inside = inside.strip_suffix('/').unwrap_or(inside);
            let (element, mut rest) = inside.split_once(char::is_whitespace).unwrap_or((inside, ""));
            while let Some((name, after)) = rest.split_once('=') {
                let (name, after) = (name.trim(), after.trim_start());
                let quote = after.chars().next().filter(|quote| matches!(quote, '"' | '\''));
                let quoted = quote.and_then(|quote| after.get(1..)?.split_once(quote));
                let (value, next) = quoted.ok_or_else(|| Finding::TelegramNotQuoted {
                    element: element.into(),
                    name: name.into(),
                })?;
                values.insert((element, name), value.trim());
                rest = next;
            }
        }
        Ok(Self(values))
    }

    fn text(&self, element: &str, name: &str) -> Result<&'a str, Finding> {
        let lacks = || Finding::TelegramLacks { element: element.into(), name: name.into() };
        self.0.get(&(element, name)).copied().ok_or_else(lacks)
    }

    fn whole(&self, name: &str) -> Result<u32, Finding> {
        let text = self.text("Pt", name)?;
        text.parse().map_err(|_| Finding::TelegramNotWhole { name: name.into(), value: text.into() })
    }

    fn angle_deg(&self, name: &str) -> Result<f64, Finding> {
        let text = self.text("Ax", name)?;
        let degrees = text.parse::<f64>().ok().filter(|degrees| degrees.abs() <= MAX_AXIS_DEG);
        degrees.ok_or_else(|| Finding::TelegramNotAngle { name: name.into(), value: text.into() })
    }
}

fn read_telegram(text: &str) -> Result<Telegram, Finding> {
    let values = AttributeValues::of(text)?;
    let mut axes_deg = [0.0; AXES];
    for (axis, name) in axes_deg.iter_mut().zip(rsi::AXIS_NAMES) {
        *axis = values.angle_deg(name)?;
    }
    let phase = match values.whole("Ph")? {
        1 => 1,
        2 => 2,
        phase => return Err(Finding::TelegramPhase { phase }),
    };
    Ok(Telegram { run: values.whole("Run")?, index: values.whole("Id")?, phase, axes_deg })
}

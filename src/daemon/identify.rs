//! First contact with a bar: what comes over a line, and which definition explains it.

use std::time::Duration;

use serde::Serialize;

use super::session;
use crate::base::clock;
use crate::catalogue::PortFinding::{self, BarSilent};
use crate::device::port::{LineSettings, Port, PortAddress, Transport};
use crate::device::protocol::{Definition, Evidence, Mode};

/// A board that restarts when its line is opened sends after this at the latest, s.
const WAKE_S: f64 = 2.5;
/// How long a rate is listened to before it is given up, s.
const SNIFF_S: f64 = 0.5;
/// How long a device that was asked may take to say something, s.
const ANSWER_S: f64 = 0.7;
const SLICE: Duration = Duration::from_millis(50);

/// What is to be found out.
pub struct Search<'a> {
    pub port: &'a PortAddress,
    pub definitions: &'a [Definition],
    /// How long bytes are gathered, s.
    pub span_s: f64,
    /// Whether a bar that says nothing by itself is asked, in the words of each definition.
    pub asks: bool,
}

/// What was heard with one setting of the line.
#[derive(Clone, Debug, Serialize)]
pub struct Attempt {
    /// The definition whose commands were sent; none where the line was only listened to.
    pub asked: Option<String>,
    /// The line's rate; none where it has none.
    pub baud: Option<u32>,
    pub bytes: usize,
    /// The best definition first; those that explain nothing are left out.
    pub ranked: Vec<Evidence>,
}

impl Attempt {
    /// The definition that explains the bytes.
    pub fn found(&self) -> Option<&Evidence> {
        self.ranked.first().filter(|evidence| evidence.is_enough())
    }
}

impl Search<'_> {
    /// Listens at each rate of the definitions, then asks; ends as soon as the bytes are explained.
    ///
    /// # Errors
    /// When the line cannot be opened or goes away.
    pub fn attempts(&self, mut say: impl FnMut(&Attempt)) -> Result<Vec<Attempt>, PortFinding> {
        let mut attempts = Vec::new();
        let mut patience_s = WAKE_S;
        for line in self.lines() {
            let (attempt, waited_s, has_rate) = self.listen(&line, patience_s)?;
            say(&attempt);
            let (silent, done) = (attempt.bytes == 0, attempt.found().is_some());
            attempts.push(attempt);
            // What sends is heard at any rate.
            if done || silent || !has_rate {
                break;
            }
            patience_s = waited_s + SNIFF_S;
        }
        let heard = attempts.iter().any(|attempt| attempt.bytes > 0);
        let speaks = |definition: &&Definition| !(definition.poll.is_empty() && definition.start.is_empty());
        for definition in self.definitions.iter().filter(speaks).filter(|_| self.asks && !heard) {
            let attempt = self.ask(definition)?;
            say(&attempt);
            let done = attempt.found().is_some();
            attempts.push(attempt);
            if done {
                break;
            }
        }
        Ok(attempts)
    }

    /// The settings of the line that the definitions have, each once.
    fn lines(&self) -> Vec<LineSettings> {
        let mut lines: Vec<LineSettings> = Vec::new();
        for Definition { line, .. } in self.definitions {
            for baud in std::iter::once(line.baud).chain(line.baud_probe.iter().copied()) {
                let same = |other: &LineSettings| {
                    (other.baud, other.data_bits, other.parity, other.stop_bits)
                        == (baud, line.data_bits, line.parity, line.stop_bits)
                };
                if !lines.iter().any(same) {
                    let mut other = line.clone();
                    other.baud = baud;
                    lines.push(other);
                }
            }
        }
        lines
    }

    /// Listens until something has come, and on if it may be a bar; how long the first byte took, s, and whether the line
    /// has a rate.
    fn listen(&self, line: &LineSettings, patience_s: f64) -> Result<(Attempt, f64, bool), PortFinding> {
        let mut port = Port::open(self.port, line)?;
        let has_rate = matches!(port.stamps().transport, Transport::Tty | Transport::Rfc2217);
        let began = clock::now();
        let mut bytes = Vec::new();
        while bytes.is_empty() && clock::now().seconds_since(began) < patience_s {
            bytes = port.listen(SLICE, &[])?;
        }
        let waited_s = clock::now().seconds_since(began);
        let baud = has_rate.then_some(line.baud);
        if bytes.is_empty() {
            return Ok((Attempt { asked: None, baud, bytes: 0, ranked: Vec::new() }, waited_s, has_rate));
        }
        bytes.extend(port.listen(Duration::from_secs_f64(SNIFF_S.min(self.span_s)), &[])?);
        let promising =
            !has_rate || Evidence::ranked(self.definitions, &bytes).iter().any(|one| one.explained > 0.5);
        if promising && self.span_s > SNIFF_S {
            bytes.extend(port.listen(Duration::from_secs_f64(self.span_s - SNIFF_S), &[])?);
        }
        Ok((self.attempt(None, baud, &bytes), waited_s, has_rate))
    }

    /// Starts or polls the bar as a definition has it.
    fn ask(&self, definition: &Definition) -> Result<Attempt, PortFinding> {
        let asked = Some(definition.id.clone());
        let opened = match session::open(self.port, definition) {
            Ok(opened) => opened,
            Err(BarSilent { .. }) => {
                return Ok(Attempt { asked, baud: Some(definition.line.baud), bytes: 0, ranked: Vec::new() });
            }
            Err(error) => return Err(error),
        };
        let (mut port, mut bytes) = (opened.port, opened.first);
        let period = match definition.mode {
            Mode::Poll { hz, .. } => Duration::from_secs_f64(1.0 / hz),
            Mode::Stream | Mode::Push => SLICE,
        };
        let began = clock::now();
        loop {
            let passed_s = clock::now().seconds_since(began);
            if passed_s >= self.span_s || (bytes.is_empty() && passed_s >= ANSWER_S) {
                break;
            }
            session::ask(&mut port, definition)?;
            bytes.extend(port.listen(period, &[])?);
        }
        session::close(port, definition);
        Ok(self.attempt(asked, Some(definition.line.baud), &bytes))
    }

    fn attempt(&self, asked: Option<String>, baud: Option<u32>, bytes: &[u8]) -> Attempt {
        let mut ranked = Evidence::ranked(self.definitions, bytes);
        ranked.retain(|evidence| evidence.samples > 0);
        Attempt { asked, baud, bytes: bytes.len(), ranked }
    }
}

//! Identification of the protocol of a bar: which definition explains the bytes on its line.

use std::time::Duration;

use serde::Serialize;

use super::session;
use dbbd_device::clock;
use dbbd_device::port::PortFinding::{self, BarSilent};
use dbbd_device::port::{LineSettings, LineTransport, Port, PortAddress};
use dbbd_device::protocol::{ProtocolDefinition, ProtocolEvidence, ProtocolMode};

/// Longest start of a board that resets when its line is opened, s.
const WAKE_S: f64 = 2.5;
/// Listening time per baud rate, s.
const SNIFF_S: f64 = 0.5;
/// Timeout for an answer to a request, s.
const ANSWER_S: f64 = 0.7;
const SLICE: Duration = Duration::from_millis(50);

pub struct ProtocolSearch<'a> {
    pub port: &'a PortAddress,
    pub definitions: &'a [ProtocolDefinition],
    /// Time for which bytes are collected.
    pub span_s: f64,
    /// Whether the commands of each definition are sent to a silent bar.
    pub asks: bool,
}

/// The bytes received with one setting of the line.
#[derive(Clone, Debug, Serialize)]
pub struct ProbeAttempt {
    /// The definition whose commands were sent; `None` if nothing was sent.
    pub asked: Option<String>,
    /// Baud rate; `None` for a line without one.
    pub baud: Option<u32>,
    pub bytes: usize,
    /// The definitions that explain some bytes, the best first.
    pub ranked: Vec<ProtocolEvidence>,
}

impl ProbeAttempt {
    /// The identified definition.
    pub fn found(&self) -> Option<&ProtocolEvidence> {
        self.ranked.first().filter(|evidence| evidence.is_enough())
    }
}

impl ProtocolSearch<'_> {
    /// Listens at each baud rate of the definitions, then sends their commands, until the bytes are explained. `report`
    /// is called after each attempt.
    pub fn attempts(&self, mut report: impl FnMut(&ProbeAttempt)) -> Result<Vec<ProbeAttempt>, PortFinding> {
        let mut attempts = Vec::new();
        let mut patience_s = WAKE_S;
        for line in self.lines() {
            let (attempt, waited_s) = self.listen(&line, patience_s)?;
            report(&attempt);
            // A bar that sends is received at any rate, though as garbage.
            let last = attempt.bytes == 0 || attempt.found().is_some() || attempt.baud.is_none();
            attempts.push(attempt);
            if last {
                break;
            }
            patience_s = waited_s + SNIFF_S;
        }
        let heard = attempts.iter().any(|attempt| attempt.bytes > 0);
        let speaks =
            |definition: &&ProtocolDefinition| !(definition.poll.is_empty() && definition.start.is_empty());
        for definition in self.definitions.iter().filter(speaks).filter(|_| self.asks && !heard) {
            let attempt = self.ask(definition)?;
            report(&attempt);
            let done = attempt.found().is_some();
            attempts.push(attempt);
            if done {
                break;
            }
        }
        Ok(attempts)
    }

    /// The distinct line settings of the definitions.
    fn lines(&self) -> Vec<LineSettings> {
        let mut lines: Vec<LineSettings> = Vec::new();
        for ProtocolDefinition { line, .. } in self.definitions {
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

    /// Waits for the first byte, and listens longer if a bar may have sent the bytes. Also returns the time until the
    /// first byte, s.
    fn listen(&self, line: &LineSettings, patience_s: f64) -> Result<(ProbeAttempt, f64), PortFinding> {
        let mut port = Port::open(self.port, line)?;
        let has_rate = matches!(port.stamps().transport, LineTransport::Tty | LineTransport::Rfc2217);
        let began = clock::now();
        let mut bytes = Vec::new();
        while bytes.is_empty() && clock::now().seconds_since(began) < patience_s {
            bytes = port.listen(SLICE, &[])?;
        }
        let waited_s = clock::now().seconds_since(began);
        let baud = has_rate.then_some(line.baud);
        if bytes.is_empty() {
            return Ok((self.attempt(None, baud, &[]), waited_s));
        }
        bytes.extend(port.listen(Duration::from_secs_f64(SNIFF_S.min(self.span_s)), &[])?);
        let promising = !has_rate
            || ProtocolEvidence::ranked(self.definitions, &bytes).iter().any(|one| one.explained > 0.5);
        if promising && self.span_s > SNIFF_S {
            bytes.extend(port.listen(Duration::from_secs_f64(self.span_s - SNIFF_S), &[])?);
        }
        Ok((self.attempt(None, baud, &bytes), waited_s))
    }

    /// Starts or polls the bar with the commands of a definition.
    fn ask(&self, definition: &ProtocolDefinition) -> Result<ProbeAttempt, PortFinding> {
        let asked = Some(definition.id.clone());
        let baud = Some(definition.line.baud);
        let (mut port, mut bytes) = match session::open_bar(self.port, definition) {
            Ok(opened) => (opened.port, opened.first),
            Err(BarSilent { .. }) => return Ok(self.attempt(asked, baud, &[])),
            Err(error) => return Err(error),
        };
        let period = match definition.mode {
            ProtocolMode::Poll { hz, .. } => Duration::from_secs_f64(1.0 / hz),
            ProtocolMode::Stream | ProtocolMode::Push => SLICE,
        };
        let began = clock::now();
        loop {
            let passed_s = clock::now().seconds_since(began);
            if passed_s >= self.span_s || (bytes.is_empty() && passed_s >= ANSWER_S) {
                break;
            }
            session::request_reading(&mut port, definition)?;
            bytes.extend(port.listen(period, &[])?);
        }
        session::close(port, definition);
        Ok(self.attempt(asked, baud, &bytes))
    }

    fn attempt(&self, asked: Option<String>, baud: Option<u32>, bytes: &[u8]) -> ProbeAttempt {
        let mut ranked = ProtocolEvidence::ranked(self.definitions, bytes);
        ranked.retain(|evidence| evidence.samples > 0);
        ProbeAttempt { asked, baud, bytes: bytes.len(), ranked }
    }
}

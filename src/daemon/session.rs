//! The bar on its line: opening, start and stop commands, polling.

use std::time::Duration;

use super::OpenedBar;
use super::recorder::Recorder;
use dbbd_device::clock;
use dbbd_device::port::PortFinding::{self, BarSilent};
use dbbd_device::port::{Port, PortAddress};
use dbbd_device::protocol::{CommandStep, ProtocolDefinition};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;

/// Opens the line, stops the bar (it may still send from an earlier run) and starts it.
pub(super) fn open_bar(
    address: &PortAddress,
    definition: &ProtocolDefinition,
) -> Result<OpenedBar, PortFinding> {
    let began = clock::now();
    let (mut port, stale) = open_stopped(address, definition)?;
    perform(&mut port, &definition.init)?;
    let first = perform(&mut port, &definition.start)?.rest;
    Ok(OpenedBar { port, began, stale, first })
}

/// Sets the bar's present reading to zero.
pub fn zero_bar(address: &PortAddress, definition: &ProtocolDefinition) -> Result<(), PortFinding> {
    let (mut port, _) = open_stopped(address, definition)?;
    let received = perform(&mut port, &definition.zero)?;
    if received.answered {
        Ok(())
    } else {
        Err(BarSilent { port: address.to_string(), bauds: definition.line.baud.to_string() })
    }
}

/// Opens the line and stops the bar. Also returns the number of discarded bytes of an earlier stream.
fn open_stopped(address: &PortAddress, definition: &ProtocolDefinition) -> Result<(Port, u64), PortFinding> {
    let mut port = Port::open(address, &definition.line)?;
    clock::sleep(definition.line.settle.as_secs_f64());
    let mut stale = find_rate(&mut port, address, definition)?;
    stale += perform(&mut port, &definition.stop)?.count();
    if definition.stop.is_empty() {
        stale += port.drain(Duration::from_millis(1))?;
    }
    Ok((port, stale))
}

/// Tries the baud rates of the definition until the bar answers. Returns the number of discarded bytes.
fn find_rate(
    port: &mut Port,
    address: &PortAddress,
    definition: &ProtocolDefinition,
) -> Result<u64, PortFinding> {
    let mut discarded = 0;
    if definition.ident.is_empty() {
        return Ok(discarded);
    }
    let rates: Vec<u32> =
        std::iter::once(definition.line.baud).chain(definition.line.baud_probe.iter().copied()).collect();
    for baud in &rates {
        port.set_baud(*baud)?;
        let received = perform(port, &definition.ident)?;
        let answered = received.answered;
        discarded += received.count();
        if answered {
            return Ok(discarded);
        }
    }
    let bauds = rates.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
    Err(BarSilent { port: address.to_string(), bauds })
}

/// Stops the bar. An absent bar needs no stop.
pub(super) fn close(mut port: Port, definition: &ProtocolDefinition) {
    let _ = perform(&mut port, &definition.stop);
}

/// Requests a reading.
pub(super) fn request_reading(port: &mut Port, definition: &ProtocolDefinition) -> Result<(), PortFinding> {
    perform(port, &definition.poll).map(drop)
}

/// Polls a device: one request at a time.
pub(super) struct BarPolling {
    port: Port,
    period_s: f64,
    timeout_s: f64,
    /// Time of the request that is not answered yet.
    pending: Option<HostNs>,
    last: Option<HostNs>,
}

impl BarPolling {
    pub(super) fn new(port: Port, hz: f64, timeout: Duration) -> Self {
        Self { port, period_s: 1.0 / hz, timeout_s: timeout.as_secs_f64(), pending: None, last: None }
    }

    pub(super) fn answered(&mut self) {
        self.pending = None;
    }

    /// Sends a request if one is due, and returns the time until the next step. The inner error means that the port is
    /// gone.
    pub(super) fn step(
        &mut self,
        definition: &ProtocolDefinition,
        recorder: &mut Recorder,
    ) -> Result<Result<Duration, PortFinding>, Diagnostic> {
        let now = clock::now();
        let left = |since: HostNs, span: f64| span - now.seconds_since(since);
        let wait = match (self.pending, self.last) {
            (Some(asked), _) if left(asked, self.timeout_s) > 0.0 => left(asked, self.timeout_s),
            (None, Some(last)) if left(last, self.period_s) > 0.0 => left(last, self.period_s),
            (unanswered, _) => {
                if unanswered.is_some() {
                    recorder.unanswered(now)?;
                }
                recorder.requested(clock::now());
                if let Err(gone) = request_reading(&mut self.port, definition) {
                    return Ok(Err(gone));
                }
                (self.pending, self.last) = (Some(now), Some(now));
                self.timeout_s.min(self.period_s)
            }
        };
        Ok(Ok(Duration::from_secs_f64(wait.clamp(0.0, 1.0))))
    }
}

/// The bytes received while a command was performed.
struct CommandReply {
    /// Discarded bytes and answers.
    drained: u64,
    /// Bytes after the last answer.
    rest: Vec<u8>,
    /// Whether every step was answered.
    answered: bool,
}

impl CommandReply {
    fn count(self) -> u64 {
        self.drained + self.rest.len() as u64
    }
}

/// Performs the steps of a command. A missing answer is not an error: the caller sees whether the device sends.
fn perform(port: &mut Port, steps: &[CommandStep]) -> Result<CommandReply, PortFinding> {
    let mut received = CommandReply { drained: 0, rest: Vec::new(), answered: true };
    for step in steps {
        match step {
            CommandStep::Send(bytes) => port.send(bytes)?,
            CommandStep::Ask { send, expect, timeout, retries } => {
                let mut answered = false;
                for _ in 0..=*retries {
                    port.send(send)?;
                    received.drained += std::mem::take(&mut received.rest).len() as u64;
                    let mut answer = port.listen(*timeout, expect)?;
                    let place = answer.windows(expect.len().max(1)).position(|part| part == &expect[..]);
                    answered = place.is_some();
                    received.rest = answer.split_off(place.map_or(answer.len(), |at| at + expect.len()));
                    received.drained += answer.len() as u64;
                    if answered {
                        break;
                    }
                }
                received.answered &= answered;
            }
            CommandStep::DtrPulse(duration) => port.pulse_dtr(*duration)?,
            CommandStep::Wait(duration) => clock::sleep(duration.as_secs_f64()),
            CommandStep::Drain(quiet) => {
                received.drained += port.drain(*quiet)? + std::mem::take(&mut received.rest).len() as u64;
            }
        }
    }
    Ok(received)
}

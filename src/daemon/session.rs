//! The bar on its line: opening it, its start and stop commands.

use std::time::Duration;

use crate::base::clock;
use crate::base::units::HostNs;
use crate::catalogue::PortFinding::{self, BarSilent};
use crate::device::port::{Port, PortAddress};
use crate::device::protocol::{Definition, Step};

/// A bar that has been opened and started.
pub(super) struct Opened {
    pub(super) port: Port,
    /// When the line was about to be opened.
    pub(super) began: HostNs,
    /// How many bytes of an earlier stream were thrown away.
    pub(super) stale: u64,
    /// What came behind the answer to the start command: the stream has begun.
    pub(super) first: Vec<u8>,
}

/// Opens the line, silences the bar (it may still send from an earlier run) and starts it.
pub(super) fn open(address: &PortAddress, definition: &Definition) -> Result<Opened, PortFinding> {
    let began = clock::now();
    let (mut port, stale) = silence(address, definition)?;
    perform(&mut port, &definition.init)?;
    let first = perform(&mut port, &definition.start)?.rest;
    Ok(Opened { port, began, stale, first })
}

/// Sets the bar's present reading to zero.
///
/// # Errors
/// When the port cannot be opened, or the bar does not answer where it should.
pub fn zero(address: &PortAddress, definition: &Definition) -> Result<(), PortFinding> {
    let (mut port, _) = silence(address, definition)?;
    let heard = perform(&mut port, &definition.zero)?;
    if heard.answered {
        Ok(())
    } else {
        Err(BarSilent { port: address.to_string(), bauds: definition.line.baud.to_string() })
    }
}

/// Opens the line and silences the bar; how many bytes of an earlier stream were thrown away.
fn silence(address: &PortAddress, definition: &Definition) -> Result<(Port, u64), PortFinding> {
    let mut port = Port::open(address, &definition.line)?;
    clock::sleep(definition.line.settle.as_secs_f64());
    let mut stale = find(&mut port, address, definition)?;
    stale += perform(&mut port, &definition.stop)?.thrown();
    if definition.stop.is_empty() {
        stale += port.drain(Duration::from_millis(1))?.len() as u64;
    }
    Ok((port, stale))
}

/// Tries the rates that the bar may be set to until it answers; how many bytes were thrown away.
fn find(port: &mut Port, address: &PortAddress, definition: &Definition) -> Result<u64, PortFinding> {
    let mut thrown = 0;
    if definition.ident.is_empty() {
        return Ok(thrown);
    }
    let rates: Vec<u32> =
        std::iter::once(definition.line.baud).chain(definition.line.baud_probe.iter().copied()).collect();
    for baud in &rates {
        port.set_baud(*baud)?;
        let heard = perform(port, &definition.ident)?;
        let answered = heard.answered;
        thrown += heard.thrown();
        if answered {
            return Ok(thrown);
        }
    }
    let bauds = rates.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
    Err(BarSilent { port: address.to_string(), bauds })
}

/// Silences the bar; a bar that is gone is silent.
pub(super) fn close(mut port: Port, definition: &Definition) {
    let _ = perform(&mut port, &definition.stop);
}

/// Asks for a reading.
pub(super) fn ask(port: &mut Port, definition: &Definition) -> Result<(), PortFinding> {
    perform(port, &definition.poll).map(drop)
}

/// What came while a command was performed.
struct Heard {
    /// Bytes that were thrown away, or were an answer.
    drained: u64,
    /// What came behind the last answer.
    rest: Vec<u8>,
    /// Whether everything that was asked was answered.
    answered: bool,
}

impl Heard {
    /// All of its bytes, where none of them matter.
    fn thrown(self) -> u64 {
        self.drained + self.rest.len() as u64
    }
}

/// Performs the steps of a command. A device that does not answer as expected is given up after its
/// retries: whether it sends is seen soon enough.
fn perform(port: &mut Port, steps: &[Step]) -> Result<Heard, PortFinding> {
    let mut heard = Heard { drained: 0, rest: Vec::new(), answered: true };
    for step in steps {
        match step {
            Step::Send(bytes) => port.send(bytes)?,
            Step::Ask { send, expect, timeout, retries } => {
                let mut answered = false;
                for _ in 0..=*retries {
                    port.send(send)?;
                    heard.drained += std::mem::take(&mut heard.rest).len() as u64;
                    let mut answer = port.listen(*timeout, expect)?;
                    let place = answer.windows(expect.len().max(1)).position(|part| part == &expect[..]);
                    answered = place.is_some();
                    heard.rest = answer.split_off(place.map_or(answer.len(), |at| at + expect.len()));
                    heard.drained += answer.len() as u64;
                    if answered {
                        break;
                    }
                }
                heard.answered &= answered;
            }
            Step::DtrPulse(duration) => port.pulse_dtr(*duration)?,
            Step::Wait(duration) => clock::sleep(duration.as_secs_f64()),
            Step::Drain(quiet) => {
                let thrown = port.drain(*quiet)?.len() + std::mem::take(&mut heard.rest).len();
                heard.drained += thrown as u64;
            }
        }
    }
    Ok(heard)
}

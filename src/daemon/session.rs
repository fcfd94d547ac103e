//! The bar on its line: opening it, its start and stop commands.

use std::time::Duration;

use serialport::{DataBits, FlowControl, StopBits};

use crate::clock;
use crate::port::{Port, PortError, Settings};
use crate::protocol::{Definition, Flow, Line, Parity, Step};

/// The line's settings in the words of the port.
fn settings(line: &Line) -> Settings {
    Settings {
        baud: line.baud,
        data_bits: if line.data_bits == 7 { DataBits::Seven } else { DataBits::Eight },
        parity: match line.parity {
            Parity::None => serialport::Parity::None,
            Parity::Even => serialport::Parity::Even,
            Parity::Odd => serialport::Parity::Odd,
        },
        stop_bits: if line.stop_bits == 2 { StopBits::Two } else { StopBits::One },
        flow: match line.flow {
            Flow::None => FlowControl::None,
            Flow::XonXoff => FlowControl::Software,
            Flow::RtsCts => FlowControl::Hardware,
        },
        dtr: line.dtr,
        rts: line.rts,
    }
}

/// Opens the line, silences the bar (it may still send from an earlier run) and starts it. The port,
/// and how many stale bytes were thrown away.
pub(super) fn open(name: &str, definition: &Definition) -> Result<(Port, u64), PortError> {
    let mut port = Port::open(name, &settings(&definition.line))?;
    clock::sleep(definition.line.settle.as_secs_f64());
    let mut stale = perform(&mut port, &definition.stop)?;
    if definition.stop.is_empty() {
        stale += port.drain(Duration::from_millis(1))?.len() as u64;
    }
    perform(&mut port, &definition.init)?;
    perform(&mut port, &definition.start)?;
    Ok((port, stale))
}

/// Silences the bar; a bar that is gone is silent.
pub(super) fn close(mut port: Port, definition: &Definition) {
    let _ = perform(&mut port, &definition.stop);
}

/// Asks for a reading.
pub(super) fn ask(port: &mut Port, definition: &Definition) -> Result<(), PortError> {
    perform(port, &definition.poll).map(drop)
}

/// Performs the steps of a command; how many bytes were thrown away. A device that does not answer
/// as expected is given up after its retries: whether it sends is seen soon enough.
fn perform(port: &mut Port, steps: &[Step]) -> Result<u64, PortError> {
    let mut drained = 0;
    for step in steps {
        match step {
            Step::Send(bytes) => port.send(bytes)?,
            Step::Ask { send, expect, timeout, retries } => {
                for _ in 0..=*retries {
                    port.send(send)?;
                    let answer = port.listen(*timeout, expect)?;
                    drained += answer.len() as u64;
                    if answer.windows(expect.len().max(1)).any(|part| part == &expect[..]) {
                        break;
                    }
                }
            }
            Step::DtrPulse(duration) => port.pulse_dtr(*duration)?,
            Step::Wait(duration) => clock::sleep(duration.as_secs_f64()),
            Step::Drain(quiet) => drained += port.drain(*quiet)?.len() as u64,
        }
    }
    Ok(drained)
}

//! Serial ports and pseudo-terminals of this computer.

use std::io::{self, ErrorKind};
use std::path::Path;
use std::time::Duration;

use serialport::{DataBits, FlowControl, SerialPort, StopBits};

use super::line::{LineTransport, PortLine, StampAccuracy};
use super::settings::{Flow, LineSettings, Parity};
use super::{PORT_READ_TIMEOUT, adapter};
use crate::port::PortFinding::{self, NoPort, PortBusy, PortDenied, PortRefused};

pub(super) struct Tty {
    port: Box<dyn SerialPort>,
    stamps: StampAccuracy,
}

impl Tty {
    /// Opens a device for this process alone; `name` is the user's word for it.
    pub(super) fn open(name: &str, path: &Path, settings: &LineSettings) -> Result<Self, PortFinding> {
        if cfg!(unix) && !path.exists() {
            return Err(NoPort { port: name.into() });
        }
        // A pseudo-terminal has no modem wires and no symbol rate: it takes the bytes as they come.
        let target = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let transport = if target.starts_with("/dev/pts") { LineTransport::Pty } else { LineTransport::Tty };
        let wires = transport == LineTransport::Tty;
        let mut builder = serialport::new(path.to_string_lossy(), settings.baud)
            .data_bits(if settings.data_bits == 7 { DataBits::Seven } else { DataBits::Eight })
            .parity(match settings.parity {
                Parity::None => serialport::Parity::None,
                Parity::Even => serialport::Parity::Even,
                Parity::Odd => serialport::Parity::Odd,
            })
            .stop_bits(if settings.stop_bits == 2 { StopBits::Two } else { StopBits::One })
            .flow_control(match settings.flow {
                Flow::None => FlowControl::None,
                Flow::XonXoff => FlowControl::Software,
                Flow::RtsCts => FlowControl::Hardware,
            })
            .timeout(PORT_READ_TIMEOUT);
        if let Some(dtr) = settings.dtr.filter(|_| wires) {
            builder = builder.dtr_on_open(dtr);
        }
        let mut port = builder.open().map_err(|error| refusal(name, &error))?;
        if let Some(rts) = settings.rts.filter(|_| wires) {
            port.write_request_to_send(rts).map_err(|error| refusal(name, &error))?;
        }
        let held_ms = adapter::latency_ms(path).map(f64::from);
        Ok(Self { port, stamps: StampAccuracy { transport, held_ms } })
    }
}

impl PortLine for Tty {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        match self.port.read(room) {
            // Some drivers answer reads of an adapter that was pulled out with silence, but not this question.
            Err(error) if error.kind() == ErrorKind::TimedOut => match self.port.bytes_to_read() {
                Ok(_) => Err(error),
                Err(gone) => Err(io::Error::new(ErrorKind::BrokenPipe, gone.to_string())),
            },
            read => read,
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.port.write(bytes)
    }

    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        Ok(self.port.set_timeout(timeout)?)
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        Ok(self.port.set_baud_rate(baud)?)
    }

    fn set_dtr(&mut self, level: bool) -> io::Result<()> {
        if self.stamps.transport == LineTransport::Pty {
            return Ok(());
        }
        Ok(self.port.write_data_terminal_ready(level)?)
    }

    fn handle(&self) -> io::Result<Box<dyn PortLine>> {
        Ok(Box::new(Self { port: self.port.try_clone()?, stamps: self.stamps }))
    }

    fn stamps(&self) -> StampAccuracy {
        self.stamps
    }
}

/// Finds the cause of a refusal by the words of the system, which has no kind of error for a port in use.
#[expect(
    clippy::wildcard_enum_match_arm,
    reason = "the kinds of errors of the system and of the crate are open"
)]
fn refusal(name: &str, error: &serialport::Error) -> PortFinding {
    use serialport::ErrorKind::{Io, NoDevice};
    let text = error.to_string().to_lowercase();
    let says = |words: &[&str]| words.iter().any(|word| text.contains(word));
    let port = name.to_owned();
    match error.kind() {
        // Windows denies a port that another program has open, and reports it as no device.
        NoDevice | Io(ErrorKind::PermissionDenied) if cfg!(windows) && says(&["denied"]) => PortBusy { port },
        Io(ErrorKind::PermissionDenied) => PortDenied { port },
        Io(ErrorKind::NotFound) => NoPort { port },
        _ if says(&["busy", "lock", "unavailable", "would block"]) => PortBusy { port },
        NoDevice => NoPort { port },
        _ => PortRefused { port, why: error.to_string() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dbbd_model::diagnostic::Finding;

    /// Root may open every port, so no test of the binary is refused one.
    #[test]
    fn refusals_name_their_cause() {
        let said = |kind, text: &str| refusal("p", &serialport::Error::new(kind, text)).code().as_str();
        let denied = said(serialport::ErrorKind::Io(ErrorKind::PermissionDenied), "Permission denied");
        assert_eq!(denied, if cfg!(windows) { "E0203" } else { "E0202" });
        assert_eq!(said(serialport::ErrorKind::Io(ErrorKind::NotFound), "No such file"), "E0201");
        assert_eq!(said(serialport::ErrorKind::NoDevice, "Device or resource busy"), "E0203");
        assert_eq!(said(serialport::ErrorKind::Unknown, "Not a typewriter"), "E0204");
    }
}

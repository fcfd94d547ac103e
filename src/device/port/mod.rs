//! The serial line and nothing else: opening, writing, and a thread that reads and stamps.

mod adapter;
mod list;
mod reader;

use std::io::{ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serialport::{DataBits, FlowControl, Parity, SerialPort, StopBits};

use crate::base::clock;
use crate::catalogue::PortFinding::{self, NoPort, PortBusy, PortDenied, PortGone, PortRefused};

pub use adapter::{identity, quicken};
pub use list::{Found, list};
pub use reader::{Arrival, Reader};

/// How long a read waits before it looks whether it is to end.
const PATIENCE: Duration = Duration::from_millis(50);
/// How long a write may take.
const WRITE_PATIENCE_S: f64 = 2.0;

/// Settings of the line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Settings {
    pub baud: u32,
    pub data_bits: DataBits,
    pub parity: Parity,
    pub stop_bits: StopBits,
    pub flow: FlowControl,
    /// Level of DTR after opening; left alone when absent.
    pub dtr: Option<bool>,
    /// Level of RTS after opening; left alone when absent.
    pub rts: Option<bool>,
}

/// An open line, for this process alone.
pub struct Port {
    line: Box<dyn SerialPort>,
    name: String,
    pty: bool,
}

/// The device of a port as the user named it: `by-id/..` and `by-path/..` stand under `/dev/serial`.
pub fn device(name: &str) -> PathBuf {
    if name.starts_with("by-id/") || name.starts_with("by-path/") {
        Path::new("/dev/serial").join(name)
    } else {
        PathBuf::from(name)
    }
}

impl Port {
    /// Opens a line exclusively.
    ///
    /// # Errors
    /// When it is missing, denied, in use, or refuses the settings.
    pub fn open(name: &str, settings: &Settings) -> Result<Self, PortFinding> {
        let path = device(name);
        if cfg!(unix) && !path.exists() {
            return Err(NoPort { port: name.into() });
        }
        // A pseudo terminal has no modem wires and no symbol rate: it takes the bytes as they come.
        let target = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
        let pty = target.starts_with("/dev/pts");
        let mut builder = serialport::new(path.to_string_lossy(), settings.baud)
            .data_bits(settings.data_bits)
            .parity(settings.parity)
            .stop_bits(settings.stop_bits)
            .flow_control(settings.flow)
            .timeout(PATIENCE);
        if let (Some(dtr), false) = (settings.dtr, pty) {
            builder = builder.dtr_on_open(dtr);
        }
        let mut line = builder.open().map_err(|error| refusal(name, &error))?;
        if let (Some(rts), false) = (settings.rts, pty) {
            line.write_request_to_send(rts).map_err(|error| refused(name, &error))?;
        }
        Ok(Self { line, name: name.into(), pty })
    }

    /// Whether this is a pseudo terminal, whose other side waits until its bytes are taken.
    pub fn is_pty(&self) -> bool {
        self.pty
    }

    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// When the port is gone or takes nothing for two seconds.
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), PortFinding> {
        let began = clock::now();
        let mut rest = bytes;
        while !rest.is_empty() {
            match self.line.write(rest) {
                Ok(sent) => rest = &rest[sent.min(rest.len())..],
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error)
                    if error.kind() == ErrorKind::TimedOut
                        && clock::now().seconds_since(began) < WRITE_PATIENCE_S => {}
                Err(error) => return Err(self.gone(&error)),
            }
        }
        Ok(())
    }

    /// Reads and throws away until nothing has come for `quiet`; the bytes thrown away. Gives up after
    /// a second beyond that: a device that does not stop must not hold the run up.
    ///
    /// # Errors
    /// When the port is gone.
    pub fn drain(&mut self, quiet: Duration) -> Result<Vec<u8>, PortFinding> {
        self.read_until(quiet, 1.0 + quiet.as_secs_f64(), |_| false)
    }

    /// Reads until `answer` has come or the time is up; the bytes that came.
    ///
    /// # Errors
    /// When the port is gone.
    pub fn listen(&mut self, timeout: Duration, answer: &[u8]) -> Result<Vec<u8>, PortFinding> {
        self.read_until(timeout, timeout.as_secs_f64(), |bytes| {
            bytes.windows(answer.len().max(1)).any(|part| part == answer)
        })
    }

    fn read_until(
        &mut self,
        quiet: Duration,
        limit_s: f64,
        done: impl Fn(&[u8]) -> bool,
    ) -> Result<Vec<u8>, PortFinding> {
        let began = clock::now();
        let (mut came, mut buffer) = (Vec::new(), [0; 4096]);
        self.line.set_timeout(quiet.max(Duration::from_millis(1))).map_err(|error| self.gone(&error))?;
        while clock::now().seconds_since(began) < limit_s && !done(&came) {
            match self.line.read(&mut buffer) {
                Ok(0) => return Err(self.gone(&ErrorKind::UnexpectedEof)),
                Ok(count) => came.extend_from_slice(&buffer[..count.min(buffer.len())]),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::TimedOut => break,
                Err(error) => return Err(self.gone(&error)),
            }
        }
        self.line.set_timeout(PATIENCE).map_err(|error| self.gone(&error))?;
        Ok(came)
    }

    /// Changes the rate, symbols per second; a pseudo terminal takes the bytes at any.
    ///
    /// # Errors
    /// When the port is gone or cannot do it.
    pub fn set_baud(&mut self, baud: u32) -> Result<(), PortFinding> {
        self.line.set_baud_rate(baud).map_err(|error| refused(&self.name, &error))
    }

    /// Lowers DTR for so long; a pseudo terminal has none.
    ///
    /// # Errors
    /// When the port is gone.
    pub fn pulse_dtr(&mut self, low: Duration) -> Result<(), PortFinding> {
        if self.pty {
            return Ok(());
        }
        self.line.write_data_terminal_ready(false).map_err(|error| self.gone(&error))?;
        clock::sleep(low.as_secs_f64());
        self.line.write_data_terminal_ready(true).map_err(|error| self.gone(&error))
    }

    /// A second handle of the same line, for the reading thread.
    ///
    /// # Errors
    /// When the system has no handle left.
    pub fn handle(&self) -> Result<Self, PortFinding> {
        let line = self.line.try_clone().map_err(|error| refused(&self.name, &error))?;
        Ok(Self { line, name: self.name.clone(), pty: self.pty })
    }

    fn gone(&self, why: &impl ToString) -> PortFinding {
        PortGone { port: self.name.clone(), why: why.to_string() }
    }
}

fn refused(name: &str, error: &serialport::Error) -> PortFinding {
    PortRefused { port: name.into(), why: error.to_string() }
}

/// By the words of the system, which has no kind of error for a port in use.
fn refusal(name: &str, error: &serialport::Error) -> PortFinding {
    use serialport::ErrorKind::{Io, NoDevice};
    let text = error.to_string().to_lowercase();
    let says = |words: &[&str]| words.iter().any(|word| text.contains(word));
    match error.kind() {
        Io(ErrorKind::PermissionDenied) => PortDenied { port: name.into() },
        Io(ErrorKind::NotFound) => NoPort { port: name.into() },
        _ if says(&["busy", "lock", "unavailable", "would block"]) => PortBusy { port: name.into() },
        NoDevice => NoPort { port: name.into() },
        _ => refused(name, error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnostic::Finding;

    /// Root may open every port, so that no test through the binary is refused one.
    #[test]
    fn a_refusal_says_who_refuses() {
        let said = |kind, text: &str| refusal("p", &serialport::Error::new(kind, text)).code().0;
        assert_eq!(
            said(serialport::ErrorKind::Io(ErrorKind::PermissionDenied), "Permission denied"),
            "E0202"
        );
        assert_eq!(said(serialport::ErrorKind::Io(ErrorKind::NotFound), "No such file"), "E0201");
        assert_eq!(said(serialport::ErrorKind::NoDevice, "Device or resource busy"), "E0203");
        assert_eq!(said(serialport::ErrorKind::Unknown, "Not a typewriter"), "E0204");
    }
}

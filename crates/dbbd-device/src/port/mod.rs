//! The line to the bar: opening, writing, and a thread that reads and stamps.

mod catalogue;
pub use catalogue::PortFinding;

mod adapter;
mod address;
mod line;
mod list;
mod network;
mod reader;
mod settings;
mod simulated;
pub mod telnet;
mod tty;

use std::io::ErrorKind;
use std::time::Duration;

use crate::clock;
use crate::port::PortFinding::{NoPort, PortGone, PortRefused};
use line::PortLine;

pub use adapter::{PortDevice, blur, identity};
pub use address::{NetworkAddress, PortAddress};
pub use line::{LineTransport, StampAccuracy};
pub use list::{PortInfo, list_ports};
pub use reader::{Arrival, PortReader, Received};
pub(crate) use settings::ms;
pub use settings::{Flow, LineSettings, Parity};
pub use simulated::SIMULATED_MARK;

/// Timeout of a read, after which the thread checks whether to stop. On Windows a write to a serial port waits for
/// the read, and a request must not be late.
const PORT_READ_TIMEOUT: Duration = Duration::from_millis(if cfg!(windows) { 5 } else { 50 });
/// Timeout of a write.
const PORT_WRITE_TIMEOUT: Duration = Duration::from_secs(2);
/// Most bytes that are kept while an answer is waited for: two seconds of the fastest line of any definition, 4 Mbaud.
const MAX_ANSWER_BYTES: usize = 1 << 20;

/// An open line.
pub struct Port {
    line: Box<dyn PortLine>,
    name: String,
}

impl Port {
    /// Opens a line exclusively.
    pub fn open(address: &PortAddress, settings: &LineSettings) -> Result<Self, PortFinding> {
        let name = address.to_string();
        let line: Box<dyn PortLine> = match address {
            PortAddress::Tcp(server) => Box::new(network::NetworkLine::tcp(server)?),
            PortAddress::Rfc2217(server) => Box::new(network::NetworkLine::rfc2217(server, settings)?),
            PortAddress::Serial(_) | PortAddress::Sim => {
                let device = address.device().ok_or_else(|| NoPort { port: name.clone() })?;
                Box::new(tty::Tty::open(&name, &device, settings)?)
            }
        };
        Ok(Self { line: Box::new(simulated::UnmarkedLine::new(line)), name })
    }

    /// Whether the bar is a simulated one: whether it has sent the mark by now.
    pub fn is_simulated(&self) -> bool {
        self.line.is_simulated()
    }

    /// What opening the line has shown.
    pub fn finding(&self) -> Option<PortFinding> {
        self.line.is_plain_telnet().then(|| PortFinding::SpeaksTelnet { port: self.name.clone() })
    }

    pub fn stamps(&self) -> StampAccuracy {
        self.line.stamps()
    }

    /// Sends all bytes, or fails after two seconds.
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), PortFinding> {
        let began = clock::now();
        let mut rest = bytes;
        while !rest.is_empty() {
            match self.line.write(rest) {
                Ok(sent @ 1..) => rest = &rest[sent.min(rest.len())..],
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                // Windows has no error for a write that timed out.
                result => {
                    let error = result.err().unwrap_or_else(|| ErrorKind::TimedOut.into());
                    let waited = clock::now().seconds_since(began);
                    if error.kind() != ErrorKind::TimedOut || waited >= PORT_WRITE_TIMEOUT.as_secs_f64() {
                        return Err(self.gone(&error));
                    }
                    clock::sleep(0.001);
                }
            }
        }
        Ok(())
    }

    /// Discards input until the line is quiet for `quiet`, and returns the number of bytes. Gives up a second later: a
    /// device that does not stop must not block the run.
    pub fn drain(&mut self, quiet: Duration) -> Result<u64, PortFinding> {
        let mut count = 0;
        self.read_until(quiet, 1.0 + quiet.as_secs_f64(), |bytes| {
            count += bytes.len() as u64;
            false
        })?;
        Ok(count)
    }

    /// Reads until `answer` was received, the time is up or `MAX_ANSWER_BYTES` came without it, and returns all bytes.
    /// Bytes that the device sends afterwards stay in the line.
    pub fn listen(&mut self, timeout: Duration, answer: &[u8]) -> Result<Vec<u8>, PortFinding> {
        let mut came: Vec<u8> = Vec::new();
        self.read_until(timeout, timeout.as_secs_f64(), |bytes| {
            // The answer may begin in the bytes before.
            let from = came.len().saturating_sub(answer.len().saturating_sub(1));
            came.extend_from_slice(bytes);
            let is_answered = came[from..].windows(answer.len().max(1)).any(|part| part == answer);
            is_answered || came.len() >= MAX_ANSWER_BYTES
        })?;
        Ok(came)
    }

    /// Gives the bytes of each read to `done`, until it returns `true`, the line is quiet or the time is up.
    fn read_until(
        &mut self,
        quiet: Duration,
        limit_s: f64,
        mut done: impl FnMut(&[u8]) -> bool,
    ) -> Result<(), PortFinding> {
        let began = clock::now();
        let mut buffer = [0; 4096];
        self.line.set_timeout(quiet.max(Duration::from_millis(1))).map_err(|error| self.gone(&error))?;
        while clock::now().seconds_since(began) < limit_s {
            match self.line.read(&mut buffer) {
                Ok(0) => return Err(self.gone(&ErrorKind::UnexpectedEof)),
                Ok(count) if done(&buffer[..count.min(buffer.len())]) => break,
                Ok(_) => {}
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::TimedOut => break,
                Err(error) => return Err(self.gone(&error)),
            }
        }
        self.line.set_timeout(PORT_READ_TIMEOUT).map_err(|error| self.gone(&error))
    }

    /// Changes the rate, symbols per second; a line without a rate ignores it.
    pub fn set_baud(&mut self, baud: u32) -> Result<(), PortFinding> {
        self.line.set_baud(baud).map_err(|error| self.refused(&error))
    }

    /// Lowers DTR for a time, if the line has DTR.
    pub fn pulse_dtr(&mut self, low: Duration) -> Result<(), PortFinding> {
        self.line.set_dtr(false).map_err(|error| self.gone(&error))?;
        clock::sleep(low.as_secs_f64());
        self.line.set_dtr(true).map_err(|error| self.gone(&error))
    }

    /// A second handle of the same line, for the reading thread.
    pub fn handle(&self) -> Result<Self, PortFinding> {
        let line = self.line.handle().map_err(|error| self.refused(&error))?;
        Ok(Self { line, name: self.name.clone() })
    }

    fn refused(&self, why: &impl ToString) -> PortFinding {
        PortRefused { port: self.name.clone(), why: why.to_string() }
    }

    fn gone(&self, why: &impl ToString) -> PortFinding {
        PortGone { port: self.name.clone(), why: why.to_string() }
    }
}

//! The interface of all lines.

use std::time::Duration;
use std::{fmt, io};

use serde::{Deserialize, Serialize};

/// A connected line. Settings that its transport lacks (modem lines, a rate) are ignored.
pub(super) trait PortLine: Send {
    /// Reads bytes into `room`. `TimedOut` if nothing was received in time; 0 bytes if the line was closed.
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize>;
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;
    /// Timeout of a read.
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()>;
    /// Sets the rate, symbols per second.
    fn set_baud(&mut self, baud: u32) -> io::Result<()>;
    fn set_dtr(&mut self, level: bool) -> io::Result<()>;
    fn handle(&self) -> io::Result<Box<dyn PortLine>>;
    fn stamps(&self) -> StampAccuracy;

    /// Whether the mark of a simulated bar was read.
    fn is_simulated(&self) -> bool {
        false
    }

    /// Whether the server of a raw line turned out to speak telnet.
    fn is_plain_telnet(&self) -> bool {
        false
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LineTransport {
    Tty,
    /// A pseudo-terminal.
    Pty,
    Tcp,
    Rfc2217,
}

impl fmt::Display for LineTransport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Tty => "serial port",
            Self::Pty => "pseudo-terminal",
            Self::Tcp => "TCP",
            Self::Rfc2217 => "RFC 2217",
        })
    }
}

impl LineTransport {
    /// Whether the sender waits until its bytes are read; a device on a tty does not.
    pub fn waits(self) -> bool {
        self != Self::Tty
    }
}

/// Accuracy of the host's time stamps of a line.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StampAccuracy {
    pub transport: LineTransport,
    /// Delay of bytes before they are stamped, ms, if known: the latency timer of a USB adapter, or the round trip
    /// of the network at opening. A serial server adds its own delay.
    pub held_ms: Option<f64>,
}

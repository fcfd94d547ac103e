//! What every line can do, whatever carries it.

use std::time::Duration;
use std::{fmt, io};

use serde::{Deserialize, Serialize};

/// A connected line. What its transport lacks (modem wires, a rate) it takes and does nothing.
pub(super) trait Line: Send {
    /// `TimedOut` when nothing came in time; 0 bytes when the line has ended.
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize>;
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize>;
    /// How long a read waits.
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()>;
    /// In symbols per second.
    fn set_baud(&mut self, baud: u32) -> io::Result<()>;
    fn set_dtr(&mut self, level: bool) -> io::Result<()>;
    /// A second handle of the same line.
    fn handle(&self) -> io::Result<Box<dyn Line>>;
    fn stamps(&self) -> Stamps;
}

/// What carries the bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Transport {
    Tty,
    /// A pseudo-terminal.
    Pty,
    Tcp,
    Rfc2217,
}

impl fmt::Display for Transport {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Tty => "serial port",
            Self::Pty => "pseudo-terminal",
            Self::Tcp => "TCP",
            Self::Rfc2217 => "RFC 2217",
        })
    }
}

impl Transport {
    /// Whether the other side waits until its bytes are taken; a device on a tty does not.
    pub fn waits(self) -> bool {
        self != Self::Tty
    }
}

/// What the host's time stamps of a line are worth.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stamps {
    pub transport: Transport,
    /// How long bytes are held back before they are stamped, ms, as far as it is known: the timer of a USB adapter, or the
    /// round trip of the network when the line was opened. A serial server adds its own.
    pub held_ms: Option<f64>,
}

//! The controller's end of EthernetKRL: a TCP client that sends telegrams and reads the answers.

use std::fmt::Display;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

use crate::sim::SimulationFinding;
use dbbd_model::diagnostic::Diagnostic;

/// Longest wait for an answer; a controller would wait for ever.
const TIMEOUT: Duration = Duration::from_secs(10);
/// Most bytes of an answer.
const MAX_ANSWER_BYTES: usize = 4096;

#[derive(Debug)]
pub struct EkrlClient {
    stream: TcpStream,
    received: Vec<u8>,
}

impl EkrlClient {
    pub fn connect(server: SocketAddr) -> Result<Self, Diagnostic> {
        let connect = || {
            let stream = TcpStream::connect_timeout(&server, TIMEOUT)?;
            stream.set_read_timeout(Some(TIMEOUT))?;
            stream.set_nodelay(true)?;
            Ok(Self { stream, received: Vec::new() })
        };
        connect().map_err(|error: std::io::Error| {
            SimulationFinding::NotConnected { server: server.to_string(), why: error.to_string() }.into()
        })
    }

    /// Sends a telegram and waits for `<Ack Id=".."/>`. Returns the number.
    pub fn exchange(&mut self, telegram: &str) -> Result<i64, Diagnostic> {
        let broken = |error: &dyn Display| SimulationFinding::NotExchanged {
            telegram: telegram.into(),
            why: error.to_string(),
        };
        self.stream.write_all(telegram.as_bytes()).map_err(|error| broken(&error))?;
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == b'>') {
                let answer: Vec<u8> = self.received.drain(..=end).collect();
                let answer = String::from_utf8_lossy(&answer).trim().to_owned();
                return acknowledged(&answer)
                    .ok_or_else(|| SimulationFinding::NotAcknowledged { answer }.into());
            }
            let mut bytes = [0; 512];
            let count = self.stream.read(&mut bytes).map_err(|error| broken(&error))?;
            self.received.extend_from_slice(bytes.get(..count).unwrap_or_default());
            if count == 0 || self.received.len() > MAX_ANSWER_BYTES {
                return Err(SimulationFinding::NotAnswered.into());
            }
        }
    }
}

/// The number in `<Ack Id=".."/>`.
fn acknowledged(answer: &str) -> Option<i64> {
    let inside = answer.strip_prefix("<Ack Id=\"")?.strip_suffix('>')?.trim_end();
    inside.strip_suffix('/')?.trim_end().strip_suffix('"')?.parse().ok()
}

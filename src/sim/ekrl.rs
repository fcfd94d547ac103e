//! The controller's end of EthernetKRL: a TCP client that sends telegrams and reads their answers.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpStream};
use std::time::Duration;

/// How long an answer may take; a controller would wait for ever.
const PATIENCE: Duration = Duration::from_secs(10);
/// An answer is short; more without its end is none.
const LONGEST: usize = 4096;

/// A connection to the server.
#[derive(Debug)]
pub struct Client {
    stream: TcpStream,
    read: Vec<u8>,
}

impl Client {
    /// Connects.
    ///
    /// # Errors
    /// As the operating system says.
    pub fn connect(server: SocketAddr) -> io::Result<Self> {
        let stream = TcpStream::connect_timeout(&server, PATIENCE)?;
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_nodelay(true)?;
        Ok(Self { stream, read: Vec::new() })
    }

    /// Sends a telegram and waits for `<Ack Id=".."/>`: its number.
    ///
    /// # Errors
    /// A broken connection, no answer within ten seconds, or one that is no `Ack`.
    pub fn exchange(&mut self, telegram: &str) -> io::Result<i64> {
        self.stream.write_all(telegram.as_bytes())?;
        loop {
            if let Some(end) = self.read.iter().position(|byte| *byte == b'>') {
                let answer: Vec<u8> = self.read.drain(..=end).collect();
                let answer = String::from_utf8_lossy(&answer);
                let id = answer.trim().strip_prefix("<Ack Id=\"").and_then(|rest| {
                    rest.strip_suffix('>')?
                        .trim_end()
                        .strip_suffix('/')?
                        .trim_end()
                        .strip_suffix('"')?
                        .parse()
                        .ok()
                });
                return id.ok_or_else(|| {
                    io::Error::new(
                        ErrorKind::InvalidData,
                        format!("`{}` is no <Ack Id=\"..\"/>", answer.trim()),
                    )
                });
            }
            let mut bytes = [0; 512];
            let count = self.stream.read(&mut bytes)?;
            self.read.extend_from_slice(bytes.get(..count).unwrap_or_default());
            if count == 0 || self.read.len() > LONGEST {
                return Err(io::Error::new(
                    ErrorKind::UnexpectedEof,
                    "the connection ended without an answer",
                ));
            }
        }
    }
}

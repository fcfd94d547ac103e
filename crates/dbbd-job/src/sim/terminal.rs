//! The bar's end of its line: a pseudo-terminal, or a TCP port like the port of a serial server.

use std::fmt::Display;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream, ToSocketAddrs};
use std::time::Duration;
#[cfg(unix)]
use std::{
    fs,
    path::{Path, PathBuf},
};

#[cfg(unix)]
use serialport::{SerialPort, TTYPort};

use crate::sim::SimulationFinding;
use dbbd_device::clock;
use dbbd_device::port::telnet::{Telnet, TelnetSide};
use dbbd_device::port::{NetworkAddress, PortAddress};
use dbbd_model::diagnostic::Diagnostic;

/// Default timeout of a read.
pub(super) const TERMINAL_READ_TIMEOUT: Duration = Duration::from_millis(1);

/// The line of a virtual bar; one host at a time may open it.
pub struct Terminal {
    wire: TerminalWire,
    address: PortAddress,
}

enum TerminalWire {
    #[cfg(unix)]
    Pty {
        line: TTYPort,
        link: Option<TerminalLink>,
    },
    Network(TerminalServer),
}

fn failed(why: impl Display) -> SimulationFinding {
    SimulationFinding::Terminal { why: why.to_string() }
}

impl Terminal {
    /// Opens a pseudo-terminal.
    #[cfg(unix)]
    pub fn new() -> Result<Self, Diagnostic> {
        let (mut line, host) = TTYPort::pair().map_err(failed)?;
        line.set_timeout(TERMINAL_READ_TIMEOUT).map_err(failed)?;
        // The host's end is closed here: while it is open, nobody could see the host come and go.
        let address = PortAddress::Serial(host.name().unwrap_or_default());
        Ok(Self { wire: TerminalWire::Pty { line, link: None }, address })
    }

    /// Opens a TCP port of this computer, on systems without pseudo-terminals.
    #[cfg(not(unix))]
    pub fn new() -> Result<Self, Diagnostic> {
        Self::listen(&PortAddress::Tcp(NetworkAddress { host: "127.0.0.1".into(), port: 0 }))
    }

    /// Opens a TCP port, for `tcp://` or `rfc2217://`; for port 0 the system chooses a port.
    pub fn listen(address: &PortAddress) -> Result<Self, Diagnostic> {
        let (network, transport) = match address {
            PortAddress::Tcp(network) => (network, TerminalTransport::Bytes),
            PortAddress::Rfc2217(network) => (network, TerminalTransport::Telnet),
            PortAddress::Serial(_) | PortAddress::Sim => {
                return Err(SimulationFinding::NotToListenOn { address: address.to_string() }.into());
            }
        };
        let NetworkAddress { host, port } = network;
        let mut addresses = (host.as_str(), *port).to_socket_addrs().map_err(failed)?;
        let listener =
            addresses.next().map_or_else(|| Err(ErrorKind::NotFound.into()), listener).map_err(failed)?;
        let port = listener.local_addr().map_err(failed)?.port();
        let network = NetworkAddress { host: host.clone(), port };
        let address = match transport {
            TerminalTransport::Bytes => PortAddress::Tcp(network),
            TerminalTransport::Telnet => PortAddress::Rfc2217(network),
        };
        let server = TerminalServer { listener, transport, client: None, timeout: TERMINAL_READ_TIMEOUT };
        Ok(Self { wire: TerminalWire::Network(server), address })
    }

    /// The address for the host.
    pub fn address(&self) -> &PortAddress {
        &self.address
    }

    /// Adds a symlink that follows the pseudo-terminal when it gets another name; a TCP port keeps its address.
    #[cfg(unix)]
    pub fn with_link(mut self, new: TerminalLink) -> Self {
        if let TerminalWire::Pty { link, .. } = &mut self.wire {
            *link = Some(new);
        }
        self
    }

    pub(super) fn set_timeout(&mut self, timeout: Duration) -> Result<(), Diagnostic> {
        match &mut self.wire {
            #[cfg(unix)]
            TerminalWire::Pty { line, .. } => line.set_timeout(timeout).map_err(failed)?,
            TerminalWire::Network(server) => server.timeout = timeout,
        }
        Ok(())
    }

    /// Reads bytes of the host. Fails with `TimedOut` if the host sends nothing, with another error if there is no
    /// host.
    pub(super) fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match &mut self.wire {
            #[cfg(unix)]
            TerminalWire::Pty { line, .. } => line.read(buffer),
            TerminalWire::Network(server) => server.read(buffer),
        }
    }

    /// Writes bytes to the host. Fails with `TimedOut` if the host reads nothing at present.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.wire {
            #[cfg(unix)]
            TerminalWire::Pty { line, .. } => line.write(bytes),
            TerminalWire::Network(server) => server.write(bytes),
        }
    }

    /// Writes all bytes, unless the host goes away.
    pub(super) fn write_all(&mut self, bytes: &[u8]) -> Result<(), Diagnostic> {
        let server = match &mut self.wire {
            #[cfg(unix)]
            TerminalWire::Pty { line, .. } => return Ok(line.write_all(bytes).map_err(failed)?),
            TerminalWire::Network(server) => server,
        };
        let mut rest = bytes;
        while !rest.is_empty() && server.client.is_some() {
            if let Ok(count) = server.write(rest) {
                rest = &rest[count.min(rest.len())..];
            }
        }
        Ok(())
    }

    /// Unplugs the bar for `away_s`; a pseudo-terminal comes back under another name.
    pub(super) fn unplug(&mut self, away_s: f64) -> Result<(), Diagnostic> {
        match &mut self.wire {
            #[cfg(unix)]
            TerminalWire::Pty { link, .. } => {
                let path = link.take().map(|link| link.path().to_owned());
                // The new terminal is opened before the old one is closed: otherwise the system would reuse its name.
                let new = Self::new()?;
                let name = new.address.to_string();
                *self = new;
                clock::sleep(away_s);
                if let (Some(path), TerminalWire::Pty { link, .. }) = (path, &mut self.wire) {
                    *link = Some(TerminalLink::new(&path, &name)?);
                }
            }
            TerminalWire::Network(server) => {
                let address = server.listener.local_addr().map_err(failed)?;
                server.client = None;
                // A listener on an unknown port replaces the old one, which closes the old port.
                server.listener = listener((address.ip(), 0).into()).map_err(failed)?;
                clock::sleep(away_s);
                server.listener = listener(address).map_err(failed)?;
            }
        }
        Ok(())
    }
}

/// A symlink that gives a pseudo-terminal a name of the user's choice. It is removed when this is dropped.
#[cfg(unix)]
#[derive(Debug)]
pub struct TerminalLink {
    path: PathBuf,
    target: PathBuf,
}

#[cfg(unix)]
impl TerminalLink {
    /// Creates the link. An existing symlink is replaced; any other file is an error.
    pub fn new(path: &Path, target: &str) -> Result<Self, Diagnostic> {
        let wrong = |error: std::io::Error| {
            let finding = SimulationFinding::NoLink { why: error.to_string() };
            Diagnostic::file(path.display().to_string(), finding)
        };
        if fs::symlink_metadata(path).is_ok_and(|data| data.file_type().is_symlink()) {
            fs::remove_file(path).map_err(wrong)?;
        }
        std::os::unix::fs::symlink(target, path).map_err(wrong)?;
        Ok(Self { path: path.into(), target: target.into() })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(unix)]
impl Drop for TerminalLink {
    fn drop(&mut self) {
        // Another simulator may have replaced the link.
        if fs::read_link(&self.path).is_ok_and(|target| target == self.target) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn listener(address: std::net::SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum TerminalTransport {
    Bytes,
    /// Telnet with RFC 2217.
    Telnet,
}

/// A TCP port with at most one client.
struct TerminalServer {
    listener: TcpListener,
    transport: TerminalTransport,
    client: Option<TerminalClient>,
    timeout: Duration,
}

struct TerminalClient {
    stream: TcpStream,
    telnet: Option<Telnet>,
    /// Bytes that the network has not accepted yet.
    unsent: Vec<u8>,
}

impl TerminalClient {
    fn new(stream: TcpStream, transport: TerminalTransport) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        let (telnet, unsent) = match transport {
            TerminalTransport::Bytes => (None, Vec::new()),
            TerminalTransport::Telnet => {
                let (telnet, greeting) = Telnet::new(TelnetSide::Server);
                (Some(telnet), greeting)
            }
        };
        Ok(Self { stream, telnet, unsent })
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.flush()?;
        let count = self.stream.read(buffer)?;
        let Some(telnet) = self.telnet.as_mut().filter(|_| count > 0) else { return Ok(count) };
        let received = telnet.receive(&buffer[..count]);
        self.unsent.extend(received.reply);
        self.flush()?;
        buffer[..received.data.len()].copy_from_slice(&received.data);
        if received.data.is_empty() { Err(ErrorKind::WouldBlock.into()) } else { Ok(received.data.len()) }
    }

    fn is_gone(&self) -> bool {
        match self.stream.peek(&mut [0]) {
            Ok(count) => count == 0,
            Err(error) => error.kind() != ErrorKind::WouldBlock,
        }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.flush()?;
        if self.telnet.is_none() {
            return self.stream.write(bytes);
        }
        if !self.unsent.is_empty() {
            return Err(ErrorKind::WouldBlock.into());
        }
        self.unsent = Telnet::escaped(bytes);
        self.flush()?;
        Ok(bytes.len())
    }

    /// Sends as much as the network accepts.
    fn flush(&mut self) -> io::Result<()> {
        while !self.unsent.is_empty() {
            match self.stream.write(&self.unsent) {
                Ok(count) => drop(self.unsent.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }
}

impl TerminalServer {
    /// Accepts waiting hosts. A host is turned away while another one is connected.
    fn accept(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            // A host that opens the line again may be faster than the notice that it was closed.
            if self.client.as_ref().is_none_or(TerminalClient::is_gone) {
                self.client = TerminalClient::new(stream, self.transport).ok();
            }
        }
    }

    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.accept();
        let timeout_s = self.timeout.as_secs_f64();
        self.with_client(timeout_s, |client| match client.read(buffer) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            read => read,
        })
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.with_client(TERMINAL_READ_TIMEOUT.as_secs_f64(), |client| client.write(bytes))
    }

    /// Drops a client that fails; waits if the client sends or reads nothing.
    fn with_client(
        &mut self,
        wait_s: f64,
        act: impl FnOnce(&mut TerminalClient) -> io::Result<usize>,
    ) -> io::Result<usize> {
        let result = self.client.as_mut().map_or(Err(ErrorKind::NotConnected.into()), act);
        match result {
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                clock::sleep(wait_s);
                Err(ErrorKind::TimedOut.into())
            }
            Err(error) if error.kind() != ErrorKind::Interrupted => {
                self.client = None;
                Err(error)
            }
            result => result,
        }
    }
}

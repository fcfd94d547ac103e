//! The bar's side of its line: a pseudo-terminal, or a TCP port as a serial server has one for each of its lines.

use std::fmt::Display;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream, ToSocketAddrs};
use std::time::Duration;

#[cfg(unix)]
use serialport::{SerialPort, TTYPort};

#[cfg(unix)]
use super::link::Link;
use crate::base::clock;
use crate::catalogue::SimulationFinding;
use crate::device::port::telnet::{Side, Telnet};
use crate::device::port::{NetworkAddress, PortAddress};
use crate::diagnostic::Diagnostic;

/// How long a read waits where nobody says otherwise.
pub(super) const PATIENCE: Duration = Duration::from_millis(1);

/// A line for a virtual bar, which one host at a time may open.
pub struct Terminal {
    wire: Wire,
    address: PortAddress,
}

enum Wire {
    #[cfg(unix)]
    Pty {
        line: TTYPort,
        link: Option<Link>,
    },
    Network(Server),
}

fn failed(why: impl Display) -> SimulationFinding {
    SimulationFinding::Terminal { why: why.to_string() }
}

impl Terminal {
    /// A pseudo-terminal.
    ///
    /// # Errors
    /// When the system has none left.
    #[cfg(unix)]
    pub fn new() -> Result<Self, Diagnostic> {
        let (mut line, host) = TTYPort::pair().map_err(failed)?;
        line.set_timeout(PATIENCE).map_err(failed)?;
        // Only while no handle of the host's side is open here can its coming and going be seen.
        let address = PortAddress::Serial(host.name().unwrap_or_default());
        Ok(Self { wire: Wire::Pty { line, link: None }, address })
    }

    /// Where there is no pseudo-terminal: a TCP port of this computer.
    ///
    /// # Errors
    /// When the system has none left.
    #[cfg(not(unix))]
    pub fn new() -> Result<Self, Diagnostic> {
        Self::listen(&PortAddress::Tcp(NetworkAddress { host: "127.0.0.1".into(), port: 0 }))
    }

    /// A TCP port, for `tcp://` or `rfc2217://`; of number 0 the system chooses one.
    ///
    /// # Errors
    /// When the address is no such one, or is taken.
    pub fn listen(address: &PortAddress) -> Result<Self, Diagnostic> {
        let (network, speaks) = match address {
            PortAddress::Tcp(network) => (network, Speaks::Bytes),
            PortAddress::Rfc2217(network) => (network, Speaks::Telnet),
            PortAddress::Serial(_) | PortAddress::Sim => {
                return Err(SimulationFinding::NotToListenOn { address: address.to_string() }.into());
            }
        };
        let NetworkAddress { host, port } = network;
        let mut addresses = (host.as_str(), *port).to_socket_addrs().map_err(failed)?;
        let listener =
            addresses.next().map_or_else(|| Err(ErrorKind::NotFound.into()), bound).map_err(failed)?;
        let port = listener.local_addr().map_err(failed)?.port();
        let network = NetworkAddress { host: host.clone(), port };
        let address = match speaks {
            Speaks::Bytes => PortAddress::Tcp(network),
            Speaks::Telnet => PortAddress::Rfc2217(network),
        };
        let server = Server { listener, speaks, client: None, timeout: PATIENCE };
        Ok(Self { wire: Wire::Network(server), address })
    }

    /// What the host opens.
    pub fn address(&self) -> &PortAddress {
        &self.address
    }

    /// A symlink that follows the pseudo-terminal; a TCP port keeps its address.
    #[cfg(unix)]
    pub fn followed_by(mut self, link: Link) -> Self {
        if let Wire::Pty { link: followed, .. } = &mut self.wire {
            *followed = Some(link);
        }
        self
    }

    pub(super) fn set_timeout(&mut self, timeout: Duration) -> Result<(), Diagnostic> {
        match &mut self.wire {
            #[cfg(unix)]
            Wire::Pty { line, .. } => line.set_timeout(timeout).map_err(failed)?,
            Wire::Network(server) => server.timeout = timeout,
        }
        Ok(())
    }

    /// `TimedOut` when the host is there and says nothing; another error when there is no host.
    pub(super) fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        match &mut self.wire {
            #[cfg(unix)]
            Wire::Pty { line, .. } => line.read(room),
            Wire::Network(server) => server.read(room),
        }
    }

    /// `TimedOut` when the host takes nothing at present.
    pub(super) fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.wire {
            #[cfg(unix)]
            Wire::Pty { line, .. } => line.write(bytes),
            Wire::Network(server) => server.write(bytes),
        }
    }

    /// Writes all, unless the host goes away.
    pub(super) fn write_all(&mut self, bytes: &[u8]) -> Result<(), Diagnostic> {
        let server = match &mut self.wire {
            #[cfg(unix)]
            Wire::Pty { line, .. } => return Ok(line.write_all(bytes).map_err(failed)?),
            Wire::Network(server) => server,
        };
        let mut rest = bytes;
        while !rest.is_empty() && server.client.is_some() {
            if let Ok(count) = server.write(rest) {
                rest = &rest[count.min(rest.len())..];
            }
        }
        Ok(())
    }

    /// Pulls the plug for so long; a pseudo-terminal comes back under another name.
    pub(super) fn unplug(&mut self, away_s: f64) -> Result<(), Diagnostic> {
        match &mut self.wire {
            #[cfg(unix)]
            Wire::Pty { link, .. } => {
                let path = link.take().map(|link| link.path().to_owned());
                // The new terminal is made first: the system would give the old name again.
                let new = Self::new()?;
                let name = new.address.to_string();
                *self = new;
                clock::sleep(away_s);
                if let (Some(path), Wire::Pty { link, .. }) = (path, &mut self.wire) {
                    *link = Some(Link::new(&path, &name)?);
                }
            }
            Wire::Network(server) => {
                let address = server.listener.local_addr().map_err(failed)?;
                server.client = None;
                // A listener cannot be closed in its place: one that nobody knows takes it.
                server.listener = bound((address.ip(), 0).into()).map_err(failed)?;
                clock::sleep(away_s);
                server.listener = bound(address).map_err(failed)?;
            }
        }
        Ok(())
    }
}

fn bound(address: std::net::SocketAddr) -> io::Result<TcpListener> {
    let listener = TcpListener::bind(address)?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Speaks {
    Bytes,
    /// Telnet with RFC 2217.
    Telnet,
}

/// One line of a serial server.
struct Server {
    listener: TcpListener,
    speaks: Speaks,
    client: Option<Client>,
    timeout: Duration,
}

struct Client {
    stream: TcpStream,
    telnet: Option<Telnet>,
    /// Bytes that the network has not taken yet.
    unsent: Vec<u8>,
}

impl Client {
    fn new(stream: TcpStream, speaks: Speaks) -> io::Result<Self> {
        stream.set_nodelay(true)?;
        stream.set_nonblocking(true)?;
        let (telnet, unsent) = match speaks {
            Speaks::Bytes => (None, Vec::new()),
            Speaks::Telnet => {
                let (telnet, greeting) = Telnet::new(Side::Server);
                (Some(telnet), greeting)
            }
        };
        Ok(Self { stream, telnet, unsent })
    }

    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        self.flush()?;
        let count = self.stream.read(room)?;
        let Some(telnet) = self.telnet.as_mut().filter(|_| count > 0) else { return Ok(count) };
        let received = telnet.receive(&room[..count]);
        self.unsent.extend(received.reply);
        self.flush()?;
        room[..received.data.len()].copy_from_slice(&received.data);
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

    /// Sends what the network takes.
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

impl Server {
    /// Lets the next host in; one that comes while another is there is turned away.
    fn accept(&mut self) {
        while let Ok((stream, _)) = self.listener.accept() {
            // Who opens the line again may be faster than the news that it was closed.
            if self.client.as_ref().is_none_or(Client::is_gone) {
                self.client = Client::new(stream, self.speaks).ok();
            }
        }
    }

    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        self.accept();
        let timeout_s = self.timeout.as_secs_f64();
        self.with_client(timeout_s, |client| match client.read(room) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            read => read,
        })
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.with_client(PATIENCE.as_secs_f64(), |client| client.write(bytes))
    }

    /// A client that fails is gone; one that has or takes nothing is waited for.
    fn with_client(
        &mut self,
        wait_s: f64,
        act: impl FnOnce(&mut Client) -> io::Result<usize>,
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

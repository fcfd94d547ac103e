//! Lines over the network: raw TCP to a serial server, and RFC 2217, which also sets the server's line.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use socket2::{SockRef, TcpKeepalive};

use super::address::NetworkAddress;
use super::line::{LineTransport, PortLine, StampAccuracy};
use super::settings::{Flow, LineSettings, Parity};
use super::telnet::{self, Telnet, TelnetSide};
use super::{PORT_READ_TIMEOUT, PORT_WRITE_TIMEOUT, PortAddress};
use crate::clock;
use crate::port::PortFinding::{self, NotRfc2217, ServerAway, ServerCloses, SettingRefused};
use crate::sync::lock;

/// Timeout of a connection, for each address of a server.
const CONNECT: Duration = Duration::from_secs(1);
/// A server whose line is in use accepts a connection and closes it within this time.
const TURNED_AWAY_S: f64 = 0.15;
/// Longest message of a server before it closes the connection, bytes; a bar sends more.
const LAST_WORDS: usize = 256;
/// Timeout of the answer to a command.
const ANSWER_S: f64 = 2.0;
/// Keepalive: silence before a probe, interval and number of probes.
const PROBE: Duration = Duration::from_secs(1);
const PROBES: u32 = 3;

pub(super) struct NetworkLine {
    stream: TcpStream,
    shared: Arc<Mutex<NetworkShared>>,
    stamps: StampAccuracy,
}

struct NetworkShared {
    /// `None` for raw TCP.
    telnet: Option<Telnet>,
    /// Whether no byte was received yet.
    is_new: bool,
    /// Bytes received while waiting for something else.
    early: VecDeque<u8>,
}

impl NetworkLine {
    pub(super) fn tcp(address: &NetworkAddress) -> Result<Self, PortFinding> {
        let mut line = Self::connect(address, LineTransport::Tcp)?;
        let name = PortAddress::Tcp(address.clone()).to_string();
        let began = clock::now();
        while clock::now().seconds_since(began) < TURNED_AWAY_S && line.shared().early.len() <= LAST_WORDS {
            if line.pump().is_err() {
                let said = line.shared().early.drain(..).collect::<Vec<_>>();
                let said = String::from_utf8_lossy(&said).trim().escape_default().to_string();
                return Err(ServerCloses { port: name, said });
            }
        }
        Ok(line)
    }

    pub(super) fn rfc2217(address: &NetworkAddress, settings: &LineSettings) -> Result<Self, PortFinding> {
        let mut line = Self::connect(address, LineTransport::Rfc2217)?;
        let port = PortAddress::Rfc2217(address.clone()).to_string();
        let closes = |_| ServerCloses { port: port.clone(), said: String::new() };
        let (telnet, greeting) = Telnet::new(TelnetSide::Client);
        line.shared().telnet = Some(telnet);
        line.stream.write_all(&greeting).map_err(closes)?;
        let agreed = line.wait(|telnet| telnet.com_port()).map_err(closes)?;
        if agreed != Some(true) {
            return Err(NotRfc2217 { port });
        }
        let settings_of_line = line_settings(settings);
        // All at once: the network is slower than the server.
        let commands = settings_of_line.iter().flat_map(|(_, code, value)| Telnet::command(*code, value));
        let controls =
            control_settings(settings).flat_map(|value| Telnet::command(telnet::SET_CONTROL, &[value]));
        let all: Vec<u8> = commands.chain(controls).collect();
        line.stream.write_all(&all).map_err(closes)?;
        for (setting, code, value) in settings_of_line {
            let set = line.wait(|telnet| telnet.answer(code)).map_err(closes)?;
            if set.as_deref() != Some(&value[..]) {
                let got = set.map_or("no answer".into(), |bytes| format!("{}", number(&bytes)));
                let asked = number(&value);
                return Err(SettingRefused { port, setting, asked, got });
            }
        }
        Ok(line)
    }

    fn connect(address: &NetworkAddress, transport: LineTransport) -> Result<Self, PortFinding> {
        let away = |error: io::Error| {
            let name = if transport == LineTransport::Rfc2217 {
                PortAddress::Rfc2217(address.clone())
            } else {
                PortAddress::Tcp(address.clone())
            };
            ServerAway { port: name.to_string(), why: error.to_string() }
        };
        let mut last = io::Error::new(ErrorKind::NotFound, "the name has no address");
        for socket in (address.host.as_str(), address.port).to_socket_addrs().map_err(away)? {
            let began = clock::now();
            match TcpStream::connect_timeout(&socket, CONNECT) {
                Ok(stream) => {
                    let held_ms = Some(1e3 * clock::now().seconds_since(began));
                    prepare(&stream).map_err(away)?;
                    let shared = Arc::new(Mutex::new(NetworkShared {
                        telnet: None,
                        is_new: true,
                        early: VecDeque::new(),
                    }));
                    return Ok(Self { stream, shared, stamps: StampAccuracy { transport, held_ms } });
                }
                Err(error) => last = error,
            }
        }
        Err(away(last))
    }

    fn shared(&self) -> MutexGuard<'_, NetworkShared> {
        lock(&self.shared)
    }

    /// Receives into `early`; an error if the connection was closed.
    fn pump(&mut self) -> io::Result<()> {
        let mut room = [0; 1024];
        match self.receive(&mut room) {
            Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                self.shared().early.extend(&room[..count]);
                Ok(())
            }
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Reads from the network and extracts the data.
    fn receive(&mut self, room: &mut [u8]) -> io::Result<usize> {
        let count = self.stream.read(room).map_err(|error| {
            // Unix reports a read timeout as `WouldBlock`.
            if error.kind() == ErrorKind::WouldBlock { ErrorKind::TimedOut.into() } else { error }
        })?;
        self.greet(&room[..count])?;
        let received = match &mut self.shared().telnet {
            Some(telnet) if count > 0 => telnet.receive(&room[..count]),
            _ => return Ok(count),
        };
        self.stream.write_all(&received.reply)?;
        room[..received.data.len()].copy_from_slice(&received.data);
        if received.data.is_empty() { Err(ErrorKind::Interrupted.into()) } else { Ok(received.data.len()) }
    }

    /// Speaks telnet from here on if the first bytes are the greeting of such a server: it doubles each 255 of the bar.
    fn greet(&mut self, bytes: &[u8]) -> io::Result<()> {
        let is_first = !bytes.is_empty() && std::mem::take(&mut self.shared().is_new);
        if is_first && self.shared().telnet.is_none() && Telnet::is_greeting(bytes) {
            let (telnet, greeting) = Telnet::new(TelnetSide::PlainClient);
            self.stream.write_all(&greeting)?;
            self.shared().telnet = Some(telnet);
        }
        Ok(())
    }

    /// Waits for an answer of telnet; `None` if it is late.
    fn wait<T>(&mut self, ask: impl Fn(&mut Telnet) -> Option<T>) -> io::Result<Option<T>> {
        let began = clock::now();
        loop {
            let found = self.shared().telnet.as_mut().and_then(&ask);
            if found.is_some() || clock::now().seconds_since(began) >= ANSWER_S {
                return Ok(found);
            }
            self.pump()?;
        }
    }
}

/// No delay for small packets; detection of a lost server.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(PORT_READ_TIMEOUT))?;
    stream.set_write_timeout(Some(PORT_WRITE_TIMEOUT))?;
    let socket = SockRef::from(stream);
    let asking = TcpKeepalive::new().with_time(PROBE).with_interval(PROBE);
    // Some systems have a fixed number of probes.
    let times = socket.set_tcp_keepalive(&asking.clone().with_retries(PROBES));
    times.or_else(|_| socket.set_tcp_keepalive(&asking))?;
    #[cfg(target_os = "linux")]
    socket.set_tcp_user_timeout(Some(PROBE * (PROBES + 1)))?;
    Ok(())
}

/// The settings that a server must confirm, with their numbers in RFC 2217.
fn line_settings(settings: &LineSettings) -> [(&'static str, u8, Vec<u8>); 4] {
    let parity = match settings.parity {
        Parity::None => 1,
        Parity::Odd => 2,
        Parity::Even => 3,
    };
    [
        ("baud rate", telnet::SET_BAUD, settings.baud.to_be_bytes().to_vec()),
        ("data bits", telnet::SET_DATA_BITS, vec![settings.data_bits]),
        ("parity (1 none, 2 odd, 3 even)", telnet::SET_PARITY, vec![parity]),
        ("stop bits", telnet::SET_STOP_BITS, vec![settings.stop_bits]),
    ]
}

/// Flow control and modem lines.
fn control_settings(settings: &LineSettings) -> impl Iterator<Item = u8> {
    let flow = match settings.flow {
        Flow::None => 1,
        Flow::XonXoff => 2,
        Flow::RtsCts => 3,
    };
    let rts = settings.rts.map(|level| if level { 11 } else { 12 });
    [Some(flow), settings.dtr.map(dtr), rts].into_iter().flatten()
}

fn dtr(level: bool) -> u8 {
    if level { 8 } else { 9 }
}

fn number(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0, |value, byte| value << 8 | u32::from(*byte))
}

impl PortLine for NetworkLine {
    fn read(&mut self, room: &mut [u8]) -> io::Result<usize> {
        let early = self.shared().early.read(room)?;
        if early > 0 { Ok(early) } else { self.receive(room) }
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let telnet = match &self.shared().telnet {
            Some(telnet) if telnet.is_suspended() => return Err(ErrorKind::TimedOut.into()),
            telnet => telnet.is_some(),
        };
        if !telnet {
            return self.stream.write(bytes);
        }
        self.stream.write_all(&Telnet::escaped(bytes))?;
        Ok(bytes.len())
    }

    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        self.stream.set_read_timeout(Some(timeout))
    }

    fn set_baud(&mut self, baud: u32) -> io::Result<()> {
        if self.stamps.transport == LineTransport::Tcp {
            return Ok(());
        }
        let asked = baud.to_be_bytes();
        self.stream.write_all(&Telnet::command(telnet::SET_BAUD, &asked))?;
        match self.wait(|telnet| telnet.answer(telnet::SET_BAUD))? {
            Some(set) if set == asked => Ok(()),
            Some(set) => Err(io::Error::other(format!("the server set {} baud", number(&set)))),
            None => Err(io::Error::other("the server does not answer")),
        }
    }

    fn set_dtr(&mut self, level: bool) -> io::Result<()> {
        if self.stamps.transport != LineTransport::Rfc2217 {
            return Ok(());
        }
        // Not every server answers.
        self.stream.write_all(&Telnet::command(telnet::SET_CONTROL, &[dtr(level)]))
    }

    fn handle(&self) -> io::Result<Box<dyn PortLine>> {
        let stream = self.stream.try_clone()?;
        Ok(Box::new(Self { stream, shared: Arc::clone(&self.shared), stamps: self.stamps }))
    }

    fn stamps(&self) -> StampAccuracy {
        self.stamps
    }

    fn is_plain_telnet(&self) -> bool {
        self.stamps.transport == LineTransport::Tcp && self.shared().telnet.is_some()
    }
}

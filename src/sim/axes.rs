//! The controller's side of its axes: the packets of each cycle, over a bad line.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::{Arc, Mutex};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::fault::Faults;
use crate::base::clock;
use crate::base::sync::lock;
use crate::base::units::DeviceTicks;
use crate::catalogue::AxesFinding;
use crate::device::axes::rtde::{self, Package};
use crate::device::axes::{AxesAddress, AxesProtocol, AxesSample, rsi};
use crate::diagnostic::Diagnostic;
use crate::robot::AXES;

/// The number of the recipe that the simulated controller gives.
pub const RECIPE: u8 = 1;

/// What became of the packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sent {
    /// Cycles that passed.
    pub cycles: u64,
    pub dropped: u64,
    /// Packets that were sent twice.
    pub doubled: u64,
    /// Packets that were overtaken.
    pub swapped: u64,
    pub spoiled: u64,
    pub bytes: u64,
}

/// Makes the packets of one controller.
#[derive(Clone, Debug)]
pub struct Publisher {
    protocol: AxesProtocol,
    faults: Faults,
    dice: Pcg64,
    /// The controller's clock at the first cycle, ticks.
    first_ticks: u64,
    overtaken: Option<Vec<u8>>,
    /// Packets on their way, each with the time at which it is there, s.
    under_way: VecDeque<(f64, Vec<u8>)>,
    pub sent: Sent,
}

impl Publisher {
    pub fn new(protocol: AxesProtocol, faults: &Faults, seed: u64, first_ticks: u64) -> Self {
        // A stream of its own, so that the bar's faults stay what they are.
        let dice = Pcg64::seed_from_u64(seed ^ 0x6178_6573);
        let (overtaken, under_way) = (None, VecDeque::new());
        Self { protocol, faults: *faults, dice, first_ticks, overtaken, under_way, sent: Sent::default() }
    }

    /// Seconds of the controller's clock in a second of the robot.
    pub fn pace(&self) -> f64 {
        1.0 + self.faults.axes_drift_ppm * 1e-6
    }

    /// A cycle at a time of the robot, s, with the axes in rad.
    pub fn cycle(&mut self, t_s: f64, measured: &[f64; AXES], commanded: &[f64; AXES]) {
        let clock_ns = t_s * self.pace() * 1e9;
        let ticks = (clock_ns / f64::from(self.protocol.tick_ns())).round() as u64;
        let sample = AxesSample {
            ticks: DeviceTicks(self.first_ticks + ticks),
            measured_deg: measured.map(f64::to_degrees),
            commanded_deg: Some(commanded.map(f64::to_degrees)),
            late: Some(0),
        };
        self.sent.cycles += 1;
        let spoiled = self.happens(self.faults.axes_spoil);
        let packet = match self.protocol {
            AxesProtocol::Rsi => {
                let mut packet = rsi::write(&sample).into_bytes();
                if spoiled {
                    let kept = self.dice.random_range(1..packet.len());
                    packet.truncate(kept);
                }
                packet
            }
            AxesProtocol::Rtde => rtde::data(if spoiled { RECIPE + 1 } else { RECIPE }, &sample),
        };
        self.sent.spoiled += u64::from(spoiled);
        self.carry(t_s + self.faults.axes_delay_ms * 1e-3, packet, spoiled);
    }

    fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.dice.random::<f64>() < probability
    }

    /// A packet over the line.
    fn carry(&mut self, at_s: f64, packet: Vec<u8>, spoiled: bool) {
        // One fault a packet, so that each can be accounted for.
        let faults = self.faults;
        if !spoiled && self.happens(faults.axes_drop) {
            self.sent.dropped += 1;
            return;
        }
        if !spoiled && self.overtaken.is_none() && self.happens(faults.axes_swap) {
            self.sent.swapped += 1;
            self.overtaken = Some(packet);
            return;
        }
        if !spoiled && self.happens(faults.axes_double) {
            self.sent.doubled += 1;
            self.go(at_s, packet.clone());
        }
        self.go(at_s, packet);
        if !spoiled && let Some(overtaken) = self.overtaken.take() {
            self.go(at_s, overtaken);
        }
    }

    fn go(&mut self, at_s: f64, packet: Vec<u8>) {
        self.sent.bytes += packet.len() as u64;
        self.under_way.push_back((at_s, packet));
    }

    /// The next packet that is there at a time, s.
    pub fn arrived(&mut self, t_s: f64) -> Option<Vec<u8>> {
        self.under_way.pop_front_if(|(at_s, _)| *at_s <= t_s).map(|(_, packet)| packet)
    }
}

/// RSI's cycle, s.
const RSI_CYCLE_S: f64 = 0.004;
/// How often requests are looked for, s.
const SERVED_EVERY_S: f64 = 0.002;
/// RTDE's shortest cycle, s.
const RTDE_CYCLE_S: f64 = 0.002;

/// The controller's line to whoever reads its axes.
pub enum AxesLine {
    Rsi {
        socket: UdpSocket,
        to: SocketAddr,
    },
    /// A thread serves whoever asks, also while the time of the robot is stopped.
    Rtde {
        client: Arc<Mutex<Option<Client>>>,
    },
}

/// Who asked for axes.
pub struct Client {
    stream: TcpStream,
    received: Vec<u8>,
    cycle_s: f64,
    started: bool,
}

impl AxesLine {
    /// Sends to `rsi://ADDR:PORT`, or serves at `rtde://ADDR:PORT`.
    ///
    /// # Errors
    /// When there is no socket for that.
    pub fn open(address: &AxesAddress) -> Result<Self, Diagnostic> {
        let failed = |error: io::Error| {
            let (address, why) = (address.to_string(), error.to_string());
            Diagnostic::from(AxesFinding::NotListening { address, why })
        };
        match address {
            AxesAddress::Rsi { listen: to, .. } => {
                let any: IpAddr =
                    if to.is_ipv4() { Ipv4Addr::UNSPECIFIED.into() } else { Ipv6Addr::UNSPECIFIED.into() };
                let socket = UdpSocket::bind((any, 0)).map_err(failed)?;
                Ok(Self::Rsi { socket, to: *to })
            }
            AxesAddress::Rtde { server, .. } => {
                let listener = TcpListener::bind((server.host.as_str(), server.port)).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                let client = Arc::<Mutex<Option<Client>>>::default();
                let shared = Arc::clone(&client);
                let serve = move || {
                    while Arc::strong_count(&shared) > 1 {
                        serve(&listener, &shared);
                        clock::sleep(SERVED_EVERY_S);
                    }
                };
                std::thread::Builder::new().name("rtde".into()).spawn(serve).map_err(failed)?;
                Ok(Self::Rtde { client })
            }
        }
    }

    pub fn protocol(&self) -> AxesProtocol {
        match self {
            Self::Rsi { .. } => AxesProtocol::Rsi,
            Self::Rtde { .. } => AxesProtocol::Rtde,
        }
    }

    /// The time between packets, s.
    pub fn cycle_s(&self) -> f64 {
        match self {
            Self::Rsi { .. } => RSI_CYCLE_S,
            Self::Rtde { client } => {
                lock(client).as_ref().map_or(4.0 * RTDE_CYCLE_S, |client| client.cycle_s)
            }
        }
    }

    /// Sends a packet to whoever wants it; one that nobody takes is lost.
    pub fn send(&mut self, packet: &[u8]) {
        match self {
            Self::Rsi { socket, to } => _ = socket.send_to(packet, *to),
            Self::Rtde { client } => {
                let mut client = lock(client);
                let gone = |client: &mut Client| client.started && client.stream.write_all(packet).is_err();
                if client.as_mut().is_some_and(gone) {
                    *client = None;
                }
            }
        }
    }
}

/// Lets a client in and answers its requests.
fn serve(listener: &TcpListener, client: &Mutex<Option<Client>>) {
    let mut client = lock(client);
    if let Ok((stream, _)) = listener.accept()
        && stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)).is_ok()
    {
        *client = Some(Client { stream, received: Vec::new(), cycle_s: 4.0 * RTDE_CYCLE_S, started: false });
    }
    if client.as_mut().is_some_and(|client| client.serve().is_err()) {
        *client = None;
    }
}

impl Client {
    /// An error where the client is gone or sends what is no request.
    fn serve(&mut self) -> io::Result<()> {
        let mut room = [0; 2048];
        match self.stream.read(&mut room) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => self.received.extend_from_slice(room.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error),
        }
        loop {
            let received = std::mem::take(&mut self.received);
            let package = rtde::next_package(&received).map_err(|_| ErrorKind::InvalidData)?;
            let Some(Package { kind, content, bytes }) = package else {
                self.received = received;
                return Ok(());
            };
            let answer = self.answer(kind, content);
            self.stream.write_all(&rtde::package(kind, &answer))?;
            self.received = received[bytes..].to_vec();
        }
    }

    /// The content of the answer to a request.
    fn answer(&mut self, kind: u8, content: &[u8]) -> Vec<u8> {
        match kind {
            rtde::ASK_VERSION => vec![u8::from(content == rtde::VERSION.to_be_bytes())],
            rtde::ASK_CONTROLLER => [5_u32, 12, 0, 0].iter().flat_map(|part| part.to_be_bytes()).collect(),
            rtde::SET_UP_OUTPUTS => {
                let Some((rate, names)) = content.split_first_chunk::<8>() else { return vec![0] };
                let cycles = (1.0 / f64::from_be_bytes(*rate) / RTDE_CYCLE_S).round();
                self.cycle_s = RTDE_CYCLE_S * if cycles.is_finite() { cycles.clamp(1.0, 500.0) } else { 1.0 };
                let names = String::from_utf8_lossy(names);
                // ur_rtde ends its list with a comma.
                let types = if names.trim_end_matches(',') == rtde::VARIABLES {
                    rtde::TYPES.to_owned()
                } else {
                    names.split(',').map(|_| "NOT_FOUND").collect::<Vec<_>>().join(",")
                };
                [&[RECIPE], types.as_bytes()].concat()
            }
            rtde::START | rtde::PAUSE => {
                self.started = kind == rtde::START;
                vec![1]
            }
            _ => vec![0],
        }
    }
}

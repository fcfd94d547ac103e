//! The controller's end of published axes (RSI, RTDE): one packet per cycle, over a faulty line.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::{Arc, Mutex};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::fault::InjectedFaults;
use dbbd_device::axes::AxesFinding;
use dbbd_device::axes::rtde::{self, RtdePackage};
use dbbd_device::axes::{AxesAddress, AxesProtocol, AxesSample, rsi};
use dbbd_device::clock;
use dbbd_device::sync::lock;
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::robot::AXES;

/// The RTDE recipe of the simulated controller.
pub const RECIPE: u8 = 1;

/// Counts of the packets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PacketsSent {
    /// Cycles of the controller.
    pub cycles: u64,
    pub dropped: u64,
    /// Packets that were sent twice.
    pub doubled: u64,
    /// Packets that the next one overtook.
    pub swapped: u64,
    pub spoiled: u64,
    pub bytes: u64,
}

/// Makes the packets of one controller.
#[derive(Clone, Debug)]
pub struct AxesPublisher {
    protocol: AxesProtocol,
    faults: InjectedFaults,
    random: Pcg64,
    /// The clock of the controller at the first cycle, ticks.
    first_ticks: u64,
    overtaken: Option<Vec<u8>>,
    /// Packets on the line, each with its time of arrival, s.
    on_line: VecDeque<(f64, Vec<u8>)>,
    pub sent: PacketsSent,
}

impl AxesPublisher {
    pub fn new(protocol: AxesProtocol, faults: &InjectedFaults, seed: u64, first_ticks: u64) -> Self {
        // A separate random stream, so that the stream of the bar's line is unchanged.
        let random = Pcg64::seed_from_u64(seed ^ 0x6178_6573);
        let (faults, on_line) = (*faults, VecDeque::new());
        Self { protocol, faults, random, first_ticks, overtaken: None, on_line, sent: PacketsSent::default() }
    }

    /// Seconds of the controller's clock per second of the robot.
    pub fn pace(&self) -> f64 {
        1.0 + self.faults.axes_drift_ppm * 1e-6
    }

    /// Sends the packet of a cycle at a time of the robot, s, with the axes in rad.
    pub fn cycle(&mut self, t_s: f64, measured: &[f64; AXES], commanded: &[f64; AXES]) {
        let clock_ns = t_s * self.pace() * 1e9;
        let ticks = (clock_ns / f64::from(self.protocol.tick_ns())).round() as u64;
        let sample = AxesSample {
            ticks: DeviceTicks(self.first_ticks + ticks),
            measured_deg: measured.map(f64::to_degrees),
            commanded_deg: Some(commanded.map(f64::to_degrees)),
            external: None,
            late: Some(0),
        };
        self.sent.cycles += 1;
        let is_spoiled = self.happens(self.faults.axes_spoil);
        let packet = match self.protocol {
            AxesProtocol::Rsi => {
                let mut packet = rsi::write_datagram(&sample).into_bytes();
                if is_spoiled {
                    let kept = self.random.random_range(1..packet.len());
                    packet.truncate(kept);
                }
                packet
            }
            AxesProtocol::Rtde => rtde::data(if is_spoiled { RECIPE + 1 } else { RECIPE }, &sample),
        };
        self.sent.spoiled += u64::from(is_spoiled);
        self.carry(t_s + self.faults.axes_delay_ms * 1e-3, packet, is_spoiled);
    }

    fn happens(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.random.random::<f64>() < probability
    }

    /// Puts a packet on the line. It has at most one fault, so that each fault can be accounted for.
    fn carry(&mut self, at_s: f64, packet: Vec<u8>, is_spoiled: bool) {
        let faults = self.faults;
        if !is_spoiled && self.happens(faults.axes_drop) {
            self.sent.dropped += 1;
            return;
        }
        if !is_spoiled && self.overtaken.is_none() && self.happens(faults.axes_swap) {
            self.sent.swapped += 1;
            self.overtaken = Some(packet);
            return;
        }
        if !is_spoiled && self.happens(faults.axes_double) {
            self.sent.doubled += 1;
            self.push(at_s, packet.clone());
        }
        self.push(at_s, packet);
        if !is_spoiled && let Some(overtaken) = self.overtaken.take() {
            self.push(at_s, overtaken);
        }
    }

    fn push(&mut self, at_s: f64, packet: Vec<u8>) {
        self.sent.bytes += packet.len() as u64;
        self.on_line.push_back((at_s, packet));
    }

    /// The next packet that has arrived at a time, s.
    pub fn arrived(&mut self, t_s: f64) -> Option<Vec<u8>> {
        self.on_line.pop_front_if(|(at_s, _)| *at_s <= t_s).map(|(_, packet)| packet)
    }
}

/// Cycle of RSI, s.
const RSI_CYCLE_S: f64 = 0.004;
/// Interval at which requests of RTDE are read, s.
const POLL_S: f64 = 0.002;
/// Shortest cycle of RTDE, s.
const RTDE_CYCLE_S: f64 = 0.002;

/// The line from the controller to the reader of its axes.
pub enum AxesLine {
    Rsi {
        socket: UdpSocket,
        to: SocketAddr,
    },
    /// Serves RTDE; a thread answers requests, also while the time of the robot is stopped.
    Rtde {
        client: Arc<Mutex<Option<RtdeClient>>>,
    },
}

/// The reader that is connected to RTDE.
pub struct RtdeClient {
    stream: TcpStream,
    received: Vec<u8>,
    cycle_s: f64,
    started: bool,
}

impl AxesLine {
    /// Opens a line: sends to `rsi://ADDR:PORT`, or serves at `rtde://ADDR:PORT`.
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
                let client = Arc::<Mutex<Option<RtdeClient>>>::default();
                let shared = Arc::clone(&client);
                let serve = move || {
                    while Arc::strong_count(&shared) > 1 {
                        serve_rtde(&listener, &shared);
                        clock::sleep(POLL_S);
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

    /// Sends a packet; without a reader it is lost.
    pub fn send(&mut self, packet: &[u8]) {
        match self {
            Self::Rsi { socket, to } => _ = socket.send_to(packet, *to),
            Self::Rtde { client } => {
                let mut client = lock(client);
                let is_gone =
                    |client: &mut RtdeClient| client.started && client.stream.write_all(packet).is_err();
                if client.as_mut().is_some_and(is_gone) {
                    *client = None;
                }
            }
        }
    }
}

/// Accepts a client and answers its requests.
fn serve_rtde(listener: &TcpListener, client: &Mutex<Option<RtdeClient>>) {
    let mut client = lock(client);
    if let Ok((stream, _)) = listener.accept()
        && stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true)).is_ok()
    {
        *client =
            Some(RtdeClient { stream, received: Vec::new(), cycle_s: 4.0 * RTDE_CYCLE_S, started: false });
    }
    if client.as_mut().is_some_and(|client| client.serve().is_err()) {
        *client = None;
    }
}

impl RtdeClient {
    /// Answers the requests of the client. Fails if the client is gone or sends something that is not a request.
    fn serve(&mut self) -> io::Result<()> {
        let mut buffer = [0; 2048];
        match self.stream.read(&mut buffer) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(count) => self.received.extend_from_slice(buffer.get(..count).unwrap_or_default()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error),
        }
        loop {
            let received = std::mem::take(&mut self.received);
            let package = rtde::next_package(&received).map_err(|_| ErrorKind::InvalidData)?;
            let Some(RtdePackage { kind, content, bytes }) = package else {
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
            rtde::ASK_VERSION => vec![u8::from(content == rtde::RTDE_VERSION.to_be_bytes())],
            rtde::ASK_CONTROLLER => [5_u32, 12, 0, 0].iter().flat_map(|part| part.to_be_bytes()).collect(),
            rtde::SET_UP_OUTPUTS => {
                let Some((rate, names)) = content.split_first_chunk::<8>() else { return vec![0] };
                let cycles = (1.0 / f64::from_be_bytes(*rate) / RTDE_CYCLE_S).round();
                self.cycle_s = RTDE_CYCLE_S * if cycles.is_finite() { cycles.clamp(1.0, 500.0) } else { 1.0 };
                let names = String::from_utf8_lossy(names);
                // The client ur_rtde ends its list with a comma.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn publisher(faults: InjectedFaults) -> AxesPublisher {
        AxesPublisher::new(AxesProtocol::Rsi, &faults, 1, 1000)
    }

    fn arrived(publisher: &mut AxesPublisher, t_s: f64) -> usize {
        std::iter::from_fn(|| publisher.arrived(t_s)).count()
    }

    #[test]
    fn packet_arrives_after_its_delay() {
        let mut publisher = publisher(InjectedFaults { axes_delay_ms: 30.0, ..InjectedFaults::default() });
        publisher.cycle(0.1, &[0.0; AXES], &[0.0; AXES]);
        publisher.cycle(0.104, &[0.0; AXES], &[0.0; AXES]);
        assert_eq!(arrived(&mut publisher, 0.129), 0);
        assert_eq!(arrived(&mut publisher, 0.131), 1);
        assert_eq!(arrived(&mut publisher, 0.2), 1);
        assert_eq!((publisher.sent.cycles, publisher.sent.dropped), (2, 0));
    }

    #[test]
    fn faults_of_the_packets_are_counted() {
        let none = InjectedFaults::default();
        for (faults, counts, packets) in [
            (none, [0, 0, 0, 0], 6),
            (InjectedFaults { axes_drop: 1.0, ..none }, [6, 0, 0, 0], 0),
            (InjectedFaults { axes_double: 1.0, ..none }, [0, 6, 0, 0], 12),
            // Each second packet overtakes the one before.
            (InjectedFaults { axes_swap: 1.0, ..none }, [0, 0, 3, 0], 6),
            (InjectedFaults { axes_spoil: 1.0, axes_drop: 1.0, ..none }, [0, 0, 0, 6], 6),
        ] {
            let mut publisher = publisher(faults);
            for cycle in 0..6 {
                publisher.cycle(f64::from(cycle) * 0.004, &[0.0; AXES], &[0.0; AXES]);
            }
            let PacketsSent { cycles, dropped, doubled, swapped, spoiled, .. } = publisher.sent;
            assert_eq!((cycles, [dropped, doubled, swapped, spoiled]), (6, counts));
            assert_eq!(arrived(&mut publisher, 1.0), packets);
        }
    }

    /// RSI counts in ms.
    #[test]
    fn clock_of_the_controller_drifts() {
        let fast = InjectedFaults { axes_drift_ppm: 500.0, ..InjectedFaults::default() };
        let mut publisher = publisher(fast);
        assert!((publisher.pace() - 1.0005).abs() < 1e-12);
        publisher.cycle(100.0, &[0.25; AXES], &[0.5; AXES]);
        let packet = publisher.arrived(100.0).expect("a packet was sent");
        let sample = rsi::read_datagram(&packet).expect("it is a datagram");
        assert_eq!(sample.ticks, DeviceTicks(1000 + 100_050));
        assert!((sample.measured_deg[2] - 0.25_f64.to_degrees()).abs() < 1e-3);
        assert!((sample.commanded_deg.expect("it is sent")[3] - 0.5_f64.to_degrees()).abs() < 1e-3);
    }
}

//! The connection to a controller that publishes its axes: a listener for KUKA RSI (UDP) or a client of UR RTDE (TCP).
//!
//! A thread reads and timestamps; the recorder writes and decodes. Nothing is sent to an RSI controller unless the
//! address requests it: a wrong answer could move the robot, a missing one may stop it.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use dbbd_device::axes::AxesFinding::{self, ControllerAway, NotListening, Refused};
use dbbd_device::axes::{AxesAddress, AxesDecoder, AxesProtocol, PacketContent, RsiAnswer, rsi, rtde};
use dbbd_device::clock;
use dbbd_device::port::NetworkAddress;
use dbbd_job::recording::capture::RunEvent;
use dbbd_model::base::units::HostNs;

/// Arrivals that may wait for the recorder: several seconds.
const QUEUE: usize = 4096;
/// Interval at which the thread checks whether the run is over.
const AXES_STOP_CHECK_INTERVAL: Duration = Duration::from_millis(20);
/// Timeout for a connection and for an answer.
const ANSWER_TIME: Duration = Duration::from_secs(2);
/// Pause between attempts to reconnect, s.
const BACKOFF_S: f64 = 0.5;

#[derive(Debug)]
pub(super) enum AxesArrival {
    /// A datagram, or the bytes of one read.
    Bytes(Vec<u8>),
    Event(RunEvent),
}

/// Receives the packets of a controller until it is dropped.
#[derive(Debug)]
pub struct AxesSource {
    address: SocketAddr,
    arrivals: Receiver<(HostNs, AxesArrival)>,
    stop: Arc<AtomicBool>,
}

impl AxesSource {
    /// Listens for RSI, or connects to an RTDE server and sets up its output.
    pub fn open(address: &AxesAddress) -> Result<Self, AxesFinding> {
        let (sender, arrivals) = sync_channel(QUEUE);
        let stop = Arc::new(AtomicBool::new(false));
        let line = AxesThread { address: address.clone(), sender, stop: Arc::clone(&stop) };
        let address = match *address {
            AxesAddress::Rsi { listen, answer } => line.listen(listen, answer)?,
            AxesAddress::Rtde { .. } => line.poll()?,
        };
        Ok(Self { address, arrivals, stop })
    }

    /// The address at which RSI is received, or the address of the RTDE controller.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    pub(super) fn next(&self) -> Option<(HostNs, AxesArrival)> {
        self.arrivals.try_recv().ok()
    }
}

impl Drop for AxesSource {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// The state of the receiving thread.
struct AxesThread {
    address: AxesAddress,
    sender: SyncSender<(HostNs, AxesArrival)>,
    stop: Arc<AtomicBool>,
}

impl AxesThread {
    fn over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn away(&self, error: io::Error) -> AxesFinding {
        ControllerAway { address: self.address.to_string(), why: error.to_string() }
    }

    /// Sends an arrival to the recorder; it is ignored once the run is over.
    fn send(&self, host: HostNs, arrival: AxesArrival) {
        let _ = self.sender.send((host, arrival));
    }

    fn event(&self, event: RunEvent) {
        self.send(clock::now(), AxesArrival::Event(event));
    }

    fn remark(&self, text: String) {
        self.event(RunEvent::Mark { text: format!("axes: {text}") });
    }

    fn opened(&self) {
        self.event(RunEvent::AxesOpened {
            address: self.address.to_string(),
            protocol: self.address.protocol(),
        });
    }

    fn listen(self, listen: SocketAddr, answer: RsiAnswer) -> Result<SocketAddr, AxesFinding> {
        let wrong =
            |error: io::Error| NotListening { address: self.address.to_string(), why: error.to_string() };
        let socket = UdpSocket::bind(listen).map_err(wrong)?;
        socket.set_read_timeout(Some(AXES_STOP_CHECK_INTERVAL)).map_err(wrong)?;
        let bound = socket.local_addr().map_err(wrong)?;
        let no_thread = wrong(io::Error::other("no thread"));
        self.opened();
        std::thread::Builder::new()
            .name("axes".into())
            .spawn(move || self.receive(&socket, answer))
            .map_err(|_| no_thread)?;
        Ok(bound)
    }

    /// Receives the datagrams of the first controller that sends one.
    fn receive(&self, socket: &UdpSocket, answer: RsiAnswer) {
        let mut room = vec![0; rsi::MAX_DATAGRAM_BYTES + 1];
        let (mut controller, mut unrecorded, mut strangers): (Option<IpAddr>, u64, u64) = (None, 0, 0);
        while !self.over() {
            // The error may refer to an earlier answer, which nobody received.
            let Ok((count, from)) = socket.recv_from(&mut room) else { continue };
            let host = clock::now();
            let bytes = room.get(..count).unwrap_or_default();
            if controller.is_none() {
                self.remark(format!("{from} sends"));
            }
            if *controller.get_or_insert(from.ip()) != from.ip() {
                strangers += 1;
                if strangers == 1 {
                    self.remark(format!("{from} sends as well, and is ignored"));
                }
                continue;
            }
            if answer == RsiAnswer::Zero
                && let Ok(sample) = rsi::read_datagram(bytes)
            {
                // Fails if the controller is gone.
                let _ = socket.send_to(rsi::zero_answer(sample.ticks).as_bytes(), from);
            }
            match self.sender.try_send((host, AxesArrival::Bytes(bytes.to_vec()))) {
                Ok(()) if unrecorded > 0 => {
                    self.remark(format!("{unrecorded} packets were not recorded: the recorder was too slow"));
                    unrecorded = 0;
                }
                Ok(()) => {}
                Err(TrySendError::Full(_)) => unrecorded += 1,
                Err(TrySendError::Disconnected(_)) => break,
            }
        }
    }

    fn poll(self) -> Result<SocketAddr, AxesFinding> {
        let mut stream = self.connect()?;
        let controller = stream.peer_addr().map_err(|error| self.away(error))?;
        let no_thread = self.away(io::Error::other("no thread"));
        std::thread::Builder::new()
            .name("axes".into())
            .spawn(move || {
                while !self.over() {
                    let why = self.read(&mut stream);
                    if self.over() {
                        break;
                    }
                    self.remark(format!("the controller is gone: {why}"));
                    let Some(again) = self.reconnect() else { break };
                    stream = again;
                }
            })
            .map_err(|_| no_thread)?;
        Ok(controller)
    }

    /// Connects and sets up the output recipe. The bytes of the set-up are recorded too.
    fn connect(&self) -> Result<TcpStream, AxesFinding> {
        let AxesAddress::Rtde { server: NetworkAddress { host, port }, rate_hz } = &self.address else {
            return Err(Refused { address: self.address.to_string(), step: "protocol" });
        };
        let away = |error| self.away(error);
        let mut connected = Err(io::Error::new(ErrorKind::NotFound, "the name has no address"));
        for socket in (host.as_str(), *port).to_socket_addrs().map_err(away)? {
            connected = TcpStream::connect_timeout(&socket, ANSWER_TIME);
            if connected.is_ok() {
                break;
            }
        }
        let mut stream = connected.map_err(away)?;
        stream
            .set_nodelay(true)
            .and_then(|()| stream.set_read_timeout(Some(AXES_STOP_CHECK_INTERVAL)))
            .map_err(away)?;
        self.opened();
        let mut decoder = AxesDecoder::new(AxesProtocol::Rtde);
        for (request, step) in rtde::requests(*rate_hz).iter().zip(["protocol version", "recipe", "start"]) {
            stream.write_all(request).map_err(away)?;
            if !self.accepted(&mut stream, &mut decoder).map_err(away)? {
                return Err(Refused { address: self.address.to_string(), step });
            }
        }
        Ok(stream)
    }

    /// Whether the controller accepts the last request in time.
    fn accepted(&self, stream: &mut TcpStream, decoder: &mut AxesDecoder) -> io::Result<bool> {
        let began = clock::now();
        let mut room = [0; 4096];
        while clock::now().seconds_since(began) < ANSWER_TIME.as_secs_f64() {
            let count = match stream.read(&mut room) {
                Ok(0) => return Ok(false),
                Ok(count) => count,
                Err(error) if idle(&error) => continue,
                Err(error) => return Err(error),
            };
            let bytes = room.get(..count).unwrap_or_default();
            self.send(clock::now(), AxesArrival::Bytes(bytes.to_vec()));
            let mut answer = None;
            decoder.push(bytes, |packet| {
                if let PacketContent::Answer { accepted } = packet.content {
                    answer = Some(accepted);
                }
            });
            if let Some(answer) = answer {
                return Ok(answer);
            }
        }
        Ok(false)
    }

    /// Reads until the connection ends, and returns the reason.
    fn read(&self, stream: &mut TcpStream) -> String {
        let mut room = [0; 4096];
        while !self.over() {
            match stream.read(&mut room) {
                Ok(0) => return "it closed the connection".into(),
                Ok(count) => {
                    let bytes = room.get(..count).unwrap_or_default().to_vec();
                    if self.sender.send((clock::now(), AxesArrival::Bytes(bytes))).is_err() {
                        return "the run is over".into();
                    }
                }
                Err(error) if idle(&error) => {}
                Err(error) => return error.to_string(),
            }
        }
        String::new()
    }

    /// Connects again. `None` when the run is over.
    fn reconnect(&self) -> Option<TcpStream> {
        while !self.over() {
            if let Ok(stream) = self.connect() {
                return Some(stream);
            }
            clock::sleep(BACKOFF_S);
        }
        None
    }
}

fn idle(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

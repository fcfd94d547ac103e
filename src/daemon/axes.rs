//! The line to a controller that publishes its axes: a listener for KUKA RSI (UDP), a client of UR RTDE (TCP).
//!
//! A thread reads, stamps and hands over; the recorder writes and decodes. Nothing is sent to an RSI controller unless
//! the address asks for it: a wrong answer could move the robot, one that is missing may stop it.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

use crate::base::clock;
use crate::base::units::HostNs;
use crate::catalogue::AxesFinding::{self, ControllerAway, NotListening, Refused};
use crate::device::axes::{Answer, AxesAddress, AxesDecoder, AxesProtocol, PacketContent, rsi, rtde};
use crate::device::port::NetworkAddress;
use crate::recording::capture::Event;

/// Arrivals that wait for the recorder: several seconds.
const QUEUE: usize = 4096;
/// How often the thread looks whether the run is over.
const PATIENCE: Duration = Duration::from_millis(20);
/// How long a controller may take to accept, and to answer a request.
const ANSWER: Duration = Duration::from_secs(2);
/// Pause between attempts to reach a controller that went away, s.
const BACKOFF_S: f64 = 0.5;

/// What comes from the controller.
#[derive(Debug)]
pub(super) enum AxesArrival {
    /// A datagram, or the bytes of one read.
    Bytes(Vec<u8>),
    /// What is to be said in the capture.
    Event(Event),
}

/// Listens to a controller, or asks it, until it is dropped.
#[derive(Debug)]
pub struct AxesSource {
    address: SocketAddr,
    arrivals: Receiver<(HostNs, AxesArrival)>,
    stop: Arc<AtomicBool>,
}

impl AxesSource {
    /// Listens, or connects and agrees on what is sent.
    ///
    /// # Errors
    /// When the address cannot be listened on, or the controller is away or refuses.
    pub fn open(address: &AxesAddress) -> Result<Self, AxesFinding> {
        let (sender, arrivals) = sync_channel(QUEUE);
        let stop = Arc::new(AtomicBool::new(false));
        let line = Line { address: address.clone(), sender, stop: Arc::clone(&stop) };
        let address = match *address {
            AxesAddress::Rsi { listen, answer } => line.listen(listen, answer)?,
            AxesAddress::Rtde { .. } => line.ask()?,
        };
        Ok(Self { address, arrivals, stop })
    }

    /// Where it listens, or the controller's address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What came next, and when.
    pub(super) fn next(&self) -> Option<(HostNs, AxesArrival)> {
        self.arrivals.try_recv().ok()
    }
}

impl Drop for AxesSource {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// The thread's end.
struct Line {
    address: AxesAddress,
    sender: SyncSender<(HostNs, AxesArrival)>,
    stop: Arc<AtomicBool>,
}

impl Line {
    fn over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Hands over; nobody takes it once the run is over.
    fn send(&self, host: HostNs, arrival: AxesArrival) {
        let _ = self.sender.send((host, arrival));
    }

    fn remark(&self, text: String) {
        self.send(clock::now(), AxesArrival::Event(Event::Mark { text: format!("axes: {text}") }));
    }

    fn opened(&self) {
        let (address, protocol) = (self.address.to_string(), self.address.protocol());
        self.send(clock::now(), AxesArrival::Event(Event::AxesOpened { address, protocol }));
    }

    fn listen(self, listen: SocketAddr, answer: Answer) -> Result<SocketAddr, AxesFinding> {
        let wrong =
            |error: io::Error| NotListening { address: self.address.to_string(), why: error.to_string() };
        let socket = UdpSocket::bind(listen).map_err(wrong)?;
        socket.set_read_timeout(Some(PATIENCE)).map_err(wrong)?;
        let bound = socket.local_addr().map_err(wrong)?;
        let failed = NotListening { address: self.address.to_string(), why: "no thread".into() };
        self.opened();
        std::thread::Builder::new()
            .name("axes".into())
            .spawn(move || self.receive(&socket, answer))
            .map_err(|_| failed)?;
        Ok(bound)
    }

    /// Takes the datagrams of the first controller that sends any.
    fn receive(&self, socket: &UdpSocket, answer: Answer) {
        let mut room = vec![0; rsi::LONGEST + 1];
        let (mut controller, mut unrecorded, mut strangers): (Option<IpAddr>, u64, u64) = (None, 0, 0);
        while !self.over() {
            // An error of an earlier answer (nobody is at its port) is none of what comes.
            let Ok((count, from)) = socket.recv_from(&mut room) else { continue };
            let host = clock::now();
            let bytes = room.get(..count).unwrap_or_default();
            if controller.is_none() {
                self.remark(format!("{from} sends"));
            }
            if *controller.get_or_insert(from.ip()) != from.ip() {
                strangers += 1;
                if strangers == 1 {
                    self.remark(format!("{from} sends as well, and is not listened to"));
                }
                continue;
            }
            if answer == Answer::Zero
                && let Ok(sample) = rsi::read(bytes)
            {
                // A controller that is gone takes no answer.
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

    fn ask(self) -> Result<SocketAddr, AxesFinding> {
        let mut stream = self.connect()?;
        let wrong =
            |error: io::Error| ControllerAway { address: self.address.to_string(), why: error.to_string() };
        let controller = stream.peer_addr().map_err(wrong)?;
        let failed = ControllerAway { address: self.address.to_string(), why: "no thread".into() };
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
            .map_err(|_| failed)?;
        Ok(controller)
    }

    /// Connects, and agrees on the recipe; what came meanwhile is handed over.
    fn connect(&self) -> Result<TcpStream, AxesFinding> {
        let AxesAddress::Rtde { server: NetworkAddress { host, port }, rate_hz } = &self.address else {
            return Err(Refused { address: self.address.to_string(), step: "protocol" });
        };
        let away =
            |error: io::Error| ControllerAway { address: self.address.to_string(), why: error.to_string() };
        let mut last = io::Error::new(ErrorKind::NotFound, "the name has no address");
        let mut connected = None;
        for socket in (host.as_str(), *port).to_socket_addrs().map_err(away)? {
            match TcpStream::connect_timeout(&socket, ANSWER) {
                Ok(stream) => {
                    connected = Some(stream);
                    break;
                }
                Err(error) => last = error,
            }
        }
        let mut stream = connected.ok_or(last).map_err(away)?;
        stream.set_nodelay(true).and_then(|()| stream.set_read_timeout(Some(PATIENCE))).map_err(away)?;
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

    /// Whether the request that was sent last is accepted, in time.
    fn accepted(&self, stream: &mut TcpStream, decoder: &mut AxesDecoder) -> io::Result<bool> {
        let began = clock::now();
        let mut room = [0; 4096];
        while clock::now().seconds_since(began) < ANSWER.as_secs_f64() {
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

    /// Hands over what comes until the connection ends; why it did.
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

    /// Tries until the controller is back; `None` when the run is over.
    fn reconnect(&self) -> Option<TcpStream> {
        while !self.over() {
            match self.connect() {
                Ok(stream) => return Some(stream),
                Err(_) => clock::sleep(BACKOFF_S),
            }
        }
        None
    }
}

fn idle(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

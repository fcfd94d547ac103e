//! The server of the channel over which a program reports its dwells: EthernetKRL, TCP.
//!
//! The controller connects for each module and closes at its end; one that was switched off closes
//! nothing, so a new connection is taken while an old one is still open. A telegram is answered when it
//! is in the capture, not before. One that cannot be meant (not readable, of another plan, of a row that
//! the plan does not have) is answered with 0, at which the program halts.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::base::clock;
use crate::base::sync::lock;
use crate::base::units::HostNs;
use crate::catalogue::PortFinding::{self, NotListening};
use crate::recording::{Telegram, TelegramReader, TelegramResult};

/// Connections at a time: the controller's, and some that it left behind. A further one takes the place of that which
/// has sent no telegram for the longest.
const MOST: usize = 8;
/// What was heard and is not recorded yet; each connection waits for its answer, so there is never more.
const QUEUE: usize = 4 * MOST;
/// How often the threads look whether the run is over.
const PATIENCE: Duration = Duration::from_millis(20);

/// Something that happened on the channel.
#[derive(Debug)]
pub(super) enum ChannelEvent {
    /// A telegram, and where its answer is waited for: the `Id` of the acknowledgement.
    Telegram(Telegram, SyncSender<u32>),
    /// What is worth a remark in the capture.
    Remark(String),
    /// The last connection was closed.
    Quiet,
}

/// Listens, and hands over what happens.
#[derive(Debug)]
pub struct Server {
    address: SocketAddr,
    events: Receiver<(HostNs, ChannelEvent)>,
    stop: Arc<AtomicBool>,
}

impl Server {
    /// Listens at an address; port 0 is any that is free.
    ///
    /// # Errors
    /// When the address is taken or none of this computer's.
    pub fn listen(address: SocketAddr) -> Result<Self, PortFinding> {
        let error = |error: io::Error| NotListening { address: address.to_string(), why: error.to_string() };
        let listener = TcpListener::bind(address).map_err(error)?;
        listener.set_nonblocking(true).map_err(error)?;
        let address = listener.local_addr().map_err(error)?;
        let (sender, events) = sync_channel(QUEUE);
        let stop = Arc::new(AtomicBool::new(false));
        let channel = Channel { sender, stop: Arc::clone(&stop), open: Arc::default() };
        std::thread::Builder::new()
            .name("ekrl".into())
            .spawn(move || channel.accept(&listener))
            .map_err(error)?;
        Ok(Self { address, events, stop })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What happened next, with the time at which it came.
    pub(super) fn next(&self) -> Option<(HostNs, ChannelEvent)> {
        self.events.try_recv().ok()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// What the threads of the connections share.
#[derive(Clone)]
struct Channel {
    sender: SyncSender<(HostNs, ChannelEvent)>,
    stop: Arc<AtomicBool>,
    open: Arc<Mutex<Vec<Arc<Client>>>>,
}

/// A connection.
#[derive(Debug, Default)]
struct Client {
    /// When its last telegram came, ns; 0 for none.
    heard_ns: AtomicU64,
    /// Whether another one has its place.
    replaced: AtomicBool,
}

impl Channel {
    fn over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Hands over; nobody listens any more once the run is over.
    fn send(&self, event: ChannelEvent) {
        let _ = self.sender.send((clock::now(), event));
    }

    fn accept(&self, listener: &TcpListener) {
        let mut failing = false;
        while !self.over() {
            match listener.accept() {
                Ok((stream, from)) => {
                    failing = false;
                    self.take(stream, from);
                }
                Err(error) => {
                    // Said once, not fifty times a second.
                    if error.kind() != ErrorKind::WouldBlock && !std::mem::replace(&mut failing, true) {
                        self.send(ChannelEvent::Remark(format!("EthernetKRL: nobody can connect: {error}")));
                    }
                    clock::sleep(PATIENCE.as_secs_f64());
                }
            }
        }
    }

    fn take(&self, stream: TcpStream, from: SocketAddr) {
        let client = self.enter();
        let (channel, entered) = (self.clone(), Arc::clone(&client));
        let spawned = std::thread::Builder::new().name("ekrl-client".into()).spawn(move || {
            channel.send(ChannelEvent::Remark(format!("EthernetKRL: {from} has connected")));
            let (reader, why) = channel.serve(stream, &client);
            let left = match (reader.pending(), reader.skipped()) {
                (0, 0) => String::new(),
                (0, skipped) => format!(", {skipped} bytes of it were no telegram"),
                (pending, 0) => format!(" in the middle of a telegram ({pending} bytes)"),
                (pending, skipped) => {
                    format!(
                        " in the middle of a telegram ({pending} bytes), {skipped} bytes were no telegram"
                    )
                }
            };
            channel.send(ChannelEvent::Remark(format!("EthernetKRL: {from} {why}{left}")));
            if channel.leave(&client) == 0 {
                channel.send(ChannelEvent::Quiet);
            }
        });
        if let Err(error) = spawned {
            self.leave(&entered);
            self.send(ChannelEvent::Remark(format!("EthernetKRL: {from} was turned away: {error}")));
        }
    }

    /// A place for a client, that of another if there is none.
    fn enter(&self) -> Arc<Client> {
        let client = Arc::<Client>::default();
        let mut open = lock(&self.open);
        if open.len() >= MOST {
            let heard = |at: &usize| open[*at].heard_ns.load(Ordering::Relaxed);
            if let Some(idle) = (0..open.len()).min_by_key(heard) {
                open.remove(idle).replaced.store(true, Ordering::Relaxed);
            }
        }
        open.push(Arc::clone(&client));
        client
    }

    /// How many are left.
    fn leave(&self, client: &Arc<Client>) -> usize {
        let mut open = lock(&self.open);
        open.retain(|other| !Arc::ptr_eq(other, client));
        open.len()
    }

    /// Answers one client until it goes; what its reader has left, and why it went.
    fn serve(&self, mut stream: TcpStream, client: &Client) -> (TelegramReader, String) {
        let mut reader = TelegramReader::default();
        let set = stream
            .set_nonblocking(false)
            .and_then(|()| stream.set_read_timeout(Some(PATIENCE)))
            .and_then(|()| stream.set_write_timeout(Some(Duration::from_secs(1))))
            .and_then(|()| stream.set_nodelay(true));
        if let Err(error) = set {
            return (reader, format!("was given up: {error}"));
        }
        let mut bytes = [0; 2048];
        while !self.over() {
            if client.replaced.load(Ordering::Relaxed) {
                return (reader, format!("was idle the longest of {MOST}, and was left for another"));
            }
            let count = match stream.read(&mut bytes) {
                Ok(0) => return (reader, "has closed".into()),
                Ok(count) => count,
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return (reader, format!("is gone: {error}")),
            };
            for heard in reader.push(bytes.get(..count).unwrap_or_default()) {
                client.heard_ns.store(clock::now().0, Ordering::Relaxed);
                let Some(id) = self.answer(heard) else {
                    return (reader, "was left: the run is over".into());
                };
                if let Err(error) = stream.write_all(format!("<Ack Id=\"{id}\"/>\n").as_bytes()) {
                    return (reader, format!("took no answer: {error}"));
                }
            }
        }
        (reader, "was left: the run is over".into())
    }

    /// Hands a telegram over and waits until it is recorded; `None` when the run is over.
    fn answer(&self, heard: TelegramResult) -> Option<u32> {
        match heard {
            TelegramResult::Telegram(telegram) => {
                let (sender, answer) = sync_channel(1);
                self.send(ChannelEvent::Telegram(telegram, sender));
                answer.recv().ok()
            }
            TelegramResult::Malformed(why) => {
                self.send(ChannelEvent::Remark(format!("EthernetKRL: a telegram is not understood: {why}")));
                Some(0)
            }
        }
    }
}

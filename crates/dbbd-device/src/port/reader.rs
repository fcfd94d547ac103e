//! The reading thread: each read is stamped at once and passed on through a queue.

use std::io::ErrorKind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use super::{PORT_READ_TIMEOUT, Port};
use crate::clock;
use crate::port::PortFinding::{self, PortRefused};
use dbbd_model::base::units::HostNs;

/// Bytes that may wait for the recorder before further ones are lost: half a minute of a bar of 1 kHz.
const ROOM: u64 = 4 << 20;
/// What an arrival takes besides its bytes.
const OVERHEAD: u64 = 64;
/// Time for which a reader that ends still takes what the line holds, s.
const REST_S: f64 = 0.1;

/// The bytes of one read.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// When the read returned.
    pub host: HostNs,
    /// For how long the line was watched before, since the last bytes, s. The rest of the time this computer did not look.
    pub watched_s: f64,
    pub bytes: Vec<u8>,
}

/// A report of the reading thread.
#[derive(Clone, Debug, PartialEq)]
pub enum Arrival {
    Bytes(Received),
    /// The bar is a simulated one: its mark was read.
    Simulated(HostNs),
    /// Number of bytes dropped since, because the recorder was too slow.
    Lost(HostNs, u64),
    /// The thread has ended as it was asked to, and for how long the line was watched since the last bytes, s.
    Ended(HostNs, f64),
    /// The port is gone, and why; the thread has ended.
    Gone(HostNs, String),
}

/// The reading thread and the queue of its reports.
pub struct PortReader {
    stop: Arc<AtomicBool>,
    is_dropped: Arc<AtomicBool>,
    waiting: Arc<AtomicU64>,
    receiver: Receiver<Arrival>,
    thread: Option<JoinHandle<()>>,
}

impl PortReader {
    pub fn start(port: Port) -> Result<Self, PortFinding> {
        let (sender, receiver) = channel();
        let (stop, waiting) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
        let is_dropped = Arc::new(AtomicBool::new(false));
        let outbox = ArrivalOutbox {
            sender,
            waiting: Arc::clone(&waiting),
            stop: Arc::clone(&stop),
            is_dropped: Arc::clone(&is_dropped),
            lost: None,
        };
        let name = port.name.clone();
        let thread = std::thread::Builder::new()
            .name("reader".into())
            .spawn(move || read_port(port, outbox))
            .map_err(|error| PortRefused { port: name, why: error.to_string() })?;
        Ok(Self { stop, is_dropped, waiting, receiver, thread: Some(thread) })
    }

    /// The next report; `Disconnected` after the last one.
    pub fn next(&self, patience: Duration) -> Result<Arrival, RecvTimeoutError> {
        let arrival = self.receiver.recv_timeout(patience)?;
        if let Arrival::Bytes(received) = &arrival {
            self.waiting.fetch_sub(received.bytes.len() as u64 + OVERHEAD, Ordering::Relaxed);
        }
        Ok(arrival)
    }

    /// Asks the thread to end. It takes what the line still holds; then [`Self::next`] gives its last reports.
    pub fn end(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl Drop for PortReader {
    fn drop(&mut self) {
        self.end();
        self.is_dropped.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was already reported on stderr.
            let _ = thread.join();
        }
    }
}

fn read_port(mut port: Port, mut outbox: ArrivalOutbox) {
    let waits = port.stamps().transport.waits();
    let mut buffer = [0; 4096];
    let (mut watched_s, mut ends) = (0.0_f64, None::<HostNs>);
    let mut is_simulated = port.is_simulated();
    let gone = loop {
        let asked = clock::now();
        if outbox.stop.load(Ordering::Relaxed) && asked.seconds_since(*ends.get_or_insert(asked)) > REST_S {
            break None;
        }
        let read = port.line.read(&mut buffer);
        let host = clock::now();
        // A read that takes longer than its timeout was held up: this computer stood still.
        watched_s += host.seconds_since(asked).min(PORT_READ_TIMEOUT.as_secs_f64());
        if port.is_simulated() && !is_simulated {
            is_simulated = true;
            // Fails if the receiver was dropped.
            let _ = outbox.sender.send(Arrival::Simulated(host));
        }
        match read {
            Ok(0) => break Some("the line ended".to_owned()),
            Ok(count) => {
                let bytes = buffer[..count.min(buffer.len())].to_vec();
                let received = Received { host, watched_s: std::mem::take(&mut watched_s), bytes };
                if outbox.send(received, waits).is_err() {
                    return;
                }
            }
            Err(error) if error.kind() == ErrorKind::TimedOut && ends.is_some() => break None,
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
            Err(error) => break Some(error.to_string()),
        }
    };
    let host = clock::now();
    let lost = outbox.lost.take().map(|(since, bytes)| Arrival::Lost(since, bytes));
    let last = gone.map_or(Arrival::Ended(host, watched_s), |why| Arrival::Gone(host, why));
    // Fails if the receiver was dropped.
    lost.into_iter().chain([last]).for_each(|arrival| _ = outbox.sender.send(arrival));
}

/// The receiver was dropped.
struct ReceiverClosed;

/// The queue to the recorder, and the bytes dropped on it.
struct ArrivalOutbox {
    sender: Sender<Arrival>,
    /// The size of what waits in the queue, bytes.
    waiting: Arc<AtomicU64>,
    stop: Arc<AtomicBool>,
    is_dropped: Arc<AtomicBool>,
    lost: Option<(HostNs, u64)>,
}

impl ArrivalOutbox {
    /// Sends bytes. If there is no room for them, it waits where the other side `waits` too; else they are counted as lost.
    fn send(&mut self, received: Received, waits: bool) -> Result<(), ReceiverClosed> {
        let has_room = || self.waiting.load(Ordering::Relaxed) < ROOM;
        while waits && !has_room() {
            if self.is_dropped.load(Ordering::Relaxed) {
                return Err(ReceiverClosed);
            }
            clock::sleep(0.001);
        }
        let size = received.bytes.len() as u64;
        if !waits && !has_room() {
            let (since, before) = self.lost.unwrap_or((received.host, 0));
            self.lost = Some((since, before + size));
            return Ok(());
        }
        let lost = self.lost.take().map(|(since, bytes)| Arrival::Lost(since, bytes));
        self.waiting.fetch_add(size + OVERHEAD, Ordering::Relaxed);
        let mut arrivals = lost.into_iter().chain([Arrival::Bytes(received)]);
        arrivals.try_for_each(|arrival| self.sender.send(arrival)).map_err(|_| ReceiverClosed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn received(at: u64, count: usize) -> Received {
        Received { host: HostNs(at), watched_s: 0.0, bytes: vec![0; count] }
    }

    #[test]
    fn full_queue_counts_lost_bytes() {
        let (sender, receiver) = channel();
        let waiting = Arc::<AtomicU64>::default();
        let mut outbox = ArrivalOutbox {
            sender,
            waiting: Arc::clone(&waiting),
            stop: Arc::default(),
            is_dropped: Arc::default(),
            lost: None,
        };
        let reader =
            PortReader { stop: Arc::default(), is_dropped: Arc::default(), waiting, receiver, thread: None };
        // The last one fills the room; the next two are lost.
        let half = (ROOM / 2) as usize;
        for (at, count) in [(0, half), (1, half), (2, 10), (3, 10)] {
            assert!(outbox.send(received(at, count), false).is_ok());
        }
        let next = || reader.next(Duration::ZERO);
        assert_eq!(next(), Ok(Arrival::Bytes(received(0, half))));
        assert!(outbox.send(received(4, 3), false).is_ok());
        assert_eq!(next(), Ok(Arrival::Bytes(received(1, half))));
        assert_eq!(next(), Ok(Arrival::Lost(HostNs(2), 20)));
        assert_eq!(next(), Ok(Arrival::Bytes(received(4, 3))));
        assert_eq!(next(), Err(RecvTimeoutError::Timeout));
        assert_eq!(reader.waiting.load(Ordering::Relaxed), 0);
    }
}

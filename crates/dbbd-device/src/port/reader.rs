//! The reading thread: each read is stamped at once and passed on through a bounded channel.

use std::io::ErrorKind;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use super::Port;
use crate::clock;
use crate::port::PortFinding::{self, PortRefused};
use dbbd_model::base::units::HostNs;

/// Reads that may wait for the recorder before bytes are lost.
const ROOM: usize = 4096;

/// A report of the reading thread.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Bytes of one read, and when it returned.
    Bytes(HostNs, Vec<u8>),
    /// Number of bytes dropped since, because the recorder was too slow.
    Lost(HostNs, u64),
    /// The port is gone, and why; the thread has ended.
    Gone(HostNs, String),
}

pub struct PortReader {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl PortReader {
    pub fn start(port: Port) -> Result<(Self, Receiver<Arrival>), PortFinding> {
        let (sender, receiver) = sync_channel(ROOM);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let name = port.name.clone();
        let thread = std::thread::Builder::new()
            .name("reader".into())
            .spawn(move || read_port(port, ArrivalOutbox { sender, lost: None }, &stopped))
            .map_err(|error| PortRefused { port: name, why: error.to_string() })?;
        Ok((Self { stop, thread: Some(thread) }, receiver))
    }

    /// Ends the thread, at the latest after the timeout of its read.
    pub fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

impl Drop for PortReader {
    fn drop(&mut self) {
        self.stop();
        if let Some(thread) = self.thread.take() {
            // A panic of the thread was already reported on stderr.
            let _ = thread.join();
        }
    }
}

fn read_port(mut port: Port, mut outbox: ArrivalOutbox, stop: &AtomicBool) {
    let waits = port.stamps().transport.waits();
    let mut buffer = [0; 4096];
    while !stop.load(Ordering::Relaxed) {
        let read = port.line.read(&mut buffer);
        let host = clock::now();
        let gone = match read {
            Ok(0) => "the line ended".to_owned(),
            Ok(count) => {
                let bytes = buffer[..count.min(buffer.len())].to_vec();
                let sent = if waits { outbox.wait(host, bytes) } else { outbox.offer(host, bytes) };
                if sent.is_err() {
                    return;
                }
                continue;
            }
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => continue,
            Err(error) => error.to_string(),
        };
        // Fails if the receiver was dropped.
        let _ = outbox.sender.send(Arrival::Gone(host, gone));
        return;
    }
}

/// The receiver was dropped.
struct ReceiverClosed;

/// The channel to the recorder, and the bytes dropped on it.
struct ArrivalOutbox {
    sender: SyncSender<Arrival>,
    lost: Option<(HostNs, u64)>,
}

impl ArrivalOutbox {
    /// Sends bytes and waits for room: the other side waits too.
    fn wait(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), ReceiverClosed> {
        self.sender.send(Arrival::Bytes(host, bytes)).map_err(|_| ReceiverClosed)
    }

    /// Sends bytes if there is room; else they are counted as lost, because the device does not wait.
    fn offer(&mut self, host: HostNs, bytes: Vec<u8>) -> Result<(), ReceiverClosed> {
        if let Some((since, lost)) = self.lost {
            match self.sender.try_send(Arrival::Lost(since, lost)) {
                Ok(()) => self.lost = None,
                Err(TrySendError::Full(_)) => {
                    self.lost = Some((since, lost + bytes.len() as u64));
                    return Ok(());
                }
                Err(TrySendError::Disconnected(_)) => return Err(ReceiverClosed),
            }
        }
        match self.sender.try_send(Arrival::Bytes(host, bytes)) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(Arrival::Bytes(_, bytes))) => {
                self.lost = Some((host, bytes.len() as u64));
                Ok(())
            }
            Err(_) => Err(ReceiverClosed),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn full_channel_counts_lost_bytes() {
        let (sender, receiver) = sync_channel(2);
        let mut outbox = ArrivalOutbox { sender, lost: None };
        for at in 0..4 {
            assert!(outbox.offer(HostNs(at), vec![0; 10]).is_ok());
        }
        assert_eq!(receiver.recv(), Ok(Arrival::Bytes(HostNs(0), vec![0; 10])));
        assert_eq!(receiver.recv(), Ok(Arrival::Bytes(HostNs(1), vec![0; 10])));
        assert!(outbox.offer(HostNs(4), vec![1; 3]).is_ok());
        assert_eq!(receiver.recv(), Ok(Arrival::Lost(HostNs(2), 20)));
        assert_eq!(receiver.recv(), Ok(Arrival::Bytes(HostNs(4), vec![1; 3])));
    }
}

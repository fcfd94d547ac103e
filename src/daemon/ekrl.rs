//! EthernetKRL: the TCP server for the dwell reports (telegrams) of a program, and their recording.
//!
//! The controller connects for each module and closes at its end. A controller that was switched off closes nothing, so
//! a new connection is accepted while an old one is open. A telegram is answered after it has been recorded. A telegram
//! that is malformed, of another plan or of a row without a dwell is answered with 0, which halts the program.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::TelegramMismatch;
use super::recorder::Recorder;
use super::schedule::Schedule;
use dbbd_device::clock;
use dbbd_device::port::PortFinding::{self, NotListening};
use dbbd_device::sync::lock;
use dbbd_job::recording::capture::RunEvent;
use dbbd_job::recording::{Telegram, TelegramReader, TelegramResult};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;

/// Connections at a time: the connection of the controller and stale ones. A new connection replaces the one that has
/// been idle longest.
const MAX_CLIENTS: usize = 8;
/// Events that are not recorded yet. Each client waits for its answer, so the queue never fills.
const QUEUE: usize = 4 * MAX_CLIENTS;
/// Interval at which the threads check whether the run is over.
const EKRL_STOP_CHECK_INTERVAL: Duration = Duration::from_millis(20);

#[derive(Debug)]
enum ChannelEvent {
    /// A telegram, and the channel for the `Id` of its acknowledgement.
    Telegram(Telegram, SyncSender<u32>),
    /// A remark for the capture.
    Remark(String),
    /// The last connection was closed.
    Quiet,
}

/// Receives the telegrams until it is dropped.
#[derive(Debug)]
pub struct EkrlServer {
    address: SocketAddr,
    events: Receiver<(HostNs, ChannelEvent)>,
    stop: Arc<AtomicBool>,
}

impl EkrlServer {
    /// Listens for the controller. Port 0 means any free port.
    pub fn listen(address: SocketAddr) -> Result<Self, PortFinding> {
        let error = |error: io::Error| NotListening { address: address.to_string(), why: error.to_string() };
        let listener = TcpListener::bind(address).map_err(error)?;
        listener.set_nonblocking(true).map_err(error)?;
        let address = listener.local_addr().map_err(error)?;
        let (sender, events) = sync_channel(QUEUE);
        let stop = Arc::new(AtomicBool::new(false));
        let channel = TelegramChannel { sender, stop: Arc::clone(&stop), open: Arc::default() };
        std::thread::Builder::new()
            .name("ekrl".into())
            .spawn(move || channel.accept(&listener))
            .map_err(error)?;
        Ok(Self { address, events, stop })
    }

    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for EkrlServer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Shared by the threads of the connections.
#[derive(Clone)]
struct TelegramChannel {
    sender: SyncSender<(HostNs, ChannelEvent)>,
    stop: Arc<AtomicBool>,
    open: Arc<Mutex<Vec<Arc<TelegramClient>>>>,
}

#[derive(Debug, Default)]
struct TelegramClient {
    /// Time of the client's last telegram, ns; 0 for none.
    heard_ns: AtomicU64,
    replaced: AtomicBool,
}

impl TelegramChannel {
    fn over(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Sends an event to the recorder; it is ignored once the run is over.
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
                    // The error is noted once, not fifty times a second.
                    if error.kind() != ErrorKind::WouldBlock && !std::mem::replace(&mut failing, true) {
                        self.send(ChannelEvent::Remark(format!("EthernetKRL: nobody can connect: {error}")));
                    }
                    clock::sleep(EKRL_STOP_CHECK_INTERVAL.as_secs_f64());
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
            let pending = match reader.pending() {
                0 => String::new(),
                bytes => format!(" in the middle of a telegram ({bytes} bytes)"),
            };
            let skipped = match reader.skipped() {
                0 => String::new(),
                bytes => format!(", {bytes} bytes were no telegram"),
            };
            channel.send(ChannelEvent::Remark(format!("EthernetKRL: {from} {why}{pending}{skipped}")));
            if channel.leave(&client) == 0 {
                channel.send(ChannelEvent::Quiet);
            }
        });
        if let Err(error) = spawned {
            self.leave(&entered);
            self.send(ChannelEvent::Remark(format!("EthernetKRL: {from} was turned away: {error}")));
        }
    }

    /// Registers a client, in place of the one that has been idle longest if there are too many.
    fn enter(&self) -> Arc<TelegramClient> {
        let client = Arc::<TelegramClient>::default();
        let mut open = lock(&self.open);
        if open.len() >= MAX_CLIENTS {
            let heard = |at: &usize| open[*at].heard_ns.load(Ordering::Relaxed);
            if let Some(idle) = (0..open.len()).min_by_key(heard) {
                open.remove(idle).replaced.store(true, Ordering::Relaxed);
            }
        }
        open.push(Arc::clone(&client));
        client
    }

    /// Removes a client, and returns the number of remaining clients.
    fn leave(&self, client: &Arc<TelegramClient>) -> usize {
        let mut open = lock(&self.open);
        open.retain(|other| !Arc::ptr_eq(other, client));
        open.len()
    }

    /// Answers one client until it disconnects. Also returns the reason in words.
    fn serve(&self, mut stream: TcpStream, client: &TelegramClient) -> (TelegramReader, String) {
        let mut reader = TelegramReader::default();
        let set = stream
            .set_nonblocking(false)
            .and_then(|()| stream.set_read_timeout(Some(EKRL_STOP_CHECK_INTERVAL)))
            .and_then(|()| stream.set_write_timeout(Some(Duration::from_secs(1))))
            .and_then(|()| stream.set_nodelay(true));
        if let Err(error) = set {
            return (reader, format!("was given up: {error}"));
        }
        let mut bytes = [0; 2048];
        while !self.over() {
            if client.replaced.load(Ordering::Relaxed) {
                return (reader, format!("was idle the longest of {MAX_CLIENTS}, and was left for another"));
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

    /// Waits until the telegram is recorded, and returns the answer. `None` when the run is over.
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

/// Records the telegrams of a run, and reports when the program is over.
pub(super) struct TelegramRecorder {
    server: EkrlServer,
    schedule: Schedule,
    waiting: VecDeque<(HostNs, ChannelEvent)>,
    last_dwell_over: bool,
    closed: bool,
}

/// Bytes of the bar that arrived before a telegram are recorded before it, if the reader delivers them within this
/// time.
const BEFORE_S: f64 = 0.02;

/// Whether bytes of the bar may be waiting to be recorded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BarLineState {
    Busy,
    Idle,
}

impl TelegramRecorder {
    /// Longest wait for the bar while telegrams may come.
    pub(super) const PATIENCE: Duration = Duration::from_millis(4);

    pub(super) fn new(server: EkrlServer, schedule: Schedule) -> Self {
        Self { server, schedule, waiting: VecDeque::new(), last_dwell_over: false, closed: false }
    }

    /// Records and answers the telegrams that are old enough; all telegrams while the bar is idle.
    pub(super) fn step(&mut self, recorder: &mut Recorder, line: BarLineState) -> Result<(), Diagnostic> {
        self.waiting.extend(self.server.events.try_iter());
        let now = clock::now();
        while let Some((host, event)) = self
            .waiting
            .pop_front_if(|(host, _)| line == BarLineState::Idle || now.seconds_since(*host) > BEFORE_S)
        {
            match event {
                ChannelEvent::Telegram(telegram, answer) => {
                    let id = self.record(recorder, host, &telegram)?;
                    // The client may have disconnected.
                    let _ = answer.send(id);
                }
                ChannelEvent::Remark(text) => recorder.event(host, RunEvent::Mark { text })?,
                ChannelEvent::Quiet => self.closed = self.last_dwell_over,
            }
        }
        Ok(())
    }

    /// Records a telegram and returns the `Id` of the answer.
    fn record(
        &mut self,
        recorder: &mut Recorder,
        host: HostNs,
        telegram: &Telegram,
    ) -> Result<u32, Diagnostic> {
        let Telegram { run, index, phase, axes_deg } = *telegram;
        if let Some(mismatch) = self.schedule.mismatch(telegram) {
            let why = match mismatch {
                TelegramMismatch::Run { expected } => {
                    format!("it is of run {run}, the plan's program is run {expected}")
                }
                TelegramMismatch::NoDwell => format!("row {index} of the plan is no dwell"),
            };
            recorder.progress.refused += 1;
            recorder
                .event(host, RunEvent::Mark { text: format!("EthernetKRL: refused a telegram: {why}") })?;
            return Ok(0);
        }
        recorder.progress.telegrams += 1;
        if phase == 2 {
            recorder.progress.counts.dwells += 1;
            self.last_dwell_over |= self.schedule.is_last(index);
        }
        recorder.event(host, RunEvent::Controller { index, phase, axes_deg })?;
        Ok(index)
    }

    /// Whether the program has reported its last dwell and closed the channel.
    pub(super) fn over(&self) -> bool {
        self.closed
    }
}

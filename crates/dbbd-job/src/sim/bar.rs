//! The virtual double ball-bar: sends frames like a real one.
//!
//! The bar is silent until the host has opened the terminal and sent the start command of the protocol, if it has one. From
//! then on device time runs: frame k is the reading at k / rate. The bar is silent after the stop command and while the host
//! is away; the next start continues. At the end it waits until the host has sent the stop command or gone away, because a
//! pseudo-terminal discards what was not read when this end is closed.

use std::io::ErrorKind;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::device::{DeviceCommand, SendTiming, VirtualDevice};
pub use super::device::{ReadingSource, SimulatedReading};
use super::fault::{FaultyLine, InjectedFaults};
use super::terminal::TERMINAL_READ_TIMEOUT;
pub use super::terminal::Terminal;
#[cfg(unix)]
pub use super::terminal::TerminalLink;
use crate::sim::SimulationFinding;
use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;

/// How long the bar waits at the end for a host that neither reads nor closes, s.
const LINGER_S: f64 = 10.0;
/// Most bytes that are held back.
const LONGEST_BATCH: usize = 1 << 20;
/// Most bytes that are written at once.
const BATCH: usize = 512;

/// Timing of the bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VirtualBarOptions {
    /// Frames per second of device time.
    pub rate_hz: f64,
    /// Device seconds per second of host time; 0: as fast as the host reads, and time stops while no host is there.
    pub speed: f64,
    /// Ticks of the device clock at the first start.
    pub first_ticks: u64,
}

/// A bar between two fixed balls: noise of 1 um, resolution of 0.1 um.
pub fn at_rest(seed: u64) -> impl ReadingSource {
    const NOISE_MM: f64 = 1e-3;
    const STEP_MM: f64 = 1e-4;
    let mut random = Pcg64::seed_from_u64(seed);
    move |_| {
        let noise: f64 = random.sample(StandardNormal);
        let reading_mm = (NOISE_MM * noise / STEP_MM).round() * STEP_MM;
        Some(SimulatedReading { reading_mm, strobe: false, valid: true, temperature_c: 20.0 })
    }
}

/// Streams until the source ends and the host has sent the stop command or gone away. Returns the number of frames.
pub fn serve_bar(
    terminal: Terminal,
    definition: &ProtocolDefinition,
    options: VirtualBarOptions,
    source: impl ReadingSource,
) -> Result<u64, Diagnostic> {
    serve_over(FaultyLine::new(InjectedFaults::default(), 0), terminal, definition, options, source)
}

/// As [`serve_bar`], over a faulty line.
pub fn serve_over(
    bad: FaultyLine,
    terminal: Terminal,
    definition: &ProtocolDefinition,
    options: VirtualBarOptions,
    source: impl ReadingSource,
) -> Result<u64, Diagnostic> {
    let numbers = [("rate_hz", options.rate_hz, f64::MIN_POSITIVE), ("--speed", options.speed, 0.0)];
    for (option, value, low) in numbers {
        let high = 1e9;
        if !(low..=high).contains(&value) {
            let option = option.to_owned();
            return Err(SimulationFinding::OptionOutOfRange { option, value, low, high }.into());
        }
    }
    let bar = VirtualBar {
        device: VirtualDevice::new(definition, options.first_ticks, bad.faults()),
        line: terminal,
        requests: 0,
        running: false,
        stale: bad.faults().stale as usize,
        skipped: 0,
        last_batch: None,
        unplugged: false,
        bad,
        options,
        source,
        frames: 0,
        sent: 0,
        first_start: None,
    };
    bar.run()
}

struct VirtualBar<S> {
    device: VirtualDevice,
    line: Terminal,
    /// Requests that are not answered yet.
    requests: u32,
    running: bool,
    /// Number of bytes of an earlier stream that are still to be sent.
    stale: usize,
    /// Sequence numbers that were left out.
    skipped: u64,
    /// When the last batch was delivered.
    last_batch: Option<HostNs>,
    unplugged: bool,
    bad: FaultyLine,
    options: VirtualBarOptions,
    source: S,
    /// Device time in frames, sent or not.
    frames: u64,
    sent: u64,
    first_start: Option<HostNs>,
}

impl<S: ReadingSource> VirtualBar<S> {
    fn run(mut self) -> Result<u64, Diagnostic> {
        let mut batch = Vec::new();
        loop {
            self.listen()?;
            if self.source.is_stopped() {
                return Ok(self.sent);
            }
            if !self.running && self.first_start.is_some() && self.source.over() {
                return Ok(self.sent);
            }
            if !self.running && (self.options.speed == 0.0 || self.first_start.is_none()) {
                continue;
            }
            self.unplug()?;
            let hold_s = self.bad.faults().batch_ms / 1e3;
            if hold_s > 0.0 {
                let now = clock::now();
                if self.last_batch.is_some_and(|last| now.seconds_since(last) < hold_s) {
                    continue;
                }
                self.last_batch = Some(now);
            }
            batch.clear();
            let more = self.measure(&mut batch)?;
            self.write(&batch)?;
            if !more {
                self.linger()?;
                return Ok(self.sent);
            }
        }
    }

    /// Handles what the host sends; waits a millisecond for it, or longer while there is no host.
    fn listen(&mut self) -> Result<(), Diagnostic> {
        // Without pacing the bar streams without waiting for the host.
        if self.running && self.options.speed == 0.0 {
            self.line.set_timeout(Duration::ZERO)?;
        }
        let mut buffer = [0; 256];
        let read = self.line.read(&mut buffer);
        if self.options.speed == 0.0 {
            self.line.set_timeout(TERMINAL_READ_TIMEOUT)?;
        }
        match read {
            Ok(count) => {
                for &byte in &buffer[..count.min(buffer.len())] {
                    self.receive(byte)?;
                }
            }
            Err(error) => match error.kind() {
                ErrorKind::TimedOut if self.stale > 0 => {
                    let noise = self.bad.noise(std::mem::take(&mut self.stale));
                    self.line.write_all(&noise)?;
                }
                // A host is there: that starts a protocol without a start command.
                ErrorKind::TimedOut if self.device.sends == SendTiming::AtOnce => self.begin(),
                ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                _ => {
                    self.running = false;
                    self.device.forget();
                    clock::sleep(0.005);
                }
            },
        }
        Ok(())
    }

    fn receive(&mut self, byte: u8) -> Result<(), Diagnostic> {
        if self.bad.faults().echo > 0.0 {
            self.line.write_all(&[byte])?;
        }
        let (commands, answer) = self.device.receive(byte);
        if let Some(answer) = answer {
            self.line.write_all(answer)?;
        }
        match commands.first() {
            Some(DeviceCommand::Stop) => self.running = false,
            Some(DeviceCommand::Start) => self.begin(),
            Some(DeviceCommand::Poll) => {
                self.begin();
                self.requests += 1;
            }
            Some(DeviceCommand::Zero) | None => {}
        }
        Ok(())
    }

    fn begin(&mut self) {
        self.running = true;
        self.first_start.get_or_insert_with(clock::now);
    }

    /// Adds the frames that are due to a batch; `false` at the end of the source.
    fn measure(&mut self, batch: &mut Vec<u8>) -> Result<bool, Diagnostic> {
        let most = if self.last_batch.is_some() { LONGEST_BATCH } else { BATCH };
        let is_polled = self.device.sends == SendTiming::OnRequest;
        while batch.len() < most && self.is_due() {
            let t_s = self.frames as f64 / self.options.rate_hz;
            let Some(mut reading) = self.source.reading(t_s) else { return Ok(false) };
            reading.reading_mm += self.bad.mounting.offset_mm(t_s, reading.valid, reading.strobe);
            if self.running && (!is_polled || self.requests > 0) {
                let skip = self.bad.faults().skip;
                self.skipped += u64::from(self.bad.happens(skip));
                let count = self.frames + self.skipped;
                let mut frame = self.device.frame(t_s, &reading, count, &mut self.bad)?;
                self.source.spoil(&mut frame);
                self.bad.carry(&mut frame);
                if is_polled {
                    self.requests -= 1;
                    clock::sleep(self.device.reply_delay_s);
                }
                batch.extend(std::mem::take(&mut self.device.banner));
                batch.extend(frame);
                self.sent += 1;
            }
            self.frames += 1;
        }
        Ok(true)
    }

    /// Unplugs the bar once, when it is time.
    fn unplug(&mut self) -> Result<(), Diagnostic> {
        let InjectedFaults { unplug_s, away_s, .. } = *self.bad.faults();
        let t_s = self.frames as f64 / self.options.rate_hz;
        if self.unplugged || unplug_s <= 0.0 || t_s < unplug_s {
            return Ok(());
        }
        self.unplugged = true;
        self.running = false;
        self.device.forget();
        self.line.unplug(away_s)
    }

    /// Whether the next frame is due.
    fn is_due(&self) -> bool {
        let speed = self.options.speed;
        let passed = self.first_start.map_or(0.0, |start| clock::now().seconds_since(start));
        if speed == 0.0 && self.device.sends == SendTiming::OnRequest {
            // Time advances with the requests.
            return self.requests > 0;
        }
        speed == 0.0 || self.frames as f64 / self.options.rate_hz <= passed * speed
    }

    /// Writes as fast as the host reads. What a host does not read before it goes away is lost, as on a real line.
    fn write(&mut self, bytes: &[u8]) -> Result<(), Diagnostic> {
        let mut rest = bytes;
        while !rest.is_empty() && self.running {
            match self.line.write(rest) {
                Ok(count) => rest = &rest[count.min(rest.len())..],
                Err(error) if error.kind() == ErrorKind::TimedOut => self.listen()?,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.running = false,
            }
        }
        Ok(())
    }

    fn linger(&mut self) -> Result<(), Diagnostic> {
        let began = clock::now();
        while self.running && clock::now().seconds_since(began) < LINGER_S {
            self.listen()?;
        }
        Ok(())
    }
}

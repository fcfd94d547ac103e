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

use super::fault::{FaultyLine, InjectedFaults};
use super::mounting::SimulatedMounting;
use super::terminal::TERMINAL_READ_TIMEOUT;
pub use super::terminal::Terminal;
#[cfg(unix)]
pub use super::terminal::TerminalLink;
use crate::sim::SimulationFinding;
use dbbd_device::clock;
use dbbd_device::port::SIMULATED_MARK;
use dbbd_device::protocol::ProtocolFinding;
use dbbd_device::protocol::{CommandStep, ProtocolDefinition, ProtocolEncoder, ProtocolMode};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;

/// Longest wait of the bar at the end for a host that neither reads nor closes, s.
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

/// The same as [`serve_bar`], over a faulty line.
pub fn serve_over(
    bad: FaultyLine,
    terminal: Terminal,
    definition: &ProtocolDefinition,
    options: VirtualBarOptions,
    source: impl ReadingSource,
) -> Result<u64, Diagnostic> {
    let numbers = [("rate_hz", options.rate_hz, f64::MIN_POSITIVE), ("speed", options.speed, 0.0)];
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
        line_faults: LineFaultState {
            stale: bad.faults().stale as usize,
            last_batch: None,
            unplugged: false,
        },
        mounting: SimulatedMounting::new(*bad.faults(), bad.seed()),
        bad,
        options,
        source,
        frames: FrameCounts::default(),
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
    line_faults: LineFaultState,
    mounting: SimulatedMounting,
    bad: FaultyLine,
    options: VirtualBarOptions,
    source: S,
    frames: FrameCounts,
    first_start: Option<HostNs>,
}

/// The faults of the line that depend on what happened before.
struct LineFaultState {
    /// Number of bytes of an earlier stream that are still to be sent.
    stale: usize,
    /// The time at which the last batch was delivered.
    last_batch: Option<HostNs>,
    unplugged: bool,
}

/// The frames of a virtual bar.
#[derive(Clone, Copy, Default)]
struct FrameCounts {
    /// Device time in frames, sent or not.
    passed: u64,
    sent: u64,
    /// Sequence numbers that were left out.
    skipped: u64,
}

impl<S: ReadingSource> VirtualBar<S> {
    fn run(mut self) -> Result<u64, Diagnostic> {
        let mut batch = Vec::new();
        loop {
            self.listen()?;
            if self.source.is_stopped() {
                return Ok(self.frames.sent);
            }
            if !self.running && self.first_start.is_some() && self.source.over() {
                return Ok(self.frames.sent);
            }
            if !self.running && (self.options.speed == 0.0 || self.first_start.is_none()) {
                continue;
            }
            self.unplug()?;
            let hold_s = self.bad.faults().batch_ms / 1e3;
            if hold_s > 0.0 {
                let now = clock::now();
                if self.line_faults.last_batch.is_some_and(|last| now.seconds_since(last) < hold_s) {
                    continue;
                }
                self.line_faults.last_batch = Some(now);
            }
            batch.clear();
            let more = self.measure(&mut batch)?;
            self.write(&batch)?;
            if !more {
                self.linger()?;
                return Ok(self.frames.sent);
            }
        }
    }

    /// Handles the input from the host; waits a millisecond for it, or longer while there is no host.
    #[expect(clippy::wildcard_enum_match_arm, reason = "the kinds of errors of the system are open")]
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
                ErrorKind::TimedOut if self.line_faults.stale > 0 => {
                    let noise = self.bad.noise(std::mem::take(&mut self.line_faults.stale));
                    self.line.write_all(&noise)?;
                }
                // A host is there: this starts a protocol without a start command.
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
        if !self.running {
            self.device.before_frame.extend(SIMULATED_MARK);
        }
        self.running = true;
        self.first_start.get_or_insert_with(clock::now);
    }

    /// Adds the frames that are due to a batch; `false` at the end of the source.
    fn measure(&mut self, batch: &mut Vec<u8>) -> Result<bool, Diagnostic> {
        let most = if self.line_faults.last_batch.is_some() { LONGEST_BATCH } else { BATCH };
        let is_polled = self.device.sends == SendTiming::OnRequest;
        while batch.len() < most && self.is_due() {
            let t_s = self.frames.passed as f64 / self.options.rate_hz;
            let Some(mut reading) = self.source.reading(t_s) else { return Ok(false) };
            reading.reading_mm += self.mounting.offset_mm(t_s, reading.valid, reading.strobe);
            if self.running && (!is_polled || self.requests > 0) {
                let skip = self.bad.faults().skip;
                self.frames.skipped += u64::from(self.bad.happens(skip));
                let count = self.frames.passed + self.frames.skipped;
                let mut frame = self.device.frame(t_s, &reading, count, &mut self.bad)?;
                self.source.spoil(&mut frame);
                self.bad.carry(&mut frame);
                if is_polled {
                    self.requests -= 1;
                    clock::sleep(self.device.reply_delay_s);
                }
                batch.extend(std::mem::take(&mut self.device.before_frame));
                batch.extend(frame);
                self.frames.sent += 1;
            }
            self.frames.passed += 1;
        }
        Ok(true)
    }

    /// Unplugs the bar once, when it is time.
    fn unplug(&mut self) -> Result<(), Diagnostic> {
        let InjectedFaults { unplug_s, away_s, .. } = *self.bad.faults();
        let t_s = self.frames.passed as f64 / self.options.rate_hz;
        if self.line_faults.unplugged || unplug_s <= 0.0 || t_s < unplug_s {
            return Ok(());
        }
        self.line_faults.unplugged = true;
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
        speed == 0.0 || self.frames.passed as f64 / self.options.rate_hz <= passed * speed
    }

    /// Writes as fast as the host reads. Bytes that a host does not read before it goes away are lost, as on a real
    /// line.
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

/// A reading before it is sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedReading {
    /// Reading, mm; longer is positive.
    pub reading_mm: f64,
    /// Whether the strobe of the controller is high.
    pub strobe: bool,
    /// Whether the reading is inside the stroke and the bar not too fast.
    pub valid: bool,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: f64,
}

/// The source of the readings; any closure `FnMut(f64) -> Option<SimulatedReading>` is one.
pub trait ReadingSource {
    /// The reading at a device time, s since the first start, which never decreases. `None` ends the stream.
    fn reading(&mut self, t_s: f64) -> Option<SimulatedReading>;

    /// Whether the program of the robot has ended: the bar then ends when the host sends the stop command or goes away.
    /// Before the end of the program it waits for the host to come back.
    fn over(&self) -> bool {
        false
    }

    /// Whether the bar must end at once.
    fn is_stopped(&self) -> bool {
        false
    }

    /// Damages a frame on the line.
    fn spoil(&mut self, _frame: &mut Vec<u8>) {}
}

impl<F: FnMut(f64) -> Option<SimulatedReading>> ReadingSource for F {
    fn reading(&mut self, t_s: f64) -> Option<SimulatedReading> {
        self(t_s)
    }
}

/// Longest command, bytes.
const LONGEST_COMMAND: usize = 256;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DeviceCommand {
    Start,
    Stop,
    Poll,
    Zero,
}

/// When readings are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SendTiming {
    /// Readings are sent as soon as there is a host.
    AtOnce,
    AfterStart,
    OnRequest,
}

struct VirtualDevice {
    encoder: ProtocolEncoder,
    counter: DeviceTickClock,
    modulo: u32,
    /// If several commands end with the same bytes, the first one applies.
    commands: [(DeviceCommand, Vec<u8>); 4],
    /// Requests with their answers.
    answers: Vec<(Vec<u8>, Vec<u8>)>,
    /// The last bytes from the host, which may be part of a command.
    received: Vec<u8>,
    sends: SendTiming,
    reply_delay_s: f64,
    /// What is sent before the next frame: at the beginning the banner, and before each stream the mark of a simulated bar.
    before_frame: Vec<u8>,
    at_mm: f64,
    /// The reading that becomes zero, mm; `None` for the next reading.
    zero_mm: Option<f64>,
}

/// The clock of the device.
struct DeviceTickClock {
    tick_ns: u32,
    wrap_bits: u32,
    /// Ticks at the first start.
    first: u64,
}

impl VirtualDevice {
    fn new(definition: &ProtocolDefinition, first_ticks: u64, faults: &InjectedFaults) -> Self {
        // A command that consists of several messages is recognised by the last one.
        let command = |steps: &[CommandStep]| -> Vec<u8> {
            let last = steps.iter().rev().find_map(|step| match step {
                CommandStep::Send(bytes) | CommandStep::Ask { send: bytes, .. } => Some(bytes.clone()),
                CommandStep::DtrPulse(_) | CommandStep::Wait(_) | CommandStep::Drain(_) => None,
            });
            last.unwrap_or_default()
        };
        let ProtocolDefinition { ident, zero, init, start, stop, poll, sim, .. } = definition;
        let asked = [ident, zero, init, start, stop].into_iter().flatten();
        let answers = asked.filter_map(|step| match step {
            CommandStep::Ask { send, expect, .. } => Some((send.clone(), expect.clone())),
            CommandStep::DtrPulse(_)
            | CommandStep::Send(_)
            | CommandStep::Wait(_)
            | CommandStep::Drain(_) => None,
        });
        let commands = [
            (DeviceCommand::Stop, command(stop)),
            (DeviceCommand::Start, command(start)),
            (DeviceCommand::Poll, command(poll)),
            (DeviceCommand::Zero, command(zero)),
        ];
        let sends = match definition.mode {
            ProtocolMode::Poll { .. } => SendTiming::OnRequest,
            _ if command(start).is_empty() => SendTiming::AtOnce,
            ProtocolMode::Stream | ProtocolMode::Push => SendTiming::AfterStart,
        };
        let banner = match sim.banner.as_slice() {
            [] if faults.banner > 0.0 => b"ball-bar\r\n".to_vec(),
            banner => banner.to_vec(),
        };
        Self {
            encoder: definition.encoder(),
            counter: DeviceTickClock {
                tick_ns: definition.clock.map_or(1, |clock| clock.tick_ns),
                wrap_bits: definition.clock.map_or(64, |clock| clock.wrap_bits),
                first: first_ticks,
            },
            modulo: definition.sequence_modulo.unwrap_or(u32::MAX),
            commands,
            answers: answers.collect(),
            received: Vec::new(),
            sends,
            reply_delay_s: sim.reply_delay.as_secs_f64(),
            before_frame: banner,
            at_mm: sim.at_mm,
            zero_mm: Some(0.0),
        }
    }

    /// Receives a byte of the host. Returns the commands that end with it, and the answer.
    fn receive(&mut self, byte: u8) -> (Vec<DeviceCommand>, Option<&[u8]>) {
        self.received.push(byte);
        let received = &self.received;
        let ends = |bytes: &[u8]| !bytes.is_empty() && received.ends_with(bytes);
        let commands: Vec<DeviceCommand> =
            self.commands.iter().filter(|(_, bytes)| ends(bytes)).map(|(command, _)| *command).collect();
        let answer = self.answers.iter().find(|(sent, _)| ends(sent)).map(|(_, answer)| answer.as_slice());
        if commands.contains(&DeviceCommand::Zero) {
            self.zero_mm = None;
        }
        if !commands.is_empty() {
            self.received.clear();
        }
        let excess = self.received.len().saturating_sub(LONGEST_COMMAND);
        self.received.drain(..excess);
        (commands, answer)
    }

    /// Drops the received bytes after the host has gone away.
    fn forget(&mut self) {
        self.received.clear();
    }

    /// The frame of a reading at a device time, s; `count` frames were numbered before it. Empty if the bar sends none.
    fn frame(
        &mut self,
        t_s: f64,
        reading: &SimulatedReading,
        count: u64,
        bad: &mut FaultyLine,
    ) -> Result<Vec<u8>, ProtocolFinding> {
        let InjectedFaults { silence, refuse, .. } = *bad.faults();
        let sample = self.sample(t_s, reading, count, bad.faults());
        let mut frame = Vec::new();
        let refused = bad.happens(refuse) && self.encoder.refuse(&sample, &mut frame);
        if refused || bad.happens(silence) {
            return Ok(frame);
        }
        // Outside of the stroke the device sends its word for "no reading", unless its frames have a flag for an
        // invalid reading.
        let is_refused =
            !sample.valid && !self.encoder.has_validity() && self.encoder.refuse(&sample, &mut frame);
        if !is_refused {
            self.encoder.encode(&sample, &mut frame)?;
        }
        Ok(frame)
    }

    fn sample(
        &mut self,
        t_s: f64,
        reading: &SimulatedReading,
        count: u64,
        faults: &InjectedFaults,
    ) -> Sample {
        let InjectedFaults { drift_ppm, wrap_ticks, over_mm, .. } = *faults;
        let DeviceTickClock { tick_ns, wrap_bits, first } = self.counter;
        let zero_mm = *self.zero_mm.get_or_insert(reading.reading_mm);
        let ticks = (t_s * (1.0 + drift_ppm * 1e-6) * 1e9 / f64::from(tick_ns)).round() as u64;
        let ticks = ticks.wrapping_sub(wrap_ticks as u64);
        let mask = u64::MAX >> (64 - wrap_bits.clamp(1, 64));
        Sample {
            sequence: u32::try_from(count % u64::from(self.modulo)).ok(),
            ticks: Some(DeviceTicks(first.wrapping_add(ticks) & mask)),
            trigger: Some(reading.strobe),
            temperature_c: Some(reading.temperature_c),
            valid: reading.valid && over_mm == 0.0,
            ..Sample::of(reading.reading_mm - zero_mm + self.at_mm + over_mm)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 4000 readings: the standard deviation of their standard deviation is 1.1 %.
    #[test]
    fn bar_at_rest_has_a_noise_of_a_micrometre_in_steps_of_a_tenth() {
        let mut source = at_rest(2);
        let readings: Vec<f64> = (0..4000)
            .map(|frame| source.reading(f64::from(frame)).expect("it has no end").reading_mm)
            .collect();
        assert!(readings.iter().all(|mm| (mm * 1e4 - (mm * 1e4).round()).abs() < 1e-6));
        let variance = readings.iter().map(|mm| mm * mm).sum::<f64>() / 4000.0;
        assert!((variance.sqrt() / 1e-3 - 1.0).abs() < 0.05, "{variance}");
    }

    fn device(first_ticks: u64) -> VirtualDevice {
        let definition =
            ProtocolDefinition::by_name("dbb-cobs-1").expect("it is built in").expect("its file can be read");
        VirtualDevice::new(&definition, first_ticks, &InjectedFaults::default())
    }

    fn reading(reading_mm: f64) -> SimulatedReading {
        SimulatedReading { reading_mm, strobe: true, valid: true, temperature_c: 21.5 }
    }

    #[test]
    fn clock_of_the_device_drifts_and_wraps() {
        let mut device = device(100);
        (device.counter.tick_ns, device.counter.wrap_bits, device.modulo) = (1000, 16, 256);
        let ticks = |device: &mut VirtualDevice, t_s: f64, faults: InjectedFaults| {
            device.sample(t_s, &reading(0.0), 700, &faults).ticks
        };
        let none = InjectedFaults::default();
        assert_eq!(ticks(&mut device, 0.002, none), Some(DeviceTicks(2100)));
        // 50 ms are 50 000 ticks of 1 us, and 20 of them more with 400 ppm.
        let fast = InjectedFaults { drift_ppm: 400.0, ..none };
        assert_eq!(ticks(&mut device, 0.05, fast), Some(DeviceTicks(50_120)));
        assert_eq!(ticks(&mut device, 0.07, none), Some(DeviceTicks(70_100 - 65_536)));
        let wraps = InjectedFaults { wrap_ticks: 1100.0, ..none };
        assert_eq!(ticks(&mut device, 0.001, wraps), Some(DeviceTicks(0)));
        assert_eq!(ticks(&mut device, 0.0, wraps), Some(DeviceTicks(65_536 - 1000)));
        assert_eq!(device.sample(0.0, &reading(0.0), 700, &none).sequence, Some(700 % 256));
    }

    #[test]
    fn zeroed_device_counts_from_its_next_reading() {
        let mut device = device(0);
        let none = InjectedFaults::default();
        assert_eq!(device.sample(0.0, &reading(1.25), 0, &none).reading_mm, 1.25);
        device.at_mm = 0.5;
        assert_eq!(device.sample(0.0, &reading(1.25), 0, &none).reading_mm, 1.75);
        device.zero_mm = None;
        assert_eq!(device.sample(0.0, &reading(1.25), 0, &none).reading_mm, 0.5);
        assert_eq!(device.sample(0.0, &reading(1.5), 0, &none).reading_mm, 0.75);
        let over = device.sample(0.0, &reading(1.5), 0, &InjectedFaults { over_mm: 4.0, ..none });
        assert_eq!((over.reading_mm, over.valid), (4.75, false));
        assert_eq!((over.trigger, over.temperature_c), (Some(true), Some(21.5)));
    }
}

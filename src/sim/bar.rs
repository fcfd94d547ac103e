//! The virtual double ball-bar: frames on a pseudo terminal, as a real one would send them.
//!
//! The bar stands still until the host has opened the terminal and sent the protocol's start
//! command (or, without one, anything has opened it). From then on device time runs: frame k is the
//! reading at k / rate. The stop command and a host that goes away silence it; the next start goes
//! on. At the end it waits until the host has gone or said stop, for a pseudo terminal throws away
//! what was not read when this side closes.

use std::io::{self, ErrorKind, Read, Write};
use std::time::Duration;

use serialport::{SerialPort, TTYPort};
use thiserror::Error;

use super::fault::{BadLine, Faults};
use super::link::Link;
pub use super::source::{Reading, Source};
use crate::clock;
use crate::protocol::{Definition, EncodeError, Encoder, Mode, Step};
use crate::sample::Sample;
use crate::units::{DeviceTicks, HostNs};

/// How long the bar waits at its end for a host that neither reads on nor closes, s.
const LINGER_S: f64 = 10.0;
/// Bytes that are handed over at once at most where they are held back.
const LONGEST_BATCH: usize = 1 << 20;
/// Longest command that is heard, bytes.
const LONGEST_COMMAND: usize = 256;
/// Bytes that are written at once when time does not matter.
const BATCH: usize = 512;

/// How the bar runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Frames per second of device time.
    pub rate_hz: f64,
    /// Device seconds per second of host time; 0: as fast as the host takes the bytes, and time
    /// stands still while nobody listens.
    pub speed: f64,
    /// The device clock's ticks at the first start.
    pub first_ticks: u64,
}

/// Why the bar cannot go on.
#[derive(Debug, Error)]
pub enum BarError {
    /// The pseudo terminal.
    #[error("the virtual bar's pseudo terminal fails")]
    Terminal(#[from] io::Error),
    /// The protocol cannot say a reading.
    #[error("the protocol cannot send what the bar measures")]
    Encode(#[from] EncodeError),
    /// The rate or speed is no number that makes sense.
    #[error("a rate must be above 0, a speed 0 or more")]
    Options,
}

/// A pseudo terminal for a virtual bar.
pub struct Terminal {
    line: TTYPort,
    name: String,
}

impl Terminal {
    /// Makes one.
    ///
    /// # Errors
    /// When the system has none left.
    pub fn new() -> Result<Self, BarError> {
        let (mut line, host) = TTYPort::pair().map_err(io::Error::from)?;
        line.set_timeout(Duration::from_millis(1)).map_err(io::Error::from)?;
        // Only while no handle of the host's side is open here can its coming and going be seen.
        let name = host.name().unwrap_or_default();
        Ok(Self { line, name })
    }

    /// What the host opens.
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// Streams until the source ends and the host has gone or said stop. The number of frames sent.
///
/// # Errors
/// When the terminal fails or the protocol cannot say a reading.
pub fn serve(
    terminal: Terminal,
    definition: &Definition,
    options: Options,
    source: impl Source,
) -> Result<u64, BarError> {
    serve_badly(terminal, definition, options, source, BadLine::new(Faults::default(), 0), None)
}

/// The same over a bad line. A bar that is unplugged comes back under another name; `link` follows it.
///
/// # Errors
/// When a terminal fails or the protocol cannot say a reading.
pub fn serve_badly(
    terminal: Terminal,
    definition: &Definition,
    options: Options,
    source: impl Source,
    bad: BadLine,
    link: Option<Link>,
) -> Result<u64, BarError> {
    if !(options.rate_hz > 0.0
        && options.rate_hz.is_finite()
        && options.speed >= 0.0
        && options.speed.is_finite())
    {
        return Err(BarError::Options);
    }
    // A command of several sends is known by its last one.
    let command = |steps: &[Step]| -> Vec<u8> {
        let sent = steps.iter().rev().find_map(|step| match step {
            Step::Send(bytes) | Step::Ask { send: bytes, .. } => Some(bytes.clone()),
            _ => None,
        });
        sent.unwrap_or_default()
    };
    let Definition { ident, zero, init, start, stop, .. } = definition;
    let steps = [ident, zero, init, start, stop];
    let answers = steps.into_iter().flatten().filter_map(|step| match step {
        Step::Ask { send, expect, .. } => Some((send.clone(), expect.clone())),
        _ => None,
    });
    let bar = Bar {
        line: terminal.line,
        encoder: definition.encoder(),
        tick_ns: definition.clock.map_or(1, |clock| clock.tick_ns),
        wrap_bits: definition.clock.map_or(64, |clock| clock.wrap_bits),
        modulo: definition.sequence_modulo.unwrap_or(u32::MAX),
        start: command(start),
        stop: command(stop),
        zero: command(zero),
        zero_mm: Some(0.0),
        poll: command(&definition.poll),
        polled: matches!(definition.mode, Mode::Poll { .. }),
        asked: 0,
        answers: answers.collect(),
        at_mm: definition.sim.at_mm,
        reply_delay_s: definition.sim.reply_delay.as_secs_f64(),
        banner: if bad.faults().banner > 0.0 && definition.sim.banner.is_empty() {
            b"ball-bar\r\n".to_vec()
        } else {
            definition.sim.banner.clone()
        },
        heard: Vec::new(),
        running: false,
        stale: bad.faults().stale as usize,
        skipped: 0,
        batched: None,
        unplugged: false,
        bad,
        link,
        options,
        source,
        frames: 0,
        sent: 0,
        first_start: None,
    };
    bar.run()
}

struct Bar<S> {
    line: TTYPort,
    encoder: Encoder,
    tick_ns: u32,
    wrap_bits: u32,
    modulo: u32,
    start: Vec<u8>,
    stop: Vec<u8>,
    poll: Vec<u8>,
    zero: Vec<u8>,
    /// The reading that counts as zero, mm; none when the next one is to.
    zero_mm: Option<f64>,
    /// Whether every reading is asked for.
    polled: bool,
    /// Requests that are not answered yet.
    asked: u32,
    /// What is answered to which command.
    answers: Vec<(Vec<u8>, Vec<u8>)>,
    at_mm: f64,
    reply_delay_s: f64,
    /// What is said once at the beginning.
    banner: Vec<u8>,
    /// The last bytes from the host, in which a command may be.
    heard: Vec<u8>,
    running: bool,
    /// Bytes of an earlier stream that are still to be sent.
    stale: usize,
    /// Sequence numbers that were left out.
    skipped: u64,
    /// When the last batch was handed over.
    batched: Option<HostNs>,
    /// Whether it has been unplugged.
    unplugged: bool,
    bad: BadLine,
    link: Option<Link>,
    options: Options,
    source: S,
    /// Frames of device time that have passed.
    frames: u64,
    sent: u64,
    first_start: Option<HostNs>,
}

impl<S: Source> Bar<S> {
    fn run(mut self) -> Result<u64, BarError> {
        let mut batch = Vec::new();
        loop {
            self.listen()?;
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
                if self.batched.is_some_and(|last| now.seconds_since(last) < hold_s) {
                    continue;
                }
                self.batched = Some(now);
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

    /// Hears what the host says; waits a millisecond, or longer while there is none.
    fn listen(&mut self) -> Result<(), BarError> {
        // Without pacing there is no time to wait for a word that is not there.
        if self.running && self.options.speed == 0.0 {
            self.line.set_timeout(Duration::ZERO).map_err(io::Error::from)?;
        }
        let mut buffer = [0; 256];
        let read = self.line.read(&mut buffer);
        if self.options.speed == 0.0 {
            self.line.set_timeout(Duration::from_millis(1)).map_err(io::Error::from)?;
        }
        match read {
            Ok(count) => {
                for &byte in &buffer[..count.min(buffer.len())] {
                    self.hear(byte)?;
                }
            }
            Err(error) => match error.kind() {
                ErrorKind::TimedOut if self.stale > 0 => {
                    let noise = self.bad.noise(std::mem::take(&mut self.stale));
                    self.line.write_all(&noise)?;
                }
                // A host is there: a protocol without a start command has been started by that.
                ErrorKind::TimedOut if self.start.is_empty() && !self.polled => self.begin(),
                ErrorKind::TimedOut | ErrorKind::Interrupted => {}
                _ => {
                    self.running = false;
                    self.heard.clear();
                    clock::sleep(0.005);
                }
            },
        }
        Ok(())
    }

    fn hear(&mut self, byte: u8) -> Result<(), BarError> {
        self.heard.push(byte);
        let said = |command: &[u8]| !command.is_empty() && self.heard.ends_with(command);
        let answer = self.answers.iter().find(|(command, _)| said(command)).map(|(_, answer)| answer.clone());
        let (stop, start, poll) = (said(&self.stop), said(&self.start), said(&self.poll));
        let zero = said(&self.zero);
        if self.bad.faults().echo > 0.0 {
            self.line.write_all(&[byte])?;
        }
        if let Some(answer) = answer {
            self.line.write_all(&answer)?;
        }
        if stop {
            self.running = false;
        } else if start {
            self.begin();
        } else if poll {
            self.begin();
            self.asked += 1;
        }
        if zero {
            self.zero_mm = None;
        }
        if stop || start || poll || zero {
            self.heard.clear();
        }
        let excess = self.heard.len().saturating_sub(LONGEST_COMMAND);
        self.heard.drain(..excess);
        Ok(())
    }

    fn begin(&mut self) {
        self.running = true;
        self.first_start.get_or_insert_with(clock::now);
    }

    /// Measures what is due. Whether there is more to come.
    fn measure(&mut self, batch: &mut Vec<u8>) -> Result<bool, BarError> {
        let room = if self.batched.is_some() { LONGEST_BATCH } else { BATCH };
        while batch.len() < room && self.due() {
            let t_s = self.frames as f64 / self.options.rate_hz;
            let Some(reading) = self.source.reading(t_s) else { return Ok(false) };
            if self.running && (!self.polled || self.asked > 0) {
                let mut frame = Vec::new();
                let Faults { silence, refuse, skip, .. } = *self.bad.faults();
                self.skipped += u64::from(self.bad.happens(skip));
                let zero_mm = *self.zero_mm.get_or_insert(reading.reading_mm);
                let sample = self.sample(t_s, &reading, zero_mm);
                let refused = self.bad.happens(refuse) && self.encoder.refuse(&sample, &mut frame);
                if !refused && !self.bad.happens(silence) {
                    self.say(&sample, &mut frame)?;
                }
                self.source.spoil(&mut frame);
                self.bad.carry(&mut frame);
                if self.polled {
                    self.asked -= 1;
                    clock::sleep(self.reply_delay_s);
                }
                batch.extend(std::mem::take(&mut self.banner));
                batch.extend(frame);
                self.sent += 1;
            }
            self.frames += 1;
        }
        Ok(true)
    }

    /// Pulls the plug once, when it is time, and comes back under another name.
    fn unplug(&mut self) -> Result<(), BarError> {
        let Faults { unplug_s, away_s, .. } = *self.bad.faults();
        let t_s = self.frames as f64 / self.options.rate_hz;
        if self.unplugged || unplug_s <= 0.0 || t_s < unplug_s {
            return Ok(());
        }
        self.unplugged = true;
        let path = self.link.take().map(|link| link.path().to_owned());
        // The new terminal is made first: the system would give the old name again.
        let new = Terminal::new()?;
        self.line = new.line;
        self.running = false;
        self.heard.clear();
        clock::sleep(away_s);
        if let Some(path) = path {
            self.link = Some(Link::new(&path, &new.name)?);
        }
        Ok(())
    }

    /// The frame of a sample; the device's word for none where the bar is out of its stroke.
    fn say(&self, sample: &Sample, frame: &mut Vec<u8>) -> Result<(), BarError> {
        if !sample.valid && !self.encoder.doubts() && self.encoder.refuse(sample, frame) {
            return Ok(());
        }
        Ok(self.encoder.encode(sample, frame)?)
    }

    fn due(&self) -> bool {
        let speed = self.options.speed;
        let passed = self.first_start.map_or(0.0, |start| clock::now().seconds_since(start));
        if speed == 0.0 && self.polled {
            // Time goes on with the requests.
            return self.asked > 0;
        }
        speed == 0.0 || self.frames as f64 / self.options.rate_hz <= passed * speed
    }

    fn sample(&self, t_s: f64, reading: &Reading, zero_mm: f64) -> Sample {
        let Faults { drift_ppm, wrap_ticks, over_mm, .. } = *self.bad.faults();
        let ticks = (t_s * (1.0 + drift_ppm * 1e-6) * 1e9 / f64::from(self.tick_ns)).round() as u64;
        let ticks = ticks.wrapping_sub(wrap_ticks as u64);
        let mask = u64::MAX >> (64 - self.wrap_bits.clamp(1, 64));
        Sample {
            reading_mm: reading.reading_mm - zero_mm + self.at_mm + over_mm,
            sequence: u32::try_from((self.frames + self.skipped) % u64::from(self.modulo)).ok(),
            ticks: Some(DeviceTicks(self.options.first_ticks.wrapping_add(ticks) & mask)),
            trigger: Some(reading.strobe),
            temperature_c: Some(reading.temperature_c),
            valid: reading.valid && over_mm == 0.0,
            status: 0,
            offset: 0,
        }
    }

    /// Writes as the host takes the bytes; what a host that went away did not take is lost, as on
    /// a real line.
    fn write(&mut self, bytes: &[u8]) -> Result<(), BarError> {
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

    fn linger(&mut self) -> Result<(), BarError> {
        let began = clock::now();
        while self.running && clock::now().seconds_since(began) < LINGER_S {
            self.listen()?;
        }
        Ok(())
    }
}

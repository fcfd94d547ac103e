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

use crate::clock;
use crate::protocol::{Definition, EncodeError, Encoder, Sample, Step};
use crate::units::{DeviceTicks, HostNs};

/// How long the bar waits at its end for a host that neither reads on nor closes, s.
const LINGER_S: f64 = 10.0;
/// Bytes that are written at once when time does not matter.
const BATCH: usize = 512;

/// What the bar measures at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Reading, mm; longer is positive.
    pub reading_mm: f64,
    /// Whether the controller's strobe is high.
    pub strobe: bool,
    /// Whether the reading can be trusted (inside the stroke, not too fast).
    pub valid: bool,
    /// Temperature of the bar, degrees Celsius.
    pub temperature_c: f64,
}

/// What the bar is mounted on. A closure `FnMut(f64) -> Option<Reading>` is one too.
pub trait Source {
    /// The reading at a device time, s since the first start; times only go forward. None ends it.
    fn reading(&mut self, t_s: f64) -> Option<Reading>;

    /// Whether the robot's program has ended: readings may go on, and the bar ends when the host
    /// says stop or goes away. Until then it waits for the host to come again.
    fn over(&self) -> bool {
        false
    }

    /// Spoils a frame on its way, to try what a bad line does.
    fn spoil(&mut self, _frame: &mut Vec<u8>) {}
}

impl<F: FnMut(f64) -> Option<Reading>> Source for F {
    fn reading(&mut self, t_s: f64) -> Option<Reading> {
        self(t_s)
    }
}

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
    if !(options.rate_hz > 0.0
        && options.rate_hz.is_finite()
        && options.speed >= 0.0
        && options.speed.is_finite())
    {
        return Err(BarError::Options);
    }
    let command = |steps: &[Step]| -> Vec<u8> {
        let sent = steps.iter().filter_map(|step| match step {
            Step::Send(bytes) => Some(bytes.as_slice()),
            _ => None,
        });
        sent.flatten().copied().collect()
    };
    let bar = Bar {
        line: terminal.line,
        encoder: definition.encoder(),
        tick_ns: definition.clock.map_or(1, |clock| clock.tick_ns),
        wrap_bits: definition.clock.map_or(64, |clock| clock.wrap_bits),
        modulo: definition.sequence_modulo.unwrap_or(u32::MAX),
        start: command(&definition.start),
        stop: command(&definition.stop),
        heard: Vec::new(),
        running: false,
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
    /// The last bytes from the host, in which a command may be.
    heard: Vec<u8>,
    running: bool,
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
                    self.hear(byte);
                }
            }
            Err(error) => match error.kind() {
                // A host is there: a protocol without a start command has been started by that.
                ErrorKind::TimedOut if self.start.is_empty() => self.begin(),
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

    fn hear(&mut self, byte: u8) {
        self.heard.push(byte);
        if !self.stop.is_empty() && self.heard.ends_with(&self.stop) {
            self.running = false;
            self.heard.clear();
        } else if !self.start.is_empty() && self.heard.ends_with(&self.start) {
            self.begin();
            self.heard.clear();
        }
        let longest = self.start.len().max(self.stop.len());
        let excess = self.heard.len().saturating_sub(longest);
        self.heard.drain(..excess);
    }

    fn begin(&mut self) {
        self.running = true;
        self.first_start.get_or_insert_with(clock::now);
    }

    /// Measures what is due. Whether there is more to come.
    fn measure(&mut self, batch: &mut Vec<u8>) -> Result<bool, BarError> {
        while batch.len() < BATCH && self.due() {
            let t_s = self.frames as f64 / self.options.rate_hz;
            let Some(reading) = self.source.reading(t_s) else { return Ok(false) };
            if self.running {
                let mut frame = Vec::new();
                self.encoder.encode(&self.sample(t_s, &reading), &mut frame)?;
                self.source.spoil(&mut frame);
                batch.extend(frame);
                self.sent += 1;
            }
            self.frames += 1;
        }
        Ok(true)
    }

    fn due(&self) -> bool {
        let speed = self.options.speed;
        let passed = self.first_start.map_or(0.0, |start| clock::now().seconds_since(start));
        speed == 0.0 || self.frames as f64 / self.options.rate_hz <= passed * speed
    }

    fn sample(&self, t_s: f64, reading: &Reading) -> Sample {
        let ticks = (t_s * 1e9 / f64::from(self.tick_ns)).round() as u64;
        let mask = u64::MAX >> (64 - self.wrap_bits.clamp(1, 64));
        Sample {
            reading_mm: reading.reading_mm,
            sequence: u32::try_from(self.frames % u64::from(self.modulo)).ok(),
            ticks: Some(DeviceTicks(self.options.first_ticks.wrapping_add(ticks) & mask)),
            trigger: Some(reading.strobe),
            temperature_c: Some(reading.temperature_c),
            valid: reading.valid,
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

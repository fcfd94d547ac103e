//! The electronics of the virtual bar, as the definition of its protocol describes them.

use super::fault::{FaultyLine, InjectedFaults};
use dbbd_device::protocol::ProtocolFinding;
use dbbd_device::protocol::{CommandStep, ProtocolDefinition, ProtocolEncoder, ProtocolMode};
use dbbd_model::base::units::DeviceTicks;
use dbbd_model::measurement::sample::Sample;

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

    /// Whether the program of the robot has ended: the bar then ends when the host sends the stop command or goes away. Before
    /// that it waits for the host to come back.
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
pub(super) enum DeviceCommand {
    Start,
    Stop,
    Poll,
    Zero,
}

/// When readings are sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SendTiming {
    /// As soon as there is a host.
    AtOnce,
    AfterStart,
    OnRequest,
}

pub(super) struct VirtualDevice {
    encoder: ProtocolEncoder,
    tick_ns: u32,
    wrap_bits: u32,
    modulo: u32,
    /// If several commands end with the same bytes, the first one applies.
    commands: [(DeviceCommand, Vec<u8>); 4],
    /// Requests with their answers.
    answers: Vec<(Vec<u8>, Vec<u8>)>,
    /// The last bytes from the host, which may be part of a command.
    received: Vec<u8>,
    pub(super) sends: SendTiming,
    pub(super) reply_delay_s: f64,
    /// Sent once, at the beginning.
    pub(super) banner: Vec<u8>,
    at_mm: f64,
    /// The reading that is zero, mm; `None`: the next one.
    zero_mm: Option<f64>,
    first_ticks: u64,
}

impl VirtualDevice {
    pub(super) fn new(definition: &ProtocolDefinition, first_ticks: u64, faults: &InjectedFaults) -> Self {
        // A command that consists of several messages is recognised by the last one.
        let command = |steps: &[CommandStep]| -> Vec<u8> {
            let last = steps.iter().rev().find_map(|step| match step {
                CommandStep::Send(bytes) | CommandStep::Ask { send: bytes, .. } => Some(bytes.clone()),
                _ => None,
            });
            last.unwrap_or_default()
        };
        let ProtocolDefinition { ident, zero, init, start, stop, poll, sim, .. } = definition;
        let asked = [ident, zero, init, start, stop].into_iter().flatten();
        let answers = asked.filter_map(|step| match step {
            CommandStep::Ask { send, expect, .. } => Some((send.clone(), expect.clone())),
            _ => None,
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
            _ => SendTiming::AfterStart,
        };
        let banner = match sim.banner.as_slice() {
            [] if faults.banner > 0.0 => b"ball-bar\r\n".to_vec(),
            banner => banner.to_vec(),
        };
        Self {
            encoder: definition.encoder(),
            tick_ns: definition.clock.map_or(1, |clock| clock.tick_ns),
            wrap_bits: definition.clock.map_or(64, |clock| clock.wrap_bits),
            modulo: definition.sequence_modulo.unwrap_or(u32::MAX),
            commands,
            answers: answers.collect(),
            received: Vec::new(),
            sends,
            reply_delay_s: sim.reply_delay.as_secs_f64(),
            banner,
            at_mm: sim.at_mm,
            zero_mm: Some(0.0),
            first_ticks,
        }
    }

    /// Receives a byte of the host. Returns the commands that end with it, and the answer.
    pub(super) fn receive(&mut self, byte: u8) -> (Vec<DeviceCommand>, Option<&[u8]>) {
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

    /// After the host has gone away.
    pub(super) fn forget(&mut self) {
        self.received.clear();
    }

    /// The frame of a reading at a device time, s; `count` frames were numbered before it. Empty if the bar sends none.
    pub(super) fn frame(
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
        // Outside of the stroke the device sends its word for "no reading", unless its frames have a flag for that.
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
        let zero_mm = *self.zero_mm.get_or_insert(reading.reading_mm);
        let ticks = (t_s * (1.0 + drift_ppm * 1e-6) * 1e9 / f64::from(self.tick_ns)).round() as u64;
        let ticks = ticks.wrapping_sub(wrap_ticks as u64);
        let mask = u64::MAX >> (64 - self.wrap_bits.clamp(1, 64));
        Sample {
            sequence: u32::try_from(count % u64::from(self.modulo)).ok(),
            ticks: Some(DeviceTicks(self.first_ticks.wrapping_add(ticks) & mask)),
            trigger: Some(reading.strobe),
            temperature_c: Some(reading.temperature_c),
            valid: reading.valid && over_mm == 0.0,
            ..Sample::of(reading.reading_mm - zero_mm + self.at_mm + over_mm)
        }
    }
}

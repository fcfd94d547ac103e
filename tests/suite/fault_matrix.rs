//! Every recording with every fault, replayed with its recorded times: received bytes are stored or counted as lost,
//! unwrapped counters increase, and an interrupted capture is a prefix of the complete one.
//!
//! Faults of the pseudo-terminal (unplugged, back under another name) are in `replay`.

use std::io::{self, ErrorKind, Write};
use std::path::Path;
use std::sync::{Arc, Mutex};

use dbbd::daemon::{EndReason, Recorder, RunProgress};
use dbbd_device::port::Received;
use dbbd_device::protocol::{self, DecodedItem, LineFaultKind, ProtocolDefinition};
use dbbd_job::recording::capture::{self, Capture, CaptureRecord, CaptureWriter, Disk, RunEvent};
use dbbd_job::recording::{ClockStamp, DeviceClock, DeviceTime, StreamBuilder};
use dbbd_job::sim::fault::{FaultyLine, InjectedFaults};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::sample::Sample;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::recordings::{Recording, all};

/// Faults.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Harm {
    Nothing,
    Flipped,
    Dropped,
    Doubled,
    /// Bytes at a wrong rate: a part of the stream is noise.
    Garbage,
    /// Bytes that do not reach the recorder.
    TooSlow,
    /// Silence.
    Stall,
    /// The host's clock jumps forward by an hour, as after a suspend, or back.
    Ahead,
    Back,
    /// Counters wrap, or restart because the device was switched off and on.
    Wrap,
    Reset,
    DiskFull,
    SyncFails,
    Killed,
}

const HARMS: [Harm; 14] = [
    Harm::Nothing,
    Harm::Flipped,
    Harm::Dropped,
    Harm::Doubled,
    Harm::Garbage,
    Harm::TooSlow,
    Harm::Stall,
    Harm::Ahead,
    Harm::Back,
    Harm::Wrap,
    Harm::Reset,
    Harm::DiskFull,
    Harm::SyncFails,
    Harm::Killed,
];

/// A disk in memory that fails from some byte or sync on, and remembers the end of each write.
#[derive(Clone, Default)]
struct Memory {
    taken: Arc<Mutex<Vec<u8>>>,
    ends: Arc<Mutex<Vec<usize>>>,
    room: Option<usize>,
    syncs: Option<u32>,
}

impl Write for Memory {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let mut taken = self.taken.lock().unwrap();
        let count = self.room.map_or(bytes.len(), |room| bytes.len().min(room - taken.len()));
        if count == 0 && !bytes.is_empty() {
            return Err(ErrorKind::StorageFull.into());
        }
        taken.extend(&bytes[..count]);
        self.ends.lock().unwrap().push(taken.len());
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Disk for Memory {
    fn sync(&mut self) -> io::Result<()> {
        match &mut self.syncs {
            Some(0) => Err(io::Error::other("the disk does not answer")),
            Some(left) => {
                *left -= 1;
                Ok(())
            }
            None => Ok(()),
        }
    }

    fn cut(&mut self, bytes: u64) -> io::Result<()> {
        self.taken.lock().unwrap().truncate(bytes as usize);
        Ok(())
    }
}

/// Input of the recorder.
#[derive(Clone, Debug)]
enum Given {
    Bytes(HostNs, Vec<u8>),
    Lost(HostNs, u64),
}

fn host(t_s: f64) -> HostNs {
    HostNs((t_s * 1e9) as u64)
}

/// Feeds it to the recorder of a run.
fn recorded(
    definition: &ProtocolDefinition,
    given: &[Given],
    disk: &Memory,
) -> Result<RunProgress, Diagnostic> {
    let begin = host(0.0);
    let writer = CaptureWriter::on(Box::new(disk.clone()), Path::new("run"))?;
    let mut recorder = Recorder::new(writer, definition, None, begin);
    recorder.event(begin, RunEvent::Started { unix_ns: 1, version: "0".into() })?;
    let mut last = begin;
    for given in given {
        match given {
            Given::Bytes(at, bytes) => {
                recorder.bytes(Received { host: *at, watched_s: f64::INFINITY, bytes: bytes.clone() })?;
                last = *at;
            }
            Given::Lost(at, bytes) => recorder.lost(*at, *bytes)?,
        }
        recorder.tick(last)?;
    }
    recorder.finish(last, EndReason::Duration)
}

/// A recording with a fault.
struct Case {
    recording: Recording,
    definition: ProtocolDefinition,
    harm: Harm,
    given: Vec<Given>,
    dice: Pcg64,
}

impl Case {
    /// `None` if the fault is impossible: a device without counters cannot wrap.
    fn new(recording: &Recording, harm: Harm, seed: u64) -> Option<Self> {
        let definition = recording.definition();
        let mut dice = Pcg64::seed_from_u64(seed);
        let mut pieces = recording.pieces();
        let middle = dice.random_range(1..pieces.len());
        let mut line = InjectedFaults::default();
        match harm {
            Harm::Flipped => line.flip = 0.01,
            Harm::Dropped => line.drop = 0.01,
            Harm::Doubled => line.double = 0.01,
            Harm::Garbage => {
                let count = dice.random_range(1..200);
                pieces[middle].1 = FaultyLine::new(line, seed).noise(count);
            }
            Harm::Stall => pieces[middle..].iter_mut().for_each(|(t_s, _)| *t_s += 5.0),
            Harm::Ahead => pieces[middle..].iter_mut().for_each(|(t_s, _)| *t_s += 3600.0),
            Harm::Back => pieces[middle..].iter_mut().for_each(|(t_s, _)| *t_s = (*t_s - 2.0).max(0.0)),
            Harm::Wrap | Harm::Reset => pieces = counted_anew(&definition, &pieces, harm, middle)?,
            _ => {}
        }
        let mut line = FaultyLine::new(line, seed);
        let mut given = Vec::new();
        for (at, (t_s, mut bytes)) in pieces.into_iter().enumerate() {
            line.carry(&mut bytes);
            if harm == Harm::TooSlow && at == middle {
                given.push(Given::Lost(host(t_s), bytes.len() as u64));
            } else if !bytes.is_empty() {
                given.push(Given::Bytes(host(t_s), bytes));
            }
        }
        Some(Self { recording: recording.clone(), definition, harm, given, dice })
    }

    fn holds(mut self) -> u64 {
        let name = format!("{} {:?}", self.recording.name, self.harm);
        let disk = Memory::default();
        let progress = recorded(&self.definition, &self.given, &disk).unwrap();
        let bytes = disk.taken.lock().unwrap().clone();
        let capture = capture::read_capture(&bytes);
        assert!(capture.ended() && capture.damages.is_empty(), "{name}");
        self.accounts(&name, &capture, &progress);
        self.counts_rise(&name, &capture);
        match self.harm {
            Harm::DiskFull => {
                let room = self.dice.random_range(0..bytes.len());
                self.ends_as_a_prefix(&name, &capture, Memory { room: Some(room), ..Memory::default() });
            }
            Harm::SyncFails => {
                let syncs = Some(self.dice.random_range(0..4));
                self.ends_as_a_prefix(&name, &capture, Memory { syncs, ..Memory::default() });
            }
            Harm::Killed => {
                let from = self.dice.random_range(0..5);
                for end in disk.ends.lock().unwrap().iter().skip(from).step_by(5) {
                    let cut = capture::read_capture(&bytes[..*end]);
                    assert!(cut.damages.is_empty() && capture.records.starts_with(&cut.records), "{name}");
                    let torn = capture::read_capture(&bytes[..end - 1]);
                    assert!(capture.records.starts_with(&torn.records) && torn.damages.len() == 1, "{name}");
                }
            }
            _ => {}
        }
        progress.counts.samples
    }

    /// Bytes received = bytes in samples and faults + bytes counted as lost; samples received = stored +
    /// counted as lost.
    fn accounts(&self, name: &str, capture: &Capture, progress: &RunProgress) {
        let (mut decoder, mut decoded) = (self.definition.decoder(), Vec::new());
        let mut came = 0;
        let mut lost = 0;
        for given in &self.given {
            match given {
                Given::Bytes(_, bytes) => {
                    came += bytes.len() as u64;
                    decoder.push(bytes, &mut decoded);
                }
                Given::Lost(_, bytes) => {
                    lost += bytes;
                    decoder.interrupt(&mut decoded);
                }
            }
        }
        decoder.interrupt(&mut decoded);
        assert_eq!((progress.counts.bytes, progress.counts.lost_bytes), (came, lost), "{name}");
        assert_eq!(decoded.iter().map(DecodedItem::bytes).sum::<u64>(), came, "{name}");
        let (mut samples, mut faults) = (Vec::new(), Vec::new());
        for one in decoded {
            match one {
                DecodedItem::Sample(sample, _) => samples.push(sample),
                DecodedItem::Fault(fault) => faults.push(fault),
            }
        }
        let stored: Vec<Sample> = capture.samples().map(|(_, sample)| *sample).collect();
        // A damaged frame without a check may be a NaN, which equals nothing.
        assert_eq!(format!("{stored:?}"), format!("{samples:?}"), "{name}");
        assert_eq!(progress.counts.samples, stored.len() as u64, "{name}");
        let counted_anew = matches!(self.harm, Harm::Wrap | Harm::Reset);
        if let (Some(sent), true, false) =
            (self.recording.samples(), self.definition.undetected() < 1e-4, counted_anew)
        {
            let mut sent = sent.into_iter();
            let sent = |came: &Sample| sent.any(|sent| sent == Sample { offset: 0, ..*came });
            assert!(stored.iter().all(sent), "{name}: a sample that was not sent");
        }
        let told: Vec<protocol::LineFault> = capture
            .records
            .iter()
            .filter_map(|stamped| match &stamped.record {
                CaptureRecord::Fault(json) => Some(serde_json::from_slice(json).unwrap()),
                _ => None,
            })
            .collect();
        assert_eq!(told, faults, "{name}");
        let count =
            |of: fn(&LineFaultKind) -> bool| faults.iter().filter(|fault| of(&fault.kind)).count() as u64;
        let refused = count(|kind| matches!(kind, LineFaultKind::Reject(_)));
        let passed = count(|kind| matches!(kind, LineFaultKind::Ignored));
        assert_eq!(
            (progress.counts.rejected, progress.counts.faults),
            (refused, faults.len() as u64 - refused - passed),
            "{name}"
        );
        let [gaps, missing] = capture.events().fold([0, 0], |[gaps, missing], event| {
            let (more, lost) = event.gaps();
            [gaps + more, missing + lost]
        });
        assert_eq!((progress.counts.gaps, progress.counts.missing), (gaps, missing), "{name}");
        // If a check protects the numbers, they show every missing frame between the first and the last.
        if let (Some(modulo), true) = (self.definition.sequence_modulo, self.definition.undetected() < 1e-4)
            && let (Some(first), Some(last)) = (stored.first(), stored.last())
            && self.harm != Harm::Reset
        {
            let span = last.sequence.unwrap() + modulo - first.sequence.unwrap();
            assert_eq!(
                u64::from(span % modulo) + 1,
                progress.counts.samples + progress.counts.missing,
                "{name}"
            );
        }
        let silent = capture.events().any(
            |event| matches!(event, RunEvent::Gap { reason, .. } if reason.starts_with("nothing was received")),
        );
        let waits = self.definition.stall.is_some() && matches!(self.harm, Harm::Stall | Harm::Ahead);
        assert!(silent || !waits, "{name}: a silence that was not told");
    }

    /// Device time never decreases; it increases with each sample if no byte was damaged.
    fn counts_rise(&self, name: &str, capture: &Capture) {
        let Some(clock) = self.definition.clock else { return };
        let mut time = DeviceTime::new(clock.into());
        let seconds = capture
            .samples()
            .map(|(host, sample)| time.seconds(ClockStamp { host, ticks: sample.ticks.unwrap_or_default() }));
        let seconds: Vec<f64> = seconds.collect();
        assert!(seconds.windows(2).all(|pair| pair[0] <= pair[1]), "{name}");
        let harmed = matches!(self.harm, Harm::Flipped | Harm::Dropped | Harm::Doubled | Harm::Garbage);
        let sound = self.recording.name == self.recording.protocol() || self.definition.undetected() < 1e-4;
        if harmed || !sound {
            return;
        }
        let still = seconds.windows(2).filter(|pair| pair[0] == pair[1]).count();
        assert_eq!(still, 0, "{name}: over a restart it goes on with the host");
        let device = DeviceClock {
            seconds_per_tick: f64::from(clock.tick_ns) * 1e-9,
            wrap: 1u64.checked_shl(clock.wrap_bits),
        };
        let mut stream = StreamBuilder::new(Some(device));
        capture.samples().for_each(|(host, sample)| stream.push(host, sample));
        let stream = stream.build();
        assert!(stream.t_s.windows(2).all(|pair| pair[0] <= pair[1]), "{name}");
        if self.harm == Harm::Wrap {
            assert_eq!((stream.clock().unwrap().wraps, stream.breaks.len()), (1, 0), "{name}");
        }
        if self.harm == Harm::Reset {
            assert_eq!(stream.breaks.len(), 1, "{name}: {:?}", stream.clock().unwrap().breaks);
        }
    }

    /// The run ends, reports what is kept, and its file is a prefix of that of the undisturbed run.
    fn ends_as_a_prefix(&self, name: &str, whole: &Capture, disk: Memory) {
        let failed = recorded(&self.definition, &self.given, &disk);
        let Err(failed) = failed else {
            assert!(
                self.harm == Harm::SyncFails,
                "{name}: a short recording may be over before the disk fails"
            );
            return;
        };
        let cut = capture::read_capture(&disk.taken.lock().unwrap());
        assert!(cut.damages.is_empty() && whole.records.starts_with(&cut.records), "{name}");
        assert!(cut.records.len() < whole.records.len() || self.harm == Harm::SyncFails, "{name}");
        let kept = format!("{} samples", cut.samples().count());
        let said = failed.to_string();
        assert!(said.contains(&kept) && said.contains("help:"), "{name}: {said}");
    }
}

/// The same readings with other counters: they wrap in the middle, or restart there.
fn counted_anew(
    definition: &ProtocolDefinition,
    pieces: &[(f64, Vec<u8>)],
    harm: Harm,
    middle: usize,
) -> Option<Vec<(f64, Vec<u8>)>> {
    let clock = definition.clock?;
    let (mut decoder, mut samples) = (definition.decoder(), Vec::new());
    for (t_s, bytes) in pieces {
        let mut decoded = Vec::new();
        decoder.push(bytes, &mut decoded);
        samples.extend(decoded.into_iter().filter_map(|one| match one {
            DecodedItem::Sample(sample, _) => Some((*t_s, sample)),
            DecodedItem::Fault(_) => None,
        }));
    }
    // Away from the ends, where a restart is hardly visible.
    let (count, quarter) = (samples.len(), samples.len() / 4);
    let middle = quarter + (middle * count / pieces.len()) / 2;
    let mask = u64::MAX >> (64 - clock.wrap_bits);
    let (ticks, sequence) = (samples[middle].1.ticks?.0, samples[middle].1.sequence);
    // A counter that restarts shortly before its wrap has wrapped, as far as can be seen, and one that just
    // started steps
    // back by too little.
    if harm == Harm::Reset && (ticks > mask / 2 || ticks as f64 * f64::from(clock.tick_ns) < 0.5e9) {
        return None;
    }
    let modulo = definition.sequence_modulo.unwrap_or(1);
    let mut again = Vec::new();
    for (at, (t_s, sample)) in samples.iter().enumerate() {
        let mut sample = *sample;
        if harm == Harm::Wrap || at >= middle {
            sample.ticks = sample.ticks.map(|now| DeviceTicks(now.0.wrapping_sub(ticks) & mask));
            let from = sequence.unwrap_or(0);
            sample.sequence = sample.sequence.map(|now| (now + modulo - from % modulo) % modulo);
        }
        let mut bytes = Vec::new();
        definition.encoder().encode(&sample, &mut bytes).unwrap();
        again.push((*t_s, bytes));
    }
    Some(again)
}

fn matrix(seeds: std::ops::Range<u64>) {
    let (mut cases, mut samples) = (0, 0);
    for recording in all() {
        for harm in HARMS {
            for seed in seeds.clone() {
                if let Some(case) = Case::new(&recording, harm, seed) {
                    samples += case.holds();
                    cases += 1;
                }
            }
        }
    }
    eprintln!("{cases} cases, {samples} samples");
    assert!(cases > 300);
}

#[test]
fn every_recording_over_every_fault() {
    matrix(0..2);
}

/// `cargo test --release --test suite fault_matrix -- --ignored --nocapture`
#[test]
#[ignore = "a campaign"]
fn every_recording_over_every_fault_with_100_seeds() {
    matrix(0..100);
}

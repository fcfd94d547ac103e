//! Kills, truncation, flipped bits and failing disks: short samples here, the campaigns with `-- --ignored`
//! (commands and
//! figures: docs/evidence/README.md).
#![cfg(unix)]

use std::io::{self, Write};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, OnceLock};

use dbbd::daemon::{Acquisition, AcquisitionOptions, ControllerConnections, EndReason, RunProgress};
use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;
use dbbd_model::provenance::Identity;

use crate::cell::{codes, stderr};
use crate::process::{dbbd, run};
use dbbd_job::recording::capture::{
    self, Capture, CaptureRecord, CaptureWriter, Disk, RunEnd, RunEvent, StampedRecord,
};
use dbbd_job::sim::bar::{self, SimulatedReading, Terminal};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const PERIOD: u64 = 20_001;

/// Readings on the 10 nm grid of the protocol, each identified by its number.
fn reading_mm(frame: u64) -> f64 {
    ((frame % PERIOD) as f64 - 10_000.0) / 1e5
}

fn definition() -> ProtocolDefinition {
    ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap()
}

/// A bar that streams until `over`, as fast as it is read; returns the name of its port.
fn stream(over: &Arc<AtomicBool>) -> String {
    let terminal = Terminal::new().unwrap();
    let name = terminal.address().to_string();
    let over = Arc::clone(over);
    std::thread::spawn(move || {
        let source = |t_s: f64| {
            let reading_mm = reading_mm((t_s * 1000.0).round() as u64);
            let reading = SimulatedReading { reading_mm, strobe: false, valid: true, temperature_c: 20.0 };
            (!over.load(Ordering::Relaxed)).then_some(reading)
        };
        bar::serve_bar(
            terminal,
            &definition(),
            bar::VirtualBarOptions { rate_hz: 1000.0, speed: 0.0, first_ticks: 0 },
            source,
        )
    });
    name
}

fn size(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |data| data.len())
}

/// The samples are those that the bar sent, in order from the first.
fn is_prefix_of_what_was_sent(capture: &Capture) -> usize {
    let mut frame = 0;
    for (_, sample) in capture.samples() {
        assert_eq!(sample.sequence, Some((frame % 65_536) as u32));
        assert_eq!(sample.reading_mm, reading_mm(frame), "frame {frame}");
        frame += 1;
    }
    frame as usize
}

/// Kills the acquisition at random moments. Every sample in the file before the kill is read afterwards, and
/// `recover`
/// gives exactly the whole records.
fn kills(count: u64) {
    let mut random = Pcg64::seed_from_u64(1);
    let (mut torn, mut samples) = (0, 0);
    for _ in 0..count {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run");
        let over = Arc::default();
        let port = stream(&over);
        let mut child: Child =
            dbbd(&["acquire", "--port", &port, "--out", path.to_str().unwrap()]).spawn().unwrap();
        let until = random.random_range(0..400_000);
        let begun = clock::now();
        while size(&path) < until && clock::now().seconds_since(begun) < 20.0 {
            clock::sleep(random.random_range(0.0..0.003));
        }
        let before = size(&path);
        child.kill().unwrap();
        child.wait().unwrap();
        over.store(true, Ordering::Relaxed);
        if before == 0 {
            continue;
        }
        let bytes = std::fs::read(&path).unwrap();
        let capture = capture::read_capture(&bytes);
        let end = match &capture.damages[..] {
            [] => bytes.len(),
            [tail] => {
                torn += 1;
                assert_eq!((tail.offset + tail.bytes) as usize, bytes.len(), "{tail:?}");
                tail.offset as usize
            }
            more => panic!("{more:?}"),
        };
        // The last record may be torn; all before it are whole.
        let before = capture::read_capture(&bytes[..before as usize]);
        assert!(capture.records.starts_with(&before.records));
        samples += is_prefix_of_what_was_sent(&capture);
        let raw: u64 = capture
            .records
            .iter()
            .map(|stamped| match &stamped.record {
                CaptureRecord::Raw(raw) => raw.len() as u64,
                _ => 0,
            })
            .sum();
        assert!(capture.samples().all(|(_, sample)| sample.offset < raw), "a sample without its bytes");
        let recovered = directory.path().join("recovered");
        let output = run(&["recover", path.to_str().unwrap(), "--out", recovered.to_str().unwrap()]);
        if capture.records.is_empty() {
            assert_eq!(output.status.code(), Some(1));
        } else {
            assert_eq!(output.status.code(), Some(3), "{}", stderr(&output));
            assert!(stderr(&output).contains("cut off"), "{}", stderr(&output));
            assert_eq!(std::fs::read(&recovered).unwrap(), bytes[..end]);
        }
    }
    eprintln!("{count} kills: {samples} samples, {torn} torn tails");
}

#[test]
fn killed_writer_keeps_all_written_records() {
    kills(4);
}

#[test]
#[ignore = "a campaign"]
fn killed_at_300_moments_it_keeps_what_was_written() {
    kills(300);
}

/// A capture of more than 200 kB with every kind of record.
fn long() -> &'static (Vec<u8>, Vec<usize>, Vec<StampedRecord>) {
    static LONG: OnceLock<(Vec<u8>, Vec<usize>, Vec<StampedRecord>)> = OnceLock::new();
    LONG.get_or_init(|| {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("run");
        let mut writer = CaptureWriter::create(&path).unwrap();
        let mut random = Pcg64::seed_from_u64(2);
        let mut ends = vec![size(&path) as usize];
        let mut records = Vec::new();
        let mut write = |host: u64, record: CaptureRecord| {
            writer.write(HostNs(host), &record).unwrap();
            ends.push(size(&path) as usize);
            records.push(StampedRecord { host: HostNs(host), record });
        };
        write(0, CaptureRecord::Event(RunEvent::Started { unix_ns: 1, version: "0".into() }));
        write(0, CaptureRecord::Attachment { name: "plan.csv".into(), content: vec![b'1'; 5000] });
        let mut frame = 0_u64;
        while frame < 4000 {
            let count = random.random_range(1..9);
            // Random bytes, with the start of a record among them.
            let mut raw: Vec<u8> = (0..18 * count).map(|_| random.random::<u8>()).collect();
            if frame.is_multiple_of(7) {
                raw[..4].copy_from_slice(&[0xdb, 0xbd, 0x5a, 0xa5]);
            }
            write(frame, CaptureRecord::Raw(raw));
            let sample = |frame: u64| Sample {
                reading_mm: reading_mm(frame),
                sequence: Some(frame as u32),
                ticks: Some(DeviceTicks(1000 * frame)),
                trigger: Some(false),
                temperature_c: Some(20.0),
                valid: true,
                status: 0,
                offset: 18 * frame,
            };
            write(frame, CaptureRecord::Samples((frame..frame + count).map(sample).collect()));
            frame += count;
        }
        write(
            frame,
            CaptureRecord::Event(RunEvent::Ended(RunEnd { reason: "done".into(), samples: frame, lost: 0 })),
        );
        (std::fs::read(&path).unwrap(), ends, records)
    })
}

/// After truncation every record before is whole, nothing else is, and the tail is reported.
fn cut(at: usize) {
    let (bytes, ends, records) = long();
    let capture = capture::read_capture(&bytes[..at]);
    let whole = ends.partition_point(|end| *end <= at).saturating_sub(1);
    assert_eq!(capture.records.len(), whole, "cut at {at}");
    assert!(capture.records == records[..whole], "cut at {at}");
    let torn = usize::from(at > 0 && !ends.contains(&at));
    assert_eq!(capture.damages.len(), torn, "cut at {at}");
    if let [damage] = &capture.damages[..] {
        assert_eq!((damage.offset + damage.bytes) as usize, at);
    }
}

/// A flipped bit loses its record only, and the position of the record is reported.
fn flip(bit: usize) {
    let (bytes, ends, records) = long();
    let mut bytes = bytes.clone();
    bytes[bit / 8] ^= 1 << (bit % 8);
    let capture = capture::read_capture(&bytes);
    let harmed = ends.partition_point(|end| *end <= bit / 8);
    let kept = records.iter().enumerate().filter(|(at, _)| at + 1 != harmed).map(|(_, record)| record);
    assert!(capture.records.iter().eq(kept), "bit {bit}");
    let [damage] = &capture.damages[..] else { panic!("bit {bit}: {:?}", capture.damages) };
    let start = if harmed == 0 { 0 } else { ends[harmed - 1] };
    assert_eq!((damage.offset, damage.bytes), (start as u64, (ends[harmed] - start) as u64), "bit {bit}");
}

fn cuts_and_flips(last: usize, random: usize, flips: usize) {
    let (bytes, ..) = long();
    (bytes.len() - last..=bytes.len()).for_each(cut);
    let mut numbers = Pcg64::seed_from_u64(3);
    (0..random).for_each(|_| cut(numbers.random_range(0..=bytes.len())));
    (0..flips).for_each(|_| flip(numbers.random_range(0..8 * bytes.len())));
    eprintln!("{} bytes: {} cuts, {flips} flipped bits", bytes.len(), last + 1 + random);
}

#[test]
fn damage_loses_only_damaged_records() {
    cuts_and_flips(300, 30, 100);
}

#[test]
#[ignore = "a campaign"]
fn cut_at_every_byte_of_64_kib_and_2000_places_it_is_a_prefix() {
    cuts_and_flips(65_536, 2000, 20_000);
}

/// Acquires until the program ends; returns its output.
fn acquire_in_shell(before: &str, path: &Path) -> Output {
    let over = Arc::default();
    let port = stream(&over);
    let command = format!(
        "{before} exec '{}' acquire --port '{port}' --duration 20 --out '{}'",
        env!("CARGO_BIN_EXE_dbbd"),
        path.display()
    );
    let output = Command::new("sh").args(["-c", &command]).stdin(Stdio::null()).output().unwrap();
    over.store(true, Ordering::Relaxed);
    output
}

/// The run failed with a reason, and its file contains whole records only.
fn ended_by_the_disk(output: &Output, path: &Path, remedy: &str) {
    let said = stderr(output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert_eq!(codes(output), ["W0418", "E0403"], "{said}");
    assert!(said.contains(remedy), "{said}");
    let capture = capture::read_capture(&std::fs::read(path).unwrap());
    assert_eq!(capture.damages, []);
    assert!(!capture.ended());
    let samples = is_prefix_of_what_was_sent(&capture);
    assert!(samples > 100 && said.contains(&format!("{samples} samples")), "{samples}: {said}");
}

#[cfg(unix)]
#[test]
fn file_size_limit_ends_the_run() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("run");
    // Blocks of 512 or 1024 bytes, by the shell.
    let output = acquire_in_shell("trap '' XFSZ; ulimit -f 100;", &path);
    ended_by_the_disk(&output, &path, "ulimit -f");
}

/// Run as root, which can mount a small file system.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "needs root: mounts a file system of 256 kB"]
fn a_full_disk_ends_the_run_and_keeps_it() {
    let mount = Mount::new(&["-t", "tmpfs", "-o", "size=256k", "tmpfs"]);
    let path = mount.0.path().join("run");
    let output = acquire_in_shell("", &path);
    ended_by_the_disk(&output, &path, "make room");
    // Not even the header of another capture fits; no empty file is left.
    std::fs::write(mount.0.path().join("rest"), vec![0; 1 << 20]).unwrap_err();
    let output = acquire_in_shell("", &mount.0.path().join("second"));
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    assert!(!mount.0.path().join("second").exists());
}

#[test]
fn unwritable_location_is_reported() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("missing").join("run");
    let output = acquire_in_shell("", &path);
    assert_eq!(output.status.code(), Some(1));
    let said = stderr(&output);
    assert_eq!(codes(&output), ["E0402"], "{said}");
    if cfg!(target_os = "linux") {
        // Not even root can create a file there.
        let output = acquire_in_shell("", Path::new("/sys/dbbd-run"));
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(codes(&output), ["E0402"], "{}", stderr(&output));
    }
}

/// A mount on a temporary directory.
struct Mount(tempfile::TempDir);

impl Mount {
    fn new(what: &[&str]) -> Self {
        let directory = tempfile::tempdir().unwrap();
        let status = Command::new("mount").args(what).arg(directory.path()).status().unwrap();
        assert!(status.success(), "only root can mount");
        Self(directory)
    }
}

impl Drop for Mount {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}

/// A disk that blocks while it is stalled.
struct Stalling {
    taken: Arc<Mutex<Vec<u8>>>,
    stalled: Arc<AtomicBool>,
}

impl Write for Stalling {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        while self.stalled.load(Ordering::Relaxed) {
            clock::sleep(0.01);
        }
        self.taken.lock().unwrap().extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Disk for Stalling {
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }

    fn cut(&mut self, bytes: u64) -> io::Result<()> {
        self.taken.lock().unwrap().truncate(bytes as usize);
        Ok(())
    }
}

/// Records from `port` for a second, stalls the disk for `stall_s`, and ends; returns capture and counts.
fn stalled(port: String, stall_s: f64) -> (Capture, RunProgress) {
    let (taken, stalled, stop) = (Arc::default(), Arc::default(), Arc::default());
    let disk = Stalling { taken: Arc::clone(&taken), stalled: Arc::clone(&stalled) };
    let writer = CaptureWriter::on(Box::new(disk), Path::new("run")).unwrap();
    let options = AcquisitionOptions {
        port: port.parse().unwrap(),
        definition: definition(),
        out: "run".into(),
        plan: None,
        identity: Identity::default(),
        controller: ControllerConnections::default(),
        duration_s: None,
        gone_s: 1.0,
        feed: None,
        sync_s: 0.1,
    };
    let acquisition = Acquisition::start_on(writer, options, Arc::clone(&stop)).unwrap();
    clock::sleep(0.3);
    stalled.store(true, Ordering::Relaxed);
    clock::sleep(stall_s);
    stalled.store(false, Ordering::Relaxed);
    clock::sleep(1.0);
    stop.store(true, Ordering::Relaxed);
    let summary = acquisition.join().unwrap();
    assert_eq!(summary.ending, EndReason::Stopped);
    let capture = capture::read_capture(&taken.lock().unwrap());
    assert!(capture.ended() && capture.damages.is_empty());
    (capture, summary.progress)
}

/// A pseudo-terminal waits for its reader: a stalled disk delays, and nothing is lost.
#[test]
fn stalled_disk_loses_nothing_on_a_pseudo_terminal() {
    let over = Arc::default();
    let (capture, progress) = stalled(stream(&over), 0.5);
    over.store(true, Ordering::Relaxed);
    assert_eq!((progress.counts.lost_bytes, progress.counts.missing), (0, 0));
    assert!(is_prefix_of_what_was_sent(&capture) > 100);
}

/// A device does not wait. A terminal outside of the path of pseudo-terminals simulates one.
#[cfg(target_os = "linux")]
#[test]
#[ignore = "needs root: mounts /dev/pts at a second place"]
fn what_a_stalled_disk_loses_of_a_device_is_counted_and_named() {
    let mount = Mount::new(&["--bind", "/dev/pts"]);
    let over = Arc::default();
    let pty = stream(&over);
    let port = mount.0.path().join(Path::new(&pty).file_name().unwrap());
    let (capture, progress) = stalled(port.display().to_string(), 8.0);
    over.store(true, Ordering::Relaxed);
    // The sequence numbers wrapped more than once, so they do not show the number of frames.
    assert!(progress.counts.lost_bytes > 0 && progress.counts.gaps > 0, "{progress:?}");
    let lost: u64 = capture
        .events()
        .filter_map(|event| match event {
            RunEvent::Gap { reason, .. } => {
                reason.strip_suffix(" bytes were lost: the recorder was too slow")
            }
            _ => None,
        })
        .map(|bytes| bytes.parse::<u64>().unwrap())
        .sum();
    assert_eq!(lost, progress.counts.lost_bytes);
    let missing = capture.events().map(|event| event.gaps().1);
    assert_eq!(missing.sum::<u64>(), progress.counts.missing);
    eprintln!("{} samples kept, {lost} bytes lost and counted", progress.counts.samples);
}

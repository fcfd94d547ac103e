//! However a run ends, and however slow the disk is: what the port took is in the capture, or it is counted; and a finding
//! names who was to blame.
#![cfg(unix)]

use std::io::{self, Write};
use std::net::TcpListener;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use dbbd::daemon::{Acquisition, AcquisitionOptions, AcquisitionSummary, ControllerConnections, EndReason};
use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::{self, CaptureRecord, CaptureWriter, Disk};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::Identity;

/// A disk whose syncs and writes take their time, and which is full after some bytes.
#[derive(Clone)]
struct SlowDisk {
    taken: Arc<Mutex<Vec<u8>>>,
    sync_s: f64,
    write_s: f64,
    room: usize,
}

impl Write for SlowDisk {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        clock::sleep(self.write_s);
        let mut taken = self.taken.lock().unwrap();
        if taken.len() + bytes.len() > self.room {
            return Err(io::ErrorKind::StorageFull.into());
        }
        taken.extend(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Disk for SlowDisk {
    fn sync(&mut self) -> io::Result<()> {
        clock::sleep(self.sync_s);
        Ok(())
    }

    fn second(&self) -> io::Result<Option<Box<dyn Disk>>> {
        Ok(Some(Box::new(self.clone())))
    }

    fn cut(&mut self, bytes: u64) -> io::Result<()> {
        self.taken.lock().unwrap().truncate(bytes as usize);
        Ok(())
    }
}

/// Lines, and when the port took them.
type SentLines = Vec<(HostNs, Vec<u8>)>;

/// A bar at a TCP port that sends 1000 lines a second, without regard to its reader, until `over` or for `lines`. Returns its
/// address, and the time and the bytes of each line that the port took.
fn bar(lines: u64, over: &Arc<AtomicBool>) -> (String, JoinHandle<SentLines>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("tcp://{}", listener.local_addr().unwrap());
    let over = Arc::clone(over);
    let sender = std::thread::spawn(move || {
        let (mut line, _) = listener.accept().unwrap();
        let began = clock::now();
        let mut sent = Vec::new();
        for number in 0..lines {
            clock::sleep((1e-3 * number as f64 - clock::now().seconds_since(began)).max(0.0));
            let text = format!("{},{:.4}\r\n", 1000 * number, 1e-3 * (number % 7) as f64).into_bytes();
            if over.load(Ordering::Relaxed) || line.write_all(&text).is_err() {
                break;
            }
            sent.push((clock::now(), text));
        }
        sent
    });
    (address, sender)
}

/// A run ends so long after its beginning, or after the bar was opened.
const DURATION_S: f64 = 3.5;
const STOPPED_S: f64 = 1.5;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Ends {
    Stop,
    Duration,
    Gone,
    DiskFull,
}

struct Ended {
    summary: Result<AcquisitionSummary, Diagnostic>,
    findings: Vec<Diagnostic>,
    /// The bytes in the capture, those that the port took, and how many it took up to 0.1 s before the end.
    recorded: Vec<u8>,
    sent: Vec<u8>,
    sent_before: usize,
}

impl Ended {
    /// The place among the sent bytes at which the recorded ones end. None is missing among them; what came before the start
    /// was discarded.
    fn recorded_to(&self) -> usize {
        let first = &self.recorded[..self.recorded.len().min(100)];
        let at = self.sent.windows(first.len()).position(|bytes| bytes == first).unwrap();
        let end = at + self.recorded.len();
        assert!(self.sent.get(at..end) == Some(&self.recorded[..]), "another sequence of bytes");
        end
    }
}

fn run(disk: SlowDisk, sync_s: f64, ends: Ends) -> Ended {
    let (over, stop) = (Arc::default(), Arc::default());
    let lines = if ends == Ends::Gone { 3500 } else { u64::MAX };
    let (port, sender) = bar(lines, &over);
    let writer = CaptureWriter::on(Box::new(disk.clone()), Path::new("run")).unwrap();
    let options = AcquisitionOptions {
        port: port.parse().unwrap(),
        definition: ProtocolDefinition::by_name("dbb-csv-1").unwrap().unwrap(),
        out: "run".into(),
        plan: None,
        identity: Identity::default(),
        controller: ControllerConnections::default(),
        duration_s: (ends == Ends::Duration).then_some(DURATION_S),
        gone_s: 0.3,
        feed: None,
        sync_s,
    };
    // The opening, in which the bar is stopped, counts.
    let began = clock::now();
    let acquisition = Acquisition::start_on(writer, options, Arc::clone(&stop)).unwrap();
    let (since, after_s) =
        if ends == Ends::Duration { (began, DURATION_S) } else { (clock::now(), STOPPED_S) };
    if ends == Ends::Stop {
        clock::sleep(STOPPED_S);
        assert!(acquisition.mark("before the end".into()));
        stop.store(true, Ordering::Relaxed);
    }
    while !acquisition.is_over() {
        clock::sleep(0.005);
    }
    let findings = acquisition.findings();
    let summary = acquisition.join();
    over.store(true, Ordering::Relaxed);
    let sent = sender.join().unwrap();
    let bytes = |lines: &[(HostNs, Vec<u8>)]| lines.iter().flat_map(|(_, line)| line.clone()).collect();
    let sent_before = sent.iter().filter(|(at, _)| at.seconds_since(since) < after_s - 0.1);
    let sent_before = sent_before.map(|(_, line)| line.len()).sum();
    let capture = capture::read_capture(&disk.taken.lock().unwrap());
    assert!(capture.damages.is_empty());
    let raw = capture.records.iter().filter_map(|record| match &record.record {
        CaptureRecord::Raw(bytes) => Some(bytes.clone()),
        _ => None,
    });
    Ended { summary, findings, recorded: raw.flatten().collect(), sent: bytes(&sent), sent_before }
}

fn disk(sync_s: f64, write_s: f64) -> SlowDisk {
    SlowDisk { taken: Arc::default(), sync_s, write_s, room: usize::MAX }
}

/// Of a bar that never pauses all that the port took is recorded, byte for byte, by a disk that is only slow.
#[test]
fn a_slow_disk_loses_nothing() {
    let disks = [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.8, 0.0, 1.0), (0.0, 0.01, 1.0), (3.0, 0.01, 0.0)];
    let cases =
        disks.iter().flat_map(|disk| [Ends::Stop, Ends::Duration, Ends::Gone].map(|ends| (*disk, ends)));
    std::thread::scope(|scope| {
        for ((sync_s, write_s, every_s), ends) in cases {
            scope.spawn(move || {
                let ended = run(disk(sync_s, write_s), every_s, ends);
                let name = format!("sync {sync_s} s, write {write_s} s, {ends:?}");
                let progress = ended.summary.as_ref().unwrap().progress;
                let recorded_to = ended.recorded_to();
                assert!(
                    recorded_to >= ended.sent_before && ended.sent_before > 15_000,
                    "{name}: {progress:?}"
                );
                if ends == Ends::Gone {
                    assert_eq!(recorded_to, ended.sent.len(), "{name}");
                } else {
                    // The port itself is away for a while at the other end.
                    assert_eq!((progress.silent_s, progress.stood_still_s), (0.0, 0.0), "{name}");
                }
                assert_eq!((progress.counts.lost_bytes, progress.counts.missing), (0, 0), "{name}");
            });
        }
    });
}

/// What a full disk refuses is counted.
#[test]
fn what_a_full_disk_refuses_is_counted() {
    let full = SlowDisk { room: 20_000, ..disk(0.0, 0.0) };
    let ended = run(full, 1.0, Ends::DiskFull);
    assert_eq!(ended.summary.as_ref().unwrap_err().code().as_str(), "E0403");
    let refused: u64 = ended
        .findings
        .iter()
        .filter(|finding| finding.code().as_str() == "W0418")
        .map(|finding| {
            let said = finding.to_string();
            let number = said.split(" bytes that").next().unwrap().rsplit(' ').next().unwrap();
            number.parse::<u64>().unwrap()
        })
        .sum();
    // At least what the reader takes in the last 0.1 s.
    let total = ended.recorded_to() + refused as usize;
    assert!(refused > 1000 && total <= ended.sent.len(), "{refused}");
}

/// A remark that a run takes is in its capture; after the end it takes none.
#[test]
fn a_remark_is_recorded_or_refused() {
    let taken = disk(0.0, 0.0);
    let ended = run(taken.clone(), 1.0, Ends::Stop);
    assert_eq!(ended.summary.unwrap().ending, EndReason::Stopped);
    let capture = capture::read_capture(&taken.taken.lock().unwrap());
    let marks = capture.records.iter().filter(|record| {
        matches!(&record.record, CaptureRecord::Event(capture::RunEvent::Mark { text }) if text == "before the end")
    });
    assert_eq!(marks.count(), 1);
}

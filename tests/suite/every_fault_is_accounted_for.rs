//! Every kind of `simulate --fault`, between two programs on a pseudo-terminal: recorded samples were sent, and
//! faults
//! are reported. Recordings of most of them are played in `replay`.
#![cfg(unix)]

use std::collections::BTreeSet;
use std::io::{Read, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use dbbd_job::recording::capture::{Capture, CaptureRecord, RunEvent, StampedRecord};
use dbbd_job::recording::{DeviceClock, SampleStream, StreamBuilder};
use dbbd_job::sim::bar::Terminal;
use serde_json::Value;
use serialport::{SerialPort, TTYPort};

use crate::cell::{codes, stderr};
use crate::process::dbbd;
use crate::virtual_bar::{RATE_HZ, Row, Run, acquire, acquire_until, simulate, simulate_at};

/// Length of a frame of `dbb-cobs-1`.
const FRAME: u64 = 18;

/// Frames that the bar sends over a good line.
fn truth() -> &'static [f64] {
    static TRUTH: OnceLock<Vec<f64>> = OnceLock::new();
    TRUTH.get_or_init(|| {
        let directory = tempfile::tempdir().unwrap();
        let bar = simulate(directory.path(), "0", &[]);
        let run = acquire_until(directory.path(), &bar.port, |capture| capture.samples().count() > 4000);
        assert_eq!(run.output.status.code(), Some(0), "{}", stderr(&run.output));
        // The end may split a frame.
        assert!(run.rows.len() > 3000 && run.faults.len() <= 1, "{:?}", run.faults);
        assert!((0..).zip(&run.rows).all(|(frame, row)| row.frame == frame));
        let readings: Vec<f64> = run.rows.iter().map(|row| row.sample.reading_mm).collect();
        // They differ, so that a misplaced reading is detected.
        let different: BTreeSet<u64> = readings.iter().map(|mm| mm.to_bits()).collect();
        assert!(different.len() > 1000);
        readings
    })
}

/// Protocol, fault, and duration.
const KINDS: &[(&str, &str, &str)] = &[
    ("dbb-cobs-1", "drop=0.002", "1.2"),
    ("dbb-cobs-1", "flip=0.002", "1.2"),
    ("dbb-cobs-1", "double=0.002", "1.2"),
    ("dbb-cobs-1", "insert=0.002", "1.2"),
    ("dbb-cobs-1", "batch_ms=1000", "2.5"),
    ("dbb-cobs-1", "banner=1", "1.2"),
    ("dbb-cobs-1", "echo=1", "1.2"),
    ("dbb-cobs-1", "stale=1000", "1.2"),
    ("dbb-cobs-1", "skip=0.01", "1.2"),
    ("dbb-cobs-1", "wrap_ticks=500000", "1.2"),
    ("dbb-cobs-1", "over_mm=3", "1.2"),
    ("sylvac-opto", "silence=0.4", "3"),
    ("sylvac-opto", "refuse=0.4", "2.5"),
    ("sylvac-opto", "echo=1", "1.5"),
    ("microepsilon-ild1420", "refuse=0.1", "1.2"),
];

/// A run with a fault. The runs are concurrent, since most of their time is waiting.
fn with(protocol: &str, fault: &str) -> &'static Run {
    static RUNS: OnceLock<Vec<Run>> = OnceLock::new();
    let runs = RUNS.get_or_init(|| {
        truth();
        std::thread::scope(|scope| {
            let runs = KINDS.iter().map(|(protocol, fault, seconds)| {
                scope.spawn(move || {
                    let directory = tempfile::tempdir().unwrap();
                    let rest = ["--protocol", protocol, "--fault", fault];
                    let bar = simulate(directory.path(), "1", &rest);
                    acquire(directory.path(), &bar.port, seconds, &["--protocol", protocol])
                })
            });
            let runs: Vec<_> = runs.collect();
            runs.into_iter().map(|run| run.join().unwrap()).collect()
        })
    });
    let at = KINDS.iter().position(|kind| (kind.0, kind.1) == (protocol, fault)).unwrap();
    &runs[at]
}

impl Run {
    fn count(&self, what: &str) -> u64 {
        self.summary["progress"][what].as_u64().unwrap()
    }

    /// Every sample equals its frame, and every byte belongs to a sample or a fault.
    fn holds(&self) {
        let truth = truth();
        assert!(self.rows.len() > 200, "{} samples: {}", self.rows.len(), stderr(&self.output));
        for Row { frame, sample, .. } in &self.rows {
            if let Some(mm) = truth.get(*frame as usize) {
                assert_eq!(sample.reading_mm, *mm, "frame {frame}");
            }
            assert_eq!(sample.sequence.map(u64::from), Some(frame % 65536));
            assert!(sample.valid);
        }
        let in_faults: u64 = self.faults.iter().map(|(_, _, bytes)| bytes).sum();
        assert_eq!(self.bytes, self.rows.len() as u64 * FRAME + in_faults);
    }

    /// Frames between the first and the last sample without a sample, by their device time.
    fn absent(&self) -> u64 {
        let ends = self.rows.first().zip(self.rows.last());
        ends.map_or(0, |(first, last)| last.frame - first.frame + 1 - self.rows.len() as u64)
    }

    fn of(&self, kinds: &[&str]) -> usize {
        self.faults.iter().filter(|(kind, _, _)| kinds.contains(&kind.as_str())).count()
    }

    fn events(&self, name: &str) -> Vec<&Value> {
        self.events.iter().filter(|(_, event, _)| event == name).map(|(_, _, detail)| detail).collect()
    }

    /// The evaluated stream, and the true times of the frames, s.
    fn stream(&self) -> (SampleStream, Vec<f64>) {
        let clock = DeviceClock { seconds_per_tick: 1e-6, wrap: Some(1 << 32) };
        let mut stream = StreamBuilder::new(Some(clock));
        self.rows.iter().for_each(|row| stream.push(row.host, &row.sample));
        let mut turns = 0;
        let mut last = None;
        let times = self.rows.iter().map(|row| {
            let now = row.sample.sequence.unwrap();
            turns += u64::from(last.is_some_and(|last| now < last));
            last = Some(now);
            (turns * 65536 + u64::from(now)) as f64 / RATE_HZ
        });
        let times = times.collect();
        (stream.build(), times)
    }
}

/// Damaged bytes: each lost frame is counted, and no sample is invented.
fn damage(fault: &str) {
    let run = with("dbb-cobs-1", fault);
    run.holds();
    assert!(run.absent() > 3, "{fault}: {} absent", run.absent());
    assert_eq!(run.count("missing"), run.absent(), "{fault}");
    assert!(run.count("faults") > 3 && run.of(&["framing", "check"]) > 3, "{fault}: {:?}", run.faults);
    assert!(!run.events("gap").is_empty());
    assert_eq!(run.output.status.code(), Some(3), "samples are missing: {}", stderr(&run.output));
}

#[test]
fn damaged_bytes() {
    ["drop=0.002", "flip=0.002", "double=0.002", "insert=0.002"].into_iter().for_each(damage);
}

fn spread(errors: &[f64]) -> f64 {
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    (errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Standard deviations of a run's times from the true ones, s: by arrival, by a least-squares line through
/// arrivals and
/// device times, and as evaluated; and the stream.
fn chain(seconds: &str, drift_ppm: &str) -> ([f64; 3], SampleStream) {
    let directory = tempfile::tempdir().unwrap();
    let drift = format!("drift_ppm={drift_ppm}");
    let bar = simulate(directory.path(), "1", &["--fault", "batch_ms=16", "--fault", &drift]);
    let run = acquire(directory.path(), &bar.port, seconds, &[]);
    assert_eq!(run.output.status.code(), Some(0), "{}", stderr(&run.output));
    assert_eq!((run.count("missing"), run.count("faults"), run.count("gaps")), (0, 0, 0));
    let (stream, times) = run.stream();
    let off = |t_s: &[f64]| spread(&t_s.iter().zip(&times).map(|(t, truth)| t - truth).collect::<Vec<_>>());
    let arrival: Vec<f64> = run.rows.iter().map(|row| row.host.seconds_since(run.rows[0].host)).collect();
    // Device time is the true time but for a constant factor, which the line contains.
    let n = times.len() as f64;
    let (mean_t, mean_a) = (times.iter().sum::<f64>() / n, arrival.iter().sum::<f64>() / n);
    let slope = times.iter().zip(&arrival).map(|(t, a)| (t - mean_t) * (a - mean_a)).sum::<f64>()
        / times.iter().map(|t| (t - mean_t).powi(2)).sum::<f64>();
    let line: Vec<f64> = times.iter().map(|t| mean_a + (t - mean_t) * slope).collect();
    let spreads = [off(&arrival), off(&line), off(&stream.t_s)];
    let clock = stream.clock().unwrap();
    eprintln!(
        "sd of the times over {seconds} s, ms: {:.4} by arrival, {:.4} least squares, {:.4} joined; drift {:.2} ppm, bound {:.4} ms",
        1e3 * spreads[0],
        1e3 * spreads[1],
        1e3 * spreads[2],
        1e6 * clock.drift().unwrap(),
        1e3 * clock.bound_s().unwrap(),
    );
    (spreads, stream)
}

/// The evaluation removes batches of 16 ms and the skew of a fast quartz.
#[test]
fn batches_and_drift() {
    let ([arrived, _, joined], stream) = chain("4", "500");
    // Batches of 16 ms have a standard deviation of 16 / sqrt(12) = 4.6 ms.
    assert!(arrived > 3e-3 && joined < 0.25 * arrived, "{arrived} {joined}");
    let drift = stream.clock().unwrap().drift().unwrap();
    assert!((drift + 500e-6).abs() < 300e-6, "{drift}");
    assert!(stream.breaks.is_empty());
}

/// cargo test --test suite ten_minutes_of_batches -- --ignored --nocapture
#[test]
#[ignore = "ten minutes in real time"]
fn ten_minutes_of_batches() {
    let ([arrived, _, joined], stream) = chain("600", "50");
    assert!(joined < 0.1 * arrived && stream.breaks.is_empty());
    assert!((stream.clock().unwrap().drift().unwrap() + 50e-6).abs() < 5e-6);
}

#[test]
fn batches_of_a_second() {
    let run = with("dbb-cobs-1", "batch_ms=1000");
    run.holds();
    assert_eq!((run.absent(), run.count("faults"), run.count("gaps")), (0, 0, 0));
    let (stream, times) = run.stream();
    assert!(stream.breaks.is_empty());
    let worst =
        stream.t_s.iter().zip(&times).map(|(t, truth)| (t - truth + times[0]).abs()).fold(0.0, f64::max);
    assert!(worst < 1.0, "{worst}");
}

#[test]
fn a_stale_stream() {
    let run = with("dbb-cobs-1", "stale=1000");
    run.holds();
    let thrown =
        run.events("mark").iter().any(|mark| mark["text"].as_str().unwrap().contains("earlier stream"));
    assert!(thrown, "{:?}", run.events);
    assert_eq!(run.absent(), 0);
}

#[test]
fn unplugged_and_back_under_another_name() {
    let directory = tempfile::tempdir().unwrap();
    let link = directory.path().join("bar");
    let link = link.to_str().unwrap();
    let faults = ["--link", link, "--fault", "unplug_s=0.6", "--fault", "away_s=0.8"];
    let bar = simulate(directory.path(), "1", &faults);
    let before = std::fs::read_link(link).unwrap();
    let came_back = |capture: &Capture| {
        let opened =
            |stamped: &StampedRecord| matches!(stamped.record, CaptureRecord::Event(RunEvent::Opened { .. }));
        let last = capture.records.iter().rposition(opened).unwrap_or(0);
        capture.records.iter().filter(|stamped| opened(stamped)).count() == 2
            && capture.records.len() > last + 500
    };
    let run = acquire_until(directory.path(), link, came_back);
    run.holds();
    assert_ne!(std::fs::read_link(link).unwrap(), before, "it has another name now");
    let gaps = run.events("gap");
    assert!(matches!(gaps[..], [gap] if gap["reason"].as_str().unwrap().contains("gone")), "{gaps:?}");
    let seconds = gaps[0]["seconds"].as_f64().unwrap();
    // 0.8 s, and what a busy machine takes to open the line.
    assert!((0.6..20.0).contains(&seconds), "{seconds}");
    assert_eq!(run.events("opened").len(), 2);
    // Device time continued: the gap is exactly what is missing.
    let holes: Vec<u64> =
        run.rows.windows(2).map(|pair| pair[1].frame - pair[0].frame).filter(|step| *step > 1).collect();
    assert!(matches!(holes[..], [hole] if hole > 500), "{holes:?}");
    drop(bar);
}

/// Whether a run reported the fault.
type Told<'a> = &'a dyn Fn(&Run) -> bool;

/// The faults that `replay` plays from recordings, with the bars that made them: each is reported by its own counts.
#[test]
fn each_fault_has_its_own_count() {
    let silent = |run: &Run| {
        let words = stderr(&run.output).contains("not answered in time");
        run.count("unanswered") > 0 && words && run.output.status.code() == Some(3)
    };
    let refused =
        |run: &Run| run.count("rejected") > 0 && run.of(&["reject"]) as u64 == run.count("rejected");
    let wrapped = |run: &Run| {
        let clock = run.stream().0.clock().map(|clock| (clock.wraps, clock.breaks.len()));
        clock == Some((1, 0)) && run.count("missing") == 0
    };
    let table: [(&str, &str, Told); 9] = [
        ("dbb-cobs-1", "banner=1", &|run| run.of(&["framing"]) == 1 && run.rows[0].frame == 0),
        ("dbb-cobs-1", "echo=1", &|run| run.of(&["framing", "check"]) > 0 && run.absent() == 0),
        ("dbb-cobs-1", "skip=0.01", &|run| run.count("missing") > 2 && run.absent() == 0),
        ("dbb-cobs-1", "wrap_ticks=500000", &wrapped),
        ("dbb-cobs-1", "over_mm=3", &|run| run.rows.iter().all(|row| !row.sample.valid)),
        ("sylvac-opto", "silence=0.4", &silent),
        ("sylvac-opto", "refuse=0.4", &refused),
        ("sylvac-opto", "echo=1", &|run| run.of(&["ignored"]) > 2 && run.count("faults") == 0),
        ("microepsilon-ild1420", "refuse=0.1", &refused),
    ];
    for (protocol, fault, told) in table {
        let run = with(protocol, fault);
        assert!(
            run.rows.len() > 2 && told(run),
            "{protocol} {fault}: {} {:?}",
            run.summary,
            run.faults.first()
        );
    }
}

/// The bar is set to zero before the run, if its protocol has a command for it.
#[test]
fn zero_is_set_before_the_run() {
    let mean = |rest: &[&str]| {
        let directory = tempfile::tempdir().unwrap();
        let bar = simulate_at(1.0, directory.path(), "1", &["--protocol", "mitutoyo-idh"]);
        let rest = [&["--protocol", "mitutoyo-idh"], rest].concat();
        let run = acquire(directory.path(), &bar.port, "1.5", &rest);
        assert!(run.rows.len() > 3, "{}", stderr(&run.output));
        run.rows.iter().map(|row| row.sample.reading_mm).sum::<f64>() / run.rows.len() as f64
    };
    // The noise of the reading that became zero is 0.1 mm.
    assert!((mean(&[]) - 1.0).abs() < 0.3);
    assert!(mean(&["--zero"]).abs() < 0.6);
    let directory = tempfile::tempdir().unwrap();
    let bar = simulate(directory.path(), "1", &[]);
    let mut command = dbbd(&["acquire", "--port", &bar.port, "--out", "run", "--zero"]);
    let output = command.current_dir(directory.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(codes(&output), ["E0301"], "{}", stderr(&output));
}

/// The rate of a device is probed, and samples directly after its answer to the start command are kept. A pseudo-
/// terminal
/// shows both sides the rate that was set.
#[test]
fn baud_rate_is_probed_and_first_samples_are_kept() {
    const READINGS: usize = 100;
    let (mut line, host) = TTYPort::pair().unwrap();
    let port = host.name().unwrap();
    drop(host);
    line.set_timeout(Duration::from_millis(10)).unwrap();
    let over = Arc::new(AtomicBool::new(false));
    let stop = Arc::clone(&over);
    let device = std::thread::spawn(move || {
        let (mut heard, mut buffer, mut sent) = (Vec::new(), [0; 256], false);
        while !stop.load(Ordering::Relaxed) {
            match line.read(&mut buffer) {
                Ok(count) => heard.extend_from_slice(&buffer[..count]),
                Err(_) => std::thread::sleep(Duration::from_millis(2)),
            }
            while let Some(end) = heard.iter().position(|byte| *byte == b'\n') {
                let command: Vec<u8> = heard.drain(..=end).collect();
                if line.baud_rate().unwrap() != 115_200 {
                    continue;
                }
                let mut answer = b"->".to_vec();
                if command == b"OUTPUT RS422\n" && !sent {
                    // Half of the range, as in the maker's vector.
                    answer.extend([0x3d, 0x7f, 0x87].repeat(READINGS));
                    sent = true;
                }
                line.write_all(&answer).unwrap();
            }
        }
    });
    let directory = tempfile::tempdir().unwrap();
    let run = acquire(directory.path(), &port, "3", &["--protocol", "microepsilon-ild1420"]);
    over.store(true, Ordering::Relaxed);
    device.join().unwrap();
    assert_eq!(run.rows.len(), READINGS, "{}", stderr(&run.output));
    assert!(run.rows.iter().all(|row| (row.sample.reading_mm - 25.0039).abs() < 1e-4));
    assert_eq!(run.bytes, 3 * READINGS as u64, "the answers are no part of the stream");
}

#[test]
fn bar_without_an_answer_is_reported() {
    let terminal = Terminal::new().unwrap();
    let port = terminal.address().to_string();
    let mut command = dbbd(&["acquire", "--port", &port, "--protocol", "microepsilon-ild1420"]);
    let directory = tempfile::tempdir().unwrap();
    let output = command.args(["--out", "run"]).current_dir(directory.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let said = stderr(&output);
    assert!(said.contains("does not answer (tried at 921600, 1000000,") && said.contains("help:"), "{said}");
    assert!(!directory.path().join("run").exists());
}

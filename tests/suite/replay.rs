//! Every recorded line is played through a pseudo-terminal, split differently each time, and gives the frames,
//! faults,
//! gaps and counts of its reference file.
//!
//! `DBBD_BLESS=1 cargo test replay` writes the reference files and shows the differences.
#![cfg(unix)]

mod player;
mod record;

use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};
use std::sync::Mutex;

use dbbd_device::clock;
use dbbd_device::protocol::{LineFault, LineFaultKind, ProtocolDefinition};
use dbbd_job::recording::capture::{self, Capture, CaptureRecord, RunEvent};
use serde_json::Value;

use crate::recordings::{Recording, all, directory};
use player::{Cuts, PATIENCE_S};

/// Number of lines that are played concurrently.
const BESIDE_EACH_OTHER: usize = 16;

#[test]
fn every_protocol_is_recorded() {
    let recorded: Vec<String> = all().into_iter().map(|recording| recording.name).collect();
    for (name, _) in ProtocolDefinition::built_in() {
        assert!(
            recorded.iter().any(|recorded| recorded == name),
            "no fixtures/captures/{name}.rec: see fixtures/README.md for how to record it"
        );
    }
}

#[test]
fn recordings_read_back() {
    for recording in all() {
        let path = directory().join(format!("{}.rec", recording.name));
        assert_eq!(recording.text(), std::fs::read_to_string(path).unwrap(), "{}", recording.name);
    }
}

/// Each recording is split differently; unchanged when the references are written.
#[test]
fn recordings_give_their_reference_results() {
    let bless = std::env::var_os("DBBD_BLESS").is_some();
    let mut changed = String::new();
    let cuts = [Cuts::Bytes, Cuts::Whole, Cuts::Recorded, Cuts::Seeded(1)];
    let runs = replay_all(&all(), |at| vec![if bless { Cuts::Recorded } else { cuts[at % cuts.len()] }]);
    for (recording, cuts, now) in runs {
        let was = golden(&recording);
        if was == now {
            continue;
        }
        writeln!(changed, "{}.golden ({cuts:?}):\n{}", recording.name, difference(&was, &now)).unwrap();
        if bless {
            std::fs::write(directory().join(format!("{}.golden", recording.name)), now).unwrap();
        }
    }
    assert!(
        changed.is_empty(),
        "{changed}{}",
        if bless { "written: look at the difference, and run again" } else { "DBBD_BLESS=1 writes it" }
    );
}

/// A bar that is unplugged and returns under another name loses only the bytes on the line.
#[test]
fn replay_continues_after_unplugging() {
    let clean = |recording: &Recording| recording.name == recording.protocol();
    come_back(&all().into_iter().filter(clean).collect::<Vec<_>>(), 0..1);
}

/// `cargo test --test suite replay::every_recording_unplugged -- --ignored --nocapture`
#[test]
#[ignore = "every recording unplugged at 20 places"]
fn every_recording_unplugged_at_20_places_goes_on() {
    come_back(&all(), 1..21);
}

fn come_back(recordings: &[Recording], seeds: std::ops::Range<u64>) {
    let mut count = 0;
    for seed in seeds {
        for (recording, _, now) in replay_all(recordings, |_| vec![Cuts::Unplugged(seed)]) {
            let (name, golden) = (&recording.name, golden(&recording));
            let gone = |text: &str| text.lines().filter(|line| line.ends_with(": the port was gone")).count();
            assert_eq!(gone(&now), gone(&golden) + 1, "{name}, seed {seed}:\n{now}");
            // The run continues in the same file: each sample is one of the recording's, in order.
            let samples = |text: &str| -> Vec<String> {
                // Apart from the offset: bytes on the line are lost.
                let lines = text.lines().filter_map(|line| line.split_once(" sample "));
                lines.map(|(_, sample)| sample.to_owned()).collect()
            };
            let (was, came) = (samples(&golden), samples(&now));
            let mut rest = was.iter();
            let known = came.iter().filter(|line| rest.any(|was| was == *line)).count();
            assert_eq!(known, came.len(), "{name}, seed {seed}: a sample that was not sent");
            assert!(was.len() - known <= 1, "{name}, seed {seed}: {known} of {}", was.len());
            count += 1;
        }
    }
    eprintln!("{count} times unplugged");
}

/// `cargo test --test suite replay::many_ways -- --ignored --nocapture`
#[test]
#[ignore = "every recording cut in 40 ways"]
fn many_ways_of_cutting_change_nothing() {
    let mut count = 0;
    for seed in 0..10 {
        let cuts = [Cuts::Bytes, Cuts::Whole, Cuts::Seeded(2 * seed), Cuts::Seeded(2 * seed + 1)];
        for (recording, cuts, now) in replay_all(&all(), |_| cuts.to_vec()) {
            assert_eq!(golden(&recording), now, "{} {cuts:?}", recording.name);
            count += 1;
        }
    }
    eprintln!("{count} replays");
}

/// Several run concurrently, since most of their time is waiting.
fn replay_all(recordings: &[Recording], cuts: impl Fn(usize) -> Vec<Cuts>) -> Vec<(Recording, Cuts, String)> {
    let jobs = recordings.iter().enumerate().flat_map(|(at, recording)| {
        cuts(at).into_iter().map(move |cuts| (recording, cuts)).collect::<Vec<_>>()
    });
    let jobs = Mutex::new(jobs.collect::<Vec<_>>().into_iter());
    let done = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..BESIDE_EACH_OTHER {
            scope.spawn(|| {
                loop {
                    // The lock is held for this line only.
                    let Some((recording, cuts)) = jobs.lock().unwrap().next() else { break };
                    let now = patiently(recording, cuts);
                    done.lock().unwrap().push((recording.clone(), cuts, now));
                }
            });
        }
    });
    done.into_inner().unwrap()
}

/// The reference of a recording; empty before it was written.
fn golden(recording: &Recording) -> String {
    std::fs::read_to_string(directory().join(format!("{}.golden", recording.name))).unwrap_or_default()
}

/// On a busy machine an answer may be late, which is reported: a request counts as unanswered, the bar as silent, or the answer
/// to a command as part of the stream. Then the recording is played again.
fn patiently(recording: &Recording, cuts: Cuts) -> String {
    const MOST_TRIES: u32 = 20;
    let reference = golden(recording);
    let mut tries = 0;
    loop {
        let now = replay(recording, cuts);
        tries += 1;
        let in_time = count(&now, "bytes ") == Some(recording.stream as u64);
        let late = is_late(&now, &reference);
        // Unplugged, a request may remain unanswered.
        if in_time && !late || tries == MOST_TRIES || matches!(cuts, Cuts::Unplugged(_)) {
            let blesses = std::env::var_os("DBBD_BLESS").is_some();
            return if in_time && late && !blesses { as_in_time(&now, &reference) } else { now };
        }
    }
}

/// A number of the first line of a result.
fn count(text: &str, name: &str) -> Option<u64> {
    text.split_once(name)?.1.split(',').next()?.parse().ok()
}

/// Whether more requests are unanswered than in the reference, or the run ended with a warning that the reference has not.
fn is_late(now: &str, reference: &str) -> bool {
    let codes = [now, reference].map(|text| count(text, "exit code "));
    let unanswered = [now, reference].map(|text| count(text, "unanswered ").unwrap_or(u64::MAX));
    codes == [Some(3), Some(0)] || unanswered[0] > unanswered[1]
}

/// A late result with exit code and unanswered requests of the reference: how fast the player answers is a matter of the
/// machine. What was read is not.
fn as_in_time(now: &str, reference: &str) -> String {
    let (Some((counts, rest)), Some((expected, _))) = (now.split_once('\n'), reference.split_once('\n'))
    else {
        return now.to_owned();
    };
    let late = |count: &str| count.starts_with("exit code ") || count.starts_with("unanswered ");
    let counts = counts.split(", ").zip(expected.split(", "));
    let counts: Vec<&str> = counts.map(|(now, expected)| if late(now) { expected } else { now }).collect();
    format!("{}\n{rest}", counts.join(", "))
}

/// Result of the program.
fn replay(recording: &Recording, cuts: Cuts) -> String {
    let temporary = tempfile::tempdir().unwrap();
    let path = |name: &str| temporary.path().join(name).to_str().unwrap().to_owned();
    let (link, run) = (path("bar"), path("run"));
    let mut player = player::start(recording, cuts, &link);
    let mut player_says = BufReader::new(player.stderr.take().unwrap()).lines().map_while(Result::ok);
    assert_eq!(player_says.next().as_deref(), Some("ready"));
    let arguments = ["acquire", "--json", "--protocol", recording.protocol(), "--port", &link, "--out", &run];
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
    let mut said: Vec<String> = lines.by_ref().take_while(|line| !line.starts_with("reading ")).collect();
    player.stdin.as_mut().unwrap().write_all(b"reads\n").unwrap();
    let begun = clock::now();
    while received(&run) < recording.stream && clock::now().seconds_since(begun) < PATIENCE_S {
        clock::sleep(0.01);
    }
    Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    said.extend(lines);
    let output = child.wait_with_output().unwrap();
    drop(player.stdin.take());
    player.wait().unwrap();
    let capture = capture::read_capture(&std::fs::read(&run).unwrap_or_default());
    assert!(capture.ended() && capture.damages.is_empty(), "{} {cuts:?}: {said:?}", recording.name);
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    told(&capture, &summary["progress"], output.status.code())
}

/// Number of bytes in the capture.
fn received(run: &str) -> usize {
    let capture = capture::read_capture(&std::fs::read(run).unwrap_or_default());
    let raw = capture.records.iter().map(|stamped| match &stamped.record {
        CaptureRecord::Raw(bytes) => bytes.len(),
        _ => 0,
    });
    raw.sum()
}

/// The content of a capture without its times, and the counts of the run.
fn told(capture: &Capture, progress: &Value, code: Option<i32>) -> String {
    let counts = [
        "bytes",
        "samples",
        "faults",
        "rejected",
        "unanswered",
        "missing",
        "lost_bytes",
        "dwells",
        "modules",
        "in_step",
    ];
    let counts = counts.map(|name| format!("{name} {}", progress[name]));
    let mut text = format!("exit code {}, {}\n", code.unwrap_or(-1), counts.join(", "));
    for stamped in &capture.records {
        match &stamped.record {
            CaptureRecord::Samples(samples) => {
                for sample in samples {
                    let number = |value: Option<u64>| value.map_or("-".into(), |value| value.to_string());
                    let strobe = sample.trigger.map_or("-", |high| if high { "high" } else { "low" });
                    let celsius = sample.temperature_c.map_or("-".into(), |c| c.to_string());
                    let valid = if sample.valid { "valid" } else { "not valid" };
                    let (sequence, ticks) =
                        (number(sample.sequence.map(u64::from)), number(sample.ticks.map(|ticks| ticks.0)));
                    writeln!(
                        text,
                        "{} sample {sequence} {ticks} {} mm {strobe} {celsius} {} {valid}",
                        sample.offset, sample.reading_mm, sample.status
                    )
                    .unwrap();
                }
            }
            CaptureRecord::Fault(json) => {
                let LineFault { kind, offset, bytes, .. } = serde_json::from_slice(json).unwrap();
                let kind = if let LineFaultKind::Reject(word) = kind { word } else { format!("{kind:?}") };
                writeln!(text, "{offset} fault of {bytes} bytes: {kind}").unwrap();
            }
            CaptureRecord::Event(RunEvent::Gap { missing, reason, .. }) => {
                let missing = missing.map_or("some".into(), |missing| missing.to_string());
                // The message of the system depends on the system.
                let reason = reason.split(':').next().unwrap();
                writeln!(text, "gap of {missing} samples: {reason}").unwrap();
            }
            _ => {}
        }
    }
    text
}

/// The lines that are in one text only, from the first difference.
fn difference(was: &str, now: &str) -> String {
    let (was, now): (Vec<&str>, Vec<&str>) = (was.lines().collect(), now.lines().collect());
    let same = was.iter().zip(&now).take_while(|(was, now)| was == now).count();
    let end =
        was[same..].iter().rev().zip(now[same..].iter().rev()).take_while(|(was, now)| was == now).count();
    let only = |lines: &[&str], sign: char| -> String {
        let lines = &lines[same..lines.len() - end];
        let more = lines.len().saturating_sub(20);
        let shown: String = lines.iter().take(20).map(|line| format!("{sign} {line}\n")).collect();
        if more > 0 { format!("{shown}{sign} .. {more} lines more\n") } else { shown }
    };
    format!("line {}:\n{}{}", same + 1, only(&was, '-'), only(&now, '+'))
}

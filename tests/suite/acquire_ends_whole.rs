//! However a run ends, and however slow the disk is: what the port took is in the capture, or it is counted; and a finding
//! names who was to blame.
#![cfg(target_os = "linux")]

use std::fs;
use std::io::{self, ErrorKind, Write};
use std::net::TcpListener;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use dbbd::daemon::{Acquisition, AcquisitionOptions, AcquisitionSummary, ControllerConnections, EndReason};
use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::recording::capture::{self, Capture, CaptureRecord, CaptureWriter, Disk};
use dbbd_model::base::units::HostNs;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::provenance::Identity;
use rustix::pty::{self, OpenptFlags};

use crate::cell::{codes, stderr};
use crate::played_bar::{read, wait_for};
use crate::process::{delayed, delays, signal};

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

/// What a bar says in a line.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Says {
    /// Its clock, a length and that it is valid.
    Lengths,
    /// The same by a clock that goes on by so many microseconds with each line; when it is told so, a dwell, an end mark, and low
    /// strobe until the program is over.
    Program(u64),
    /// No clock.
    Unclocked,
}

/// The strobe of a program is high in these seconds of the bar since its begin: a dwell, and the two short pulses of an end mark.
const HIGH_S: [(f64, f64); 3] = [(1.0, 2.0), (4.4, 4.6), (5.0, 5.2)];
/// The program is over when the strobe was low for so long, microseconds of the bar.
const OVER_US: u64 = 20_000_000;
/// The clock of a bar whose program is soon over: ten times as fast as that of the host.
const FAST: Says = Says::Program(10_000);
/// A clock at the pace of the host, which shows what a line lost.
const PACED: Says = Says::Program(1000);

impl Says {
    /// The definition of the protocol. The line is open at once, unlike that of a board that restarts.
    fn protocol(self) -> String {
        let clock = r#"{ kind = "dec", role = "t_dev", tick_ns = 1000, wrap_bits = 32 }, { kind = "lit", text = "," },"#;
        let (clock, latch) = if self == Self::Unclocked { ("", "first_byte") } else { (clock, "device") };
        format!(
            r#"schema = 1
id = "endings"
title = "A bar that never pauses"
confidence = "own"
source = ["dbbd"]
[line]
baud = 115200
bits = 8
parity = "none"
stop = 1
[framing]
kind = "line"
end = ["\r\n"]
max_len = 40
[[message]]
name = "sample"
fields = [{clock}
  {{ kind = "dec", decimals = 4, role = "length", unit = "mm" }}, {{ kind = "lit", text = "," }},
  {{ kind = "hex", digits = 2, role = "status", flags = {{ 0 = "valid", 4 = "trigger" }} }}]
[mode]
kind = "stream"
stall_ms = 500
[timing]
latch = "{latch}"
nominal_hz = 1000
"#
        )
    }

    /// The line of this number; that of `begin` was the first one of the program.
    fn line(self, number: u64, begin: Option<u64>) -> Vec<u8> {
        // A length comes again after 10 s only, so that the place of what was recorded is known without a clock too.
        let length = format!("{:.4}", 1e-4 * (number % 10_000) as f64);
        let line = match self {
            Self::Lengths => format!("{},{length},01\r\n", 1000 * number),
            Self::Unclocked => format!("{length},01\r\n"),
            Self::Program(step_us) => {
                let s = begin.map_or(0.0, |begin| 1e-6 * (step_us * (number - begin)) as f64);
                let is_high = HIGH_S.iter().any(|(from, to)| (*from..*to).contains(&s));
                format!("{},{length},{}\r\n", step_us * number, if is_high { "11" } else { "01" })
            }
        };
        line.into_bytes()
    }
}

/// The end of a line at which the bar is.
enum BarLine {
    /// The bar waits while its reader does.
    Tcp(TcpListener),
    /// What the line has no room for is lost, as that of a serial port is.
    Serial(fs::File),
}

/// What the bar is told to do.
#[derive(Default)]
struct Orders {
    /// To begin, on a serial line: it does not see its reader come.
    begin: AtomicBool,
    /// To begin its program.
    program: AtomicBool,
    /// To send nothing more, with the line open.
    silent: AtomicBool,
    /// To close the line.
    over: AtomicBool,
}

/// Lines, and when the port took them; of the last one perhaps a part.
type SentLines = Vec<(HostNs, Vec<u8>)>;

/// A bar that sends 1000 lines a second, without regard to its reader. Returns the time and the bytes of each line that the
/// port took.
fn bar(line: BarLine, says: Says, orders: &Arc<Orders>) -> JoinHandle<SentLines> {
    let orders = Arc::clone(orders);
    std::thread::spawn(move || {
        let is_serial = matches!(line, BarLine::Serial(_));
        let mut line: Box<dyn Write> = match line {
            BarLine::Tcp(listener) => Box::new(listener.accept().unwrap().0),
            BarLine::Serial(line) => Box::new(line),
        };
        let is_over = || orders.over.load(Ordering::Relaxed);
        while is_serial && !orders.begin.load(Ordering::Relaxed) && !is_over() {
            clock::sleep(0.001);
        }
        let (began, mut sent, mut program) = (clock::now(), Vec::new(), None);
        for number in 0.. {
            clock::sleep((1e-3 * number as f64 - clock::now().seconds_since(began)).max(0.0));
            if program.is_none() && orders.program.load(Ordering::Relaxed) {
                program = Some(number);
            }
            let mut text = says.line(number, program);
            if is_over() {
                break;
            } else if orders.silent.load(Ordering::Relaxed) {
                continue;
            }
            let taken =
                if is_serial { line.write(&text) } else { line.write_all(&text).map(|()| text.len()) };
            match taken {
                Ok(taken) => text.truncate(taken),
                Err(error) if is_serial && error.kind() == ErrorKind::WouldBlock => continue,
                Err(_) => break,
            }
            sent.push((clock::now(), text));
        }
        sent
    })
}

/// A TCP port of this computer, and its address.
fn network() -> (String, BarLine) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    (format!("tcp://{}", listener.local_addr().unwrap()), BarLine::Tcp(listener))
}

fn bytes(lines: &SentLines) -> Vec<u8> {
    lines.iter().flat_map(|(_, line)| line).copied().collect()
}

/// How many bytes the port took before `until`.
fn sent_before(lines: &SentLines, until: HostNs) -> usize {
    lines.iter().filter(|(at, _)| *at < until).map(|(_, line)| line.len()).sum()
}

/// When the port took the line with which the program is over.
fn program_over(lines: &SentLines) -> HostNs {
    let us = |line: &[u8]| String::from_utf8_lossy(line).split(',').next()?.parse::<u64>().ok();
    let last_high = lines.iter().rfind(|(_, line)| line.ends_with(b",11\r\n")).and_then(|(_, line)| us(line));
    let is_over = |line: &[u8]| us(line) >= last_high.map(|high_us| high_us + OVER_US);
    lines.iter().find(|(_, line)| is_over(line)).unwrap().0
}

fn earlier(at: HostNs, s: f64) -> HostNs {
    HostNs(at.0 - (1e9 * s) as u64)
}

/// The bytes of the bar in a capture.
fn recorded(capture: &Capture) -> Vec<u8> {
    let raw = capture.records.iter().filter_map(|record| match &record.record {
        CaptureRecord::Raw(bytes) => Some(bytes.clone()),
        _ => None,
    });
    raw.flatten().collect()
}

/// The place among the sent bytes at which the recorded ones end. None is missing among them; what came before the start was
/// discarded.
fn recorded_to(name: &str, recorded: &[u8], sent: &[u8]) -> usize {
    assert!(!recorded.is_empty(), "{name}: nothing was recorded");
    let first = &recorded[..recorded.len().min(100)];
    let at = sent.windows(first.len()).position(|bytes| bytes == first);
    let at = at.unwrap_or_else(|| panic!("{name}: bytes that were not sent"));
    let end = at + recorded.len();
    assert!(sent.get(at..end) == Some(recorded), "{name}: another sequence of bytes");
    end
}

/// A run of this process ends so long after its beginning, or after the bar was opened.
const DURATION_S: f64 = 1.5;
const STOPPED_S: f64 = 1.5;
/// Time for which a bar is silent before the end, s: more than the second that is usual.
const SILENT_S: f64 = 2.0;
/// What came so long before the end is in the capture, s: the last read may be under way.
const BEFORE_END_S: f64 = 0.1;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Ends {
    /// The flag that the service sets, and a signal.
    Stop,
    Duration,
    /// The program's end mark.
    Mark,
    /// The bar sends nothing more, and the run is stopped then.
    Silent,
    Gone,
    DiskFull,
}

const ENDS: [Ends; 6] = [Ends::Stop, Ends::Duration, Ends::Mark, Ends::Silent, Ends::Gone, Ends::DiskFull];

impl Ends {
    fn says(self) -> Says {
        if self == Self::Mark { FAST } else { Says::Lengths }
    }
}

struct Ended {
    summary: Result<AcquisitionSummary, Diagnostic>,
    findings: Vec<Diagnostic>,
    recorded_to: usize,
    /// The bytes that the port took, and how many of them must be recorded.
    sent: usize,
    due: usize,
}

fn run(disk: SlowDisk, sync_s: f64, ends: Ends) -> Ended {
    let (orders, stop) = (Arc::<Orders>::default(), Arc::default());
    let (port, line) = network();
    let sender = bar(line, ends.says(), &orders);
    let writer = CaptureWriter::on(Box::new(disk.clone()), Path::new("run")).unwrap();
    let options = AcquisitionOptions {
        port: port.parse().unwrap(),
        definition: ProtocolDefinition::from_toml("endings", &ends.says().protocol()).unwrap(),
        out: "run".into(),
        plan: None,
        identity: Identity::default(),
        controller: ControllerConnections::default(),
        duration_s: (ends == Ends::Duration).then_some(DURATION_S),
        gone_s: 0.3,
        feed: None,
        sync_s,
    };
    // The opening counts.
    let began = clock::now();
    let acquisition = Acquisition::start_on(writer, options, Arc::clone(&stop)).unwrap();
    let mut end = HostNs(began.0 + (1e9 * DURATION_S) as u64);
    match ends {
        Ends::Stop => {
            clock::sleep(STOPPED_S);
            assert!(acquisition.mark("before the end".into()));
            end = clock::now();
            stop.store(true, Ordering::Relaxed);
        }
        Ends::Silent => {
            clock::sleep(STOPPED_S);
            orders.silent.store(true, Ordering::Relaxed);
            clock::sleep(SILENT_S);
            end = clock::now();
            stop.store(true, Ordering::Relaxed);
        }
        Ends::Gone => {
            clock::sleep(STOPPED_S);
            orders.over.store(true, Ordering::Relaxed);
            end = clock::now();
        }
        Ends::Mark => orders.program.store(true, Ordering::Relaxed),
        Ends::Duration | Ends::DiskFull => {}
    }
    while !acquisition.is_over() {
        clock::sleep(0.005);
    }
    let findings = acquisition.findings();
    let summary = acquisition.join();
    orders.over.store(true, Ordering::Relaxed);
    let sent = sender.join().unwrap();
    if ends == Ends::Mark {
        end = program_over(&sent);
    }
    let due = sent_before(&sent, earlier(end, BEFORE_END_S));
    let capture = capture::read_capture(&disk.taken.lock().unwrap());
    assert!(capture.damages.is_empty());
    let sent = bytes(&sent);
    let recorded_to = recorded_to(&format!("{ends:?}"), &recorded(&capture), &sent);
    Ended { summary, findings, recorded_to, sent: sent.len(), due }
}

fn disk(sync_s: f64, write_s: f64) -> SlowDisk {
    SlowDisk { taken: Arc::default(), sync_s, write_s, room: usize::MAX }
}

/// The room of a full disk, bytes: a bar of 1 kHz takes a second to fill it.
const ROOM: usize = 60_000;

/// A run in this process on a disk that is slow, or full: nothing is lost, or what is refused is counted; the bar is silent
/// where it was, and this computer stood nowhere still.
fn ends_whole((sync_s, write_s, every_s): (f64, f64, f64), ends: Ends) {
    let name = format!("sync {sync_s} s, write {write_s} s, every {every_s} s, {ends:?}");
    let room = if ends == Ends::DiskFull { ROOM } else { usize::MAX };
    let ended = run(SlowDisk { room, ..disk(sync_s, write_s) }, every_s, ends);
    let Ended { findings, recorded_to, sent, due, .. } = &ended;
    if ends == Ends::DiskFull {
        assert_eq!(ended.summary.as_ref().unwrap_err().code().as_str(), "E0403", "{name}");
        let [refused] = &findings[..] else { panic!("{name}: {findings:?}") };
        assert_eq!(refused.code().as_str(), "W0418", "{name}");
        is_counted(&name, refused_bytes(&refused.to_string()), *recorded_to, *sent);
        return;
    }
    let progress = ended.summary.as_ref().unwrap().progress;
    assert!(recorded_to >= due && *due > 5000, "{name}: {recorded_to} of {due}, {progress:?}");
    assert!(findings.is_empty(), "{name}: {findings:?}");
    if ends == Ends::Gone {
        assert_eq!(recorded_to, sent, "{name}");
    }
    let is_silent = matches!(ends, Ends::Silent | Ends::Gone);
    assert_eq!((progress.silent_s > 0.0, progress.stood_still_s), (is_silent, 0.0), "{name}");
    assert_eq!((progress.counts.lost_bytes, progress.counts.missing), (0, 0), "{name}");
}

/// The number of bytes that W0418 states.
fn refused_bytes(said: &str) -> usize {
    let number = said.split(" bytes that were received").next().unwrap().rsplit(' ').next().unwrap();
    number.parse().unwrap_or_else(|_| panic!("{said}"))
}

/// What a disk refused, with what was recorded before: at least what the reader takes in its last 0.1 s, and no more than came.
fn is_counted(name: &str, refused: usize, recorded_to: usize, sent: usize) {
    assert!(refused > 1000 && recorded_to + refused <= sent, "{name}: {recorded_to} and {refused} of {sent}");
}

/// A machine whose threads wake up so late stood still itself, s: then its reader may be as late, and the verdict that it did is right.
const STOOD_STILL_S: f64 = 0.5 * BEFORE_END_S;
/// A case is begun so often where the machine stood still.
const TRIES: u32 = 3;

/// Runs each case, so many at a time: a case sleeps for most of its time. One that fails on a machine that is busy or stood still says
/// nothing, and is begun again.
fn side_by_side<T: Sync>(at_once: usize, cases: &[T], case: impl Fn(&T) + Sync) {
    let (next, left) = (AtomicUsize::new(0), AtomicUsize::new(at_once));
    let last_still = Mutex::new(HostNs(0));
    let until_it_holds = |one: &T| {
        for tried in 1.. {
            let begun = clock::now();
            let failed = catch_unwind(AssertUnwindSafe(|| case(one))).err();
            let stood_still = *last_still.lock().unwrap() > begun;
            match failed {
                Some(failed) if !stood_still || tried == TRIES => return Some(failed),
                Some(_) => {}
                None => return None,
            }
        }
        None
    };
    std::thread::scope(|scope| {
        scope.spawn(|| {
            while left.load(Ordering::Relaxed) > 0 {
                let begun = clock::now();
                clock::sleep(0.01);
                if clock::now().seconds_since(begun) > STOOD_STILL_S {
                    *last_still.lock().unwrap() = clock::now();
                }
            }
        });
        for _ in 0..at_once {
            scope.spawn(|| {
                let cases = std::iter::from_fn(|| cases.get(next.fetch_add(1, Ordering::Relaxed)));
                let failed = { cases }.find_map(until_it_holds);
                left.fetch_sub(1, Ordering::Relaxed);
                if let Some(failed) = failed {
                    resume_unwind(failed);
                }
            });
        }
    });
}

/// Of a bar that never pauses all that the port took is recorded, byte for byte, by a disk that is only slow; what a full one
/// refuses is counted.
#[test]
fn a_slow_disk_loses_nothing() {
    let disks = [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.8, 0.0, 1.0), (0.0, 0.01, 1.0), (3.0, 0.01, 0.0)];
    let cases: Vec<_> = disks.into_iter().flat_map(|disk| ENDS.map(|ends| (disk, ends))).collect();
    side_by_side(cases.len(), &cases, |(disk, ends)| ends_whole(*disk, *ends));
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

/// What happens to the process while it records.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Halt {
    None,
    /// The process is stopped. Over TCP nothing is lost, and the bar's clock shows it.
    Network,
    /// The same with a bar without a clock: nothing shows that nothing was lost.
    Unclocked,
    /// The serial line has room for less than a second.
    Serial,
}

/// Time for which the process is stopped, s: more than a serial line has room for, by more than a second.
const HALT_S: f64 = 3.0;
/// Limit of the size of a file by the shell: blocks of 512 or 1024 bytes, which a bar of 1 kHz fills in 2 s at most.
const BLOCKS: u32 = 60;

/// An ending of the program as a process.
#[derive(Clone, Copy, Debug)]
struct Ending {
    ends: Ends,
    halt: Halt,
    sync_s: f64,
    every_s: u32,
}

/// A pseudo-terminal as a serial line, by a name that no other test gets.
fn serial(link: &Path) -> (String, BarLine) {
    let line = pty::openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    rustix::io::ioctl_fionbio(&line, true).unwrap();
    pty::grantpt(&line).unwrap();
    pty::unlockpt(&line).unwrap();
    let terminal = pty::ptsname(&line, Vec::new()).unwrap();
    std::os::unix::fs::symlink(terminal.to_str().unwrap(), link).unwrap();
    (link.display().to_string(), BarLine::Serial(line.into()))
}

/// Runs a process to its end, on a disk whose sync takes its time. Returns how many bytes its port took.
fn process_ends_whole(ending: Ending, library: &str) -> usize {
    let name = format!("{ending:?}");
    let Ending { ends, halt, sync_s, every_s } = ending;
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name);
    let says = match (halt, ends.says()) {
        (Halt::Unclocked, _) => Says::Unclocked,
        (Halt::Serial, FAST) => PACED,
        (_, says) => says,
    };
    let link = place("bar");
    fs::write(place("protocol.toml"), says.protocol()).unwrap();
    let (port, line) = if halt == Halt::Serial { serial(&link) } else { network() };
    let orders = Arc::<Orders>::default();
    let sender = bar(line, says, &orders);
    // Until the halt, during it, and after it.
    let lasts_s = if halt == Halt::None { 2.0 } else { 2.0 + HALT_S };
    let duration = if ends == Ends::Duration { lasts_s } else { 60.0 };
    let limit =
        if ends == Ends::DiskFull { format!("trap '' XFSZ; ulimit -f {BLOCKS};") } else { String::new() };
    let command = format!(
        "{limit} exec '{}' acquire --port '{port}' --protocol protocol.toml --out run --gone 0.3 --duration {duration} \
         --sync-every {every_s} --json",
        env!("CARGO_BIN_EXE_dbbd")
    );
    let mut shell = Command::new("sh");
    shell.args(["-c", &command]);
    delayed(&mut shell, library, "DBBD_TEST_SYNC_S", sync_s);
    shell.current_dir(directory.path()).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let spawned = clock::now();
    let child = shell.spawn().unwrap();
    // The capture is made when the port is open.
    wait_for(&place("run"), 1);
    orders.begin.store(true, Ordering::Relaxed);
    clock::sleep(0.5);
    if halt != Halt::None {
        signal(&child, "STOP");
        clock::sleep(HALT_S);
        signal(&child, "CONT");
        clock::sleep(0.5);
    }
    let mut end = HostNs(spawned.0 + (1e9 * lasts_s) as u64);
    match ends {
        Ends::Stop => {
            clock::sleep(0.5);
            end = clock::now();
            signal(&child, "INT");
        }
        Ends::Silent => {
            orders.silent.store(true, Ordering::Relaxed);
            clock::sleep(SILENT_S);
            end = clock::now();
            signal(&child, "INT");
        }
        Ends::Gone => {
            clock::sleep(0.5);
            end = clock::now();
            // Another test may get the same terminal.
            let _ = fs::remove_file(&link);
            orders.over.store(true, Ordering::Relaxed);
        }
        Ends::Mark => orders.program.store(true, Ordering::Relaxed),
        Ends::Duration | Ends::DiskFull => {}
    }
    let output = child.wait_with_output().unwrap();
    orders.over.store(true, Ordering::Relaxed);
    let sent = sender.join().unwrap();
    if ends == Ends::Mark {
        end = program_over(&sent);
    }
    let due = sent_before(&sent, earlier(end, BEFORE_END_S));
    let sent = bytes(&sent);
    let capture = read(&place("run"));
    assert!(capture.damages.is_empty(), "{name}: {:?}", capture.damages);
    let recorded_to = recorded_to(&name, &recorded(&capture), &sent);
    let said = stderr(&output);
    let named: Vec<_> = codes(&output).into_iter().filter(|code| !code.starts_with('I')).collect();
    let expected = [
        (ends == Ends::DiskFull, "W0418"),
        (ends == Ends::DiskFull, "E0403"),
        (ends == Ends::Gone, "W0220"),
        (matches!(ends, Ends::Silent | Ends::Gone), "W0225"),
        (matches!(halt, Halt::Unclocked | Halt::Serial), "W0226"),
    ];
    let expected: Vec<_> = expected.into_iter().filter_map(|(found, code)| found.then_some(code)).collect();
    assert_eq!(named, expected, "{name}: {said}");
    if ends == Ends::DiskFull {
        assert_eq!(output.status.code(), Some(1), "{name}");
        is_counted(&name, refused_bytes(&said), recorded_to, sent.len());
        return sent.len();
    }
    assert_eq!(output.status.code(), Some(if expected.is_empty() { 0 } else { 3 }), "{name}");
    assert!(recorded_to >= due && due > 5000, "{name}: {recorded_to} of {due} before the end");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let lost = ["lost_bytes", "missing"].map(|key| summary["progress"][key].as_u64());
    assert_eq!(lost, [Some(0); 2], "{name}");
    due
}

/// A short sample of [`endings_campaign`]: that the computer is named where the line had no room, and the bar where it fell silent.
#[test]
fn who_is_to_blame_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let library = delays(directory.path());
    let ending = |ends, halt| Ending { ends, halt, sync_s: 0.8, every_s: 0 };
    let cases = [
        ending(Ends::Stop, Halt::Serial),
        ending(Ends::Stop, Halt::Network),
        ending(Ends::Silent, Halt::None),
        ending(Ends::Gone, Halt::Unclocked),
        ending(Ends::DiskFull, Halt::None),
    ];
    side_by_side(cases.len(), &cases, |case| _ = process_ends_whole(*case, &library));
}

/// Runs at a time in the campaign: they sleep for most of their time.
const AT_ONCE: usize = 4;

#[test]
#[ignore = "a campaign of ten minutes"]
fn endings_campaign() {
    let directory = tempfile::tempdir().unwrap();
    let library = delays(directory.path());
    let mut cases = Vec::new();
    for (sync_s, every_s) in
        [0.0, 0.8, 3.0].into_iter().flat_map(|sync_s| [0, 1, 10].map(|every_s| (sync_s, every_s)))
    {
        for halt in [Halt::None, Halt::Network, Halt::Unclocked, Halt::Serial] {
            // A disk is full before the halt is over, and without a clock no program is as fast.
            let ends = ENDS.into_iter().filter(|ends| match ends {
                Ends::DiskFull => halt == Halt::None,
                Ends::Mark => halt != Halt::Unclocked,
                _ => true,
            });
            cases.extend(ends.map(|ends| Ending { ends, halt, sync_s, every_s }));
        }
    }
    let (taken, slow) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    side_by_side(AT_ONCE, &cases, |case| {
        taken.fetch_add(process_ends_whole(*case, &library), Ordering::Relaxed);
        // The same disk in this process, without the library.
        if case.halt == Halt::None {
            ends_whole((case.sync_s, 0.0, f64::from(case.every_s)), case.ends);
            slow.lock().unwrap().push(case.ends);
        }
    });
    let (processes, inside) = (cases.len(), slow.lock().unwrap().len());
    eprintln!(
        "{processes} endings of processes and {inside} in this process: {} bytes were due before the ends, none is lost that is \
         not counted, and every verdict is right",
        taken.load(Ordering::Relaxed)
    );
}

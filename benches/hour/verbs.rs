//! A capture at 1 kHz of any length, and what each verb takes for it: time, processor, peak memory.

use std::path::Path;
use std::process::{Command, Stdio};

use dbbd_device::clock;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::plan::{Plan, PoseKind};
use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEvent};
use dbbd_job::recording::run::PlanFiles;
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Samples of an hour at 1 kHz.
pub(crate) const HOUR: u64 = 3_600_000;

/// The plan driven once at 1 kHz, then standing still; each sample came with a read of its own.
fn write(path: &Path, plan_csv: &Path, samples: u64) {
    let json = plan_csv.with_extension("json");
    let read = |path: &Path| std::fs::read_to_string(path).unwrap();
    let plan = Plan::from_files("plan.csv", &read(plan_csv), "plan.json", &read(&json)).unwrap();
    let mut random = Pcg64::seed_from_u64(1);
    let (mut edges, mut t_s, mut level) = (Vec::new(), 5.0, 0.0);
    for (row, time) in plan.rows.iter().zip(&plan.header.moves) {
        let to = random.random_range(-0.3..0.3);
        edges.push((t_s, t_s + time.duration_s, level, to));
        t_s += time.duration_s;
        if row.kind != PoseKind::Transit {
            t_s += plan.header.job.motion.settle_s + row.dwell_s + 0.1;
        }
        level = to;
    }
    let definition = ProtocolDefinition::by_name("dbb-cobs-1").unwrap().unwrap();
    let encoder = definition.encoder();
    let mut writer = CaptureWriter::create(path).unwrap();
    writer
        .write(
            HostNs(0),
            &CaptureRecord::Event(RunEvent::Started {
                unix_ns: 1_700_000_000_000_000_000,
                version: "0".into(),
            }),
        )
        .unwrap();
    for (name, content) in PlanFiles::read(plan_csv).unwrap().attachments() {
        let record = CaptureRecord::Attachment { name: name.into(), content: content.into_bytes() };
        writer.write(HostNs(0), &record).unwrap();
    }
    let content = definition.text.clone().into_bytes();
    writer.write(HostNs(0), &CaptureRecord::Attachment { name: "protocol.toml".into(), content }).unwrap();
    let (mut at, mut offset) = (0, 0);
    for k in 0..samples {
        let t_s = k as f64 * 1e-3;
        while at + 1 < edges.len() && edges[at + 1].0 <= t_s {
            at += 1;
        }
        let (from_s, to_s, from, to) = edges[at];
        let share = ((t_s - from_s) / (to_s - from_s).max(1e-9)).clamp(0.0, 1.0);
        let reading_mm = from + share * (to - from) + random.random_range(-0.002..0.002);
        let sample = Sample {
            sequence: Some((k % 65_536) as u32),
            ticks: Some(DeviceTicks((k * 1000) % (1 << 32))),
            reading_mm: (reading_mm * 1e5).round() / 1e5,
            trigger: Some(false),
            valid: true,
            temperature_c: Some(20.0),
            status: 0,
            offset,
        };
        let mut raw = Vec::new();
        encoder.encode(&sample, &mut raw).unwrap();
        offset += raw.len() as u64;
        let host = HostNs(k * 1_000_000 + 2_000_000 + random.random_range(0..100_000));
        writer.write(host, &CaptureRecord::Raw(raw)).unwrap();
        writer.write(host, &CaptureRecord::Samples(vec![sample])).unwrap();
    }
    writer.finish(HostNs(samples * 1_000_000 + 3_000_000), "done", 0).unwrap();
}

/// Processor time of the children that have ended, s, where the system tells it in hundredths.
fn processor_s() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    fields.skip(13).take(2).map(|ticks| ticks.parse::<f64>().unwrap() / 100.0).sum()
}

/// Runs a verb; its time and its processor time (s), and its peak of resident memory (MB) where the system
/// tells them.
fn measured(arguments: &[&str]) -> [f64; 3] {
    let before = processor_s();
    let mut command = Command::new(env!("CARGO_BIN_EXE_dbbd"));
    let begun = clock::now();
    let mut child =
        command.args(arguments).arg("--quiet").stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut peak_kb = 0.0;
    let status = loop {
        let memory = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = memory.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        if let Some(kb) = line.and_then(|line| line.trim().strip_suffix(" kB")) {
            peak_kb = kb.parse().unwrap();
        }
        if let Some(status) = child.try_wait().unwrap() {
            break status;
        }
        clock::sleep(0.002);
    };
    let seconds = clock::now().seconds_since(begun);
    assert!(matches!(status.code(), Some(0 | 3)), "{arguments:?}: {status}");
    [seconds, processor_s() - before, peak_kb / 1024.0]
}

/// Writes a capture of so many samples into `directory`, with the plan that it was recorded with.
fn record(directory: &Path, samples: u64) -> String {
    let path = |name: &str| directory.join(name).to_str().unwrap().to_owned();
    let job = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/circles.toml");
    measured(&["plan", job, "--out", &path("plan")]);
    write(Path::new(&path("run")), &directory.join("plan/plan.csv"), samples);
    path("run")
}

/// Peak memory of the matching of so many samples, MB.
#[allow(dead_code)] // the bench does not use it
pub(crate) fn sync_peak_mb(samples: u64) -> f64 {
    let directory = tempfile::tempdir().unwrap();
    let run = record(directory.path(), samples);
    measured(&["sync", &run, "--out", directory.path().join("obs.csv").to_str().unwrap()])[2]
}

/// Writes a capture of so many samples and runs the verbs on it, each so many times.
pub(crate) fn run(samples: u64, times: usize) {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let run = record(directory.path(), samples);
    let bytes = std::fs::metadata(&run).unwrap().len();
    eprintln!("{samples} samples, {bytes} bytes, {:.1} a sample", bytes as f64 / samples as f64);
    let (observations, circle, tables) = (path("obs.csv"), path("circle"), path("csv"));
    let verbs: [&[&str]; 5] = [
        &["info", &run],
        &["sync", &run, "--out", &observations],
        &["export", &run, "--out", &tables],
        &["export", &run, "--out", &tables, "--mcap"],
        &["circle", &run, "--out", &circle],
    ];
    // The first minute holds no whole circle.
    for verb in verbs.into_iter().take(if samples < HOUR { 4 } else { 5 }) {
        let runs: Vec<[f64; 3]> = (0..times).map(|_| measured(verb)).collect();
        let median = |at: usize| {
            let mut sorted: Vec<f64> = runs.iter().map(|run| run[at]).collect();
            sorted.sort_by(f64::total_cmp);
            sorted[times / 2]
        };
        let verb = verb.join(" ").replace(directory.path().to_str().unwrap(), "");
        let [wall, processor, peak] = [0, 1, 2].map(median);
        eprintln!(
            "{verb}: {wall:.2} s, of the processor {processor:.2} s, peak {peak:.0} MB (medians of {times})"
        );
    }
}

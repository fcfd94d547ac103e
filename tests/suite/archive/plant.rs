//! Captures of a plant: small runs of robots with errors, read with bars that have an offset.

use std::path::Path;

use dbbd_job::plan::{MotionKind, MoveTime, Plan, PlanHeader, PlanRow, PoseKind};
use dbbd_job::recording::capture::{CaptureRecord, CaptureWriter, RunEvent};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;
use dbbd_model::robot::{BallId, Geometry, Robot};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

use crate::cell::{CENTRE, kr60, poses, three_planes};

/// Length of every bar by its certificate, mm.
pub(crate) const BAR_MM: f64 = 300.0;
const DWELL_S: f64 = 0.4;
const MOVE_S: f64 = 0.6;
const RATE_HZ: f64 = 50.0;
/// Standard deviation of a sample, mm.
const NOISE_MM: f64 = 0.004;

/// Who measured what and when.
#[derive(Clone, Debug)]
pub(crate) struct Case {
    pub(crate) robot: String,
    pub(crate) bar: String,
    pub(crate) cell: String,
    /// ns since the Unix epoch.
    pub(crate) unix_ns: u64,
    /// By which the bar is longer than its certificate, mm.
    pub(crate) bar_offset_mm: f64,
    pub(crate) points: usize,
    pub(crate) seed: u64,
}

impl Case {
    pub(crate) fn number(number: u64) -> Self {
        Self {
            robot: format!("R{}", number % 4),
            bar: format!("B{}", number % 3),
            cell: format!("cell {}", number % 2),
            unix_ns: (1_767_225_600 + 86_400 * number) * 1_000_000_000,
            bar_offset_mm: 0.02,
            points: 8,
            seed: number,
        }
    }
}

/// The plan of three circles about one ball, for the nominal robot.
pub(crate) fn plan(points: usize) -> Plan {
    let nominal = kr60();
    let (mut rows, mut moves) = (Vec::new(), Vec::new());
    for (circle, place) in three_planes(1, CENTRE).iter().enumerate() {
        for axes_deg in poses(&nominal.geometry, place, points, 20.0) {
            let index = rows.len() as u32 + 1;
            rows.push(PlanRow {
                index,
                circle: circle as u32 + 1,
                centre: BallId::FIRST,
                kind: PoseKind::Measure,
                motion: MotionKind::Ptp,
                xyz_mm: nominal.geometry.ball(&axes_deg.map(f64::to_radians)).position.into(),
                abc_deg: [0.0; 3],
                axes_deg,
                status: 2,
                turn: 0,
                length_mm: BAR_MM,
                dwell_s: DWELL_S,
            });
            let duration_s = MOVE_S;
            moves.push(MoveTime { index, feed_mm_s: 20.0, turn_deg_s: 20.0, axis_percent: 10.0, duration_s });
        }
    }
    let job = serde_json::json!({
        "robot": "kuka-kr60ha",
        "bar": { "length_mm": BAR_MM, "stroke_mm": [-5.0, 5.0], "length_u_mm": 0.1 },
        "centre": [{ "id": 1, "xyz_mm": CENTRE }],
        "circle": [{ "centre": 1, "plane": "XY", "points": points }],
        "motion": { "settle_s": 0.1, "dwell_s": DWELL_S },
    });
    let header = serde_json::json!({
        "schema": 1, "hash": "", "job": job, "robot": nominal.to_toml().unwrap(), "moves": moves, "checks": [],
    });
    let header: PlanHeader = serde_json::from_value(header).unwrap();
    Plan { rows, header }
}

/// Writes the capture of a run of `plan` on a robot whose true geometry is `truth`.
pub(crate) fn write(path: &Path, plan: &Plan, truth: &Geometry, case: &Case) {
    let mut writer = CaptureWriter::create(path).unwrap();
    let begin = HostNs(0);
    let mut put = |at: HostNs, record: CaptureRecord| writer.write(at, &record).unwrap();
    put(begin, CaptureRecord::Event(RunEvent::Started { unix_ns: case.unix_ns, version: "0.1.0".into() }));
    let Case { robot, bar, cell, .. } = case;
    let identity = format!(
        "robot = {robot:?}\ncell = {cell:?}\noperator = 'Op {}'\n[bar]\nserial = {bar:?}\ncertificate = {:?}\n",
        case.seed % 5,
        format!("K-{bar}")
    );
    let (csv, json) = plan.to_files().unwrap();
    let protocol = include_str!("../../../protocols/dbb-cobs-1.toml").to_owned();
    for (name, content) in
        [("plan.csv", csv), ("plan.json", json), ("protocol.toml", protocol), ("identity.toml", identity)]
    {
        put(begin, CaptureRecord::Attachment { name: name.into(), content: content.into_bytes() });
    }
    let mut rng = Pcg64::seed_from_u64(case.seed);
    let noise = Normal::new(0.0, NOISE_MM).unwrap();
    let ns = |s: f64| HostNs((s * 1e9) as u64);
    let (mut t_s, mut counter) = (1.0, 0_u32);
    for row in &plan.rows {
        t_s += MOVE_S;
        put(
            ns(t_s),
            CaptureRecord::Event(RunEvent::Controller { index: row.index, phase: 1, axes_deg: row.axes_deg }),
        );
        let axes = row.axes_deg.map(f64::to_radians);
        let true_mm = truth.length(&axes, &Vector3::from(CENTRE), 0.0) - case.bar_offset_mm;
        let count = (DWELL_S * RATE_HZ) as u32;
        let mut samples = Vec::new();
        for number in 0..count {
            let at_s = t_s + f64::from(number) / RATE_HZ;
            let sample = Sample {
                sequence: Some(counter & 0xffff),
                ticks: Some(DeviceTicks((at_s * 1e6) as u64)),
                status: 1,
                ..Sample::of(true_mm - BAR_MM + noise.sample(&mut rng))
            };
            samples.push((ns(at_s), sample));
            counter += 1;
        }
        for (at, sample) in samples {
            put(at, CaptureRecord::Samples(vec![sample]));
        }
        t_s += DWELL_S;
        put(
            ns(t_s),
            CaptureRecord::Event(RunEvent::Controller { index: row.index, phase: 2, axes_deg: row.axes_deg }),
        );
    }
    writer.finish(ns(t_s + 1.0), "end mark", 0).unwrap();
}

/// A directory of runs as the service leaves it.
pub(crate) fn directory(at: &Path, runs: u64) {
    let plan = plan(Case::number(0).points);
    let truth: Robot = kr60();
    for number in 0..runs {
        let run = at.join(format!("run-{number}"));
        std::fs::create_dir_all(run.join("check")).unwrap();
        write(&run.join("run.dbbd"), &plan, &truth.geometry, &Case::number(number));
        std::fs::write(run.join("check/check.json"), "{\"decision\":\"pass\"}").unwrap();
    }
}

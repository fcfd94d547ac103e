//! Runs of a plan whose true readings and times are known.

use dbbd_job::plan::{MotionKind, MoveTime, Plan, PlanHeader, PlanRow, PoseKind};
use dbbd_job::recording::matching::PoseMatching;
use dbbd_job::recording::{DeviceClock, SampleStream, StreamBuilder};
use dbbd_model::base::units::{DeviceTicks, HostNs};
use dbbd_model::measurement::sample::Sample;
use dbbd_model::robot::{AXES, BallId};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use rand_pcg::Pcg64;

pub(crate) const BAR_MM: f64 = 300.0;
pub(crate) const SETTLE_S: f64 = 0.5;
pub(crate) const DWELL_S: f64 = 1.0;

/// A plan of `poses` dwells in modules of `module` each: three sync markers, the dwells, two sync markers.
pub(crate) fn plan(seed: u64, poses: u32, module: u32, distinct: bool) -> Plan {
    let mut rng = Pcg64::seed_from_u64(seed);
    let (mut rows, mut moves) = (Vec::new(), Vec::new());
    let mut row = |circle: u32, kind: PoseKind, duration_s: f64, axes_deg: [f64; AXES]| {
        let index = rows.len() as u32 + 1;
        rows.push(PlanRow {
            index,
            circle,
            centre: BallId::FIRST,
            kind,
            motion: MotionKind::Lin,
            xyz_mm: [1300.0, 0.0, 800.0],
            abc_deg: [0.0; 3],
            axes_deg,
            status: 2,
            turn: 0,
            length_mm: BAR_MM,
            dwell_s: if kind == PoseKind::Transit { 0.0 } else { DWELL_S },
        });
        moves.push(MoveTime { index, feed_mm_s: 20.0, turn_deg_s: 20.0, axis_percent: 10.0, duration_s });
    };
    for pose in 0..poses {
        let circle = pose / module + 1;
        let knocks = |count: usize| std::iter::repeat_n(0.3, 2 * count);
        if pose % module == 0 {
            knocks(3).for_each(|s| row(circle, PoseKind::Transit, s, [0.0; AXES]));
        }
        let kind = if pose % 20 == 0 { PoseKind::Reference } else { PoseKind::Measure };
        let axes = if kind == PoseKind::Reference { [1.0; AXES] } else { [f64::from(pose); AXES] };
        row(circle, kind, if distinct { rng.random_range(0.8..3.0) } else { 1.9 }, axes);
        if pose % module == module - 1 || pose + 1 == poses {
            knocks(2).for_each(|s| row(circle, PoseKind::Transit, s, [0.0; AXES]));
        }
    }
    let job = serde_json::json!({
        "robot": "kuka-kr60ha",
        "bar": { "length_mm": BAR_MM, "stroke_mm": [-1.0, 1.0] },
        "centre": [{ "id": 1, "xyz_mm": [1300.0, 0.0, 800.0] }],
        "circle": [{ "centre": 1, "plane": "XY", "points": 20 }],
        "motion": { "settle_s": SETTLE_S, "dwell_s": DWELL_S },
    });
    // Parsed, not constructed: a header holds more than is needed here.
    let header = serde_json::json!({
        "schema": 1, "hash": "", "pose_hash": "5eed", "job": job, "robot": "", "moves": moves, "checks": [],
    });
    let header: PlanHeader = serde_json::from_value(header).unwrap();
    Plan { rows, header }
}

/// Properties of a run.
#[derive(Clone, Copy)]
pub(crate) struct World {
    pub(crate) rate_hz: f64,
    pub(crate) noise_mm: f64,
    /// Correlation of neighbouring samples' noise.
    pub(crate) correlation: f64,
    pub(crate) override_factor: f64,
    /// Range of the true length over the poses, mm.
    pub(crate) swing_mm: f64,
    pub(crate) repeatability_mm: f64,
    pub(crate) strobe: bool,
    pub(crate) ticks_wrap: u64,
    pub(crate) ticks_begin: u64,
}

pub(crate) const WORLD: World = World {
    rate_hz: 500.0,
    noise_mm: 0.002,
    correlation: 0.0,
    override_factor: 0.8,
    swing_mm: 0.4,
    repeatability_mm: 0.02,
    strobe: false,
    ticks_wrap: 1 << 32,
    ticks_begin: 0,
};

pub(crate) const CLOCK: DeviceClock = DeviceClock { seconds_per_tick: 1e-6, wrap: Some(1 << 32) };

/// Samples with host stamps, the true reading of each dwell row, and its start.
pub(crate) struct Run {
    pub(crate) samples: Vec<(HostNs, Sample)>,
    pub(crate) readings_mm: Vec<f64>,
    pub(crate) starts_s: Vec<f64>,
}

/// A phase of the motion: from, to (mm), duration, and strobe.
type Phase = (f64, f64, f64, bool);

pub(crate) fn run(plan: &Plan, seed: u64, world: World) -> Run {
    let mut rng = Pcg64::seed_from_u64(seed);
    let noise = Normal::new(0.0, 1.0).unwrap();
    let mut phases: Vec<Phase> = Vec::new();
    let (mut readings_mm, mut starts_s) = (Vec::new(), Vec::new());
    let mut at_mm = 0.05;
    let mut knock = false;
    let mut circle = 0;
    let dwells = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).count() as f64;
    for (row, time) in plan.rows.iter().zip(&plan.header.moves) {
        if row.circle != circle {
            circle = row.circle;
            phases.push((at_mm, at_mm, 8.0, false)); // HALT
            if world.strobe {
                (0..3).for_each(|_| phases.extend([(at_mm, at_mm, 0.2, true), (at_mm, at_mm, 0.4, false)]));
            }
        }
        let move_s = time.duration_s / world.override_factor;
        if row.kind == PoseKind::Transit {
            let to_mm = if knock { at_mm - 0.3 } else { at_mm + 0.3 };
            knock = !knock;
            phases.push((at_mm, to_mm, move_s, false));
            at_mm = to_mm;
            continue;
        }
        let turn = readings_mm.len() as f64 / dwells * std::f64::consts::TAU;
        let swing = if row.kind == PoseKind::Reference {
            0.0
        } else {
            world.swing_mm * (turn.sin() + (2.0 * turn).cos())
        };
        let to_mm = 0.5 * swing + world.repeatability_mm * noise.sample(&mut rng);
        phases.push((at_mm, to_mm, move_s, false));
        starts_s.push(phases.iter().map(|phase| phase.2).sum());
        phases.extend([
            (to_mm, to_mm, SETTLE_S, false),
            (to_mm, to_mm, DWELL_S, world.strobe),
            (to_mm, to_mm, 0.1, false),
        ]);
        readings_mm.push(to_mm);
        at_mm = to_mm;
    }
    phases.push((at_mm, at_mm, 5.0, false));
    let mut samples = Vec::new();
    let (mut phase, mut since_s, mut coloured) = (0, 0.0, 0.0);
    let innovation = (1.0 - world.correlation * world.correlation).sqrt();
    for number in 0.. {
        let t_s = f64::from(number) / world.rate_hz;
        while phase < phases.len() && t_s - since_s >= phases[phase].2 {
            since_s += phases[phase].2;
            phase += 1;
        }
        let Some(&(from, to, lasts_s, strobe)) = phases.get(phase) else { break };
        let share = (t_s - since_s) / lasts_s;
        coloured = world.correlation * coloured + innovation * noise.sample(&mut rng);
        let true_mm = from + (to - from) * travelled(share, lasts_s);
        let ticks = world.ticks_begin + (t_s * 1e6).round() as u64;
        samples.push((
            HostNs((t_s * 1e9) as u64 + rng.random_range(500_000..4_000_000)),
            Sample {
                // 10 nm is the resolution of the frame.
                sequence: Some(number as u32 & 0xffff),
                ticks: Some(DeviceTicks(ticks % world.ticks_wrap)),
                trigger: world.strobe.then_some(strobe),
                status: 1,
                ..Sample::of(((true_mm + world.noise_mm * coloured) * 1e5).round() / 1e5)
            },
        ));
    }
    Run { samples, readings_mm, starts_s }
}

/// Share of the way after a share of the time: a trapezium of speed with ramps of 0.15 s.
fn travelled(share: f64, lasts_s: f64) -> f64 {
    let ramp = (0.15 / lasts_s).min(0.5);
    let speed = 1.0 / (1.0 - ramp);
    let ends = |x: f64| 0.5 * speed * x * x / ramp;
    if share < ramp {
        ends(share)
    } else if share < 1.0 - ramp {
        speed * (share - 0.5 * ramp)
    } else {
        1.0 - ends(1.0 - share)
    }
}

pub(crate) fn stream(samples: &[(HostNs, Sample)]) -> SampleStream {
    let mut stream = StreamBuilder::new(Some(CLOCK)).sequence(Some(1 << 16));
    samples.iter().for_each(|(host, sample)| stream.push(*host, sample));
    stream.build()
}

/// Number of dwells of the plan with a length; each must be the right one.
pub(crate) fn right(plan: &Plan, run: &Run, matching: &PoseMatching) -> usize {
    let dwells: Vec<&PlanRow> = plan.rows.iter().filter(|row| row.kind != PoseKind::Transit).collect();
    for row in &matching.observations.rows {
        let at = dwells.iter().position(|dwell| dwell.index == row.index).unwrap();
        let off_mm = row.length_mm - BAR_MM - run.readings_mm[at];
        assert!(off_mm.abs() < 5.0 * row.sigma_mm.unwrap() + 2e-4, "row {}: {off_mm} mm off", row.index);
        assert_eq!(row.axes.degrees(), dwells[at].axes_deg);
    }
    matching.observations.rows.len()
}

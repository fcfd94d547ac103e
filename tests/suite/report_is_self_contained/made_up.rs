//! A made-up result and a made-up plan of the size of real ones.

use std::collections::BTreeMap;

use dbbd::identifiability::{self, Observability};
use dbbd::identify::result::*;

use dbbd::plan::{Header, Job, Kind, Motion, Plan, PlanRow};
use dbbd::report::plot::HeatMap;
use dbbd::report::*;

/// A repeatable number between -1 and 1.
pub(super) fn noise(seed: usize) -> f64 {
    ((seed as f64 * 12.9898).sin() * 43758.5453).rem_euclid(2.0) - 1.0
}

fn parameter(name: &str, unit: &str, nominal: f64, correction: f64, sd: Option<f64>) -> ParameterResult {
    let status = if sd.is_some() { Status::Identified } else { Status::Held };
    let reason = if sd.is_some() { "" } else { "no length changes with it: it only turns the base" };
    ParameterResult {
        name: name.into(),
        unit: unit.into(),
        start: nominal,
        nominal,
        identified: nominal + correction,
        correction,
        sd,
        interval95: sd.map(|sd| [nominal + correction - 1.97 * sd, nominal + correction + 1.97 * sd]),
        monte_carlo: None,
        status,
        reason: reason.into(),
    }
}

fn parameters() -> Vec<ParameterResult> {
    let right = std::f64::consts::FRAC_PI_2;
    let mut all = Vec::new();
    for (i, nominal) in [0.0, -right, 0.0, -right, right, -right].into_iter().enumerate() {
        let sd = (i > 0).then(|| 4e-6 * (1.5 + noise(i)));
        let correction = if i > 0 { 8e-4 * noise(i + 7) } else { 0.0 };
        all.push(parameter(&format!("alpha{i}"), "rad", nominal, correction, sd));
    }
    for (i, nominal) in [0.0, 350.0, 850.0, 145.0, 0.0, 0.0].into_iter().enumerate() {
        let sd = (i > 0).then(|| 9e-4 * (1.5 + noise(i + 20)));
        let correction = if i > 0 { 0.5 * noise(i + 31) } else { 0.0 };
        all.push(parameter(&format!("a{i}"), "mm", nominal, correction, sd));
    }
    for i in 1..=6 {
        let weak = i == 6;
        let sd = (i > 1 && !weak).then(|| 6e-6 * (1.5 + noise(i + 40)));
        let mut theta =
            parameter(&format!("theta{i}"), "rad", 0.0, sd.map_or(0.0, |_| 9e-4 * noise(i + 51)), sd);
        if weak {
            theta.status = Status::TooWeak;
            theta.reason = "its sd of 0.21 deg would exceed 3 times the tolerance".into();
        }
        all.push(theta);
    }
    for (i, nominal) in [815.0, 0.0, 0.0, 820.0, 0.0, 170.0].into_iter().enumerate() {
        let sd = (![0, 2].contains(&i)).then(|| 1.1e-3 * (1.5 + noise(i + 60)));
        let mut d =
            parameter(&format!("d{}", i + 1), "mm", nominal, sd.map_or(0.0, |_| 0.45 * noise(i + 71)), sd);
        if i == 2 {
            d.status = Status::Dependent;
            d.reason = "only d2 + d3 can be told".into();
        }
        all.push(d);
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        all.push(parameter(&format!("tool_{axis}"), "mm", 30.0, 0.2 * noise(i + 80), Some(2.4e-3)));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        all.push(parameter(&format!("centre1_{axis}"), "mm", 1300.0, 2.1 * noise(i + 90), Some(3.1e-3)));
    }
    let mut compliance = parameter("compliance2", "rad/Nm", 0.0, 2.1e-7, Some(4e-8));
    compliance.status = Status::Prior;
    compliance.reason = "with the help of the prior".into();
    all.push(compliance);
    all
}

pub(super) fn identification(robot: &str) -> Identification {
    let pair = |before: [f64; 3], after: [f64; 3]| {
        let residual = |[rms, mean, max]: [f64; 3]| Residual { rms, mean, max };
        BeforeAfter { before: residual(before), after: residual(after) }
    };
    Identification {
        schema: 1,
        robot: robot.into(),
        observations: 239,
        rank: 24,
        rank_at_solution: 24,
        condition: 87.31,
        observability: Some(Observability { o1: 0.41, o2: 0.0115, o3: 1.31, o4: 0.015, o5: 0.087 }),
        iterations: 6,
        converged: true,
        sigma_mm: 0.0104,
        sigma_source: SigmaSource::Estimated,
        sigma_freedom: Some(206.0),
        coverage_factor: Some(1.9715),
        prior: None,
        groups: vec![GroupChoice {
            name: "gear".into(),
            added: false,
            f: Some(1.1),
            freedom: Some([12.0, 194.0]),
            p: Some(0.36),
            held_out_mm: None,
            predicted_mm: None,
            text: "gear error was not added: the data do not carry it".into(),
        }],
        monte_carlo: None,
        residual_mm: pair([0.4127, -0.0312, 1.034], [0.0103, 0.0001, 0.0312]),
        folds: Some(Folds { folds: 5, rms: 0.0121 }),
        validation: Some(pair([0.3912, 0.0241, 0.981], [0.0118, -0.0006, 0.0334])),
        predicted_position_error_mm: PredictedPair {
            nominal: PredictedError { mean: 1.854, p95: 3.41, max: 5.92 },
            identified: PredictedError { mean: 0.0411, p95: 0.0932, max: 0.184 },
        },
        parameters: parameters(),
        dependent: vec![Dependent {
            combination: BTreeMap::from([("d2".into(), 1.0), ("d3".into(), 1.0)]),
            kept: "d2".into(),
            text: "only d2 + d3 can be told".into(),
        }],
        correlated: vec![Correlated { pair: ["a2".into(), "d4".into()], r: -0.9731 }],
        advice: vec![Advice {
            kind: identifiability::trial::Kind::Ball,
            text: "a further ball at (900, 600, 500) mm, 20 poses: predicted 3-D error 0.610 -> 0.180 mm"
                .into(),
            poses: 20,
            ball_mm: Some([900.0, 600.0, 500.0]),
            before_mm: 0.61,
            after_mm: 0.18,
            adds: true,
            tells: vec!["bar_offset".into()],
        }],
        joints: vec![
            JointEffect {
                axis: 3,
                error: JointError::Reversal,
                rms_mm: 0.0041,
                play_rad: Some(1.7e-4),
                chance: 1e-9,
                z: 6.1,
            },
            JointEffect {
                axis: 2,
                error: JointError::Angle,
                rms_mm: 0.0052,
                play_rad: None,
                chance: 1e-8,
                z: 5.7,
            },
        ],
        outliers: vec![Outlier { index: 57, centre: 1, residual_mm: 97.213 }],
        warnings: vec![
            Warning {
                kind: WarningKind::Doubt,
                text: "The reference pose drifted by 0.034 mm over the run: warm the robot up, then repeat."
                    .into(),
            },
            Warning {
                kind: WarningKind::Note,
                text: "theta6 is held: turn the wrist more & repeat <b>.".into(),
            },
        ],
    }
}

pub(super) fn heat_map() -> HeatMap {
    let values_mm = (0..24 * 16).map(|cell| {
        let (x, y) = (f64::from(cell % 24) - 14.0, f64::from(cell / 24) - 6.0);
        if x < -13.0 { f64::NAN } else { 0.02 + 0.0006 * (x * x + 1.7 * y * y) }
    });
    HeatMap {
        title: "Predicted 3-D error, Z = 800 mm".into(),
        axis_names: ["X (mm)".into(), "Y (mm)".into()],
        extent: [[600.0, 1800.0], [-400.0, 400.0]],
        columns: 24,
        values_mm: values_mm.collect(),
    }
}

pub(super) fn plots() -> IdentificationPlots {
    let mut observations = Vec::new();
    for n in 0..240usize {
        let (centre, circle) = (1 + n / 120, 1 + (n / 80) as u32);
        let angle = (n % 80) as f64 * 4.5;
        let t = angle.to_radians();
        let before = 0.31 * (2.0 * t + f64::from(circle)).sin() + 0.24 * t.cos() + 0.1 * noise(n);
        let after = if n == 56 { 97.213 } else { 0.0103 * 1.2 * noise(n + 300) };
        observations.push(ObservationPoint {
            index: n as u32 + 1,
            centre,
            axes_deg: std::array::from_fn(|axis| 20.0 * axis as f64 - 90.0 + 40.0 * (t + axis as f64).sin()),
            senses: std::array::from_fn(|axis| if (t + axis as f64).cos() > 0.0 { 1 } else { -1 }),
            before_mm: if n == 56 { 97.5 } else { before },
            after_mm: after,
            circle: (n != 56).then_some(circle),
            angle_deg: Some(angle),
            kind: Some(if n % 21 == 20 { Kind::Reference } else { Kind::Measure }),
        });
    }
    let circles = [("XY", "+X", "+Y"), ("XZ", "+X", "+Z"), ("YZ", "+Y", "+Z")];
    IdentificationPlots {
        per_ball: [(1, 120), (2, 120)].into(),
        references: observations.iter().filter(|point| point.kind == Some(Kind::Reference)).count(),
        observations,
        circles: circles
            .iter()
            .zip(1..)
            .map(|((plane, x, y), number)| CirclePanel {
                number,
                name: format!("Circle {number}, {plane}"),
                radius_mm: Some(300.0),
                axis_names: Some([x.to_string(), y.to_string()]),
            })
            .collect(),
        tolerance: Some(Tolerance { length_mm: 0.5, angle_rad: 0.05f64.to_radians() }),
        zeros: vec![AxisZero {
            axis: 2,
            offset_deg: -0.0314,
            sd_deg: Some(0.0021),
            told: true,
            remark: "told by the data".into(),
        }],
        balls: vec![BallPlace {
            what: "tool ball in $FLANGE".into(),
            found_mm: [30.1, 20.2, 9.9],
            corrected_mm: [0.1, 0.2, -0.1],
            told: true,
        }],
        maps: vec![heat_map()],
        facts: vec![Fact::new("Bar length", "300.0021 mm, U = 0.6 µm (k = 2)")],
        provenance: Provenance {
            dbbd_version: "0.1.0".into(),
            robot: "KUKA KR 60 HA".into(),
            plan_hash: Some("0123456789abcdef".into()),
            date: Some("2026-11-20".into()),
            sources: vec![Source { role: "Capture".into(), name: "run1.dbb".into(), hash: None }],
        },
    }
}

pub(super) fn plan() -> Plan {
    let mut rows = Vec::new();
    for n in 0..170u32 {
        let t = f64::from(n) * 0.075;
        let (sin, cos) = t.sin_cos();
        let upright = n >= 85;
        let xyz = [
            1300.0 + 300.0 * cos,
            if upright { 0.0 } else { 300.0 * sin },
            800.0 + if upright { 300.0 * sin } else { 0.0 },
        ];
        let axes = [
            9.0 * sin,
            -70.0 + 8.0 * cos,
            95.0 - 9.0 * cos,
            20.0 * sin,
            60.0 + 5.0 * cos,
            100.0 * (0.5 * t).sin(),
        ];
        rows.push(PlanRow {
            index: n + 1,
            circle: 1 + u32::from(upright),
            centre: 1,
            kind: if n % 17 == 0 { Kind::Transit } else { Kind::Measure },
            motion: Motion::Lin,
            xyz_mm: xyz,
            abc_deg: [0.0, 90.0, 0.0],
            axes_deg: axes,
            status: 2,
            turn: 0,
            length_mm: 300.0 + if n % 17 == 0 { 0.3 } else { 0.12 * noise(n as usize) },
            dwell_s: 1.0,
        });
    }
    let job = Job::from_toml("demo.toml", include_str!("../../../examples/demo.toml")).unwrap();
    let header = Header {
        schema: 1,
        hash: "0123456789abcdef".into(),
        job,
        robot: String::new(),
        moves: Vec::new(),
        passes: Vec::new(),
        checks: Vec::new(),
        notes: Vec::new(),
        taught: Vec::new(),
        stage: None,
        stroke_risk: 0.0,
        predictions: None,
    };
    Plan { rows, header }
}

pub(super) fn plan_view(robot: &str) -> PlanView {
    let skeleton = |x: f64, y: f64| {
        vec![
            [0.0; 3],
            [0.0, 0.0, 815.0],
            [350.0, y * 0.3, 815.0],
            [500.0, y * 0.4, 1640.0],
            [x - 170.0, y, 1500.0],
            [x - 150.0, y, 1000.0],
            [x, y, 800.0],
        ]
    };
    PlanView {
        against: Vec::new(),
        regions: Vec::new(),
        advice: Vec::new(),
        manipulability: vec![0.5],
        margin_mm: 0.1,
        centres: vec![(1, [1300.0, 0.0, 800.0])],
        skeletons: vec![skeleton(1600.0, 0.0), skeleton(1000.0, 0.0), skeleton(1300.0, 300.0)],
        limits_deg: [
            [-185.0, 185.0],
            [-135.0, 35.0],
            [-120.0, 158.0],
            [-350.0, 350.0],
            [-119.0, 119.0],
            [-350.0, 350.0],
        ],
        circles: vec![CircleRow {
            number: 1,
            centre: 1,
            plane: "XY".into(),
            radius_mm: 300.0,
            points: 80,
            direction: "both".into(),
            orientation: "seed".into(),
            mode: "dwell".into(),
        }],
        checks: vec![
            CheckRow {
                quantity: "Stroke risk".into(),
                worst: "2.1e-4".into(),
                limit: "1e-3".into(),
                place: "row 57".into(),
                passed: true,
            },
            CheckRow {
                quantity: "Least |A5|".into(),
                worst: "8.1 deg".into(),
                limit: "10 deg".into(),
                place: "row 12, circle 1".into(),
                passed: false,
            },
        ],
        predicted_error_mm: Some(identification("x").predicted_position_error_mm),
        predicted: parameters()
            .into_iter()
            .map(|p| PredictedRow {
                tolerance: Some(if p.unit == "mm" { 0.5 } else { 8.7e-4 }),
                name: p.name,
                unit: p.unit,
                sd: p.sd,
                status: p.status,
                reason: p.reason,
            })
            .collect(),
        dependent: vec!["only d2 + d3 can be told".into()],
        maps: vec![heat_map()],
        facts: vec![Fact::new("Time at full override", "14 min 20 s")],
        warnings: Vec::new(),
        provenance: Provenance { robot: robot.into(), ..plots().provenance },
    }
}

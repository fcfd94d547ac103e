//! A small plan by hand: horizontal circles about one ball, the tool down, its orientation swinging.

use dbbd_job::plan::{Job, MotionKind, MoveTime, Plan, PlanHeader, PlanRow, PoseKind};
use dbbd_model::provenance::Provenance;
use dbbd_model::robot::{BallId, Pose, Robot, inverse};

pub(crate) const BALL_MM: [f64; 3] = [1300.0, 0.0, 800.0];
pub(crate) const BAR_MM: f64 = 300.0;

pub(crate) fn robot() -> Robot {
    Robot::by_name_with_tool("kr60ha", [30.0, 20.0, 10.0]).unwrap().unwrap()
}

/// Values as in `plan.csv`: rounded to the digits that KRL prints.
fn rounded(values: [f64; 3], decimals: i32) -> [f64; 3] {
    let scale = 10_f64.powi(decimals);
    values.map(|value| (value * scale).round() / scale)
}

struct Builder {
    rows: Vec<PlanRow>,
    moves: Vec<MoveTime>,
    axes: [f64; 6],
}

impl Builder {
    fn row(
        &mut self,
        circle: u32,
        kind: PoseKind,
        motion: MotionKind,
        turn_deg: f64,
        out_mm: f64,
        swing_deg: f64,
    ) {
        let robot = robot();
        let (s, c) = turn_deg.to_radians().sin_cos();
        let radius = BAR_MM + out_mm;
        let xyz_mm = rounded([BALL_MM[0] + radius * c, BALL_MM[1] + radius * s, BALL_MM[2]], 3);
        let abc_deg = rounded([10.0 + swing_deg, 0.7 * swing_deg, 180.0 - swing_deg], 4);
        let pose = Pose::from_kuka(xyz_mm, abc_deg);
        self.axes = inverse::nearest(&robot.geometry, &pose, &self.axes).unwrap();
        let index = self.rows.len() as u32 + 1;
        self.rows.push(PlanRow {
            index,
            circle,
            centre: BallId::FIRST,
            kind,
            motion,
            xyz_mm,
            abc_deg,
            axes_deg: self.axes.map(f64::to_degrees),
            status: inverse::status(&robot.geometry, &self.axes),
            turn: inverse::turn(&self.axes),
            length_mm: radius,
            dwell_s: if kind == PoseKind::Transit { 0.0 } else { 1.0 },
        });
        let knock = kind == PoseKind::Transit && motion == MotionKind::Lin;
        self.moves.push(MoveTime {
            index,
            feed_mm_s: if knock { 1.0 } else { 40.0 - 1.5 * f64::from(index % 7) },
            turn_deg_s: 20.0,
            axis_percent: 10.0,
            duration_s: 0.0,
        });
    }

    fn knocks(&mut self, circle: u32, count: usize, turn_deg: f64) {
        for _ in 0..count {
            self.row(circle, PoseKind::Transit, MotionKind::Lin, turn_deg, 0.3, 0.0);
            self.row(circle, PoseKind::Transit, MotionKind::Lin, turn_deg, 0.0, 0.0);
        }
    }
}

/// `circles` circles of `points` dwells each (every odd one reached on an arc), start and end marks.
pub(crate) fn plan(circles: u32, points: u32) -> Plan {
    let robot = robot();
    let axes = [0.0, -60.0, 90.0, 0.0, 57.0, 0.0].map(f64::to_radians);
    let mut builder = Builder { rows: Vec::new(), moves: Vec::new(), axes };
    for circle in 1..=circles {
        builder.row(circle, PoseKind::Transit, MotionKind::Ptp, 0.0, 0.0, 0.0);
        builder.knocks(circle, 3, 0.0);
        let mut turn = 0.0;
        for point in 0..points {
            turn = 20.0 * f64::from(point);
            let swing = 8.0 * (1.3 * f64::from(point)).sin();
            if point % 2 == 1 {
                builder.row(circle, PoseKind::Transit, MotionKind::Circ, turn - 10.0, 0.0, swing);
                builder.row(circle, PoseKind::Measure, MotionKind::Circ, turn, 0.0, swing);
            } else {
                builder.row(circle, PoseKind::Measure, MotionKind::Lin, turn, 0.0, swing);
            }
        }
        builder.row(circle, PoseKind::Reference, MotionKind::Lin, turn, 0.0, 0.0);
        builder.knocks(circle, 2, turn);
    }
    let job = format!(
        "robot = 'kr60ha'\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n[bar]\nlength_mm = {BAR_MM:?}\nstroke_mm = [-1.0, 1.0]\n\
         [[centre]]\nid = 1\nxyz_mm = {BALL_MM:?}\n[[circle]]\npoints = {points}\nplane = 'XY'"
    );
    let header = PlanHeader {
        schema: 1,
        hash: "0123456789abcdef".into(),
        text_hash: String::new(),
        pose_hash: String::new(),
        job: Job::from_toml("job", &job).unwrap(),
        robot: robot.to_toml().unwrap(),
        provenance: Provenance::default(),
        moves: builder.moves,
        passes: Vec::new(),
        checks: Vec::new(),
        notes: Vec::new(),
        taught: Vec::new(),
        again: false,
        stage: None,
        stroke_risk: 0.0,
        goal: None,
        predictions: None,
        check: None,
    };
    Plan { rows: builder.rows, header }
}

//! Reading a job file, and checking what its types do not say, with the line of what is wrong.

use nalgebra::Vector3;

use super::values::{JobTable, MAX_JOB_VALUE, MisplacedFinding};
use super::{
    BaseBallTable, CircleMode, CircleTable, Job, MIN_OBSTACLE_MM, ObstacleTable, OrientationPattern,
};
use crate::plan::job::JobFinding;
use crate::plan::module::MODULE_DWELLS;
use crate::plan::timing::ACCELERATION_MM_S2;
use dbbd_model::base::FileFinding;
use dbbd_model::base::parse::from_toml;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::table::MAX_BALLS;
use dbbd_model::measurement::{BallId, BaseBall};
use dbbd_model::provenance::{CERTIFIED_C, IdentityFinding, LENGTH_U_MM, check_text};
use dbbd_model::robot::pose::is_part_of_turn;
use dbbd_model::robot::{AXES, Robot};

/// Chosen poses of a plan: with more the run takes hours, in which everything drifts.
const MAX_CHOSEN_POSES: f64 = 1000.0;
const MAX_CANDIDATES: f64 = 100_000.0;
/// With a mounted bar the speed of a controller's test mode is the most, mm/s. A speed below the least is in m/s.
const FEED_MM_S: [f64; 2] = [0.5, 250.0];
/// In a shorter dwell no bar sends enough readings; a longer wait is a mistake, s.
const DWELL_S: [f64; 2] = [0.05, 60.0];
/// No bar is better than the least; a smaller value is in mm.
const SIGMA_UM: [f64; 2] = [0.01, 1e3];
/// From carbon fibre to zinc, 1/K.
const EXPANSION_PER_K: [f64; 2] = [-2e-6, 5e-5];
/// Base balls are larger: nearer places are one, mm.
const MIN_BALL_DISTANCE_MM: f64 = 10.0;
/// A shorter arc is one in radians, degrees.
const ARC_DEG: [f64; 2] = [7.0, 360.0];
/// Bars, tools and arms are thicker; a smaller radius is one in metres, mm.
const RADIUS_MM: [f64; 2] = [1.0, MAX_JOB_VALUE];
/// Digital outputs that a controller has.
const OUTPUTS: std::ops::RangeInclusive<u32> = 1..=4096;
/// Keys and tables of the robot file that no table of the job has.
const OF_ROBOT: [&str; 6] = ["ball_mm", "joint", "tolerance", "mass", "payload", "repeatability_mm"];

type JobCheck = Result<(), MisplacedFinding>;

impl Job {
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let job: Self = from_toml(file, text).map_err(key_of_robot)?;
        job.check().map_err(|wrong| match wrong.line(text) {
            Some(line) => {
                let column = text.lines().nth(line - 1).map_or(0, |l| l.len() - l.trim_start().len()) + 1;
                wrong.finding.at(file, text, line, column)
            }
            None => wrong.finding.in_file(file),
        })?;
        Ok(job)
    }

    pub fn balls(&self) -> Vec<BaseBall> {
        self.centres
            .iter()
            .map(|table| BaseBall { id: BallId::numbered(table.id), position: table.xyz_mm.into() })
            .collect()
    }

    /// The table of a base ball by its number, from 1.
    pub(crate) fn ball(&self, number: u32) -> Option<&BaseBallTable> {
        self.centres.get((number as usize).checked_sub(1)?)
    }

    /// The table of a circle by its number, from 1; `None` for 0, the number of chosen poses.
    pub(crate) fn circle(&self, number: u32) -> Option<&CircleTable> {
        self.circles.get((number as usize).checked_sub(1)?)
    }

    /// Parts of the job without effect: balls without a circle, floors that this robot does not reach.
    pub fn without_effect(&self, robot: &Robot) -> Vec<JobFinding> {
        let is_used = |ball: u32| self.circles.iter().any(|circle| circle.centre == ball);
        let given = self.optimise.is_none() && !self.circles.is_empty();
        let unused = self.centres.iter().map(|table| table.id).filter(|ball| given && !is_used(*ball));
        let hand_mm = robot.geometry.rows[5].d.abs() + robot.geometry.tool.norm();
        let lowest_mm = -(robot.reach_mm() + hand_mm);
        let floors = self.obstacles.iter().filter_map(|obstacle| match *obstacle {
            ObstacleTable::Floor { z_mm } if z_mm < lowest_mm => {
                Some(JobFinding::FloorBelow { z_mm, lowest_mm })
            }
            _ => None,
        });
        unused.map(|ball| JobFinding::BallWithoutCircle { ball }).chain(floors).collect()
    }

    /// Obstacles that enclose a part of axis 1 between the robot's foot and its shoulder.
    pub fn in_robot(&self, robot: &Robot) -> Vec<JobFinding> {
        /// What the robot stands on may reach so far up its foot.
        const FOOT: f64 = 0.3;
        let [shoulder, ..] = robot.geometry.skeleton(&[0.0; AXES]);
        let column = [FOOT, 1.0].map(|share| Vector3::new(0.0, 0.0, share * shoulder.z));
        let is_inside = |obstacle: &ObstacleTable| obstacle.from_segment(&column) <= 0.0;
        let inside = self.obstacles.iter().zip(1..).filter(|(obstacle, _)| is_inside(obstacle));
        let z_mm = column[0].z;
        inside.map(|(_, obstacle)| JobFinding::ObstacleInRobot { obstacle, z_mm }).collect()
    }

    /// Checks what the types do not say.
    pub(crate) fn check(&self) -> JobCheck {
        self.check_ranges()?;
        self.check_bar()?;
        self.check_identity()?;
        self.check_outputs()?;
        let missing = if self.centres.is_empty() {
            Some("[[centre]]")
        } else {
            (self.circles.is_empty() && self.optimise.is_none()).then_some("[[circle]] or [optimise]")
        };
        if let Some(table) = missing {
            return Err(JobTable::new("").wrong("", JobFinding::MissingTable { table: table.into() }));
        }
        if let Some([low, high]) = self.optimise.as_ref().and_then(|optimise| optimise.workspace_mm) {
            JobTable::new("[optimise]").corners("workspace_mm", low, high)?;
        }
        JobTable::new("[tool]").cup(self.tool.cup_axis, self.tool.cup_limit_deg)?;
        for (at, obstacle) in self.obstacles.iter().enumerate() {
            check_obstacle(JobTable::nth("[[obstacle]]", at), obstacle)?;
        }
        self.check_centres()?;
        self.circles.iter().enumerate().try_for_each(|(at, circle)| self.check_circle(at, circle))
    }

    /// The values of the single tables that have a range of their own.
    fn check_ranges(&self) -> JobCheck {
        let Self { bar, motion, limits, tool, .. } = self;
        let [bar_table, motion_table] = ["[bar]", "[motion]"].map(JobTable::new);
        bar_table.positive("length_mm", bar.length_mm)?;
        motion_table.positive("turn_deg_s", motion.turn_deg_s)?;
        motion_table.positive_to("settle_s", motion.settle_s, DWELL_S[1])?;
        let optimise = self.optimise.as_ref();
        let count = |of: fn(&super::OptimiseTable) -> u32| optimise.map(|optimise| f64::from(of(optimise)));
        let candidates = [10.0 * count(|o| o.points).unwrap_or(0.0), MAX_CANDIDATES];
        let ranges = [
            ("[bar]", "radius_mm", Some(bar.radius_mm), RADIUS_MM),
            ("[bar]", "sigma_um", Some(bar.sigma_um), SIGMA_UM),
            ("[bar]", "length_u_mm", bar.length_u_mm, LENGTH_U_MM),
            ("[bar]", "temperature_c", bar.temperature_c, CERTIFIED_C),
            ("[bar]", "expansion_per_k", bar.expansion_per_k, EXPANSION_PER_K),
            ("[motion]", "feed_mm_s", Some(motion.feed_mm_s), FEED_MM_S),
            ("[motion]", "dwell_s", Some(motion.dwell_s), DWELL_S),
            ("[limits]", "min_a5_deg", Some(limits.min_a5_deg), [0.0, 90.0]),
            ("[limits]", "min_elbow_deg", Some(limits.min_elbow_deg), [0.0, 90.0]),
            ("[limits]", "min_overhead_mm", Some(limits.min_overhead_mm), [0.0, 1e4]),
            ("[limits]", "max_stroke_risk", Some(limits.max_stroke_risk), [0.0, 1.0]),
            ("[limits]", "min_clearance_mm", Some(limits.min_clearance_mm), [0.0, 1e4]),
            ("[tool]", "radius_mm", Some(tool.radius_mm), RADIUS_MM),
            ("[tool]", "arm_radius_mm", Some(tool.arm_radius_mm), RADIUS_MM),
            ("[optimise]", "points", count(|o| o.points), [6.0, MAX_CHOSEN_POSES]),
            ("[optimise]", "candidates", count(|o| o.candidates), candidates),
            ("[optimise]", "stage_points", count(|o| o.stage_points), [6.0, MAX_CHOSEN_POSES]),
        ];
        for (header, key, value, range) in ranges {
            value.map_or(Ok(()), |value| JobTable::new(header).within(key, value, range))?;
        }
        check_frame(motion_table, "tool", motion.tool)?;
        check_frame(motion_table, "base", motion.base)
    }

    fn check_bar(&self) -> JobCheck {
        let (bar, table) = (&self.bar, JobTable::new("[bar]"));
        let ([low_mm, high_mm], length_mm, margin_mm) = (bar.stroke_mm, bar.length_mm, bar.margin_mm);
        let ordered = low_mm.abs() < length_mm && high_mm.abs() < length_mm && low_mm < high_mm;
        table.ensure("stroke_mm", ordered, || JobFinding::StrokeOrder { low_mm, high_mm, length_mm })?;
        let stroke_mm = high_mm - low_mm;
        let left = margin_mm >= 0.0 && 2.0 * margin_mm < stroke_mm;
        table.ensure("margin_mm", left, || JobFinding::NoStrokeLeft { margin_mm, stroke_mm })
    }

    fn check_identity(&self) -> JobCheck {
        let in_table = |table: JobTable, checked: Result<(), (&'static str, IdentityFinding)>| {
            checked.map_err(|(key, finding)| table.wrong(key, finding))
        };
        let identity = &self.identity;
        in_table(JobTable::new("[identity]"), identity.check())?;
        in_table(JobTable::new("[identity.bar]"), identity.bar.check())?;
        for (at, temperature) in identity.temperatures.iter().enumerate() {
            in_table(JobTable::nth("[[identity.temperature]]", at), temperature.check())?;
        }
        for (at, centre) in self.centres.iter().enumerate() {
            in_table(JobTable::nth("[[centre]]", at), check_text("serial", centre.serial.as_ref()))?;
        }
        in_table(JobTable::new("[bar]"), self.bar.identity().check())?;
        let balls = self.centres.len();
        let other = identity.balls.keys().find(|key| key.parse().is_ok_and(|ball: usize| ball > balls));
        let other = other.map_or(Ok(()), |key| {
            Err(("balls", IdentityFinding::SerialOfNoBall { key: key.clone(), balls }))
        });
        in_table(JobTable::new("[identity]"), other.and_then(|()| self.identity().check_all()))
    }

    fn check_outputs(&self) -> JobCheck {
        let (strobe, [first, last]) = (self.motion.outputs.strobe, self.motion.outputs.index);
        let table = JobTable::new("outputs");
        let exist =
            OUTPUTS.contains(&strobe) && OUTPUTS.contains(&first) && first.checked_add(7) == Some(last);
        table.ensure("", exist, || JobFinding::Outputs { strobe, first, last })?;
        table.ensure("", !(first..=last).contains(&strobe), || JobFinding::StrobeInIndex { strobe })
    }

    fn check_centres(&self) -> JobCheck {
        for (at, centre) in self.centres.iter().enumerate() {
            let (table, id, expected) = (JobTable::nth("[[centre]]", at), centre.id, at + 1);
            let counts = id as usize == expected;
            table.ensure("id", counts, || JobFinding::BallNumber { id: id as usize, expected })?;
            table.within("id", f64::from(id), [1.0, MAX_BALLS as f64])?;
            table.finite("xyz_mm", &centre.xyz_mm)?;
            let from_mm = |other: &BaseBallTable| {
                let steps = centre.xyz_mm.iter().zip(other.xyz_mm);
                steps.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
            };
            if let Some(other) = self.centres[..at].iter().find(|other| from_mm(other) < MIN_BALL_DISTANCE_MM)
            {
                return Err(table.wrong("xyz_mm", JobFinding::BallsAtOnePlace { one: other.id, other: id }));
            }
            table.finite("taught_deg", centre.taught_deg.iter().flatten())?;
            table.cup(centre.cup_axis, centre.cup_limit_deg)?;
        }
        Ok(())
    }

    fn check_circle(&self, at: usize, circle: &CircleTable) -> JobCheck {
        let (table, number) = (JobTable::nth("[[circle]]", at), at + 1);
        let (centre, balls) = (circle.centre as usize, self.centres.len());
        let exists = (1..=balls).contains(&centre);
        table.ensure("centre", exists, || JobFinding::NoSuchBall { circle: number, centre, balls })?;
        match (circle.plane, circle.normal) {
            (Some(_), Some(_)) => {
                return Err(table.wrong("normal", JobFinding::PlaneAndNormal { circle: number }));
            }
            (None, None) => return Err(table.wrong("", JobFinding::NoPlane { circle: number })),
            (None, Some(normal)) => table.direction("normal", normal)?,
            (Some(_), None) => {}
        }
        circle.radius_mm.map_or(Ok(()), |radius| table.positive("radius_mm", radius))?;
        table.finite("start_deg", [&circle.start_deg])?;
        table.finite("tilt_deg", [&circle.tilt_deg])?;
        table.finite("spin_deg", [&circle.spin_deg])?;
        table.within("arc_deg", circle.arc_deg, ARC_DEG)?;
        match circle.mode {
            CircleMode::Continuous => self.check_continuous(table, number, circle),
            CircleMode::Dwell => check_dwells(table, number, circle),
        }
    }

    fn check_continuous(&self, table: JobTable, number: usize, circle: &CircleTable) -> JobCheck {
        table.within("points", f64::from(circle.points), [12.0, 3600.0])?;
        let fixed = circle.orientation == OrientationPattern::Fixed && circle.amplitude_deg.is_none();
        table.ensure("orientation", fixed, || JobFinding::NotFixed { circle: number })?;
        let (overshoot_deg, feed_mm_s) = (circle.overshoot_deg, self.motion.feed_mm_s);
        table.positive_to("overshoot_deg", overshoot_deg, 180.0)?;
        let radius_mm = circle.radius_mm.unwrap_or(self.bar.length_mm);
        let needed_deg = (0.5 * feed_mm_s * feed_mm_s / ACCELERATION_MM_S2 / radius_mm).to_degrees();
        let finding = || JobFinding::OvershootShort { circle: number, overshoot_deg, needed_deg, feed_mm_s };
        table.ensure("overshoot_deg", overshoot_deg >= needed_deg, finding)
    }
}

fn check_dwells(table: JobTable, number: usize, circle: &CircleTable) -> JobCheck {
    let (points, dwells) = (circle.points, circle.dwells());
    table.ensure("points", points >= 3 && dwells <= MODULE_DWELLS, || JobFinding::DwellCount {
        circle: number,
        points,
        dwells,
        most: MODULE_DWELLS,
    })?;
    table.finite("turns_deg", circle.turns_deg.iter().flatten())?;
    match (circle.orientation, circle.amplitude_deg) {
        (OrientationPattern::Fixed | OrientationPattern::Turning, Some(_)) => {
            Err(table.wrong("amplitude_deg", JobFinding::NoAmplitude { circle: number }))
        }
        (_, Some(amplitude)) => table.within("amplitude_deg", amplitude, [0.0, 180.0]),
        (_, None) => Ok(()),
    }
}

fn check_obstacle(table: JobTable, obstacle: &ObstacleTable) -> JobCheck {
    match *obstacle {
        ObstacleTable::Box { low_mm, high_mm } => {
            table.finite("high_mm", &high_mm)?;
            table.corners("low_mm", low_mm, high_mm)?;
            table.large("high_mm", std::array::from_fn(|axis| high_mm[axis] - low_mm[axis]))
        }
        ObstacleTable::Cylinder { from_mm, to_mm, radius_mm } => {
            table.finite("from_mm", &from_mm)?;
            table.finite("to_mm", &to_mm)?;
            let along = [to_mm[0] - from_mm[0], to_mm[1] - from_mm[1], to_mm[2] - from_mm[2]];
            table.direction("to_mm", along)?;
            table.positive("radius_mm", radius_mm)?;
            table.large("to_mm", [along[0], along[1], along[2].hypot(2.0 * radius_mm)])
        }
        ObstacleTable::Floor { z_mm } => {
            table.within("z_mm", z_mm, [-MAX_JOB_VALUE, MAX_JOB_VALUE])?;
            if z_mm == 0.0 { Ok(()) } else { table.large("z_mm", [z_mm, 0.0, 0.0]) }
        }
    }
}

/// Checks that a frame is finite, in mm and degrees.
fn check_frame(table: JobTable, key: &'static str, frame: Option<[f64; 6]>) -> JobCheck {
    let Some(frame) = frame else { return Ok(()) };
    table.finite(key, &frame)?;
    let [x, y, z, angles @ ..] = frame;
    if let Some(value) = angles.into_iter().find(|value| is_part_of_turn(*value)) {
        return Err(table.wrong(key, JobFinding::FrameInRadians { key: key.into(), value }));
    }
    let size_mm = x.abs().max(y.abs()).max(z.abs());
    let tiny = size_mm > 0.0 && size_mm < MIN_OBSTACLE_MM;
    table.ensure(key, !tiny, || JobFinding::FrameInMetres { key: key.into(), size_mm })
}

/// A key that is unknown in the job but known in the robot file, at the same place.
fn key_of_robot(unread: Diagnostic) -> Diagnostic {
    let why = match unread.finding() {
        Some(FileFinding::NotToml { why }) => why.as_str(),
        _ => "",
    };
    let known = why.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
    match known.filter(|key| OF_ROBOT.contains(key)).map(str::to_owned) {
        Some(key) => unread.replaced_by(JobFinding::KeyOfRobot { key }),
        None => unread,
    }
}

//! Reads a job file, and checks what its types do not ensure. Findings name the line of the error.

use nalgebra::Vector3;

use super::values::{JobTable, MisplacedFinding};
use super::{BaseBallTable, CircleMode, CircleTable, Job, ObstacleTable, OrientationPattern};
use crate::plan::job::JobFinding;
use crate::plan::module::MODULE_DWELLS;
use crate::plan::timing::ACCELERATION_MM_S2;
use dbbd_model::base::FileFinding;
use dbbd_model::base::parse::from_toml;
use dbbd_model::diagnostic::Diagnostic;
use dbbd_model::measurement::{BallId, BaseBall};
use dbbd_model::plausibility::Quantity;
use dbbd_model::provenance::{IdentityError, IdentityFinding, check_text};
use dbbd_model::robot::{AXES, Robot};

/// Least distance of two base balls, mm: base balls are larger, so nearer places are one ball.
const MIN_BALL_DISTANCE_MM: f64 = 10.0;
/// Digital outputs that a controller has.
const OUTPUTS: std::ops::RangeInclusive<u32> = 1..=4096;
/// Keys and tables of the robot file that no table of the job has.
const OF_ROBOT: [&str; 6] = ["joint", "tolerance", "mass", "mounting", "payload", "repeatability_mm"];

pub(crate) type JobCheck = Result<(), MisplacedFinding>;

impl Job {
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let mut job: Self = from_toml(file, text).map_err(key_of_robot)?;
        job.complete();
        job.check().map_err(|wrong| wrong.in_text(file, text))?;
        Ok(job)
    }

    /// States what the job leaves open: a length of the bar if bars are listed, and chosen poses if it asks for nothing else.
    fn complete(&mut self) {
        if let Some(first) = self.bar_choices.first().filter(|_| self.bar.length_mm == 0.0) {
            self.bar.length_mm = first.length_mm;
        }
        if self.circles.is_empty() {
            self.optimise.get_or_insert_default();
        }
    }

    pub fn balls(&self) -> Vec<BaseBall> {
        let balls = self.centres.iter().enumerate();
        balls.map(|(at, table)| BaseBall { id: BallId::at(at), position: table.xyz_mm.into() }).collect()
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
        let lowest_mm = -robot.ball_reach_mm();
        let floors = self.obstacles.iter().filter_map(|obstacle| {
            if let ObstacleTable::Floor { z_mm } = *obstacle
                && z_mm < lowest_mm
            {
                Some(JobFinding::FloorBelow { z_mm, lowest_mm })
            } else {
                None
            }
        });
        unused.map(|ball| JobFinding::BallWithoutCircle { ball }).chain(floors).collect()
    }

    /// Obstacles that enclose a part of axis 1 between the robot's foot and its shoulder.
    pub fn in_robot(&self, robot: &Robot) -> Vec<JobFinding> {
        /// Share of the height of the foot up to which the robot's stand may reach.
        const FOOT: f64 = 0.3;
        let [shoulder, ..] = robot.geometry.skeleton(&[0.0; AXES]);
        let column = [FOOT, 1.0].map(|share| Vector3::new(0.0, 0.0, share * shoulder.z));
        let is_inside = |obstacle: &ObstacleTable| obstacle.from_segment(&column) <= 0.0;
        let inside = self.obstacles.iter().zip(1..).filter(|(obstacle, _)| is_inside(obstacle));
        let z_mm = column[0].z;
        inside.map(|(_, obstacle)| JobFinding::ObstacleInRobot { obstacle, z_mm }).collect()
    }

    /// Refuses a base ball in the foot of the robot, or farther away than arm and bar reach together.
    pub(crate) fn check_places(&self, robot: &Robot) -> JobCheck {
        /// The foot of every robot has at least this share of the reach as its radius: that of a small robot 7 %.
        const FOOT_RADIUS: f64 = 0.05;
        let bar_mm = self.bar.length_mm + self.bar.stroke_mm[1];
        let range = Quantity::BaseBallDistance
            .range()
            .from((FOOT_RADIUS * robot.reach_mm()).floor())
            .to((robot.ball_reach_mm() + bar_mm).ceil());
        let [shoulder, ..] = robot.geometry.skeleton(&[0.0; AXES]);
        self.centres.iter().enumerate().try_for_each(|(at, table)| {
            // The distance from axis 1 between foot and shoulder.
            let place = Vector3::from(table.xyz_mm);
            let height_mm = place.z.clamp(shoulder.z.min(0.0), shoulder.z.max(0.0));
            let away_mm = (place - Vector3::z() * height_mm).norm();
            // With the decimals of a controller.
            let wrong = |finding| JobTable::nth("[[centre]]", at).wrong("xyz_mm", finding);
            range.check("distance of xyz_mm from axis 1", (1e3 * away_mm).round() / 1e3).map_err(wrong)
        })
    }

    /// Checks what the types do not ensure.
    pub(crate) fn check(&self) -> JobCheck {
        self.check_goal()?;
        self.check_ranges()?;
        self.check_bar()?;
        self.check_identity()?;
        self.check_outputs()?;
        let has_balls = !self.centres.is_empty() || (self.goal.is_some() && !self.places.is_empty());
        let table = if self.goal.is_some() { "[[place]] or [[centre]]" } else { "[[centre]]" };
        let missing = || JobFinding::MissingTable { table: table.into() };
        JobTable::new("").ensure("", has_balls, missing)?;
        if let Some([low, high]) = self.optimise.as_ref().and_then(|optimise| optimise.workspace_mm) {
            let table = JobTable::new("[optimise]");
            table.corners("workspace_mm", low, high)?;
            table.large("workspace_mm", std::array::from_fn(|axis| high[axis] - low[axis]))?;
        }
        JobTable::new("[tool]").cup(self.tool.cup_axis, self.tool.cup_limit_deg)?;
        for (at, obstacle) in self.obstacles.iter().enumerate() {
            check_obstacle(JobTable::nth("[[obstacle]]", at), obstacle)?;
        }
        self.check_centres()?;
        self.circles.iter().enumerate().try_for_each(|(at, circle)| self.check_circle(at, circle))
    }

    /// Checks the values of the single tables that have a range of their own.
    fn check_ranges(&self) -> JobCheck {
        let Self { bar, motion, limits, tool, .. } = self;
        let [bar_table, motion_table] = ["[bar]", "[motion]"].map(JobTable::new);
        let optimise = self.optimise.as_ref();
        tool.ball_mm
            .iter()
            .flatten()
            .try_for_each(|mm| JobTable::new("[tool]").check("ball_mm", *mm, Quantity::ArmLength))?;
        let ball_mm = tool.ball_mm.map(|mm| mm.into_iter().map(f64::abs).fold(0.0, f64::max));
        let count = |of: fn(&super::OptimiseTable) -> u32| optimise.map(|optimise| f64::from(of(optimise)));
        bar_table.ensure("", bar.length_mm != 0.0, || JobFinding::NoBarLength)?;
        let values = [
            ("[bar]", "length_mm", Some(bar.length_mm), Quantity::BarLength),
            ("[bar]", "radius_mm", Some(bar.radius_mm), Quantity::BodyRadius),
            ("[bar]", "length_u_mm", bar.length_u_mm, Quantity::ExpandedLengthUncertainty),
            ("[bar]", "temperature_c", bar.temperature_c, Quantity::CertificateTemperature),
            ("[bar]", "force_n", bar.force_n, Quantity::BarForce),
            ("[bar]", "expansion_per_k", bar.expansion_per_k, Quantity::Expansion),
            ("[motion]", "feed_mm_s", Some(motion.feed_mm_s), Quantity::Feed),
            ("[motion]", "turn_deg_s", Some(motion.turn_deg_s), Quantity::TurnSpeed),
            ("[motion]", "dwell_s", Some(motion.dwell_s), Quantity::DwellTime),
            ("[motion]", "settle_s", Some(motion.settle_s), Quantity::SettleTime),
            ("[limits]", "min_axis_margin_deg", Some(limits.min_axis_margin_deg), Quantity::LimitAngle),
            ("[limits]", "min_a5_deg", Some(limits.min_a5_deg), Quantity::LimitAngle),
            ("[limits]", "min_elbow_deg", Some(limits.min_elbow_deg), Quantity::LimitAngle),
            ("[limits]", "min_overhead_mm", Some(limits.min_overhead_mm), Quantity::LimitDistance),
            ("[limits]", "max_stroke_risk", Some(limits.max_stroke_risk), Quantity::Probability),
            ("[limits]", "min_clearance_mm", Some(limits.min_clearance_mm), Quantity::LimitDistance),
            ("[tool]", "ball_mm", ball_mm.filter(|mm| *mm > 0.0), Quantity::ToolBallDistance),
            ("[tool]", "ball_u_mm", tool.ball_u_mm, Quantity::LengthTolerance),
            ("[tool]", "radius_mm", Some(tool.radius_mm), Quantity::BodyRadius),
            ("[tool]", "arm_radius_mm", Some(tool.arm_radius_mm), Quantity::BodyRadius),
            ("[optimise]", "points", count(|o| o.points), Quantity::PoseCount),
            ("[optimise]", "stage_points", count(|o| o.stage_points), Quantity::PoseCount),
        ];
        for (header, key, value, quantity) in values {
            value.map_or(Ok(()), |value| JobTable::new(header).check(key, value, quantity))?;
        }
        let sigma = Quantity::LengthSd.check("sigma_um in mm", 1e-3 * bar.sigma_um);
        sigma.map_err(|finding| bar_table.wrong("sigma_um", finding))?;
        if let Some(optimise) = optimise {
            let range = Quantity::CandidateCount.range().from(10.0 * f64::from(optimise.points));
            let candidates = range.check("candidates", f64::from(optimise.candidates));
            candidates.map_err(|finding| JobTable::new("[optimise]").wrong("candidates", finding))?;
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
        let in_table = |table: JobTable, checked: Result<(), IdentityError>| {
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
            Err(("balls", IdentityFinding::SerialOfNoBall { key: key.clone(), balls }.into()))
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
            table.check("id", f64::from(id), Quantity::BallNumber)?;
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
        circle.radius_mm.map_or(Ok(()), |radius| table.check("radius_mm", radius, Quantity::Length))?;
        table.finite("start_deg", [&circle.start_deg])?;
        table.finite("tilt_deg", [&circle.tilt_deg])?;
        table.finite("spin_deg", [&circle.spin_deg])?;
        table.check("arc_deg", circle.arc_deg, Quantity::Arc)?;
        match circle.mode {
            CircleMode::Continuous => self.check_continuous(table, number, circle),
            CircleMode::Dwell => check_dwells(table, number, circle),
        }
    }

    fn check_continuous(&self, table: JobTable, number: usize, circle: &CircleTable) -> JobCheck {
        table.check("points", f64::from(circle.points), Quantity::CirclePoints)?;
        let fixed = circle.orientation == OrientationPattern::Fixed && circle.amplitude_deg.is_none();
        table.ensure("orientation", fixed, || JobFinding::NotFixed { circle: number })?;
        let (overshoot_deg, feed_mm_s) = (circle.overshoot_deg, self.motion.feed_mm_s);
        table.check("overshoot_deg", overshoot_deg, Quantity::HalfTurn)?;
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
        (_, Some(amplitude)) => table.check("amplitude_deg", amplitude, Quantity::Amplitude),
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
            table.check("radius_mm", radius_mm, Quantity::Length)?;
            table.large("to_mm", [along[0], along[1], along[2].hypot(2.0 * radius_mm)])
        }
        ObstacleTable::Floor { z_mm } => {
            table.check("z_mm", z_mm, Quantity::Coordinate)?;
            if z_mm == 0.0 { Ok(()) } else { table.large("z_mm", [z_mm, 0.0, 0.0]) }
        }
    }
}

/// Checks that a frame is finite, in mm and degrees.
fn check_frame(table: JobTable, key: &'static str, frame: Option<[f64; 6]>) -> JobCheck {
    let Some(frame) = frame else { return Ok(()) };
    table.finite(key, &frame)?;
    let [x, y, z, angles @ ..] = frame;
    angles.into_iter().try_for_each(|angle| table.check(key, angle, Quantity::FrameAngle))?;
    let distance_mm = x.hypot(y).hypot(z);
    if distance_mm == 0.0 { Ok(()) } else { table.check(key, distance_mm, Quantity::FrameDistance) }
}

/// The finding about a key that is unknown in the job, but known in the robot file at the same place.
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

#[cfg(test)]
mod tests {
    use crate::plan::example::{job, robot};
    use dbbd_model::plausibility::PlausibilityFinding;

    /// The KR 60 has its shoulder at 815 mm and reaches 350 + 850 + hypot(145, 820) = 2032.7 mm from it, to the flange 170 mm
    /// more, and to the ball at (30, 20, 10) mm 37.4 mm more: 2240.1 mm, and 2546.1 mm with a bar of 300 mm and a stroke of 6 mm.
    /// A twentieth of the reach is 101.6 mm.
    #[test]
    fn a_base_ball_is_where_a_bar_can_reach_it() {
        let refusal = |xyz_mm: [f64; 3]| {
            let mut job = job("");
            job.centres[0].xyz_mm = xyz_mm;
            job.check_places(&robot()).err().map(|wrong| {
                match wrong.finding.finding::<PlausibilityFinding>() {
                    Some(PlausibilityFinding::InOtherUnit { meant, .. }) => *meant,
                    Some(PlausibilityFinding::Outside { .. }) => "",
                    other => panic!("{other:?}"),
                }
            })
        };
        for (xyz_mm, expected) in [
            ([1150.0, -350.0, 750.0], None),
            ([1.150, -0.350, 0.750], Some("metres")),
            ([0.0, 101.5, 800.0], None),
            ([0.0, 100.5, 800.0], Some("")),
            // Below the foot, and above the shoulder.
            ([0.0, 0.0, -90.0], Some("")),
            ([0.0, 0.0, 815.0 + 90.0], Some("")),
            ([0.0, 0.0, 815.0 + 2546.0], None),
            ([2547.0, 0.0, 815.0], None),
            ([2547.1, 0.0, 815.0], Some("")),
        ] {
            assert_eq!(refusal(xyz_mm), expected, "{xyz_mm:?}");
        }
    }
}

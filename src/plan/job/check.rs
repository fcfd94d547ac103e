//! Reading a job file: what TOML's types do not say, with the line of what is wrong.

use super::values::{MOST, Misplaced, Table};
use super::{CentreTable, CircleTable, Job, Mode, ObstacleTable, Orientation};
use crate::base::parse::from_toml;
use crate::catalogue::JobFinding;
use crate::diagnostic::Diagnostic;
use crate::measurement::table::MOST_BALLS;
use crate::measurement::{BallId, BaseBall};
use crate::plan::module::MODULE_DWELLS;
use crate::plan::timing::ACCELERATION_MM_S2;
use crate::provenance::{CERTIFIED_C, LENGTH_U_MM, check_text};
use crate::robot::pose::is_part_of_turn;

/// Chosen poses of a plan: with more the run takes hours, in which everything drifts.
const MOST_POINTS: u32 = 1000;
/// Candidates to choose from.
const MOST_CANDIDATES: u32 = 100_000;
/// A bar is mounted: the speed of a controller's test mode is the most, mm/s. The least is no speed in m/s.
const FEED_MM_S: [f64; 2] = [0.5, 250.0];
/// In a shorter dwell no bar sends enough readings, s.
const LEAST_DWELL_S: f64 = 0.05;
/// From carbon fibre to zinc, 1/K.
const EXPANSION_PER_K: [f64; 2] = [-2e-6, 5e-5];
/// Base balls are larger: nearer places are one, mm.
const LEAST_APART_MM: f64 = 10.0;
/// A shorter arc is one in radians, degrees.
const LEAST_ARC_DEG: f64 = 7.0;
/// A smaller box, cylinder, height or place is one in metres, mm.
const LEAST_OBSTACLE_MM: f64 = 3.0;
/// Bars, tools and arms are thicker; a smaller radius is one in metres, mm.
const LEAST_RADIUS_MM: f64 = 1.0;
/// Longest wait and dwell, s.
const MOST_WAIT_S: f64 = 60.0;
/// Digital outputs that a controller has.
const OUTPUTS: std::ops::RangeInclusive<u32> = 1..=4096;

impl Job {
    /// Reads a job file.
    ///
    /// # Errors
    /// Names the line of an unknown or missing key, or of a value that cannot be.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let job: Self = from_toml(file, text).map_err(of_robot)?;
        job.check().map_err(|wrong| match wrong.line(text) {
            Some(line) => {
                let column = text.lines().nth(line - 1).map_or(0, |l| l.len() - l.trim_start().len()) + 1;
                Diagnostic::position(file, text, line, column, wrong.finding)
            }
            None => Diagnostic::file(file, wrong.finding),
        })?;
        Ok(job)
    }

    /// The base balls by their numbers.
    pub fn balls(&self) -> Vec<BaseBall> {
        self.centres
            .iter()
            .map(|table| BaseBall { id: BallId::numbered(table.id), position: table.xyz_mm.into() })
            .collect()
    }

    /// The table of a base ball by its number, from 1.
    pub(crate) fn ball(&self, number: u32) -> Option<&CentreTable> {
        self.centres.get((number as usize).checked_sub(1)?)
    }

    /// The table of a circle by its number, from 1; 0 is that of chosen poses, which have none.
    pub(crate) fn circle(&self, number: u32) -> Option<&CircleTable> {
        self.circles.get((number as usize).checked_sub(1)?)
    }

    /// What the types do not say.
    pub(crate) fn check(&self) -> Result<(), Misplaced> {
        self.check_bar()?;
        self.check_identity()?;
        self.check_motion()?;
        self.check_outputs()?;
        self.check_limits()?;
        let missing = if self.centres.is_empty() {
            Some("[[centre]]")
        } else {
            (self.circles.is_empty() && self.optimise.is_none()).then_some("[[circle]] or [optimise]")
        };
        if let Some(table) = missing {
            return Err(Table::new("").wrong("", JobFinding::MissingTable { table: table.into() }));
        }
        self.check_optimise()?;
        self.check_tool()?;
        for (at, obstacle) in self.obstacles.iter().enumerate() {
            check_obstacle(Table::nth("[[obstacle]]", at), obstacle)?;
        }
        self.check_centres()?;
        self.circles.iter().enumerate().try_for_each(|(at, circle)| self.check_circle(at, circle))
    }

    fn check_bar(&self) -> Result<(), Misplaced> {
        let (bar, table) = (&self.bar, Table::new("[bar]"));
        table.positive("length_mm", bar.length_mm)?;
        table.positive("sigma_um", bar.sigma_um)?;
        let ([low_mm, high_mm], length_mm) = (bar.stroke_mm, bar.length_mm);
        if !(low_mm.abs() < length_mm && high_mm.abs() < length_mm && low_mm < high_mm) {
            return Err(table.wrong("stroke_mm", JobFinding::StrokeOrder { low_mm, high_mm, length_mm }));
        }
        table.within("radius_mm", bar.radius_mm, [LEAST_RADIUS_MM, MOST])?;
        bar.length_u_mm.map_or(Ok(()), |u| table.within("length_u_mm", u, LENGTH_U_MM))?;
        bar.temperature_c.map_or(Ok(()), |t| table.within("temperature_c", t, CERTIFIED_C))?;
        bar.expansion_per_k
            .map_or(Ok(()), |value| table.within("expansion_per_k", value, EXPANSION_PER_K))?;
        let (margin_mm, stroke_mm) = (bar.margin_mm, high_mm - low_mm);
        if !(margin_mm >= 0.0 && 2.0 * margin_mm < stroke_mm) {
            return Err(table.wrong("margin_mm", JobFinding::NoStrokeLeft { margin_mm, stroke_mm }));
        }
        Ok(())
    }

    fn check_identity(&self) -> Result<(), Misplaced> {
        let in_table = |table: Table, checked: Result<(), (&'static str, JobFinding)>| {
            checked.map_err(|(key, finding)| table.wrong(key, finding))
        };
        let identity = &self.identity;
        in_table(Table::new("[identity]"), identity.check())?;
        in_table(Table::new("[identity.bar]"), identity.bar.check())?;
        for (at, temperature) in identity.temperatures.iter().enumerate() {
            in_table(Table::nth("[[identity.temperature]]", at), temperature.check())?;
        }
        for (at, centre) in self.centres.iter().enumerate() {
            in_table(Table::nth("[[centre]]", at), check_text("serial", centre.serial.as_ref()))?;
        }
        in_table(Table::new("[bar]"), self.bar.identity().check())?;
        let balls = self.centres.len();
        let other = identity.balls.keys().find(|key| key.parse().is_ok_and(|ball: usize| ball > balls));
        let other = other
            .map_or(Ok(()), |key| Err(("balls", JobFinding::SerialOfNoBall { key: key.clone(), balls })));
        in_table(Table::new("[identity]"), other.and_then(|()| self.identity().check_all()))
    }

    fn check_optimise(&self) -> Result<(), Misplaced> {
        let Some(optimise) = &self.optimise else { return Ok(()) };
        let table = Table::new("[optimise]");
        let count = |key, value: u32, least: u32, most: u32| {
            table.within(key, f64::from(value), [f64::from(least), f64::from(most)])
        };
        count("points", optimise.points, 6, MOST_POINTS)?;
        count("candidates", optimise.candidates, 10 * optimise.points, MOST_CANDIDATES)?;
        count("stage_points", optimise.stage_points, 6, MOST_POINTS)?;
        optimise.workspace_mm.map_or(Ok(()), |[low, high]| table.corners("workspace_mm", low, high))
    }

    fn check_tool(&self) -> Result<(), Misplaced> {
        let (tool, table) = (&self.tool, Table::new("[tool]"));
        table.cup(tool.cup_axis, tool.cup_limit_deg)?;
        table.within("radius_mm", tool.radius_mm, [LEAST_RADIUS_MM, MOST])?;
        table.within("arm_radius_mm", tool.arm_radius_mm, [LEAST_RADIUS_MM, MOST])
    }

    fn check_motion(&self) -> Result<(), Misplaced> {
        let (motion, table) = (&self.motion, Table::new("[motion]"));
        table.within("feed_mm_s", motion.feed_mm_s, FEED_MM_S)?;
        table.positive("turn_deg_s", motion.turn_deg_s)?;
        table.positive_to("settle_s", motion.settle_s, MOST_WAIT_S)?;
        table.within("dwell_s", motion.dwell_s, [LEAST_DWELL_S, MOST_WAIT_S])?;
        table.frame("tool", motion.tool)?;
        table.frame("base", motion.base)
    }

    fn check_outputs(&self) -> Result<(), Misplaced> {
        let (strobe, [first, last]) = (self.motion.outputs.strobe, self.motion.outputs.index);
        let table = Table::new("outputs");
        if !(OUTPUTS.contains(&strobe) && OUTPUTS.contains(&first) && first.checked_add(7) == Some(last)) {
            return Err(table.wrong("", JobFinding::Outputs { strobe, first, last }));
        }
        if (first..=last).contains(&strobe) {
            return Err(table.wrong("", JobFinding::StrobeInIndex { strobe }));
        }
        Ok(())
    }

    fn check_limits(&self) -> Result<(), Misplaced> {
        let (limits, table) = (&self.limits, Table::new("[limits]"));
        [
            ("min_a5_deg", limits.min_a5_deg, 90.0),
            ("min_elbow_deg", limits.min_elbow_deg, 90.0),
            ("min_overhead_mm", limits.min_overhead_mm, 1e4),
            ("max_stroke_risk", limits.max_stroke_risk, 1.0),
            ("min_clearance_mm", limits.min_clearance_mm, 1e4),
        ]
        .into_iter()
        .try_for_each(|(key, value, most)| table.within(key, value, [0.0, most]))
    }

    fn check_centres(&self) -> Result<(), Misplaced> {
        for (at, centre) in self.centres.iter().enumerate() {
            let table = Table::nth("[[centre]]", at);
            if centre.id as usize != at + 1 {
                let finding = JobFinding::BallNumber { id: centre.id as usize, expected: at + 1 };
                return Err(table.wrong("id", finding));
            }
            table.within("id", f64::from(centre.id), [1.0, MOST_BALLS as f64])?;
            centre.xyz_mm.iter().try_for_each(|mm| table.within("xyz_mm", *mm, [-MOST, MOST]))?;
            let from_mm = |other: &CentreTable| {
                let steps = centre.xyz_mm.iter().zip(other.xyz_mm);
                steps.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
            };
            if let Some(other) = self.centres[..at].iter().find(|other| from_mm(other) < LEAST_APART_MM) {
                let finding = JobFinding::BallsAtOnePlace { one: other.id, other: centre.id };
                return Err(table.wrong("xyz_mm", finding));
            }
            table.finite("taught_deg", centre.taught_deg.iter().flatten())?;
            table.cup(centre.cup_axis, centre.cup_limit_deg)?;
        }
        Ok(())
    }

    fn check_circle(&self, at: usize, circle: &CircleTable) -> Result<(), Misplaced> {
        let (table, number) = (Table::nth("[[circle]]", at), at + 1);
        let (centre, balls) = (circle.centre as usize, self.centres.len());
        if !(1..=balls).contains(&centre) {
            let finding = JobFinding::NoSuchBall { circle: number, centre, balls };
            return Err(table.wrong("centre", finding));
        }
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
        table.within("arc_deg", circle.arc_deg, [LEAST_ARC_DEG, 360.0])?;
        match circle.mode {
            Mode::Continuous => self.check_continuous(table, number, circle),
            Mode::Dwell => check_dwells(table, number, circle),
        }
    }

    fn check_continuous(&self, table: Table, number: usize, circle: &CircleTable) -> Result<(), Misplaced> {
        table.within("points", f64::from(circle.points), [12.0, 3600.0])?;
        if circle.orientation != Orientation::Fixed || circle.amplitude_deg.is_some() {
            return Err(table.wrong("orientation", JobFinding::NotFixed { circle: number }));
        }
        let overshoot_deg = circle.overshoot_deg;
        table.positive_to("overshoot_deg", overshoot_deg, 180.0)?;
        let feed_mm_s = self.motion.feed_mm_s;
        let radius_mm = circle.radius_mm.unwrap_or(self.bar.length_mm);
        let needed_deg = (0.5 * feed_mm_s * feed_mm_s / ACCELERATION_MM_S2 / radius_mm).to_degrees();
        if overshoot_deg < needed_deg {
            let finding = JobFinding::OvershootShort { circle: number, overshoot_deg, needed_deg, feed_mm_s };
            return Err(table.wrong("overshoot_deg", finding));
        }
        Ok(())
    }
}

fn check_dwells(table: Table, number: usize, circle: &CircleTable) -> Result<(), Misplaced> {
    let (points, dwells) = (circle.points, circle.dwells());
    if points < 3 || dwells > MODULE_DWELLS {
        let finding = JobFinding::DwellCount { circle: number, points, dwells, most: MODULE_DWELLS };
        return Err(table.wrong("points", finding));
    }
    table.finite("turns_deg", circle.turns_deg.iter().flatten())?;
    match (circle.orientation, circle.amplitude_deg) {
        (Orientation::Fixed | Orientation::Turning, Some(_)) => {
            Err(table.wrong("amplitude_deg", JobFinding::NoAmplitude { circle: number }))
        }
        (_, Some(amplitude)) => table.within("amplitude_deg", amplitude, [0.0, 180.0]),
        (_, None) => Ok(()),
    }
}

fn check_obstacle(table: Table, obstacle: &ObstacleTable) -> Result<(), Misplaced> {
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
            table.within("z_mm", z_mm, [-MOST, MOST])?;
            if z_mm == 0.0 { Ok(()) } else { table.large("z_mm", [z_mm, 0.0, 0.0]) }
        }
    }
}

impl Table {
    /// That a frame is in mm and degrees.
    fn frame(self, key: &'static str, frame: Option<[f64; 6]>) -> Result<(), Misplaced> {
        let Some(frame) = frame else { return Ok(()) };
        self.finite(key, &frame)?;
        let [x, y, z, angles @ ..] = frame;
        if let Some(value) = angles.into_iter().find(|value| is_part_of_turn(*value)) {
            return Err(self.wrong(key, JobFinding::FrameInRadians { key: key.into(), value }));
        }
        let size_mm = x.abs().max(y.abs()).max(z.abs());
        if size_mm > 0.0 && size_mm < LEAST_OBSTACLE_MM {
            return Err(self.wrong(key, JobFinding::FrameInMetres { key: key.into(), size_mm }));
        }
        Ok(())
    }

    /// That an obstacle of this size, mm, is not one in metres.
    fn large(self, key: &'static str, size: [f64; 3]) -> Result<(), Misplaced> {
        match size.into_iter().map(f64::abs).fold(0.0, f64::max) {
            size_mm if size_mm < LEAST_OBSTACLE_MM => {
                Err(self.wrong(key, JobFinding::TinyObstacle { key: key.into(), size_mm }))
            }
            _ => Ok(()),
        }
    }
}

/// Keys and tables of the robot file, which no table of the job has.
const OF_ROBOT: [&str; 6] = ["ball_mm", "joint", "tolerance", "mass", "payload", "repeatability_mm"];

/// A key that the job does not know, but the robot file, at the same place.
fn of_robot(unread: Diagnostic) -> Diagnostic {
    let known = unread.message.strip_prefix("unknown field `").and_then(|rest| rest.split('`').next());
    let Some(key) = known.filter(|key| OF_ROBOT.contains(key)) else { return unread };
    let finding = Diagnostic::line(&unread.file, unread.line, JobFinding::KeyOfRobot { key: key.into() });
    finding.in_line(unread.excerpt.as_deref().unwrap_or_default(), unread.column)
}

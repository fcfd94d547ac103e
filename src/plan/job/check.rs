//! Reading a job file: what TOML's types do not say, with the line of what is wrong.

use super::values::{Place, Wrong, corners, direction_vector, finite, line_of, positive, within};
use super::{CentreTable, CircleTable, Direction, Job, Mode, ObstacleTable, Orientation};
use crate::diag::{Diagnostic, nearest};
use crate::model::Centre;
use crate::plan::module::MODULE_DWELLS;
use crate::plan::timing::ACCELERATION_MM_S2;

/// Chosen poses of a plan: with more the run takes hours, in which everything drifts.
const MOST_POINTS: u32 = 1000;

/// Digital outputs that a controller has.
const OUTPUTS: std::ops::RangeInclusive<u32> = 1..=4096;

impl Job {
    /// Reads a job file.
    ///
    /// # Errors
    /// Names the line of an unknown or missing key, or of a value that cannot be.
    pub fn from_toml(file: &str, text: &str) -> Result<Self, Diagnostic> {
        let job: Self = toml::from_str(text).map_err(|error| hinted(file, text, &error))?;
        job.check().map_err(|(place, message)| match line_of(text, place) {
            Some(line) => {
                let column = text.lines().nth(line - 1).map_or(0, |l| l.len() - l.trim_start().len()) + 1;
                Diagnostic::position(file, text, line, column, message)
            }
            None => Diagnostic::file(file, message),
        })?;
        Ok(job)
    }

    /// The base balls by their numbers.
    pub fn balls(&self) -> Vec<Centre> {
        let ball = |table: &CentreTable| Centre { id: table.id as usize, position: table.xyz_mm.into() };
        self.centres.iter().map(ball).collect()
    }

    /// What the types do not say.
    pub(crate) fn check(&self) -> Result<(), Wrong> {
        self.check_bar()?;
        self.check_motion()?;
        if self.centres.is_empty() || self.circles.is_empty() && self.optimise.is_none() {
            let missing = if self.centres.is_empty() { "[[centre]]" } else { "[[circle]] or [optimise]" };
            return Err((("", 0, ""), format!("has no {missing} table: a job needs one at least")));
        }
        self.check_optimise()?;
        self.check_tool()?;
        for (at, obstacle) in self.obstacles.iter().enumerate() {
            check_obstacle(at, obstacle)?;
        }
        for (at, centre) in self.centres.iter().enumerate() {
            check_centre(at, centre)?;
        }
        for (at, circle) in self.circles.iter().enumerate() {
            self.check_circle(at, circle)?;
        }
        Ok(())
    }

    fn check_bar(&self) -> Result<(), Wrong> {
        let bar = &self.bar;
        let place = |key| ("[bar]", 0, key);
        positive(place("length_mm"), bar.length_mm)?;
        positive(place("sigma_um"), bar.sigma_um)?;
        let [low, high] = bar.stroke_mm;
        if !(low.abs() < bar.length_mm && high.abs() < bar.length_mm && low < high) {
            let message =
                format!("stroke_mm = [{low}, {high}] must be [low, high], both less than the bar's length");
            return Err((place("stroke_mm"), message));
        }
        positive(place("radius_mm"), bar.radius_mm)?;
        if let Some(u) = bar.length_u_mm {
            positive(place("length_u_mm"), u)?;
        }
        let optional = [
            ("temperature_c", bar.temperature_c, [-50.0, 100.0]),
            ("expansion_per_k", bar.expansion_per_k, [-1e-3, 1e-3]),
        ];
        for (key, value, range) in optional {
            value.map_or(Ok(()), |value| within(place(key), value, range))?;
        }
        let margin = bar.margin_mm;
        if !(margin >= 0.0 && 2.0 * margin < high - low) {
            let message = format!("margin_mm = {margin} must be at least 0 and leave some of the stroke");
            return Err((place("margin_mm"), message));
        }
        Ok(())
    }

    fn check_optimise(&self) -> Result<(), Wrong> {
        let Some(optimise) = &self.optimise else { return Ok(()) };
        let place = |key| ("[optimise]", 0, key);
        if !(6..=MOST_POINTS).contains(&optimise.points) {
            return Err((
                place("points"),
                format!("points = {} must be in 6..{MOST_POINTS}", optimise.points),
            ));
        }
        if !(10 * optimise.points..=100_000).contains(&optimise.candidates) {
            let message = format!("candidates = {} must be in 10 * points..100000", optimise.candidates);
            return Err((place("candidates"), message));
        }
        if !(6..=MOST_POINTS).contains(&optimise.stage_points) {
            let message = format!("stage_points = {} must be in 6..{MOST_POINTS}", optimise.stage_points);
            return Err((place("stage_points"), message));
        }
        match optimise.workspace_mm {
            Some([low, high]) if !corners(low, high) => {
                Err((place("workspace_mm"), "workspace_mm must be its lowest and its highest corner".into()))
            }
            _ => Ok(()),
        }
    }

    fn check_tool(&self) -> Result<(), Wrong> {
        let tool = &self.tool;
        let place = |key| ("[tool]", 0, key);
        check_cup(place("cup_axis"), place("cup_limit_deg"), tool.cup_axis, tool.cup_limit_deg)?;
        positive(place("radius_mm"), tool.radius_mm)?;
        positive(place("arm_radius_mm"), tool.arm_radius_mm)
    }

    fn check_motion(&self) -> Result<(), Wrong> {
        let motion = &self.motion;
        let place = |key| ("[motion]", 0, key);
        positive(place("feed_mm_s"), motion.feed_mm_s)?;
        // A bar is mounted: the speed of a controller's test mode is the most.
        if motion.feed_mm_s > 250.0 {
            return Err((place("feed_mm_s"), format!("feed_mm_s = {} is above 250", motion.feed_mm_s)));
        }
        positive(place("turn_deg_s"), motion.turn_deg_s)?;
        for (key, value) in [("settle_s", motion.settle_s), ("dwell_s", motion.dwell_s)] {
            positive(place(key), value)?;
            if value > 60.0 {
                return Err((place(key), format!("{key} = {value} is above 60 s")));
            }
        }
        for (key, frame) in [("tool", motion.tool), ("base", motion.base)] {
            frame.iter().flatten().try_for_each(|value| finite(place(key), *value))?;
        }
        let (strobe, [first, last]) = (motion.outputs.strobe, motion.outputs.index);
        let outputs = ("outputs", 0, "");
        if !(OUTPUTS.contains(&strobe) && OUTPUTS.contains(&first) && first.checked_add(7) == Some(last)) {
            let message = format!(
                "outputs: strobe = {strobe}, index = [{first}, {last}]: outputs are 1 to 4096, the index has eight"
            );
            return Err((outputs, message));
        }
        if (first..=last).contains(&strobe) {
            return Err((outputs, format!("outputs: the strobe {strobe} is one of the index's")));
        }
        let limits = &self.limits;
        let place = |key| ("[limits]", 0, key);
        for (key, value, most) in [
            ("min_a5_deg", limits.min_a5_deg, 90.0),
            ("min_elbow_deg", limits.min_elbow_deg, 90.0),
            ("min_overhead_mm", limits.min_overhead_mm, 1e4),
            ("max_stroke_risk", limits.max_stroke_risk, 1.0),
            ("min_clearance_mm", limits.min_clearance_mm, 1e4),
        ] {
            if !(0.0..=most).contains(&value) {
                return Err((place(key), format!("{key} = {value} must be in 0..{most}")));
            }
        }
        Ok(())
    }

    fn check_circle(&self, at: usize, circle: &CircleTable) -> Result<(), Wrong> {
        let place = |key| ("[[circle]]", at, key);
        let number = at + 1;
        let centres = self.centres.len();
        if circle.centre == 0 || circle.centre as usize > centres {
            let message =
                format!("circle {number}: centre = {}: there are {centres} [[centre]] tables", circle.centre);
            return Err((place("centre"), message));
        }
        match (circle.plane, circle.normal) {
            (Some(_), Some(_)) => {
                return Err((place("normal"), format!("circle {number}: has both `plane` and `normal`")));
            }
            (None, None) => {
                return Err((place(""), format!("circle {number}: has neither `plane` nor `normal`")));
            }
            (None, Some(normal)) => direction_vector(place("normal"), "normal", normal)?,
            (Some(_), None) => {}
        }
        if let Some(radius) = circle.radius_mm {
            positive(place("radius_mm"), radius)?;
        }
        finite(place("start_deg"), circle.start_deg)?;
        finite(place("tilt_deg"), circle.tilt_deg)?;
        finite(place("spin_deg"), circle.spin_deg)?;
        if !(circle.arc_deg > 0.0 && circle.arc_deg <= 360.0) {
            let message =
                format!("circle {number}: arc_deg = {} must be above 0, at most 360", circle.arc_deg);
            return Err((place("arc_deg"), message));
        }
        if circle.mode == Mode::Continuous {
            return self.check_continuous(at, circle);
        }
        let passes = if circle.direction == Direction::Both { 2 } else { 1 };
        let dwells = circle.dwells();
        if circle.points < 3 || dwells > MODULE_DWELLS {
            let message = format!(
                "circle {number}: points = {} in {passes} pass(es) is {dwells} dwells with the reference poses: \
                 a circle has 3 points at least and {MODULE_DWELLS} dwells at most",
                circle.points
            );
            return Err((place("points"), message));
        }
        circle.turns_deg.iter().flatten().try_for_each(|turn| finite(place("turns_deg"), *turn))?;
        match (circle.orientation, circle.amplitude_deg) {
            (Orientation::Seed | Orientation::Random | Orientation::Optimal, Some(amplitude)) => {
                if !(0.0..=180.0).contains(&amplitude) {
                    let message = format!("circle {number}: amplitude_deg = {amplitude} must be in 0..180");
                    return Err((place("amplitude_deg"), message));
                }
            }
            (Orientation::Fixed | Orientation::Turning, Some(_)) => {
                let message = format!("circle {number}: this orientation has no amplitude_deg");
                return Err((place("amplitude_deg"), message));
            }
            (_, None) => {}
        }
        Ok(())
    }

    fn check_continuous(&self, at: usize, circle: &CircleTable) -> Result<(), Wrong> {
        let place = |key| ("[[circle]]", at, key);
        let number = at + 1;
        if !(12..=3600).contains(&circle.points) {
            let message = format!("circle {number}: points = {} must be in 12..3600", circle.points);
            return Err((place("points"), message));
        }
        if circle.orientation != Orientation::Fixed || circle.amplitude_deg.is_some() {
            let message = format!(
                "circle {number}: a continuous circle is one motion: it needs orientation = \"fixed\""
            );
            return Err((place("orientation"), message));
        }
        if !(circle.overshoot_deg > 0.0 && circle.overshoot_deg <= 180.0) {
            let message = format!(
                "circle {number}: overshoot_deg = {} must be above 0, at most 180",
                circle.overshoot_deg
            );
            return Err((place("overshoot_deg"), message));
        }
        let feed = self.motion.feed_mm_s;
        let radius_mm = circle.radius_mm.unwrap_or(self.bar.length_mm);
        let needed_deg = (0.5 * feed * feed / ACCELERATION_MM_S2 / radius_mm).to_degrees();
        if circle.overshoot_deg < needed_deg {
            let message = format!(
                "circle {number}: overshoot_deg = {} is too short: the robot needs {needed_deg:.1} degrees to come \
                 to {feed} mm/s",
                circle.overshoot_deg
            );
            return Err((place("overshoot_deg"), message));
        }
        Ok(())
    }
}

fn check_centre(at: usize, centre: &CentreTable) -> Result<(), Wrong> {
    let place = |key| ("[[centre]]", at, key);
    if centre.id as usize != at + 1 {
        return Err((place("id"), format!("id = {} must be {}: centres count from 1", centre.id, at + 1)));
    }
    for value in centre.xyz_mm {
        finite(place("xyz_mm"), value)?;
    }
    for value in centre.taught_deg.iter().flatten() {
        finite(place("taught_deg"), *value)?;
    }
    check_cup(place("cup_axis"), place("cup_limit_deg"), centre.cup_axis, centre.cup_limit_deg)
}

fn check_cup(
    axis_place: Place,
    limit_place: Place,
    axis: Option<[f64; 3]>,
    limit: Option<f64>,
) -> Result<(), Wrong> {
    match (axis, limit) {
        (Some(axis), Some(limit)) => {
            direction_vector(axis_place, "cup_axis", axis)?;
            if !(limit > 0.0 && limit <= 180.0) {
                let message = format!("cup_limit_deg = {limit} must be above 0, at most 180");
                return Err((limit_place, message));
            }
            Ok(())
        }
        (None, None) => Ok(()),
        (Some(_), None) => Err((axis_place, "cup_axis needs a cup_limit_deg beside it".into())),
        (None, Some(_)) => Err((limit_place, "cup_limit_deg needs a cup_axis beside it".into())),
    }
}

fn check_obstacle(at: usize, obstacle: &ObstacleTable) -> Result<(), Wrong> {
    let place = |key| ("[[obstacle]]", at, key);
    if let ObstacleTable::Box { low_mm, high_mm } = obstacle {
        low_mm.iter().try_for_each(|value| finite(place("low_mm"), *value))?;
        high_mm.iter().try_for_each(|value| finite(place("high_mm"), *value))?;
    }
    match *obstacle {
        ObstacleTable::Box { low_mm, high_mm } if !corners(low_mm, high_mm) => {
            Err((place("low_mm"), "a box needs its lowest corner as low_mm, its highest as high_mm".into()))
        }
        ObstacleTable::Box { .. } => Ok(()),
        ObstacleTable::Cylinder { from_mm, to_mm, radius_mm } => {
            from_mm.iter().try_for_each(|value| finite(place("from_mm"), *value))?;
            to_mm.iter().try_for_each(|value| finite(place("to_mm"), *value))?;
            let along = [to_mm[0] - from_mm[0], to_mm[1] - from_mm[1], to_mm[2] - from_mm[2]];
            direction_vector(place("to_mm"), "to_mm - from_mm", along)?;
            positive(place("radius_mm"), radius_mm)
        }
        ObstacleTable::Floor { z_mm } => finite(place("z_mm"), z_mm),
    }
}

/// TOML's own message, and the known key that an unknown one may mean.
fn hinted(file: &str, text: &str, error: &toml::de::Error) -> Diagnostic {
    let diagnostic = Diagnostic::toml(file, text, error);
    let mut words = error.message().split('`').skip(1).step_by(2);
    let meant = words.next().and_then(|word| nearest(word, words));
    match meant {
        Some(key) if error.message().starts_with("unknown") => {
            diagnostic.help(format!("did you mean `{key}`?"))
        }
        _ => diagnostic,
    }
}

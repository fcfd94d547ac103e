//! The steps of a job's circles, before axis angles are known.
//!
//! One module for each circle: a PTP motion to the start pose (the bar is off; the program halts there to have it mounted),
//! three sync markers, the points along the arc, two markers. The start pose is one step before the first point, so that
//! the first point is reached as all others are.
//!
//! The reference pose is the first point. It is visited after every twenty points and after the last, along the circle,
//! the shorter way round: on this path the bar's length is known to stay in the stroke. For eighty points this takes
//! three turns of the circle. Where a job has too few dwells for the time code, the points of its last circle are
//! visited again.
//!
//! A continuous circle has no reference pose; its passes go over the circle from end to end (`pass.rs`).
//!
//! Between two circles about one base ball the bar stays on: the robot goes along the sphere in short chords to the next
//! start pose, where the next module begins. Before a circle about another base ball the bar is taken off.

use std::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};

use super::circle::REFERENCE_EVERY;
use super::job::{CircleDirection, CircleMode, CircleTable, Job, JobBar};
use super::path::between;
use super::timing::MIN_CODED_DWELLS;
use super::{MotionKind, PlanStep, PlannedCircle, PoseKind, RouteLeg, StepBuilder};
use crate::plan::job::JobFinding;
use dbbd_model::design::Candidate;
use dbbd_model::robot::{AXES, Pose};

/// Length of a sync marker where the stroke has room, mm.
const MARKER_MM: f64 = 0.3;
/// Shares of [`MARKER_MM`] that are tried where the length is not known well enough.
const SMALLER: [f64; 3] = [1.0, 0.7, 0.4];
/// Angle of a step aside between two dwells at one place, rad.
pub(super) const DETOUR: f64 = 0.035;
/// Sync markers at the start and the end of a module: short moves out and back.
const START_MARKERS: u32 = 3;
const END_MARKERS: u32 = 2;

/// All steps of the job's circles; an error only in a job that was not checked.
pub(super) fn circle_steps(job: &Job) -> Result<Vec<PlanStep>, JobFinding> {
    let mut walk = StepBuilder::new(job);
    let with_dwells = (1_u32..).zip(&job.circles).filter(|(_, table)| table.mode == CircleMode::Dwell);
    let last_of_dwells = with_dwells.last().map(|(number, _)| number);
    for (number, table) in (1_u32..).zip(&job.circles) {
        let circle = PlannedCircle::new(job, table, number)?;
        let angles = table.angles();
        let Some(&first) = angles.first() else { continue };
        let sense = if table.direction == CircleDirection::Cw { -1.0 } else { 1.0 };
        // An obstacle may be outside an open arc: its start is inside.
        let outside = if table.is_closed() { sense } else { -sense } * table.step();
        let start = match table.mode {
            CircleMode::Continuous => first - sense * table.overshoot_deg.to_radians(),
            CircleMode::Dwell => first - outside,
        };
        if walk.centre == table.centre {
            // The sagitta uses at most half of the stroke that is left inwards, and is not larger than a marker.
            let sagitta = (0.5 * room(&job.bar, circle.radius)).clamp(0.02, MARKER_MM);
            walk.along_the_sphere(circle.centre, &circle.pose(start, 0.0), sagitta);
        }
        (walk.circle, walk.centre) = (number, table.centre);
        walk.push(PoseKind::Transit, MotionKind::Ptp, circle.pose(start, 0.0));
        let out = marker(&job.bar, circle.radius);
        walk.markers(MarkerPosition::Start, circle.pose(start, 0.0), circle.pose(start, out));
        let end = match table.mode {
            CircleMode::Continuous => {
                let sweep = table.sweep_deg().to_radians();
                let passes = angles.chunks(table.points as usize);
                passes.fold(start, |at, points| walk.pass(&circle, at, points, sweep))
            }
            CircleMode::Dwell => {
                let end = walk.dwells(&circle, table, start, outside);
                if last_of_dwells == Some(number) {
                    let chosen = job.optimise.as_ref().map_or(0, |wanted| wanted.points as usize);
                    let missing = MIN_CODED_DWELLS.saturating_sub(walk.dwell_count() + chosen);
                    // Go on round the circle: two visits of one pose in a row look alike by the axes.
                    let further = angles.iter().cycle().skip(1).take(missing);
                    further.fold(end, |at, angle| {
                        walk.visit(&circle, [at, end + angle - first], PoseKind::Reference, outside);
                        end + angle - first
                    })
                } else {
                    end
                }
            }
        };
        walk.markers(MarkerPosition::Finish, circle.pose(end, 0.0), circle.pose(end, out));
    }
    Ok(walk.steps)
}

/// Length of a sync marker outwards, mm, within the stroke; negative (inwards) where there is more room.
fn marker(bar: &JobBar, radius: f64) -> f64 {
    let reading = radius - bar.length_mm;
    let out = bar.stroke_mm[1] - bar.margin_mm - reading;
    let inwards = reading - bar.stroke_mm[0] - bar.margin_mm;
    if out >= MARKER_MM || out >= inwards { MARKER_MM.min(0.8 * out) } else { -MARKER_MM.min(0.8 * inwards) }
}

/// The shortest marker that [`safe_marker`] tries at a radius, mm.
pub(super) fn min_marker(bar: &JobBar, radius: f64) -> f64 {
    marker(bar, radius) * SMALLER[SMALLER.len() - 1]
}

/// The longest marker at a radius that `is_safe` accepts, mm; the shortest marker where it accepts none.
pub(super) fn safe_marker(bar: &JobBar, radius: f64, is_safe: impl Fn(f64) -> bool) -> f64 {
    let markers = SMALLER.map(|share| marker(bar, radius) * share);
    markers.into_iter().find(|out| is_safe(*out)).unwrap_or(min_marker(bar, radius))
}

/// Length of the stroke that is left inwards at a radius, mm.
pub(super) fn room(bar: &JobBar, radius: f64) -> f64 {
    radius - bar.length_mm - bar.stroke_mm[0] - bar.margin_mm
}

#[derive(Clone, Copy)]
pub(super) enum MarkerPosition {
    Start,
    Finish,
}

impl StepBuilder {
    pub(super) fn new(job: &Job) -> Self {
        Self { steps: Vec::new(), circle: 0, centre: 0, dwell_s: job.motion.dwell_s }
    }

    /// Adds a PTP motion to a pose with these axis angles, rad.
    pub(super) fn ptp(&mut self, pose: Pose, axes: [f64; AXES]) {
        self.push(PoseKind::Transit, MotionKind::Ptp, pose);
        self.at(axes);
    }

    /// Adds the motions along a way, with a dwell at its end.
    pub(super) fn go(&mut self, way: RouteLeg, to: &Candidate, kind: PoseKind) {
        match way {
            RouteLeg::Arc(aux) => {
                self.push(PoseKind::Transit, MotionKind::Circ, aux);
                self.push(kind, MotionKind::Circ, to.pose);
            }
            RouteLeg::Chords(between) => {
                for (pose, axes) in between {
                    self.line(PoseKind::Transit, pose);
                    self.at(axes);
                }
                self.line(kind, to.pose);
            }
        }
        self.at(to.axes);
    }

    /// Adds a straight line to a pose.
    pub(super) fn line(&mut self, kind: PoseKind, pose: Pose) {
        self.push(kind, MotionKind::Lin, pose);
    }

    /// The axis angles (rad) of the last step are known.
    fn at(&mut self, axes: [f64; AXES]) {
        if let Some(step) = self.steps.last_mut() {
            step.axes = Some(axes);
        }
    }

    /// The number of dwells so far.
    pub(super) fn dwell_count(&self) -> usize {
        self.steps.iter().filter(|step| step.dwell_s > 0.0).count()
    }

    /// Adds the sync markers of an end of the module: short moves from `rest` out and back.
    pub(super) fn markers(&mut self, end: MarkerPosition, rest: Pose, out: Pose) {
        let count = match end {
            MarkerPosition::Start => START_MARKERS,
            MarkerPosition::Finish => END_MARKERS,
        };
        for _ in 0..count {
            self.line(PoseKind::Transit, out);
            self.line(PoseKind::Transit, rest);
        }
    }

    fn push(&mut self, kind: PoseKind, motion: MotionKind, pose: Pose) {
        let dwell_s = if kind == PoseKind::Transit { 0.0 } else { self.dwell_s };
        let (circle, centre) = (self.circle, self.centre);
        self.steps.push(PlanStep { circle, centre, kind, motion, pose, dwell_s, axes: None });
    }

    /// Adds an arc along the circle, through its middle, with a dwell at its end.
    fn arc(&mut self, circle: &PlannedCircle<'_>, from: f64, to: f64, kind: PoseKind) {
        let end = circle.pose(to, 0.0);
        let mut aux = circle.pose(0.5 * (from + to), 0.0);
        aux.rotation = between(&circle.orientation(from), &end.rotation, 0.5);
        self.push(PoseKind::Transit, MotionKind::Circ, aux);
        self.push(kind, MotionKind::Circ, end);
    }

    /// Adds the dwells of a circle from `start`, with the visits of the reference pose. Returns the angle of the last
    /// dwell. `outside` is the step towards the side without points.
    fn dwells(&mut self, circle: &PlannedCircle<'_>, table: &CircleTable, start: f64, outside: f64) -> f64 {
        let angles = table.angles();
        let Some(&first) = angles.first() else { return start };
        let mut at = start;
        for (count, &angle) in (1_u32..).zip(&angles) {
            self.visit(circle, [at, angle], PoseKind::Measure, outside);
            at = angle;
            if count % REFERENCE_EVERY == 0 || count as usize == angles.len() {
                let turns = if table.is_closed() { ((at - first) / TAU).round() } else { 0.0 };
                let reference = first + turns * TAU;
                self.visit(circle, [at, reference], PoseKind::Reference, outside);
                at = reference;
            }
        }
        at
    }

    /// Adds a move along the circle to a dwell, with a step aside if the robot is already at its pose.
    fn visit(&mut self, circle: &PlannedCircle<'_>, [from, to]: [f64; 2], kind: PoseKind, outside: f64) {
        let mut at = from;
        if (to - at).abs() < 1e-9 {
            // Without a move there would be no interval between the two dwells.
            at = to + outside.clamp(-DETOUR, DETOUR);
            self.push(PoseKind::Transit, MotionKind::Lin, circle.pose(at, 0.0));
        }
        self.arc(circle, at, to, kind);
    }

    /// Adds a pass without stops from angle `from`. Returns the angle at which it stops.
    fn pass(&mut self, circle: &PlannedCircle<'_>, from: f64, points: &[f64], sweep: f64) -> f64 {
        let sense = points.first().map_or(1.0, |first| (first - from).signum());
        // With auxiliary points far apart, the rounding of the poses hardly moves the circle.
        let third = sense * sweep.min(TAU) / 3.0;
        for share in [1.0, 2.0] {
            self.push(PoseKind::Transit, MotionKind::Circ, circle.pose(from + share * third, 0.0));
        }
        for angle in points {
            self.push(PoseKind::Measure, MotionKind::Circ, circle.pose(*angle, 0.0));
            if let Some(step) = self.steps.last_mut() {
                step.dwell_s = 0.0;
            }
        }
        let end = from + sense * sweep;
        self.push(PoseKind::Transit, MotionKind::Circ, circle.pose(end, 0.0));
        end
    }

    /// Adds a way along the sphere about the base ball at `centre` to the pose `to`, in chords of at most this sagitta,
    /// mm.
    fn along_the_sphere(&mut self, centre: Vector3<f64>, to: &Pose, sagitta: f64) {
        let Some(from) = self.steps.last().map(|step| step.pose) else {
            return;
        };
        let (start, end) = (from.position - centre, to.position - centre);
        let (u, v) = (start.normalize(), end.normalize());
        let radius = end.norm();
        let risen = Pose { rotation: from.rotation, position: centre + u * radius };
        if (radius - start.norm()).abs() > 1e-9 {
            self.push(PoseKind::Transit, MotionKind::Lin, risen);
        }
        let normal = u.cross(&v);
        let angle = normal.norm().atan2(u.dot(&v));
        // Between opposite points any great circle will do.
        let axis = if normal.norm() > 1e-9 {
            normal.normalize()
        } else if u.z.abs() < 0.9 {
            u.cross(&Vector3::z()).normalize()
        } else {
            u.cross(&Vector3::x()).normalize()
        };
        if angle < 1e-9 {
            self.push(PoseKind::Transit, MotionKind::Lin, *to);
            return;
        }
        let widest = 2.0 * (1.0 - sagitta / radius).clamp(0.0, 1.0).acos();
        let chords = (angle / widest).ceil().clamp(1.0, 1000.0) as u32;
        for chord in 1..=chords {
            let share = f64::from(chord) / f64::from(chords);
            let turned = Rotation3::from_scaled_axis(axis * (angle * share)) * u;
            let rotation = between(&from.rotation, &to.rotation, share);
            let pose = Pose { rotation, position: centre + turned * radius };
            self.push(PoseKind::Transit, MotionKind::Lin, if chord == chords { *to } else { pose });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::example::job;

    fn bar(stroke_mm: [f64; 2], margin_mm: f64) -> JobBar {
        JobBar { stroke_mm, margin_mm, ..job("").bar }
    }

    /// The bar has 300 mm. The marker goes outwards while there are 0.3 mm, else to the side with more room, at most
    /// 0.8 of it.
    #[test]
    fn marker_goes_to_the_side_with_room() {
        for (stroke_mm, margin_mm, radius, expected) in [
            ([-2.0, 6.0], 0.5, 300.0, 0.3),
            ([-2.0, 6.0], 0.5, 305.4, -0.3),
            ([-2.0, 6.0], 0.5, 305.1, 0.3),
            ([-0.1, 0.2], 0.0, 300.0, 0.16),
            ([-0.1, 0.2], 0.0, 300.1, -0.16),
        ] {
            let bar = bar(stroke_mm, margin_mm);
            assert!((marker(&bar, radius) - expected).abs() < 1e-9, "{stroke_mm:?} {radius}");
            assert!((min_marker(&bar, radius) - 0.4 * expected).abs() < 1e-9);
        }
        assert!((room(&bar([-2.0, 6.0], 0.5), 301.25) - 2.75).abs() < 1e-9);
    }

    #[test]
    fn marker_shrinks_until_it_is_safe() {
        let bar = bar([-2.0, 6.0], 0.5);
        for (most, expected) in [(1.0, 0.3), (0.25, 0.21), (0.15, 0.12), (0.0, 0.12)] {
            assert!((safe_marker(&bar, 300.0, |out| out <= most) - expected).abs() < 1e-9, "{most}");
        }
    }

    fn kinds(steps: &[PlanStep], kind: PoseKind) -> Vec<usize> {
        (0..steps.len()).filter(|at| steps[*at].kind == kind).collect()
    }

    /// The angle of a step about the ball of the example, degrees.
    fn angle_deg(step: &PlanStep) -> f64 {
        let out = step.pose.position - Vector3::new(1300.0, 0.0, 800.0);
        out.y.atan2(out.x).to_degrees().rem_euclid(360.0)
    }

    #[test]
    fn circle_begins_one_step_before_its_first_point_and_returns_to_it() {
        let job = job("[[circle]]\nplane = \"XY\"\npoints = 24\nstart_deg = 10.0\norientation = \"fixed\"\n");
        let steps = circle_steps(&job).expect("the job is possible");
        assert_eq!(steps[0].motion, MotionKind::Ptp);
        assert!((angle_deg(&steps[0]) - 355.0).abs() < 1e-9);
        // Three markers are six moves; then each point has an auxiliary point.
        let out = (steps[1].pose.position - Vector3::new(1300.0, 0.0, 800.0)).norm();
        assert!((out - 300.3).abs() < 1e-9);
        assert!(steps[..7].iter().all(|step| step.kind == PoseKind::Transit && step.dwell_s == 0.0));
        let measured = kinds(&steps, PoseKind::Measure);
        assert_eq!((measured.len(), measured[0]), (24, 8));
        for (number, at) in measured.iter().enumerate() {
            let expected = (10.0 + 15.0 * number as f64) % 360.0;
            assert!((angle_deg(&steps[*at]) - expected).abs() < 1e-9, "{number}");
        }
        let references = kinds(&steps, PoseKind::Reference);
        assert_eq!(references.len(), 2);
        assert!(references.iter().all(|at| (angle_deg(&steps[*at]) - 10.0).abs() < 1e-9));
        // The reference is visited after twenty points, and at the end before two markers.
        assert!(measured[19] < references[0] && references[0] < measured[20]);
        assert_eq!(references[1] + 1 + 4, steps.len());
    }

    /// The auxiliary point is halfway on the shorter way: the last point at 355 degrees goes on to the first.
    #[test]
    fn reference_is_reached_along_the_circle() {
        let job = job("[[circle]]\nplane = \"XY\"\npoints = 24\nstart_deg = 10.0\n");
        let steps = circle_steps(&job).expect("the job is possible");
        let references = kinds(&steps, PoseKind::Reference);
        let before = |at: usize| angle_deg(&steps[at - 1]);
        // The reference is reached from the twentieth point, at 295 degrees, and from the last one.
        assert!((before(references[0]) - 332.5).abs() < 1e-9);
        assert!((before(references[1]) - 2.5).abs() < 1e-9);
    }

    /// Five points and the visit at the end are six dwells.
    #[test]
    fn few_points_are_visited_again() {
        let circle = "[[circle]]\nplane = \"XY\"\npoints = 5\n";
        let count = |tables: &str| {
            let steps = circle_steps(&job(tables)).expect("the job is possible");
            kinds(&steps, PoseKind::Reference).len()
        };
        assert_eq!(count(circle), 7);
        assert_eq!(count(&circle.repeat(3)), 3);
        assert_eq!(count(&format!("{circle}[optimise]\npoints = 20\n")), 1);
    }

    #[test]
    fn open_arc_starts_inside_and_steps_aside_at_its_turn() {
        let keys = "plane = \"XY\"\npoints = 4\narc_deg = 90.0\ndirection = \"both\"\n";
        let steps = circle_steps(&job(&format!("[[circle]]\n{keys}"))).expect("the job is possible");
        assert!((angle_deg(&steps[0]) - 30.0).abs() < 1e-9);
        let measured = kinds(&steps, PoseKind::Measure);
        let angles: Vec<f64> = measured.iter().map(|at| angle_deg(&steps[*at]).round() % 360.0).collect();
        assert_eq!(angles, [0.0, 30.0, 60.0, 90.0, 90.0, 60.0, 30.0, 0.0]);
        // Two dwells at 90 degrees: a step of 0.035 rad to the inside lies between them.
        let aside = &steps[measured[3] + 1];
        assert_eq!((aside.kind, aside.motion), (PoseKind::Transit, MotionKind::Lin));
        assert!((angle_deg(aside) - (90.0 - 0.035_f64.to_degrees())).abs() < 1e-9);
    }

    #[test]
    fn continuous_pass_has_its_auxiliary_points_at_thirds_of_its_sweep() {
        let keys = "plane = \"XY\"\npoints = 13\narc_deg = 120.0\nmode = \"continuous\"\novershoot_deg = 15.0\n\
                    orientation = \"fixed\"\ndirection = \"both\"\n";
        let steps = circle_steps(&job(&format!("[[circle]]\n{keys}"))).expect("the job is possible");
        let circ: Vec<f64> = steps
            .iter()
            .filter(|step| step.motion == MotionKind::Circ)
            .map(|step| (angle_deg(step) + 15.0).rem_euclid(360.0).round())
            .collect();
        // The passes go from -15 to 135 degrees and back, counted from -15; each pass has its stop.
        let points = (0..13).map(|point| 15.0 + 10.0 * f64::from(point));
        let forward = [50.0, 100.0].into_iter().chain(points.clone()).chain([150.0]);
        let backward = [100.0, 50.0].into_iter().chain(points.rev()).chain([0.0]);
        assert_eq!(circ, forward.chain(backward).collect::<Vec<f64>>());
        assert!(steps.iter().all(|step| step.dwell_s == 0.0));
    }

    /// A chord of half angle w has the sagitta r (1 - cos w): 0.3 mm at 300 mm give 2.5626 degrees, and 90 degrees 18 chords.
    #[test]
    fn way_on_the_sphere_has_chords_of_the_sagitta() {
        let job = job("");
        let mut builder = StepBuilder::new(&job);
        let centre = Vector3::new(5.0, 6.0, 7.0);
        let pose = |x: f64, y: f64, turn: f64| Pose {
            rotation: dbbd_model::robot::pose::rot_z(turn),
            position: centre + Vector3::new(x, y, 0.0),
        };
        builder.push(PoseKind::Transit, MotionKind::Ptp, pose(300.0, 0.0, 0.0));
        builder.along_the_sphere(centre, &pose(0.0, 300.0, 0.9), 0.3);
        assert_eq!(builder.steps.len(), 1 + 18);
        let ninth = &builder.steps[9].pose;
        let half = 300.0 * 0.5_f64.sqrt();
        assert!((ninth.position - centre - Vector3::new(half, half, 0.0)).norm() < 1e-9);
        assert!((ninth.rotation - pose(0.0, 0.0, 0.45).rotation).norm() < 1e-9);
        assert_eq!(builder.steps.last().map(|step| step.pose), Some(pose(0.0, 300.0, 0.9)));
        // From another radius the ball first goes straight out to the new radius.
        builder.along_the_sphere(centre, &pose(0.0, 310.0, 0.9), 0.3);
        assert_eq!(builder.steps.len(), 1 + 18 + 2);
        assert!((builder.steps[19].pose.position - centre).norm() - 310.0 < 1e-9);
    }

    #[test]
    fn steps_carry_the_dwell_of_the_job_and_the_axes_where_they_are_known() {
        let mut job = job("");
        job.motion.dwell_s = 0.7;
        let mut builder = StepBuilder::new(&job);
        let pose = Pose::identity();
        builder.ptp(pose, [0.1; AXES]);
        let candidate = Candidate { ball: dbbd_model::robot::BallId::FIRST, axes: [0.2; AXES], pose };
        builder.go(RouteLeg::Chords(vec![(pose, [0.15; AXES]); 2]), &candidate, PoseKind::Measure);
        builder.go(RouteLeg::Arc(pose), &candidate, PoseKind::Reference);
        let dwells: Vec<f64> = builder.steps.iter().map(|step| step.dwell_s).collect();
        assert_eq!(dwells, [0.0, 0.0, 0.0, 0.7, 0.0, 0.7]);
        let first: Vec<Option<f64>> =
            builder.steps.iter().map(|step| step.axes.map(|axes| axes[0])).collect();
        assert_eq!(first, [Some(0.1), Some(0.15), Some(0.15), Some(0.2), None, Some(0.2)]);
    }
}

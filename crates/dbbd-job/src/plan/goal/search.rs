//! The bars and the balls that a run for a goal can have, and the error that poses about them leave.

use nalgebra::Vector3;

use super::kept::{GoalRun, KeptErrors, RunClass};
use super::outcome::GoalPoint;
use crate::plan::circle::REFERENCE_EVERY;
use crate::plan::job::{BaseBallTable, GoalTable, Job, JobBar, PlaceTable};
use crate::plan::prior::length_sigma_mm;
use crate::plan::workspace::goal_poses;
use crate::plan::{CandidateConditions, PlanKinematics, PlanningCell, PlanningPrior};
use dbbd_model::design::placement::{
    BallPlace, PlacedBalls, Placement, PlacementSearch, RunPrices, all_poses,
};
use dbbd_model::design::{Candidate, tool_rows};
use dbbd_model::estimation::{Posterior, with_mean_joint_errors};
use dbbd_model::math::map_items;
use dbbd_model::robot::Robot;

/// Poses of each tool over which an error is taken while balls are compared.
const SEARCH_POSES: usize = 100;
/// Candidate poses about a place.
const CANDIDATES: usize = 150;
/// A place with fewer candidates is hardly in reach.
const MIN_CANDIDATES: usize = 40;
/// Places that are compared.
const MAX_PLACES: usize = 9;
/// Points along each edge of a box of which places are taken.
const ALONG_EDGE: usize = 5;
/// Largest numbers of balls and poses of a run.
const MAX_BALLS: usize = 4;
const MAX_POSES: usize = 360;
/// Less than this share of a goal is better than any run needs: drawn robots keep one to six times the error of the search.
const ENOUGH: f64 = 0.1;
/// Smallest number of poses of a run.
const MIN_POSES: usize = 12;
/// A ball in an open cup leans to the side by at most this, degrees.
const CUP_LIMIT_DEG: f64 = 90.0;
/// Way of the tool ball from one chosen pose to the next, in lengths of the bar: 2.8 m in the plan of examples/demo.toml, whose bar
/// has 0.9 m.
const WAY_PER_LENGTH: f64 = 3.0;
/// Poses for each visit of a reference pose.
const REFERENCES: f64 = REFERENCE_EVERY as f64;
/// A longer run is worth a point of the curve if it leaves at most this share of the error.
const WORTH: f64 = 0.97;
/// Points of the curve of minutes and uncertainty.
const CURVE_POINTS: usize = 8;

/// All runs that are compared for a goal.
pub(super) struct GoalSearch<'a> {
    job: &'a Job,
    bars: Vec<BarRuns>,
}

/// The sets of balls about which a run may measure with one bar.
struct BarRuns {
    bar: JobBar,
    balls: Vec<BaseBallTable>,
    places: Vec<BallPlace>,
    sets: Vec<PlacedBalls>,
    prices: RunPrices,
}

impl<'a> GoalSearch<'a> {
    /// `known` is what is known of the robot and of the balls that are mounted already.
    pub(super) fn new(job: &'a Job, goal: &'a GoalTable, robot: &Robot, known: &PlanningPrior) -> Self {
        let bars = job.bars().into_iter().map(|bar| BarRuns::new(job, goal, bar, robot, known)).collect();
        Self { job, bars }
    }

    fn of(&self, run: &GoalRun) -> (&BarRuns, &PlacedBalls) {
        let bar = &self.bars[run.bar];
        (bar, &bar.sets[run.set])
    }

    /// All bars with all sets of balls.
    fn sets(&self) -> impl Iterator<Item = GoalRun> {
        let bars = self.bars.iter().enumerate();
        bars.flat_map(|(bar, runs)| {
            let sets = runs.sets.iter().enumerate();
            sets.map(move |(set, balls)| GoalRun { bar, set, balls: balls.places.len(), poses: 0 })
        })
    }

    /// The shortest run that leaves at most the root mean square `error_mm` of its bar and balls; `None` for those that are not
    /// wanted.
    pub(super) fn shortest(&self, error_mm: impl Fn(&GoalRun) -> Option<f64>) -> Option<GoalRun> {
        self.shortest_beyond(&[], error_mm)
    }

    /// As [`Self::shortest`]; runs about the balls of those that were too short have more poses.
    pub(super) fn shortest_beyond(
        &self,
        short: &[GoalRun],
        error_mm: impl Fn(&GoalRun) -> Option<f64>,
    ) -> Option<GoalRun> {
        let with_poses = |run: GoalRun| {
            let (_, set) = self.of(&run);
            let of_short = short.iter().filter(|other| other.is_about(&run)).map(GoalRun::with_more_poses);
            let poses = of_short.fold(set.poses_for(error_mm(&run)?)?, usize::max).max(MIN_POSES);
            (poses <= set.errors_mm.len()).then_some(GoalRun { poses, ..run })
        };
        let runs = self.sets().filter_map(with_poses);
        runs.min_by(|a, b| self.time_s(a).total_cmp(&self.time_s(b)))
    }

    /// The bars with each number of balls.
    pub(super) fn classes(&self) -> Vec<RunClass> {
        let mut classes: Vec<RunClass> = self.sets().map(|run| run.class()).collect();
        classes.sort_unstable();
        classes.dedup();
        classes
    }

    /// The run that leaves least, in at most these minutes, of those that are wanted.
    pub(super) fn best_in(&self, minutes: Option<f64>, wanted: impl Fn(&GoalRun) -> bool) -> Option<GoalRun> {
        let with_poses = |run: GoalRun| {
            let (bar, set) = self.of(&run);
            let left_s = minutes.map_or(f64::INFINITY, |minutes| 60.0 * minutes - self.time_s(&run));
            let poses = ((left_s / bar.prices.pose_s).max(0.0) as usize).min(set.errors_mm.len());
            (poses >= MIN_POSES).then_some(GoalRun { poses, ..run })
        };
        let runs = self.sets().filter(wanted).filter_map(with_poses);
        runs.min_by(|a, b| self.error_mm(a).total_cmp(&self.error_mm(b)))
    }

    /// The root mean square of the position error that a run leaves, mm.
    pub(super) fn error_mm(&self, run: &GoalRun) -> f64 {
        let (_, set) = self.of(run);
        run.poses.checked_sub(1).and_then(|at| set.errors_mm.get(at)).copied().unwrap_or(f64::INFINITY)
    }

    /// The time of a run, s.
    pub(super) fn time_s(&self, run: &GoalRun) -> f64 {
        self.time_with(run, self.of(run).0.prices.pose_s, run.poses)
    }

    /// The time of a run with this time and number of poses, s.
    pub(super) fn time_with(&self, run: &GoalRun, pose_s: f64, poses: usize) -> f64 {
        let (bar, set) = self.of(run);
        RunPrices { pose_s, ..bar.prices }.time_s(set.places.len() - self.job.centres.len(), poses)
    }

    /// By how much a pose takes longer than it was estimated, if a plan has this time for it and for its share of the references.
    pub(super) fn slower(&self, run: &GoalRun, pose_s: f64) -> f64 {
        pose_s * (1.0 + 1.0 / REFERENCES) / self.of(run).0.prices.pose_s
    }

    /// The job of a run: with its bar, its balls and its number of poses.
    pub(super) fn job(&self, run: &GoalRun) -> Job {
        let (bar, set) = self.of(run);
        let balls = set.places.iter().filter_map(|at| bar.balls.get(*at).cloned());
        let mut optimise = self.job.optimise.clone().unwrap_or_default();
        optimise.points = u32::try_from(run.poses).unwrap_or(u32::MAX);
        Job {
            bar: bar.bar.clone(),
            optimise: Some(optimise),
            places: Vec::new(),
            bar_choices: Vec::new(),
            ..self.job.with_centres(balls)
        }
    }

    /// The poses of a run as the search chose them.
    pub(super) fn poses(&self, run: &GoalRun) -> Vec<Candidate> {
        let (bar, set) = self.of(run);
        let places: Vec<&BallPlace> = set.places.iter().filter_map(|at| bar.places.get(*at)).collect();
        let all = all_poses(&places);
        set.chosen.iter().take(run.poses).filter_map(|at| all.get(*at).cloned()).collect()
    }

    /// A run as a point of the curve. `slower` see [`Self::slower`].
    pub(super) fn point(&self, run: &GoalRun, judged: &KeptErrors, slower: f64) -> GoalPoint {
        let (bar, set) = self.of(run);
        GoalPoint {
            minutes: self.time_with(run, slower * bar.prices.pose_s, run.poses) / 60.0,
            position_mm: judged.kept_mm(run, self.error_mm(run)),
            bar_mm: bar.bar.length_mm,
            balls: set.places.len(),
            poses: run.poses,
        }
    }

    /// The best runs of ever longer times, as long as more time helps.
    pub(super) fn curve(&self, judged: &KeptErrors, slower: f64) -> Vec<GoalPoint> {
        let with_poses = |run: GoalRun| {
            let most = self.of(&run).1.errors_mm.len();
            (MIN_POSES..=most).map(move |poses| self.point(&GoalRun { poses, ..run }, judged, slower))
        };
        let mut points: Vec<GoalPoint> = self.sets().flat_map(with_poses).collect();
        points.sort_by(|a, b| a.minutes.total_cmp(&b.minutes));
        let mut best_mm = f64::INFINITY;
        points.retain(|point| {
            let helps = point.position_mm < WORTH * best_mm;
            best_mm = if helps { point.position_mm } else { best_mm };
            helps
        });
        let (step, last) = (points.len().div_ceil(CURVE_POINTS).max(1), points.len().saturating_sub(1));
        let is_shown = |at: usize| at.is_multiple_of(step) || at == last;
        (0..).zip(points).filter(|(at, _)| is_shown(*at)).map(|(_, point)| point).collect()
    }
}

impl BarRuns {
    fn new(job: &Job, goal: &GoalTable, bar: JobBar, robot: &Robot, known: &PlanningPrior) -> Self {
        let job = Job { bar, ..job.clone() };
        let prices = prices(&job, goal);
        let tools = goal_poses(&job, robot, SEARCH_POSES);
        let of_maker = PlanningPrior::of_maker(&job.with_centres([]), robot);
        let before = if known.lengths() > 0 { &known.posterior } else { &of_maker };
        let with_joint_errors = |known: Posterior| {
            if known.coefficients() > 0 { known } else { with_mean_joint_errors(&known, robot.controller()) }
        };
        let places = places(&job, robot, &with_joint_errors(before.clone()));
        let (balls, places): (Vec<_>, Vec<_>) = places.into_iter().unzip();
        let prior = |balls: &[Vector3<f64>]| {
            let further = balls.iter().skip(before.model.balls.len());
            with_joint_errors(further.fold(before.clone(), |known, ball| known.with_ball(*ball)))
        };
        let errors = |known: &Posterior| tool_rows(known, &tools);
        let search = PlacementSearch {
            placement: Placement {
                prior: &prior,
                errors: &errors,
                sigma_mm: length_sigma_mm(&job, robot.controller()),
            },
            places: &places,
            given: job.centres.len(),
            max_balls: MAX_BALLS,
            max_poses: MAX_POSES,
            enough_mm: ENOUGH * goal.position_mm,
            prices,
        };
        let sets = search.sets(goal.position_mm);
        Self { bar: job.bar, balls, places, sets, prices }
    }
}

/// The prices of runs of a job in time.
fn prices(job: &Job, goal: &GoalTable) -> RunPrices {
    let Job { bar, motion, .. } = job;
    let estimated_s = motion.settle_s + motion.dwell_s + WAY_PER_LENGTH * bar.length_mm / motion.feed_mm_s;
    RunPrices {
        bar_s: 60.0 * goal.minutes_per_bar,
        ball_s: 60.0 * goal.minutes_per_ball,
        pose_s: goal.seconds_per_pose.unwrap_or(estimated_s) * (1.0 + 1.0 / REFERENCES),
    }
}

/// The balls that are mounted already, then balls at places of the job that have enough poses, with these poses.
fn places(job: &Job, robot: &Robot, known: &Posterior) -> Vec<(BaseBallTable, BallPlace)> {
    let with_poses = |table: &BaseBallTable| (table.clone(), ball_place(job, robot, table, known));
    let mounted = map_items(&job.centres, with_poses);
    let free: Vec<BaseBallTable> = job.places.iter().flat_map(points).collect();
    let mut free = map_items(&free, with_poses);
    free.retain(|(_, place)| place.poses.len() >= MIN_CANDIDATES);
    let free = spread(free, MAX_PLACES.saturating_sub(mounted.len()));
    mounted.into_iter().chain(free).collect()
}

/// A ball with poses about it that keep the limits of the job, whatever their risk.
fn ball_place(job: &Job, robot: &Robot, table: &BaseBallTable, known: &Posterior) -> BallPlace {
    let job = job.with_centres([table.clone()]);
    let position = Vector3::from(table.xyz_mm);
    if job.check_places(robot.controller()).is_err() {
        return BallPlace { position, poses: Vec::new() };
    }
    let (rig, prior) = (PlanKinematics::new(&job, robot), PlanningPrior::datasheet(&job, robot));
    let anywhere = PlanningCell::new(rig, &prior, 1, &[0.0; 6]);
    let about = BaseBallTable { id: 1, ..table.clone() };
    let branch = anywhere.branches(&about, known).first().copied();
    let conditions = CandidateConditions { risk: 1.0, branch, near: None };
    let poses = branch.map_or(Vec::new(), |_| anywhere.candidates(1, CANDIDATES, &conditions));
    BallPlace { position, poses }
}

/// The points of a table where a ball can stand.
fn points(place: &PlaceTable) -> Vec<BaseBallTable> {
    let Some([low, high]) = place.box_mm else {
        return place.xyz_mm.map(|xyz_mm| ball(place, xyz_mm)).into_iter().collect();
    };
    let along = |axis: usize| {
        let parts = if high[axis] > low[axis] { ALONG_EDGE - 1 } else { 0 };
        let at = move |part: usize| low[axis] + (high[axis] - low[axis]) * part as f64 / parts.max(1) as f64;
        (0..=parts).map(at)
    };
    let points = along(0).flat_map(|x| along(1).flat_map(move |y| along(2).map(move |z| [x, y, z])));
    points.map(|xyz_mm| ball(place, xyz_mm)).collect()
}

/// The ball at a point of a place.
fn ball(place: &PlaceTable, xyz_mm: [f64; 3]) -> BaseBallTable {
    let PlaceTable { cup_axis, cup_limit_deg, .. } = *place;
    let cup_limit_deg = cup_axis.map(|_| cup_limit_deg.unwrap_or(CUP_LIMIT_DEG));
    BaseBallTable { id: 1, xyz_mm, serial: None, cup_axis, cup_limit_deg, taught_deg: None }
}

/// `count` balls that are far from each other: the one with most poses, then always the one that is farthest from those.
fn spread(mut balls: Vec<(BaseBallTable, BallPlace)>, count: usize) -> Vec<(BaseBallTable, BallPlace)> {
    balls.sort_by_key(|(_, place)| std::cmp::Reverse(place.poses.len()));
    let mut kept: Vec<(BaseBallTable, BallPlace)> = Vec::new();
    while kept.len() < count && !balls.is_empty() {
        let away = |at: usize| {
            let from = |(_, other): &(_, BallPlace)| (other.position - balls[at].1.position).norm();
            kept.iter().map(from).fold(f64::INFINITY, f64::min)
        };
        let Some(farthest) = (0..balls.len()).rev().max_by(|a, b| away(*a).total_cmp(&away(*b))) else {
            break;
        };
        kept.push(balls.remove(farthest));
    }
    kept
}
